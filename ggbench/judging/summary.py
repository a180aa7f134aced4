"""Metrics of estimators over many runs: a row per case, estimator and window.

A run is judged once, in the worker (:mod:`.judging.run_errors`). Runs that share a drawn track or
map error form a cluster; intervals are over clusters.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .convergence import median_interval
from .run_errors import COVERAGE, JUDGED, WINDOWS
from .statistics import coverage_band, mean_band, root_ratio_intervals, share_interval

if TYPE_CHECKING:
    import pandas as pd

METRICS = (
    "case",
    "estimator",
    "name",
    "parameters",
    "causality",
    "window",
    "runs",
    "failed",
    "diverged",
    "draws",
    "rms_m",
    "rms_lo",
    "rms_hi",
    "velocity_rms_mps",
    "velocity_rms_lo",
    "velocity_rms_hi",
    "bound_m",
    "velocity_bound_mps",
    "efficiency",
    "efficiency_lo",
    "efficiency_hi",
    "times_ins",
    "oracle_ratio",
    "oracle_lo",
    "oracle_hi",
    "success",
    "success_lo",
    "success_hi",
    "false_fixes",
    "converged_s",
    "converged_lo",
    "converged_hi",
    "nees",
    "nees_lo",
    "nees_hi",
    "coverage",
    "coverage_lo",
    "coverage_hi",
    "nis",
    "nis_lo",
    "nis_hi",
    "consistency",
    "recommended",
    "seconds_per_run",
    "map_evaluations",
    "published_m",
    "published_mps",
)
"""Columns of :func:`metrics`."""
CONSISTENT, CONSERVATIVE, OVERCONFIDENT, UNSAFE = (
    "consistent",
    "conservative",
    "overconfident",
    "unsafe",
)
SMOOTHERS = ("fixed-lag", "batch")
"""Causalities of estimators that see later measurements."""
LEAST_COVERAGE, UNSAFE_COVERAGE, MOST_FALSE = 0.90, 0.50, 0.05
"""Coverage of 95 % below which an estimator is overconfident, and unsafe; share of false fixes."""


def succeeded(runs: pd.DataFrame) -> np.ndarray:
    """Return which runs (R,) finished and ended within the required error."""
    near = runs["final_position_error_m"] <= runs["required_m"]
    return np.asarray(near & (runs["status"] == "ok"))


def metrics(
    runs: pd.DataFrame,
    published: Mapping[str, tuple[float, float]],
    measurements: Mapping[str, Mapping[str, tuple[int, float]]] | None = None,
) -> pd.DataFrame:
    """Return one row per case, estimator and window, with :data:`METRICS`.

    Parameters
    ----------
    runs : table of runs (:meth:`.results.folder.Results.runs`).
    published : case to published RMS errors of position [m] and velocity [m/s].
    measurements : case to window to (epochs, channels): its epochs with a measurement in one run,
        and the mean number of channels then. Where absent, the mean NIS has no band.
    """
    import pandas as pd

    groups = {
        (str(case), str(label)): group
        for (case, label), group in runs.groupby(["case", "estimator"], sort=False)
    }
    finished = {cell: group[group["status"] == "ok"] for cell, group in groups.items()}
    ratios = _ratios(finished)
    rows = []
    for cell, group in groups.items():
        good, first = finished[cell], group.iloc[0]
        case, label = cell
        position, velocity = published.get(case, (math.nan, math.nan))
        common = {
            "case": case,
            "estimator": label,
            "name": first["name"],
            "parameters": first["parameters"],
            "causality": first["causality"],
            "runs": len(group),
            "failed": len(group) - len(good),
            "diverged": int(good["diverged"].sum()),
            "draws": group["draw"].nunique(),
            "recommended": False,
            "published_m": position,
            "published_mps": velocity,
        } | _of_the_end(group)
        for window in WINDOWS:
            row = common | {"window": window}
            if len(good):
                sizes = (measurements or {}).get(case, {}).get(window, (0, 0))
                row |= _window_row(good, window, sizes) | ratios[case, label, window]
                row["consistency"] = consistency(row)
            rows.append(row)
    return _with_ins(pd.DataFrame(rows).reindex(columns=[*METRICS]), finished)


def _of_the_end(group: pd.DataFrame) -> dict[str, Any]:
    """Return success, false fixes and convergence over all runs of an estimator on a case."""
    hits = succeeded(group)
    success = share_interval(hits, group["draw"].to_numpy())
    when = median_interval(group.loc[hits, "converged_s"].dropna().to_numpy())
    found = _with_ends("success", "success", success) | _with_ends("converged_s", "converged", when)
    return found | {"false_fixes": float(group["false_fix"].mean())}


def _with_ends(key: str, stem: str, values: Sequence[float]) -> dict[str, float]:
    """Return a metric and the ends of its interval or band, by the names of their columns."""
    return dict(zip((key, f"{stem}_lo", f"{stem}_hi"), values, strict=True))


_RATIOS = {
    ("rms_m", "rms"): ("position_ms", ""),
    ("velocity_rms_mps", "velocity_rms"): ("velocity_ms", ""),
    ("efficiency", "efficiency"): ("position_ms", "bound_position_ms"),
    ("oracle_ratio", "oracle"): ("position_ms", "oracle_position_ms"),
}
"""Metrics, and stems of the ends of their intervals: root of the ratio of two means; "" is one."""


def _ratios(
    finished: Mapping[tuple[str, str], pd.DataFrame],
) -> dict[tuple[str, str, str], dict[str, float]]:
    """Return :data:`_RATIOS` of every case, estimator and window, with shared bootstrap draws."""
    names = [(*cell, window) for cell, good in finished.items() if len(good) for window in WINDOWS]
    groups = []
    for case, label, window in names:
        good = finished[case, label]
        right = np.isfinite(good[f"{window}_oracle_position_ms"].to_numpy())
        for first, second in _RATIOS.values():
            below = good[f"{window}_{second}"].to_numpy() if second else np.ones(len(good))
            # Where the assumed model is not the true one, no bound says what can be reached.
            below = np.where(right, below, math.nan) if second else below
            groups.append((good[f"{window}_{first}"].to_numpy(), below, good["draw"].to_numpy()))
    found: dict[tuple[str, str, str], dict[str, float]] = {name: {} for name in names}
    wanted = itertools.product(names, _RATIOS)
    for (name, columns), values in zip(wanted, root_ratio_intervals(groups), strict=True):
        found[name] |= _with_ends(*columns, values)
    return found


def _window_row(good: pd.DataFrame, window: str, measurements: tuple[int, float]) -> dict[str, Any]:
    """Return metrics of one window over the runs that finished."""

    def column(key: str) -> np.ndarray:
        return good[f"{window}_{key}"].to_numpy()

    draws, (epochs, channels) = good["draw"].nunique(), measurements
    nees, coverage, innovations = column("nees"), column("coverage"), column("nis")
    present = innovations[~np.isnan(innovations)]  # a run may have no measurement in the window
    nis = float(present.mean()) if len(present) else math.nan
    # Only a filter has innovations: without a mean there is no band.
    read = len(good) * epochs if len(present) else 0
    return {
        "bound_m": math.sqrt(float(column("bound_position_ms").mean())),
        "velocity_bound_mps": math.sqrt(float(column("bound_velocity_ms").mean())),
        "seconds_per_run": _median_seconds(good),
        "map_evaluations": float(good["map_evaluations"].mean()),
        **_with_ends("nees", "nees", (float(nees.mean()), *mean_band(draws, JUDGED))),
        **_with_ends(
            "coverage", "coverage", (float(coverage.mean()), *coverage_band(draws, COVERAGE))
        ),
        **_with_ends("nis", "nis", (nis, *mean_band(read, channels))),
    }


def _median_seconds(good: pd.DataFrame) -> float:
    """Return the median time of a run; the first of a process compiles, and counts if alone."""
    seconds, warm = good["seconds"].to_numpy(), ~good["cold"].to_numpy()
    return float(np.median(seconds[warm] if warm.any() else seconds))


def consistency(row: Mapping[str, Any]) -> str:
    """Return whether an estimator's covariances are right, from its metrics.

    "unsafe": coverage below 50 %, or more than 5 % of the runs end in a false fix; "overconfident":
    coverage below 90 %, or the mean NEES above its 95 % band; "conservative": it lies below;
    "consistent" otherwise; "" without covariances.

    Of consistent estimators at most 2.5 % are called overconfident.
    """
    if math.isnan(row["nees"]):
        return ""
    if row["coverage"] < UNSAFE_COVERAGE or row["false_fixes"] > MOST_FALSE:
        return UNSAFE
    if row["coverage"] < LEAST_COVERAGE or row["nees"] > row["nees_hi"]:
        return OVERCONFIDENT
    return CONSERVATIVE if row["nees"] < row["nees_lo"] else CONSISTENT


MARKS = {OVERCONFIDENT: "†", UNSAFE: "‡"}
"""What marks an estimator in a table."""


def ordered(table: pd.DataFrame, case: str, window: str = "settled") -> list[dict[str, Any]]:
    """Return the rows of a case and window: causal estimators by RMS error, then smoothers."""
    chosen = table[(table["case"] == case) & (table["window"] == window)]
    smoothers = chosen["causality"].isin(SMOOTHERS)
    rows = chosen.assign(_last=smoothers).sort_values(["_last", "rms_m"], kind="stable")
    found: list[dict[str, Any]] = rows.drop(columns="_last").to_dict("records")
    return found


def _with_ins(
    table: pd.DataFrame, finished: Mapping[tuple[str, str], pd.DataFrame]
) -> pd.DataFrame:
    """Fill ``times_ins``: RMS errors over those of the INS, on the runs that both finished."""
    unaided = {
        case: good.set_index("run")
        for (case, _), good in finished.items()
        if len(good) and good["causality"].iloc[0] == "none"
    }

    def ratios() -> Iterator[float]:
        for case, label, window in table[["case", "estimator", "window"]].itertuples(index=False):
            own, ins = finished[case, label].set_index("run"), unaided.get(case)
            common = [] if ins is None else own.index.intersection(ins.index)
            name = f"{window}_position_ms"
            below = 0.0 if ins is None or not len(common) else float(ins.loc[common, name].mean())
            yield math.sqrt(own.loc[common, name].mean() / below) if below else math.nan

    table["times_ins"] = [*ratios()]
    return table
