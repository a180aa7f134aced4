"""How good an estimate is: errors, consistency, divergence, and their summary over runs.

A run is judged once, in the worker, by :func:`evaluate`; :func:`summarize` then turns the stored
records of many runs into one row per case, estimator and window.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import chi2

from .bound import Bound
from .problem import Estimate, Problem
from .schema import WindowsSpec
from .simulation import Truth

WINDOWS = ("whole", "settled", "last20")
JUDGED = 6
"""Position and velocity error: the states whose consistency is judged."""
COVERAGE = 0.95
_BOOTSTRAP_SAMPLES = 2000
_BOOTSTRAP_SEED = 20130

SUMMARY_COLUMNS = (
    "scenario", "case", "estimator", "parameters", "causality", "runs", "failed", "diverged",
    "position_mrse_m", "position_mrse_lo", "position_mrse_hi",
    "velocity_mrse_mps", "velocity_mrse_lo", "velocity_mrse_hi",
    "window", "position_bound_m", "velocity_bound_mps", "position_efficiency",
    "paper_position_m", "paper_velocity_mps", "nees_mean", "nees_lo", "nees_hi", "seconds_per_run",
)  # fmt: skip
EXTRA_COLUMNS = (
    "label", "velocity_efficiency", "position_without_diverged_m", "position_median_m",
    "position_p95_m", "nis_mean", "coverage", "map_evaluations",
)  # fmt: skip


def window_mask(times: np.ndarray, windows: WindowsSpec, name: str) -> np.ndarray:
    """Return which epochs (K,) belong to a window.

    ``whole``: from the first update on; ``settled``: from ``settled_from_s`` on; ``last20``: the
    last ``last_s`` seconds.
    """
    if name == "whole":
        return np.ones(len(times), dtype=bool)
    if name == "settled":
        return times >= windows.settled_from_s - 1e-9
    return times > times[-1] - windows.last_s + 1e-9


@dataclass(frozen=True)
class Evaluation:
    """The judgement of one estimate.

    Attributes
    ----------
    position_error, velocity_error : (K,) spherical errors ‖·‖ [m], [m/s].
    nees : (K,) normalised estimation error squared of the six judged states; NaN without P.
    nis : (K,) normalised innovation squared; NaN where there is none.
    components : (K, 6) errors of position and velocity, ENU, estimated − true.
    sigmas : (K, 6) their claimed standard deviations.
    """

    position_error: np.ndarray
    velocity_error: np.ndarray
    nees: np.ndarray
    nis: np.ndarray
    components: np.ndarray
    sigmas: np.ndarray


def evaluate(problem: Problem, estimate: Estimate, truth: Truth) -> Evaluation:
    """Judge an estimate of the INS error against the true one.

    The corrected navigation solution is INS − x̂, so its error is x_true − x̂.
    """
    error = truth.error_state - estimate.mean
    judged = error[:, :JUDGED]
    nees = np.full(len(error), np.nan)
    sigmas = np.full(judged.shape, np.nan)
    if estimate.cov is not None:
        cov = estimate.cov[:, :JUDGED, :JUDGED]
        nees = np.einsum("ki,ki->k", judged, np.linalg.solve(cov, judged[..., None])[..., 0])
        sigmas = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    return Evaluation(
        position_error=np.linalg.norm(error[:, :3], axis=1),
        velocity_error=np.linalg.norm(error[:, 3:6], axis=1),
        nees=nees,
        nis=_innovations_squared(problem, estimate),
        components=judged,
        sigmas=sigmas,
    )


def _innovations_squared(problem: Problem, estimate: Estimate) -> np.ndarray:
    """Return the NIS (K,) of a filter's estimates, from its own mean and covariance.

    The innovation is that of the estimate at the previous epoch, predicted with Φ and Q. Only a
    filter has innovations; the first epoch's is that of the prior.
    """
    nis = np.full(problem.epochs, np.nan)
    if estimate.causality != "filter" or estimate.cov is None:
        return nis
    x, p = problem.prior_mean, problem.prior_cov
    for k in range(problem.epochs):
        phi = problem.transition[k]
        x, p = phi @ x, phi @ p @ phi.T + problem.process_cov[k]
        h = problem.model.jacobian(k, x)
        innovation = problem.measurements[k] - problem.model.predict(k, x)
        nis[k] = innovation @ np.linalg.solve(h @ p @ h.T + problem.noise_cov, innovation)
        x, p = estimate.mean[k], estimate.cov[k]
    return nis


def bound_for(bound: Bound, causality: str, lag_epochs: int | None) -> np.ndarray:
    """Return the covariance bound (K, n, n) that an estimate of this causality cannot beat.

    An estimate without aiding is set beside the filtering bound: what aiding could give.
    """
    if causality == "batch":
        return bound.smoothing
    if causality == "fixed-lag" and lag_epochs is not None:
        return bound.fixed_lag(lag_epochs)
    return bound.filtering


def squared_bounds(cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds (K,) on the squared spherical position and velocity error."""
    return (
        np.trace(cov[:, :3, :3], axis1=1, axis2=2),
        np.trace(cov[:, 3:6, 3:6], axis1=1, axis2=2),
    )


def window_figures(
    evaluation: Evaluation, times: np.ndarray, windows: WindowsSpec
) -> dict[str, dict[str, float]]:
    """Return each window's mean squared errors, mean NEES and NIS, and coverage of one run."""
    inside = evaluation.nees <= chi2.ppf(COVERAGE, JUDGED)
    figures = {}
    for name in WINDOWS:
        mask = window_mask(times, windows, name)
        figures[name] = {
            "position_ms": float(np.mean(evaluation.position_error[mask] ** 2)),
            "velocity_ms": float(np.mean(evaluation.velocity_error[mask] ** 2)),
            "nees": float(np.mean(evaluation.nees[mask])),
            "nis": float(np.mean(evaluation.nis[mask])),
            "coverage": float(np.mean(inside[mask])),
        }
    return figures


