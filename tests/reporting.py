"""The three tables of a small imaginary scenario, by hand, and the pages of a small campaign."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import pandas as pd

from ggbench.judging.cases import CASES
from ggbench.judging.pairs import PAIRS
from ggbench.judging.summary import METRICS
from ggbench.results.digest import Digest

CAUSALITY = {"ins": "none", "factor-graph[mode=batch]": "batch"}
ERRORS = {
    "ins": 100.0,
    "ekf": 5.0,
    "ukf": 5.04,
    "gaussian-sum": 4.0,
    "factor-graph[mode=batch]": 2.0,
}
"""RMS errors in the first case; each further case has twice those of the one before."""


def metrics(
    cases: int = 2, errors: Mapping[str, float] = ERRORS, runs: Mapping[str, int] | None = None
) -> pd.DataFrame:
    """Metrics of the whole flight and the settled window; errors of the whole flight are twice."""
    rows = [
        metric(
            f"c{number}", label, window, factor * 2.0**number * error, (runs or {}).get(label, 40)
        )
        for number in range(cases)
        for label, error in errors.items()
        for window, factor in (("whole", 2.0), ("settled", 1.0))
    ]
    return pd.DataFrame(rows, columns=[*METRICS])


def metric(case: str, label: str, window: str, rms: float, runs: int = 40) -> dict[str, Any]:
    causality = CAUSALITY.get(label, "filter")
    bound = (2.0 if causality == "batch" else 4.0) * 2.0 ** int(case[1:])
    bound *= 2.0 if window == "whole" else 1.0
    return dict.fromkeys(METRICS, math.nan) | {
        "case": case,
        "estimator": label,
        "name": label.partition("[")[0],
        "parameters": "",
        "causality": causality,
        "window": window,
        "runs": runs,
        "failed": 0,
        "diverged": 0,
        "draws": runs,
        "rms_m": rms,
        "rms_lo": 0.9 * rms,
        "rms_hi": 1.1 * rms,
        "bound_m": bound,
        "efficiency": rms / bound,
        "success": 0.0 if causality == "none" else 1.0,
        "consistency": "" if causality == "none" else "consistent",
        "recommended": label == "ekf" and window == "settled",
        "seconds_per_run": 0.0123,
        "lost": 0,
        "as_ins": False,
        "noise_fit": "",
    }


def cases(count: int = 2, **changes: Any) -> pd.DataFrame:
    rows = [
        dict.fromkeys(CASES, math.nan)
        | {
            "case": f"c{number}", "title": f"case {number}", "right_model": True, "width": 0.1,
            "situation": "plain", "bound_m": 4.0 * 2.0**number, "ins_m": 100.0 * 2.0**number,
            "runs": 40, "recommended": "ekf", "best": "gaussian-sum", "gain": "better",
            "best_smoother": "factor-graph[mode=batch]", "consistent": 3, "duration_s": 60.0,
            "speed_mps": 50.0, "height_m": 1000.0, "not_recommended": "",
        }
        | changes
        for number in range(count)
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=[*CASES])


def pairs(*rows: tuple[str, str, str, float, int, str]) -> pd.DataFrame:
    """Pairs from case, first, second, ratio, runs, verdict."""
    named = [
        dict.fromkeys(PAIRS, math.nan)
        | dict(zip(("case", "first", "second", "error_ratio", "runs", "verdict"), row, strict=True))
        for row in rows
    ]
    return pd.DataFrame(named, columns=[*PAIRS])


def digest(name: str, title: str = "A title", **tables: Any) -> Digest:
    manifest = {"scenario": name, "title": title, "results_version": 1}
    settled = metrics()[lambda table: table["window"] == "settled"]
    held = {"metrics": settled, "cases": cases(), "pairs": pairs()} | tables
    return Digest(manifest, **held)


def scenario(**attributes: Any) -> SimpleNamespace:
    """As much of a scenario as views need."""
    return SimpleNamespace(
        **({"sweep": None, "comparisons": (), "claims": (), "cases": (), "shown": {}} | attributes)
    )
