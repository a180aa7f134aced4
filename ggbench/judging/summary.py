"""Table of metrics of estimators over many runs, by case, estimator and window.

The input is the table of runs, with the errors of :mod:`.judging.run_errors`. Runs that share a
drawn track or map error form a cluster. Confidence intervals resample clusters.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from . import consistency
from .bootstrap import root_ratio_intervals
from .convergence import median_interval
from .run_errors import COVERAGE, JUDGED, WINDOWS
from .statistics import (
    ALPHA,
    cluster_means,
    coverage_band,
    exact_p,
    mean_band,
    share_interval,
)

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
    "lost",
    "draws",
    "rms_m",
    "rms_lo",
    "rms_hi",
    "median_m",
    "p95_m",
    "kept_rms_m",
    "velocity_rms_mps",
    "velocity_rms_lo",
    "velocity_rms_hi",
    "bound_m",
    "velocity_bound_mps",
    "efficiency",
    "efficiency_lo",
    "efficiency_hi",
    "times_ins",
    "success",
    "success_lo",
    "success_hi",
    "as_ins",
    "false_fixes",
    "converged_s",
    "converged_lo",
    "converged_hi",
    "nees",
    "nees_lo",
    "nees_hi",
    "trimmed_nees",
    "coverage",
    "coverage_lo",
    "coverage_hi",
    "nis",
    "nis_lo",
    "nis_hi",
    "noise_fit",
    "consistency",
    "recommended",
    "seconds_per_run",
    "map_evaluations",
    "published_m",
    "published_mps",
)
"""Columns of :func:`metrics`."""
SMOOTHERS = ("fixed-lag", "batch")
"""Causalities of estimators that use later measurements."""
OFTEN = 0.30
"""Success rate of the unaided INS above which success rates are not informative."""


def succeeded(runs: pd.DataFrame) -> np.ndarray:
    """Return a mask (R,) of the runs that finished and ended within the required error."""
    near = runs["final_position_error_m"].to_numpy(float) <= runs["required_m"].to_numpy(float)
    return np.asarray(near & _finished(runs))


def _finished(runs: pd.DataFrame) -> np.ndarray:
    """Return a mask (R,) of the runs that did not fail."""
    return np.asarray(runs["status"].to_numpy(object) == "ok")


def lost(runs: pd.DataFrame) -> np.ndarray:
    """Return a mask (R,) of the runs that ended outside the required error without warning.

    "Without warning" means that the mean NEES over the last window exceeds the 99.9 % quantile of
    χ², so that the reported covariance excludes such an error.
    """
    beyond = runs["last20_nees"].to_numpy(float) > consistency.BEYOND
    return np.asarray(_finished(runs) & ~succeeded(runs) & beyond)


def metrics(
    runs: pd.DataFrame,
    published: Mapping[str, tuple[float, float]],
    measurements: Mapping[str, Mapping[str, tuple[int, float]]] | None = None,
) -> pd.DataFrame:
    """Return a table of the :data:`METRICS`, with a row for each case, estimator and window.

    Parameters
    ----------
    runs : table of runs (:meth:`.results.folder.Results.runs`).
    published : published RMS errors of position [m] and velocity [m/s], by case.
    measurements : (epochs, channels) by case and window: the number of epochs with a measurement in
        one run, and the mean number of channels at these epochs. Without it the mean NIS has no
        band.
    """
    import pandas as pd

    groups = {
        (str(case), str(label)): group
        for (case, label), group in runs.groupby(["case", "estimator"], sort=False)
    }
    finished = {cell: group[_finished(group)] for cell, group in groups.items()}
    ratios = _ratios(finished)
    rows = []
    for cell, group in groups.items():
        good, first, is_lost = finished[cell], group.iloc[0], lost(group)
        retained = ~is_lost[_finished(group)]
        case, label = cell
        position, velocity = published.get(case, (math.nan, math.nan))
        false_p = consistency.false_share_p(group["false_fix"].to_numpy(), group["draw"].to_numpy())
        common = {
            "case": case,
            "estimator": label,
            "name": first["name"],
            "parameters": first["parameters"],
            "causality": first["causality"],
            "runs": len(group),
            "failed": len(group) - len(good),
            "diverged": int(good["diverged"].sum()),
            "lost": int(is_lost.sum()),
            "draws": group["draw"].nunique(),
            "noise_fit": "",
            "recommended": False,
            "published_m": position,
            "published_mps": velocity,
        } | _of_the_end(group)
        for window in WINDOWS:
            row = common | {"window": window}
            if len(good):
                sizes = (measurements or {}).get(case, {}).get(window, (0, 0))
                row |= _window_row(good, retained, window, sizes) | ratios[case, label, window]
                row["consistency"] = consistency.consistency(
                    good[f"{window}_nees"].to_numpy(),
                    good[f"{window}_coverage"].to_numpy(),
                    good["draw"].to_numpy(),
                    false_p,
                )
            rows.append(row)
    return _with_ins(pd.DataFrame(rows).reindex(columns=[*METRICS]), groups)


def _of_the_end(group: pd.DataFrame) -> dict[str, Any]:
    """Return success, false fixes and convergence over all runs of an estimator on a case."""
    hits = succeeded(group)
    success = share_interval(hits, group["draw"].to_numpy())
    when = median_interval(group.loc[hits, "converged_s"].dropna().to_numpy())
    values = _with_ends("success", "success", success) | _with_ends(
        "converged_s", "converged", when
    )
    return values | {"false_fixes": float(group["false_fix"].mean())}


def _with_ends(key: str, stem: str, values: Sequence[float]) -> dict[str, float]:
    """Return a metric and the ends of its interval or band, by column name."""
    return dict(zip((key, f"{stem}_lo", f"{stem}_hi"), values, strict=True))


_RATIOS = {
    ("rms_m", "rms"): ("position_ms", ""),
    ("velocity_rms_mps", "velocity_rms"): ("velocity_ms", ""),
    ("efficiency", "efficiency"): ("position_ms", "oracle_position_ms"),
}
"""Columns by metric and stem of its interval: √(mean of first / mean of second); "" is 1."""


def _ratios(
    finished: Mapping[tuple[str, str], pd.DataFrame],
) -> dict[tuple[str, str, str], dict[str, float]]:
    """Return :data:`_RATIOS` of every case, estimator and window, with shared bootstrap draws."""
    names = [(*cell, window) for cell, good in finished.items() if len(good) for window in WINDOWS]
    groups = []
    for case, label, window in names:
        good = finished[case, label]
        for first, second in _RATIOS.values():
            below = good[f"{window}_{second}"].to_numpy() if second else np.ones(len(good))
            # Where the assumed model is not the true one, there is no oracle: NaN.
            groups.append((good[f"{window}_{first}"].to_numpy(), below, good["draw"].to_numpy()))
    ratios: dict[tuple[str, str, str], dict[str, float]] = {name: {} for name in names}
    keys = itertools.product(names, _RATIOS)
    for (name, columns), values in zip(keys, root_ratio_intervals(groups), strict=True):
        ratios[name] |= _with_ends(*columns, values)
    return ratios


def _window_row(
    good: pd.DataFrame, retained: np.ndarray, window: str, measurements: tuple[int, float]
) -> dict[str, Any]:
    """Return the metrics of one window over the finished runs.

    ``retained`` is the mask of the finished runs that are not lost, see :func:`lost`.
    """

    def column(key: str) -> np.ndarray:
        return good[f"{window}_{key}"].to_numpy()

    draws, (epochs, channels) = good["draw"].nunique(), measurements
    nees, coverage, innovations = column("nees"), column("coverage"), column("nis")
    there = ~np.isnan(innovations)  # a run may have no measurement in the window
    present = innovations[there]
    nis = float(present.mean()) if len(present) else math.nan
    # Only a filter has innovations: without a mean there is no band.
    read = len(good) * epochs if len(present) else 0
    band = mean_band(read, channels)
    squares = column("position_ms")
    median, quantile = np.sqrt(np.quantile(squares, [0.5, 0.95]))
    return {
        "median_m": float(median),
        "p95_m": float(quantile),
        "kept_rms_m": math.sqrt(float(squares[retained].mean())) if retained.any() else math.nan,
        "bound_m": math.sqrt(float(column("bound_position_ms").mean())),
        "velocity_bound_mps": math.sqrt(float(column("bound_velocity_ms").mean())),
        "seconds_per_run": _median_seconds(good),
        "map_evaluations": float(good["map_evaluations"].mean()),
        **_with_ends("nees", "nees", (float(nees.mean()), *mean_band(draws, JUDGED))),
        **_with_ends(
            "coverage", "coverage", (float(coverage.mean()), *coverage_band(draws, COVERAGE))
        ),
        "trimmed_nees": float(consistency.trimmed(nees).mean()),
        **_with_ends("nis", "nis", (nis, *band)),
        "noise_fit": consistency.noise_fit(
            present, channels if read else 0.0, band, good["draw"].to_numpy()[there]
        ),
    }


def _median_seconds(good: pd.DataFrame) -> float:
    """Return the median time of a run [s], without cold runs if there are other runs.

    A cold run is the first run of a process; its time includes the compilation.
    """
    seconds, warm = good["seconds"].to_numpy(), ~good["cold"].to_numpy()
    return float(np.median(seconds[warm] if warm.any() else seconds))


def ordered(table: pd.DataFrame, case: str, window: str = "settled") -> list[dict[str, Any]]:
    """Return the rows of a case and window: causal estimators by RMS error, then smoothers."""
    chosen = table[(table["case"] == case) & (table["window"] == window)]
    smoothers = chosen["causality"].isin(SMOOTHERS)
    rows = chosen.assign(_last=smoothers).sort_values(["_last", "rms_m"], kind="stable")
    records: list[dict[str, Any]] = rows.drop(columns="_last").to_dict("records")
    return records


def _with_ins(table: pd.DataFrame, groups: Mapping[tuple[str, str], pd.DataFrame]) -> pd.DataFrame:
    """Fill ``times_ins`` and ``as_ins``, which compare estimators with the INS on common runs.

    ``times_ins`` is the RMS error divided by that of the INS, on the runs that both finished.
    ``as_ins`` states whether the INS succeeds as often as the estimator (:func:`_succeeds_as`).
    """
    unaided = {
        case: group for (case, _), group in groups.items() if group["causality"].iloc[0] == "none"
    }
    ratios: dict[tuple[str, str, str], float] = {}
    alike: dict[tuple[str, str], bool] = {}
    for (case, label), own in groups.items():
        if case not in unaided:
            continue
        ins = unaided[case]
        _, i, j = np.intersect1d(own["run"], ins["run"], return_indices=True)
        aided = own["causality"].iloc[0] != "none"
        lead = succeeded(own)[i], succeeded(ins)[j]
        alike[case, label] = aided and _succeeds_as(*lead, own["draw"].to_numpy()[i])
        both = _finished(own)[i] & _finished(ins)[j]
        for window in WINDOWS if both.any() else ():
            column = f"{window}_position_ms"
            above, below = (
                rows[column].to_numpy()[common][both].mean()
                for rows, common in ((own, i), (ins, j))
            )
            ratios[case, label, window] = math.sqrt(above / below) if below else math.nan
    cells = [*table[["case", "estimator", "window"]].itertuples(index=False, name=None)]
    table["times_ins"] = [ratios.get(cell, math.nan) for cell in cells]
    table["as_ins"] = [alike.get(cell[:2], False) for cell in cells]
    return table


def _succeeds_as(own: np.ndarray, ins: np.ndarray, draws: np.ndarray) -> bool:
    """Return whether an estimator does not succeed significantly more often than the INS.

    The test is exact, at 5 %, over clusters. The result is false if the INS succeeds in at most
    30 % of the runs.

    Parameters
    ----------
    own, ins : (R,) masks of the successes of an estimator and of the INS in common runs.
    draws : (R,) indices of the clusters.
    """
    if not len(own) or ins.mean() <= OFTEN:
        return False
    lead = cluster_means(own.astype(float) - ins, draws)
    more, less = int((lead > 0.0).sum()), int((lead < 0.0).sum())
    return bool(lead.sum() <= 0.0 or exact_p(more, less) >= ALPHA)
