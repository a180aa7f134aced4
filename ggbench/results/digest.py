"""Digest of a campaign: tables as small text files, for the page of all scenarios.

``manifest.json``  scenario, estimators and versions.
``metrics.csv``    metrics of the settled window.
``cases.csv``      the cases.
``pairs.csv``      comparisons with the INS, the EKF, and best or recommended estimators.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .csv_cells import csv_text, restored
from .database import StoreError
from .folder import Results

FOLDER = "data"
"""Name of the digest's folder, which is in the folder of a report's figures."""
_KEPT = (
    "ggbench",
    "results_version",
    "versions",
    "scenario",
    "scenario_hash",
    "seed",
    "runs",
    "date",
    "machine",
    "assumptions",
)
_ALWAYS = ("ins", "ekf")
_NAMING = ("recommended", "best", "best_smoother")
"""Columns of cases that name estimators."""
_FILES = ("metrics", "cases", "pairs")
_TEXTS = dict.fromkeys(
    (
        "case",
        "title",
        "estimator",
        "name",
        "parameters",
        "causality",
        "window",
        "consistency",
        "situation",
        "recommended",
        "best",
        "best_smoother",
        "gain",
        "first",
        "second",
        "verdict",
    ),
    str,
)
"""Columns that are always read as text: a case may be named 10, or null."""
_FLAGS = {"metrics": {"recommended": bool}}
"""Types of columns that replace the type text, by table."""
DIGITS = "%.6g"


@dataclass(frozen=True, eq=False)
class Digest:
    """Tables of a campaign for the page of all scenarios.

    Attributes
    ----------
    manifest : mapping
        Scenario, estimators, versions, date and machine; ``title`` is the scenario's title.
    metrics, cases, pairs : DataFrame
        Tables of :class:`.folder.Results`; ``metrics`` has only the settled window.
    """

    manifest: Mapping[str, Any]
    metrics: pd.DataFrame
    cases: pd.DataFrame
    pairs: pd.DataFrame


def write(results: Results, folder: Path) -> None:
    """Write the digest of a results folder into ``folder``, which is created if missing.

    Raise OSError if a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    metrics, cases = results.metrics(), results.cases()
    manifest = {key: results.manifest[key] for key in _KEPT} | {
        "title": results.scenario.title,
        "inputs": results.manifest.get("inputs", []),
    }
    text = json.dumps(manifest, indent=1, ensure_ascii=False)
    (folder / "manifest.json").write_text(text + "\n", encoding="utf-8")
    write_csv(metrics[metrics["window"] == "settled"], folder / "metrics.csv")
    write_csv(cases, folder / "cases.csv")
    write_csv(decisive_pairs(results.pairs(), cases), folder / "pairs.csv")


def decisive_pairs(pairs: pd.DataFrame, cases: pd.DataFrame) -> pd.DataFrame:
    """Return the pairs with at least one decisive estimator.

    Decisive estimators are the INS, the EKF, and the best and recommended estimators of the pair's
    case.
    """
    named = pairs[["case"]].merge(cases, on="case", how="left")[list(_NAMING)].to_numpy()
    is_decisive = [
        bool({first, second} & {*_ALWAYS, *names})
        for first, second, names in zip(pairs["first"], pairs["second"], named, strict=True)
    ]
    return pairs[np.array(is_decisive, dtype=bool)]


def write_csv(table: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV with six significant digits."""
    path.write_text(csv_text(table, float_format=DIGITS), encoding="utf-8")


def read(folder: Path) -> Digest:
    """Read the digest in a folder.

    Raise StoreError if a file is missing or damaged.
    """
    try:
        manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
        for key in (*_KEPT, "title"):
            manifest[key]
        return Digest(manifest, *(_table(folder, name) for name in _FILES))
    except OSError as error:
        raise StoreError(f"cannot read {error.filename}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise StoreError(f"{folder} is damaged: {error!r}; 'ggbench report' rewrites it") from None


def _table(folder: Path, name: str) -> pd.DataFrame:
    text = io.StringIO((folder / f"{name}.csv").read_text(encoding="utf-8"))
    types = _TEXTS | _FLAGS.get(name, {})
    table = pd.read_csv(text, low_memory=False, dtype=types, keep_default_na=False, na_values=[""])
    if "case" not in table:
        raise ValueError(f"{name}.csv has no column case")
    texts = [key for key in table if types.get(key) is str]
    return restored(table.fillna(dict.fromkeys(texts, "")))
