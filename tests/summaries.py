"""Summaries and paired comparisons of estimators whose errors are made up."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from problems import SMALL

from ggbench.judging.summary import WINDOWS, paired_table, runs_table, summarize
from ggbench.spec import scenario
from ggbench.spec.case import CaseSpec

RUNS = 60
LEFT_OF_THE_INS = 100.0
"""Position error of the INS at the end of every run [m]: a run succeeds within half of it."""


def records(
    label: str, squares: np.ndarray, causality: str = "filter", seconds: float = 0.01,
    failed: int = 0, locked: float | None = None, diverged: bool = False,
) -> list[dict[str, Any]]:  # fmt: skip
    """Records of an estimator with given mean squared errors, the last runs of which failed."""
    figures = {"velocity_ms": 1.0, "nees": 6.0, "nis": math.nan, "coverage": 0.95}
    out = []
    for run, square in enumerate(squares):
        windows = dict.fromkeys(WINDOWS, figures | {"position_ms": float(square)})
        record = {
            "case": "c", "estimator": label, "name": label, "parameters": "", "run": run,
            "causality": causality, "status": "ok", "seconds": seconds, "map_evaluations": 1,
            "diverged": diverged, "windows": windows,
            "final_position_error_m": math.sqrt(square), "final_ins_error_m": LEFT_OF_THE_INS,
        }  # fmt: skip
        if locked is not None:
            record["lock_time_s"] = 5.0 if run < locked * len(squares) else None
            record["false_lock"] = False
        if run >= len(squares) - failed:
            record = {k: v for k, v in record.items() if k != "windows"} | {"status": "failed"}
        out.append(record)
    return out


def tabled(*groups: list[dict[str, Any]]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The summary and the paired comparison of records of one case, whose bounds are 1."""
    flat = [record for group in groups for record in group]
    labels = dict.fromkeys(record["estimator"] for record in flat)
    bounds = {("c", label): dict.fromkeys(WINDOWS, (1.0, 1.0)) for label in labels}
    summary = summarize(runs_table(flat), bounds, {}, "s")
    rows = [
        {"assumption": "", "case": "c", "estimator": r["estimator"], "seed": 1, "run": r["run"]}
        | {
            "status": r["status"],
            "diverged": r["diverged"],
            "lock_time_s": r.get("lock_time_s"),
            "false_lock": r.get("false_lock"),
            "final_position_error_m": r["final_position_error_m"],
            "final_ins_error_m": r["final_ins_error_m"],
        }
        | {
            f"{window}_{name}": r.get("windows", {}).get(window, {}).get(name, math.nan)
            for window in WINDOWS
            for name in ("position_ms", "velocity_ms")
        }
        for r in flat
    ]
    return summary, paired_table(pd.DataFrame(rows), bounds)


def case(**changes: Any) -> CaseSpec:
    base = scenario.parse(scenario.tomllib.loads(SMALL), "s", "s").cases[0]
    return base.model_copy(update={"name": "c", "title": "the case"} | changes)


def chi(seed: int, scale: float = 1.0) -> np.ndarray:
    return scale * np.random.default_rng(seed).chisquare(3, RUNS)


SAME = chi(1)
