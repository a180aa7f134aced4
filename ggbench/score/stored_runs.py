"""Stored runs of the standard suite by a roster (a named set of estimators).

``make suite`` copies these runs from a results folder into the package. A scored estimator is
compared with them, so the other estimators need not be run again.
"""

from __future__ import annotations

import importlib.resources
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..errors import GGBenchError, text_of
from ..files.archives import read_arrays
from ..files.writing import written_whole
from ..judging.run_errors import WINDOWS
from ..results.folder import RUN_COLUMNS, Results

SUITE = "suite"
FILE = "data/suite_runs.npz"
REFERENCE = "ekf"
"""Estimator with which every other estimator is compared."""
_OF_A_WINDOW = (
    "position_ms",
    "velocity_ms",
    "nees",
    "coverage",
    "bound_position_ms",
    "bound_velocity_ms",
    "oracle_position_ms",
)
NUMBERS = (
    "final_position_error_m",
    "final_ins_error_m",
    "required_m",
    *(f"{window}_{name}" for window in WINDOWS for name in _OF_A_WINDOW),
)
"""Numbers of a run that are stored, to seven digits."""
_TYPES = dict.fromkeys(NUMBERS, np.float32) | {
    "diverged": bool,
    "false_fix": bool,
    "failed": bool,
    "run": np.uint32,
    "draw": np.uint32,
    "cell": np.uint32,
}
"""Columns of the file and their types; ``cell`` is an index into ``cells`` of the header."""
_CELL = ["case", "estimator"]


class ScoreError(GGBenchError):
    """An estimator cannot be scored, or a card cannot be used."""


@dataclass(frozen=True)
class StoredRuns:
    """Runs of all estimators of the roster in the suite.

    Attributes
    ----------
    header : ``scenario_hash``, ``results_version``, ``ggbench`` (version of the package), ``seed``,
        ``runs`` (number of runs of each case), ``cells`` and ``recommended``. ``cells`` has an item
        for every case and estimator: name, parameters, causality, name of the bound, and
        ``seconds``, the median time per run [s].
        ``recommended`` has the estimators to compare with, by case and kind (causal or smoother).
    runs : table of runs as in a results folder, NaN for missing values.
    """

    header: Mapping[str, Any]
    runs: pd.DataFrame


def write(results: Results, path: Path) -> None:
    """Write the runs of a results folder of the suite to a file.

    Raise ScoreError if an estimator lacks runs that others have, or the file cannot be written.
    """
    runs, metrics, cases = results.runs(), results.metrics(), results.cases()
    names, labels = [case.name for case in results.scenario.cases], results.labels
    count = len(runs["run"].unique())
    if len(runs) != len(names) * len(labels) * count:
        raise ScoreError(
            f"{results.folder} contains {len(runs)} runs, but {len(labels)} estimators in "
            f"{len(names)} cases of {count} runs need {len(labels) * len(names) * count}"
        )
    groups = runs.groupby(_CELL, sort=False)
    cells = groups[["name", "parameters", "causality", "bound"]].first()
    settled = metrics[metrics["window"] == "settled"].set_index(_CELL)
    # One digit: the times of one machine.
    seconds = settled["seconds_per_run"].loc[cells.index]
    cells["seconds"] = [float(f"{value:.0e}") for value in seconds]
    header = {
        "scenario_hash": results.manifest["scenario_hash"],
        "results_version": results.manifest["results_version"],
        "ggbench": results.manifest["ggbench"],
        "seed": results.manifest["seed"],
        "runs": count,
        "cells": cells.reset_index().to_dict("records"),
        "recommended": {row.case: _recommended(row) for row in cases.itertuples()},
    }
    table = runs.assign(failed=runs["status"] != "ok", cell=groups.ngroup())
    save(StoredRuns(header, table), path)


def save(stored: StoredRuns, path: Path) -> None:
    """Write stored runs to a file: the header, and the table of runs column by column.

    Raise ScoreError if the file cannot be written.
    """
    with written_whole(path, ScoreError) as temporary, temporary.open("wb") as file:
        np.savez_compressed(
            file,
            header=np.frombuffer(json.dumps(stored.header).encode(), np.uint8),
            **{name: stored.runs[name].to_numpy(kind) for name, kind in _TYPES.items()},
        )


def _recommended(row: Any) -> dict[str, dict[str, Any]]:
    """Return the estimator to compare with by kind, and whether it is recommended."""
    return {
        "causal": {"label": row.recommended or row.best, "recommended": bool(row.recommended)},
        "smoother": {"label": row.best_smoother, "recommended": False},
    }


def header() -> dict[str, Any]:
    """Return only the header of the shipped runs.

    Raise ScoreError if the file cannot be read.
    """
    return _stored(None, columns=False)[0]


def read(file: Traversable | Path | None = None) -> StoredRuns:
    """Return the runs of a file, by default the runs shipped with the package.

    Raise ScoreError if the file cannot be read.
    """
    header, columns = _stored(file, columns=True)
    cells = pd.DataFrame(header["cells"])
    kinds = dict.fromkeys(NUMBERS, float) | {"run": int, "draw": int}
    runs = pd.DataFrame(columns).astype(kinds).join(cells, on="cell")
    runs["status"] = np.where(runs["failed"], "failed", "ok")
    texts = dict.fromkeys(("assumption", "problem", "command", "reason", "remark"), "")
    runs = runs.assign(seed=header["seed"], cold=False, **texts)
    return StoredRuns(header, runs.reindex(columns=[*RUN_COLUMNS]))


def _stored(
    file: Traversable | Path | None, columns: bool
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the header of a file, by default the shipped file, and its columns if requested."""
    file = file or importlib.resources.files("ggbench.scenarios") / FILE
    try:
        stored = read_arrays(
            file.read_bytes(),
            ScoreError,
            f"the file of stored runs {file}",
            ["header", *(_TYPES if columns else ())],
        )
        return json.loads(stored.pop("header").tobytes()), stored
    except (OSError, ValueError) as error:
        raise ScoreError(f"cannot read the stored runs in {file}: {text_of(error)}") from None


if __name__ == "__main__":
    import sys

    write(Results(Path(sys.argv[1])), Path(sys.argv[2]))
