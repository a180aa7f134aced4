"""Runs of the standard suite that are shipped: what every estimator of the roster achieved.

They are written from a results folder by ``make suite`` and read as a table of runs, so that an
estimator is compared with others that are not flown again.
"""

from __future__ import annotations

import importlib.resources
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..errors import GGBenchError, text_of
from ..files import written_whole
from ..judging.run_errors import WINDOWS
from ..judging.summary import runs_table
from ..results.folder import RUN_COLUMNS, Results
from ..spec import scenario

SUITE = "suite"
FILE = "data/suite_runs.npz"
REFERENCE = "ekf"
"""The estimator that every other one is compared with."""
_OF_A_WINDOW = ("position_ms", "velocity_ms", "nees", "coverage")
FIGURES = (
    "final_position_error_m", *(f"{window}_{name}" for window in WINDOWS for name in _OF_A_WINDOW)
)  # fmt: skip
"""Numbers of a run of an estimator that are stored, to seven digits."""
_BOUNDS = ("bound_position_ms", "bound_velocity_ms", "oracle_position_ms")
SHARED = (
    "required_m", "final_ins_error_m", *(f"{window}_{n}" for window in WINDOWS for n in _BOUNDS)
)  # fmt: skip
"""Numbers of a run that estimators of one bound share."""
TRUTHS = ("diverged", "false_fix")


class ScoreError(GGBenchError):
    """An estimator cannot be scored, or a card cannot be used."""


@dataclass(frozen=True)
class StoredRuns:
    """The runs of the roster in the suite.

    Attributes
    ----------
    header : ``scenario_hash``, ``results_version``, ``ggbench``, ``seed``, ``runs``; ``estimators``
        with name, parameters, causality and bound of each; ``recommended``, by case and kind of
        estimators; ``seconds``, by case and estimator.
    runs : table of runs as a results folder has it, NaN where nothing is stored.
    """

    header: Mapping[str, Any]
    runs: pd.DataFrame


def write(results: Results, path: Path) -> None:
    """Write the runs of a results folder of the suite.

    Raise ScoreError if estimators have not flown the same runs, or the file cannot be written.
    """
    runs, metrics, cases = results.runs(), results.metrics(), results.cases()
    names, labels = [case.name for case in results.scenario.cases], results.labels
    count = len(runs["run"].unique())
    if len(runs) != len(names) * len(labels) * count:
        raise ScoreError(
            f"{results.folder} holds {len(runs)} runs; {len(labels)} estimators in {len(names)} "
            f"cases of {count} runs each would be {len(labels) * len(names) * count}"
        )
    ordered = runs.set_index(["case", "estimator", "run"]).sort_index()
    index = pd.MultiIndex.from_product([names, labels, range(count)], names=ordered.index.names)
    table = ordered.loc[index]
    shape = (len(names), len(labels), count, -1)
    made = table.groupby(level="estimator")[["name", "parameters", "causality", "bound"]].first()
    bounds = made["bound"][labels].tolist()
    kinds = sorted(set(bounds))
    owners = [bounds.index(kind) for kind in kinds]
    truths = [table["status"] == "ok", *(table[name] for name in TRUTHS)]
    settled = metrics[metrics["window"] == "settled"].set_index(["case", "estimator"])
    header = {
        "scenario_hash": results.manifest["scenario_hash"],
        "results_version": results.manifest["results_version"],
        "ggbench": results.manifest["ggbench"],
        "seed": results.manifest["seed"],
        "runs": count,
        "cases": names,
        "bounds": kinds,
        "estimators": made.loc[labels].to_dict("index"),
        "recommended": {row.case: _recommended(row) for row in cases.itertuples()},
        # One digit: the times of one machine.
        "seconds": {
            name: {
                label: float(f"{settled['seconds_per_run'][name, label]:.0e}") for label in labels
            }
            for name in names
        },
    }
    shared = table[list(SHARED)].to_numpy(np.float32).reshape(shape)
    with written_whole(path, ScoreError) as temporary, temporary.open("wb") as file:
        np.savez_compressed(
            file,
            header=np.frombuffer(json.dumps(header).encode(), np.uint8),
            figures=table[list(FIGURES)].to_numpy(np.float32).reshape(shape),
            truths=np.stack(truths, axis=-1).reshape(shape),
            shared=shared[:, owners],
        )


def _recommended(row: Any) -> dict[str, dict[str, Any]]:
    """Return the estimator to compare with by kind, and whether it is recommended."""
    return {
        "causal": {"label": row.recommended or row.best, "recommended": bool(row.recommended)},
        "smoother": {"label": row.best_smoother, "recommended": False},
    }


def header() -> dict[str, Any]:
    """Return the header of the shipped runs, without the runs.

    Raise ScoreError if the file cannot be read.
    """
    return _stored(None, ())[0]


def read(file: Traversable | Path | None = None) -> StoredRuns:
    """Return the shipped runs, or those of a file.

    Raise ScoreError if the file cannot be read.
    """
    found, parts = _stored(file, ("figures", "truths", "shared"))
    return StoredRuns(found, _table(found, **parts))


def _stored(
    file: Traversable | Path | None, names: Iterable[str]
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the header of a file, the shipped one by default, and some of its arrays."""
    file = file or importlib.resources.files("ggbench.scenarios") / FILE
    try:
        with file.open("rb") as opened, np.load(opened) as stored:
            return json.loads(stored["header"].tobytes()), {name: stored[name] for name in names}
    except (OSError, ValueError, KeyError) as error:
        raise ScoreError(f"cannot read the stored runs in {file}: {text_of(error)}") from None


def _table(
    header: Mapping[str, Any], figures: np.ndarray, truths: np.ndarray, shared: np.ndarray
) -> pd.DataFrame:
    """Return the table of runs of arrays (cases, estimators, runs, columns)."""
    suite = scenario.load(SUITE)
    labels, count = list(header["estimators"]), int(header["runs"])
    numbers, tables = range(count), []
    for c, name in enumerate(header["cases"]):
        draws = [suite.case(name).cluster(run) for run in numbers]
        for e, label in enumerate(labels):
            held = header["estimators"][label]
            columns = dict(zip(FIGURES, figures[c, e].T.astype(float), strict=True))
            own = shared[c, header["bounds"].index(held["bound"])]
            columns |= dict(zip(SHARED, own.T.astype(float), strict=True))
            columns |= dict(zip(TRUTHS, truths[c, e, :, 1:].T, strict=True))
            columns |= {
                "assumption": "", "case": name, "estimator": label, "seed": header["seed"],
                "run": numbers, "draw": draws, "reason": "", "remark": "", "command": "",
                "problem": "", "cold": False, "seconds": header["seconds"][name][label],
                "status": np.where(truths[c, e, :, 0], "ok", "failed"), **held,
            }  # fmt: skip
            tables.append(pd.DataFrame(columns))
    found = pd.concat(tables, ignore_index=True)
    return found.reindex(columns=list(runs_table([], RUN_COLUMNS).columns))


if __name__ == "__main__":
    import sys

    write(Results(Path(sys.argv[1])), Path(sys.argv[2]))
