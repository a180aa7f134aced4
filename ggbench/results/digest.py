"""What the league needs of a campaign, as a few small text files beside its report.

A league is made from many campaigns, which need not have been run on one day or kept: what it needs
of each is little, and stands beside the report that was made of it.

``manifest.json``  what was run, as the results folder has it, and the field's correlation lengths.
``settled.csv``    the summary's rows of the settled window.
``pairs.csv``      the paired comparisons of that window: who succeeds, and is nearer.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..judging import success
from ..judging.field_scale import correlation_m
from ..judging.summary import EXTRA_COLUMNS, SUMMARY_COLUMNS
from ..spec import scenario
from ..spec.scenario import Scenario
from .folder import Results
from .store import StoreError

FOLDER = "data"
"""Name of the folder, in that of a report's figures."""
_KEPT = (
    "ggbench", "results_version", "versions", "scenario", "scenario_hash", "scenario_text", "notes",
    "seed", "runs", "date", "machine", "assumptions",
)  # fmt: skip
_PAIRED = ("case", "window", "first", "second", "runs", *success.PAIRED_COLUMNS)
_TEXTS = dict.fromkeys(
    ("scenario", "case", "estimator", "label", "parameters", "causality", "window", "first",
     "second", "verdict"), str,
)  # fmt: skip
"""Columns of text, whatever it looks like: a case may be named 10, or null."""
_DIGITS = "%.6g"


@dataclass(frozen=True, eq=False)
class Digest:
    """A campaign as the league knows it.

    Attributes
    ----------
    scenario : with the cases that were run.
    manifest : what was run, when, on what; ``left_out`` has estimator to why it was not run.
    summary, pairs : rows of the settled window.
    correlation_m : case to the correlation length of the field along its track [m]; NaN without.
    """

    scenario: Scenario
    manifest: Mapping[str, Any]
    summary: pd.DataFrame
    pairs: pd.DataFrame
    correlation_m: Mapping[str, float]


def write(results: Results, folder: Path) -> None:
    """Write the digest of a results folder into a folder, which is made if need be.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    summary = results.summary()
    pairs = pd.DataFrame(columns=_PAIRED)
    if results.scenario.campaign.league:  # else nobody compares its estimators over scenarios
        pairs = results.paired()
    counts = summary.groupby(["label", "case"])["runs"].max()
    names = [case.name for case in results.scenario.cases]
    manifest = {key: results.manifest[key] for key in _KEPT} | {
        "inputs": results.manifest.get("inputs", []),
        "cases": names,
        "done": {
            label: min(int(counts.get((label, name), 0)) for name in names)
            for label in results.labels
        },
        "left_out": results.manifest.get("left_out", {}),
        "correlation_m": {name: _scale(results, name) for name in names},
    }
    text = json.dumps(manifest, indent=1, ensure_ascii=False)
    (folder / "manifest.json").write_text(text + "\n", encoding="utf-8")
    for file, table in (
        ("settled.csv", summary[summary["window"] == "settled"]),
        ("pairs.csv", pairs.loc[pairs["window"] == "settled", list(_PAIRED)]),
    ):
        content = table.to_csv(index=False, float_format=_DIGITS)
        (folder / file).write_text(content, encoding="utf-8")


def _scale(results: Results, case: str) -> float | None:
    """Return the field's correlation length along the track of a case [m], None without any."""
    arrays = results.arrays(case)
    if "vertical" not in arrays:
        return None
    read = _rows_at(arrays["gradient_times"], arrays["times"])
    found = correlation_m(arrays["track"][read], arrays["vertical"])
    return None if math.isnan(found) else float(_DIGITS % found)


def _rows_at(wanted: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return at which of the epochs the gradients were read; each has one."""
    return np.searchsorted(times, wanted - 1e-6)


def read(folder: Path) -> Digest:
    """Return the digest in a folder.

    Raises
    ------
    StoreError
        If a file is missing or damaged.
    ScenarioError
        If this version cannot read the scenario.
    """
    try:
        manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
        summary = _table(folder / "settled.csv", (*SUMMARY_COLUMNS, *EXTRA_COLUMNS))
        pairs = _table(folder / "pairs.csv", _PAIRED)
        for key in (*_KEPT, "done", "left_out"):
            manifest[key]
        named = manifest["scenario_text"], manifest["scenario"], manifest["notes"]
        lengths = {k: math.nan if v is None else v for k, v in manifest["correlation_m"].items()}
        cases = manifest["cases"]
    except OSError as error:
        raise StoreError(f"cannot read {error.filename}: {error.strerror}") from None
    except (ValueError, KeyError, AttributeError, TypeError) as error:
        raise StoreError(
            f"{folder} is damaged: {error!r}; the report's command writes it anew"
        ) from None
    loaded = scenario.from_text(*named).select(cases)
    return Digest(loaded, manifest, summary, pairs, lengths)


def _table(path: Path, columns: Iterable[str]) -> pd.DataFrame:
    """Return a table that has these columns; raises OSError or ValueError if it has not."""
    text = io.StringIO(path.read_text(encoding="utf-8"))
    table = pd.read_csv(text, low_memory=False, dtype=_TEXTS, keep_default_na=False, na_values=[""])
    missing = [name for name in columns if name not in table]
    if missing:
        raise ValueError(f"{path.name} has no column {missing[0]}")
    return table
