"""Evaluation of one estimate: errors over time and in windows of the flight."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import GGBenchError
from ..numerics.frozen import freeze_arrays
from ..problem import Estimate, Problem
from ..sensors.aiding import corrected_positions
from ..simulation.runs import Truth
from ..spec.case import WindowsSpec
from . import run_errors

OUTSIDE = "left the map at some epochs, where the field is extrapolated from the border"
"""Remark on a run whose estimate leaves the map."""

_WHOLE = "whole"


class JudgingError(GGBenchError):
    """An estimate cannot be compared with the truth."""


@dataclass(frozen=True, repr=False)
class Judgement(run_errors.Evaluation):
    """Errors (estimated − true) and consistency of one estimate, in immutable arrays.

    Attributes
    ----------
    times : (K,) epochs [s].
    position_error, velocity_error : (K,) 3-D errors [m], [m/s].
    nees : (K,) normalised estimation error squared of position and velocity, 6 if consistent; NaN
        without covariances.
    nis : (K,) normalised innovation squared; NaN without a measurement and for smoothers.
    components : (K, 6) errors of position [m] and velocity [m/s], ENU.
    sigmas : (K, 6) reported standard deviations of ``components``; NaN without covariances.
    windows : metrics by name of the window (``whole``, optionally ``settled`` and ``last20``). The
        metrics are ``position_mrse_m``, ``velocity_mrse_mps``, ``nees_mean``, ``nis_mean`` and
        ``coverage``, the share of epochs with the truth inside the reported 95 % region.
    """

    times: np.ndarray
    windows: Mapping[str, Mapping[str, float]]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def position_mrse_m(self) -> float:
        """Root of the mean squared position error over the whole flight [m]."""
        return self.windows[_WHOLE]["position_mrse_m"]

    @property
    def velocity_mrse_mps(self) -> float:
        """Root of the mean squared velocity error over the whole flight [m/s]."""
        return self.windows[_WHOLE]["velocity_mrse_mps"]

    @property
    def final_position_error_m(self) -> float:
        """Position error at the last epoch [m]."""
        return float(self.position_error[-1])

    @property
    def final_velocity_error_mps(self) -> float:
        """Velocity error at the last epoch [m/s]."""
        return float(self.velocity_error[-1])

    def __repr__(self) -> str:
        whole = self.windows[_WHOLE]
        parts = [
            f"position {self.position_mrse_m:.3g} m (at the end {self.final_position_error_m:.3g})",
            f"velocity {self.velocity_mrse_mps:.3g} m/s",
        ]
        for name in ("nees", "nis"):
            if not math.isnan(whole[f"{name}_mean"]):
                parts.append(f"{name.upper()} {whole[f'{name}_mean']:.2f}")
        return f"Judgement({len(self.times)} epochs: {', '.join(parts)})"


def judge(
    problem: Problem, estimate: Estimate, truth: Truth, windows: WindowsSpec | None = None
) -> Judgement:
    """Compare an estimate of a problem with the truth.

    Parameters
    ----------
    problem : the problem that was estimated.
    estimate : estimate of the problem.
    truth : truth of the problem, or the reference of a recorded flight.
    windows : parts of the flight to judge in addition to the whole, for example ``case.windows``.

    Raises
    ------
    JudgingError
        If the estimate has another shape than the problem, is not finite, or has an invalid
        covariance. Also if the truth has other epochs or another number of states than the problem.
        The truth of another run of the same case raises no error: its epochs and states agree.
    """
    _require(problem, estimate, truth, windows)
    try:
        evaluation = run_errors.evaluate(problem, estimate, truth)
    except (ValueError, TypeError) as error:
        raise JudgingError(f"the estimate cannot be judged: {error}") from None
    # The whole flight needs no windows to be said, but its metrics come with those of the others.
    spec = windows or WindowsSpec(settled_from_s=0.0, last_s=1.0)
    metrics = run_errors.window_metrics(evaluation, problem.times, spec)
    named = {name: _named(metrics[name]) for name in (metrics if windows else (_WHOLE,))}
    return Judgement(**vars(evaluation), times=problem.times, windows=named)


def _named(metrics: Mapping[str, float]) -> Mapping[str, float]:
    """Return the metrics of a window under the names of :attr:`Judgement.windows`.

    Mean squared errors are replaced by their roots.
    """
    return {
        "position_mrse_m": math.sqrt(metrics["position_ms"]),
        "velocity_mrse_mps": math.sqrt(metrics["velocity_ms"]),
        "nees_mean": metrics["nees"],
        "nis_mean": metrics["nis"],
        "coverage": metrics["coverage"],
    }


def _require(problem: Any, estimate: Any, truth: Any, windows: Any) -> None:
    """Raise JudgingError unless the arguments have the right types and fit the problem."""
    for name, value, kind in (
        ("problem", problem, Problem),
        ("estimate", estimate, Estimate),
        ("truth", truth, Truth),
        ("windows", windows, WindowsSpec | None),
    ):
        if not isinstance(value, kind):
            expected = getattr(kind, "__name__", "WindowsSpec")
            raise JudgingError(f"{name} must be of type {expected}, not {type(value).__name__}")
    wanted_shape = (problem.epochs, problem.dimension)
    if truth.error_state.shape != wanted_shape:
        raise JudgingError(
            "the truth belongs to another problem: its states have shape "
            f"{truth.error_state.shape}, not {wanted_shape}"
        )
    if not np.array_equal(truth.times, problem.times):
        raise JudgingError(
            f"the truth belongs to another problem: its epochs differ ({truth.times[0]:g} to "
            f"{truth.times[-1]:g} s)"
        )
    if windows is not None and windows.settled_from_s > problem.times[-1]:
        raise JudgingError(
            f"windows.settled_from_s is {windows.settled_from_s:g} s and must not lie beyond the "
            f"last epoch, at {problem.times[-1]:g} s"
        )


def epochs_outside(problem: Problem, mean: np.ndarray) -> np.ndarray:
    """Return a mask (K,) of the epochs at which an estimated position lies outside the map.

    ``mean`` (K, n) is the estimate. Without a map or a track the mask is false.
    """
    if problem.track is None or problem.map is None:
        return np.zeros(problem.epochs, dtype=bool)
    positions = corrected_positions(problem.track.positions, np.asarray(mean)[:, :3])
    believed = problem.map.coordinates(positions)
    inside = (problem.map.lower <= believed) & (believed <= problem.map.upper)
    return np.asarray(~inside.all(axis=1))
