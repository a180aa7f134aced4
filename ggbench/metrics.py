"""How good an estimate is: errors, consistency, divergence, and their summary over runs.

A run is judged once, in the worker, by :func:`evaluate`; :func:`summarize` then turns the stored
records of many runs into one row per case, estimator and window, and :func:`paired_table` sets the
estimators beside each other, run by run.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import chdtri

from . import convergence
from .bound import Bound
from .problem import Estimate, Problem
from .schema import WindowsSpec
from .simulation import Truth
from .statistics import coverage_band, nees_band, nis_band, paired_all, root_mean_interval

if TYPE_CHECKING:
    import pandas as pd

WINDOWS = ("whole", "settled", "last20")
JUDGED = 6
"""Position and velocity error: the states whose consistency is judged."""
COVERAGE = 0.95

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
    "velocity_median_mps", "velocity_p95_mps", "nis_lo", "nis_hi", "coverage_lo", "coverage_hi",
    *convergence.COLUMNS,
)  # fmt: skip
_QUANTITIES = {"position": "m2", "velocity": "m2ps2"}
"""Judged quantities, and the unit of their squared errors."""
PAIRED_COLUMNS = (
    "case", "window", "first", "second", "runs", "first_only", "second_only",
    *(
        f"{quantity}_{figure}"
        for quantity, unit in _QUANTITIES.items()
        for figure in (f"difference_{unit}", "lo", "hi", "relative", "win_rate", "verdict")
    ),
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
    filter has innovations; the first epoch's is that of the prior. Where a reading is missing (h, H
    and measurement are zero, see :mod:`ggbench.measurement_model`) there is none.
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
        if h.any() or innovation.any():
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
    inside = (evaluation.nees <= chdtri(JUDGED, 1.0 - COVERAGE)).astype(float)
    inside[np.isnan(evaluation.nees)] = np.nan
    figures = {}
    for name in WINDOWS:
        mask = window_mask(times, windows, name)
        figures[name] = {
            "position_ms": float(np.mean(evaluation.position_error[mask] ** 2)),
            "velocity_ms": float(np.mean(evaluation.velocity_error[mask] ** 2)),
            "nees": float(np.mean(evaluation.nees[mask])),
            "nis": _mean_of_present(evaluation.nis[mask]),
            "coverage": float(np.mean(inside[mask])),
        }
    return figures


def _mean_of_present(values: np.ndarray) -> float:
    """Return the mean of the values that are not NaN; NaN without any."""
    present = values[~np.isnan(values)]
    return float(present.mean()) if len(present) else math.nan


def has_diverged(final_error: float, final_bound: float, final_ins_error: float) -> bool:
    """Return whether a run's final position error is beyond 10 × bound and beyond the INS's."""
    return final_error > max(10.0 * final_bound, final_ins_error)


def summarize(
    records: Iterable[Mapping[str, Any]],
    bounds: Mapping[tuple[str, str], Mapping[str, tuple[float, float]]],
    references: Mapping[str, tuple[float, float] | None],
    scenario: str,
    readings: Mapping[str, Mapping[str, tuple[int, int]]] | None = None,
) -> pd.DataFrame:
    """Return one row per case, estimator and window, with :data:`SUMMARY_COLUMNS` and more.

    Parameters
    ----------
    records : stored records, in any order.
    bounds : (case, estimator) to window to root-mean bounds on position [m] and velocity [m/s].
    references : case to published position and velocity MRSE, or None.
    scenario : name of the scenario.
    readings : case to window to (epochs, components): its readings in one run, those that drop out
        left out. Where absent, the mean NIS has no band.

    Returns
    -------
    The documented columns first, then :data:`EXTRA_COLUMNS`. Rows in the order in which cases and
    estimators first occur in ``bounds``.
    """
    grouped: dict[tuple[str, str], list[Mapping[str, Any]]] = {key: [] for key in bounds}
    for record in records:
        grouped.setdefault((record["case"], record["estimator"]), []).append(record)
    judged = {c for (c, _), group in grouped.items() if any(map(convergence.is_judged, group))}
    rows = []
    for (case, estimator), group in grouped.items():
        if not group:
            continue
        good = [record for record in group if record["status"] == "ok"]
        reference = references.get(case)
        first = group[0]
        sizes = (readings or {}).get(case, {})
        # An estimator all of whose runs failed has not locked either.
        locking = convergence.figures(group) if case in judged else {}
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
            bound = bounds.get((case, estimator), {}).get(window)
            row |= _window_row(good, window, bound, sizes.get(window, (0, 0))) | locking
            rows.append(row)
    import pandas as pd  # not at the top: workers judge runs and make no tables

    return pd.DataFrame(rows).reindex(columns=[*SUMMARY_COLUMNS, *EXTRA_COLUMNS])


def _window_row(
    good: list[Mapping[str, Any]],
    window: str,
    bound: tuple[float, float] | None,
    readings: tuple[int, int],
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
    nees_lo, nees_hi = nees_band(len(good), JUDGED)
    coverage_lo, coverage_hi = coverage_band(len(good), COVERAGE)
    nis = _mean_of_present(column("nis"))  # a run may have no reading in the window
    # Only a filter has innovations: without a mean there is no band.
    nis_lo, nis_hi = nis_band(0 if math.isnan(nis) else len(good), *readings)
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
        "nees_lo": nees_lo,
        "nees_hi": nees_hi,
        "seconds_per_run": _median_seconds(good),
        "velocity_efficiency": velocity_mrse[0] / velocity_bound,
        "position_without_diverged_m": math.sqrt(kept.mean()) if len(kept) else math.nan,
        "position_median_m": float(np.median(np.sqrt(position))),
        "position_p95_m": float(np.percentile(np.sqrt(position), 95)),
        "nis_mean": nis,
        "coverage": float(column("coverage").mean()),
        "map_evaluations": float(np.mean([record["map_evaluations"] for record in good])),
        "velocity_median_mps": float(np.median(np.sqrt(velocity))),
        "velocity_p95_mps": float(np.percentile(np.sqrt(velocity), 95)),
        "nis_lo": nis_lo,
        "nis_hi": nis_hi,
        "coverage_lo": coverage_lo,
        "coverage_hi": coverage_hi,
    }


def _median_seconds(good: list[Mapping[str, Any]]) -> float:
    """Return the median time of a run; the first of a process compiles, and counts if alone."""
    warm = [record["seconds"] for record in good if not record.get("cold")]
    return float(np.median(warm or [record["seconds"] for record in good]))


def paired_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Return every two estimators of a case beside each other, on the runs that both were given.

    Parameters
    ----------
    runs : table of runs, one row per run and estimator; those of assumptions are left out.

    Returns
    -------
    One row per case, window and pair of estimators, all in order of first appearance, with
    :data:`PAIRED_COLUMNS`: ``runs`` both finished, ``first_only`` and ``second_only`` one of them;
    then for position and velocity the figures of :func:`ggbench.statistics.paired`, of the first
    against the second. Differences are over the runs that both finished; in the win rate a run that
    failed loses against one that finished, and one that both failed does not count. A verdict is
    wrong in 5 % of the pairs that do not differ.
    """
    cases = runs[runs["assumption"] == ""]
    rows: list[dict[str, Any]] = []
    pairs: list[tuple[np.ndarray, np.ndarray]] = []
    errors = [f"{window}_{quantity}_ms" for window in WINDOWS for quantity in _QUANTITIES]
    for case, group in cases.groupby("case", sort=False):
        tables = {
            label: own.set_index(["seed", "run"])
            for label, own in group.groupby("estimator", sort=False)
        }
        for first, second in itertools.combinations(tables, 2):
            one, two = tables[first].align(tables[second], join="inner", axis=0)
            one_finished, two_finished = (
                np.isfinite(table[errors].to_numpy(float)).all(axis=1) for table in (one, two)
            )
            both = one_finished & two_finished
            counts = {
                "case": case,
                "first": first,
                "second": second,
                "runs": int(both.sum()),
                "first_only": int((one_finished & ~both).sum()),
                "second_only": int((two_finished & ~both).sum()),
            }
            rows += [counts | {"window": window} for window in WINDOWS]
            pairs += [
                (one[column].to_numpy(float)[both], two[column].to_numpy(float)[both])
                for column in errors
            ]
    figures = iter(paired_all(pairs))
    for row, (quantity, unit) in itertools.product(rows, _QUANTITIES.items()):
        found = next(figures)
        decided = row["runs"] + row["first_only"] + row["second_only"]
        wins = row["first_only"] + (found.win_rate * found.runs if found.runs else 0.0)
        row |= {
            f"{quantity}_difference_{unit}": found.difference,
            f"{quantity}_lo": found.lo,
            f"{quantity}_hi": found.hi,
            f"{quantity}_relative": found.relative,
            f"{quantity}_win_rate": wins / decided if decided else math.nan,
            f"{quantity}_verdict": found.verdict,
        }
    import pandas as pd

    return pd.DataFrame(rows, columns=PAIRED_COLUMNS)