def has_diverged(final_error: float, final_bound: float, final_ins_error: float) -> bool:
    """Return whether a run's final position error is beyond 10 × bound and beyond the INS's."""
    return final_error > max(10.0 * final_bound, final_ins_error)


def root_mean_interval(mean_squares: np.ndarray) -> tuple[float, float, float]:
    """Return √mean over runs and its 95 % bootstrap interval (over runs, fixed seed).

    One run has no interval: its ends are NaN.
    """
    value = math.sqrt(float(np.mean(mean_squares)))
    if len(mean_squares) < 2:
        return value, math.nan, math.nan
    rng = np.random.default_rng(_BOOTSTRAP_SEED)
    draws = rng.integers(0, len(mean_squares), (_BOOTSTRAP_SAMPLES, len(mean_squares)))
    low, high = np.percentile(np.sqrt(mean_squares[draws].mean(axis=1)), [2.5, 97.5])
    return value, float(low), float(high)


def nees_band(runs: int, dimension: int = JUDGED) -> tuple[float, float]:
    """Return the 95 % band of the mean NEES of a consistent estimator over ``runs`` runs.

    χ² with runs × dimension degrees of freedom, as if each run were a single epoch (its epochs
    are strongly correlated): the false-alarm rate of a window's mean is 5 % at most.
    """
    if runs == 0:
        return math.nan, math.nan
    low, high = chi2.ppf([0.025, 0.975], runs * dimension) / runs
    return float(low), float(high)


def summarize(
    records: Iterable[Mapping[str, Any]],
    bounds: Mapping[tuple[str, str], Mapping[str, tuple[float, float]]],
    references: Mapping[str, tuple[float, float] | None],
    scenario: str,
) -> pd.DataFrame:
    """Return one row per case, estimator and window, with :data:`SUMMARY_COLUMNS` and more.

    Parameters
    ----------
    records : stored records, in any order.
    bounds : (case, estimator) to window to root-mean bounds on position [m] and velocity [m/s].
    references : case to published position and velocity MRSE, or None.
    scenario : name of the scenario.

    Returns
    -------
    The documented columns first, then :data:`EXTRA_COLUMNS`. Rows in the order in which cases and
    estimators first occur in ``bounds``.
    """
    grouped: dict[tuple[str, str], list[Mapping[str, Any]]] = {key: [] for key in bounds}
    for record in records:
        grouped.setdefault((record["case"], record["estimator"]), []).append(record)
    rows = []
    for (case, estimator), group in grouped.items():
        if not group:
            continue
        good = [record for record in group if record["status"] == "ok"]
        reference = references.get(case)
        first = group[0]
        for window in WINDOWS:
            row: dict[str, Any] = {
                "scenario": scenario,
                "case": case,
                "estimator": first["name"],
                "parameters": first["parameters"],
                "label": estimator,
                "causality": first["causality"],
                "runs": len(group),
                "failed": len(group) - len(good),
                "diverged": sum(record["diverged"] for record in good),
                "window": window,
                "paper_position_m": reference[0] if reference else math.nan,
                "paper_velocity_mps": reference[1] if reference else math.nan,
            }
            row |= _window_row(good, window, bounds.get((case, estimator), {}).get(window))
            rows.append(row)
    return pd.DataFrame(rows).reindex(columns=[*SUMMARY_COLUMNS, *EXTRA_COLUMNS])


def _window_row(
    good: list[Mapping[str, Any]], window: str, bound: tuple[float, float] | None
) -> dict[str, Any]:
    """Return the figures of one window over the runs that finished."""
    if not good:
        return {}
    figures = [record["windows"][window] for record in good]

    def column(key: str) -> np.ndarray:
        return np.array([f[key] for f in figures], dtype=float)

    position, velocity = column("position_ms"), column("velocity_ms")
    position_mrse = root_mean_interval(position)
    velocity_mrse = root_mean_interval(velocity)
    position_bound, velocity_bound = bound or (math.nan, math.nan)
    kept = position[[not record["diverged"] for record in good]]
    low, high = nees_band(len(good))
    return {
        "position_mrse_m": position_mrse[0],
        "position_mrse_lo": position_mrse[1],
        "position_mrse_hi": position_mrse[2],
        "velocity_mrse_mps": velocity_mrse[0],
        "velocity_mrse_lo": velocity_mrse[1],
        "velocity_mrse_hi": velocity_mrse[2],
        "position_bound_m": position_bound,
        "velocity_bound_mps": velocity_bound,
        "position_efficiency": position_mrse[0] / position_bound,
        "nees_mean": float(column("nees").mean()),
        "nees_lo": low,
        "nees_hi": high,
        "seconds_per_run": float(np.median([record["seconds"] for record in good])),
        "velocity_efficiency": velocity_mrse[0] / velocity_bound,
        "position_without_diverged_m": math.sqrt(kept.mean()) if len(kept) else math.nan,
        "position_median_m": float(np.median(np.sqrt(position))),
        "position_p95_m": float(np.percentile(np.sqrt(position), 95)),
        "nis_mean": float(column("nis").mean()),
        "coverage": float(column("coverage").mean()),
        "map_evaluations": float(np.mean([record["map_evaluations"] for record in good])),
    }
