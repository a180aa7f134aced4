"""Table of the cases of a campaign: set-up, bounds and verdicts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..gravity.ellipsoid import metres_along
from ..spec.case import CaseSpec
from .field_scale import correlation_m
from .references import DEFAULT_RATIO
from .run_errors import window_mask
from .situations import is_right_model, situation_of
from .summary import SMOOTHERS
from .verdicts import Verdict, verdict

if TYPE_CHECKING:
    import pandas as pd

CASES = (
    "case",
    "title",
    "right_model",
    "situation",
    "correlation_m",
    "width",
    "position_m",
    "required_m",
    "bound_m",
    "smoothing_bound_m",
    "unfiltered_bound_m",
    "ins_m",
    "ins_success",
    "runs",
    "draws",
    "epochs",
    "duration_s",
    "speed_mps",
    "height_m",
    "recommended",
    "best",
    "best_smoother",
    "gain",
    "consistent",
    "not_recommended",
)
"""Columns of :func:`cases`."""
KINDS = ("causal", "smoother")


def verdicts(runs: pd.DataFrame, metrics: pd.DataFrame) -> dict[str, dict[str, Verdict]]:
    """Return the verdicts by kind of estimators (causal, smoother) and by case.

    ``runs`` is the table of runs, and ``metrics`` the table of metrics.
    """
    by_case = list(runs.groupby("case", sort=False))
    return {
        kind: {
            str(case): verdict(own, metrics[metrics["case"] == case], kind) for case, own in by_case
        }
        for kind in KINDS
    }


def cases(
    specs: Sequence[CaseSpec],
    arrays: Mapping[str, Mapping[str, np.ndarray]],
    metrics: pd.DataFrame,
    verdicts: Mapping[str, Mapping[str, Verdict]],
) -> pd.DataFrame:
    """Return a table with a row for each case and the columns :data:`CASES`.

    Parameters
    ----------
    specs : cases of the scenario.
    arrays : arrays (K,) or (K, m) by case, then by name. The first axis is the epoch; for arrays of
        the gradiometer it is the gradient measurement. All runs of a case share its arrays. If
        each run draws its own flight, the arrays are those of run 0.
    metrics : table of metrics of the campaign.
    verdicts : verdicts by kind of estimators ("causal" or "smoother"), then by case.
    """
    import pandas as pd

    rows = [
        _row(spec, arrays[spec.name], metrics[metrics["case"] == spec.name])
        | _judged(verdicts, spec.name)
        for spec in specs
    ]
    return pd.DataFrame(rows).reindex(columns=[*CASES])


def _row(spec: CaseSpec, arrays: Mapping[str, np.ndarray], metrics: pd.DataFrame) -> dict[str, Any]:
    settled = metrics[metrics["window"] == "settled"]
    means = settled.loc[~settled["causality"].isin(SMOOTHERS), "bound_m"].dropna()
    ins = settled[settled["causality"] == "none"]
    scale, track = field_correlation_m(arrays), arrays["track"]
    mask = window_mask(arrays["times"], spec.windows, "settled")
    last = window_mask(arrays["times"], spec.windows, "last20")

    def bound(name: str, of: np.ndarray) -> float:
        squares = arrays.get(f"bound-{name}")
        return math.nan if squares is None else math.sqrt(float(squares[of, 0].mean()))

    required = spec.windows.required_m
    return {
        "case": spec.name,
        "title": spec.title,
        "right_model": is_right_model(spec),
        "situation": situation_of(spec, scale),
        "correlation_m": scale,
        "width": spec.initial_error.position_m / scale,
        "position_m": spec.initial_error.position_m,
        "required_m": DEFAULT_RATIO * bound("filter", last) if required is None else required,
        # Of cases with draws the mean over them, which metrics have.
        "bound_m": float(means.iloc[0]) if len(means) else bound("filter", mask),
        "smoothing_bound_m": bound("batch", mask),
        "unfiltered_bound_m": bound("unfiltered", mask),
        "ins_m": float(ins["rms_m"].iloc[0]) if len(ins) else math.nan,
        "ins_success": float(ins["success"].iloc[0]) if len(ins) else math.nan,
        "runs": int(settled["runs"].max()) if len(settled) else 0,
        "draws": int(settled["draws"].max()) if len(settled) else 0,
        "epochs": len(arrays["times"]),
        "duration_s": float(arrays["times"][-1]),
        "speed_mps": spec.trajectory.speed_mps or _mean_speed(track, arrays["times"]),
        "height_m": float(np.median(track[:, 2])),
    }


def _mean_speed(track: np.ndarray, times: np.ndarray) -> float:
    """Return the mean horizontal speed [m/s] along a track (K, 3), NaN for a single epoch."""
    if len(times) < 2:
        return math.nan
    steps = np.diff(track[:, [1, 0]], axis=0) * metres_along(np.ascontiguousarray(track[:-1]))
    return float(np.hypot(*steps.T).sum() / (times[-1] - times[0]))


def _judged(verdicts: Mapping[str, Mapping[str, Verdict]], case: str) -> dict[str, Any]:
    causal, smoothers = (verdicts[kind].get(case, Verdict()) for kind in KINDS)
    return {
        "recommended": causal.recommended[0] if causal.recommended else "",
        "best": causal.best,
        "best_smoother": smoothers.best,
        "gain": causal.gain,
        "consistent": causal.consistent,
        "not_recommended": causal.reason,
    }


def field_correlation_m(arrays: Mapping[str, np.ndarray]) -> float:
    """Return the correlation length [m] of the field along the track of a case.

    ``arrays`` contains the arrays of the case by name, such as ``track`` (K, 3). The result is NaN
    without a gradiometer, or if :func:`.field_scale.correlation_m` is NaN.
    """
    if "vertical" not in arrays:
        return math.nan
    read = np.searchsorted(arrays["times"], arrays["gradient_times"] - 1e-6)
    return correlation_m(arrays["track"][read], arrays["vertical"])
