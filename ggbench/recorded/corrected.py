"""Corrected track of an estimate, with innovations and errors against a reference."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..engines.innovations import innovations
from ..errors import GGBenchError
from ..judging import run_errors
from ..problem import Estimate, Problem, predict_along
from ..sensors.aiding import Motion, corrected_motion
from ..simulation.runs import Truth
from ..spec.case import WindowsSpec
from .motion import track_columns

_AXES = ("east", "north", "up")
SIGMAS = (
    *(f"sigma_{axis}_m" for axis in _AXES),
    *(f"sigma_velocity_{axis}_mps" for axis in _AXES),
    *(f"sigma_tilt_{axis}_rad" for axis in _AXES),
)
"""Columns of the standard deviations of position, velocity and attitude, about ENU."""


class EstimateError(GGBenchError):
    """A corrected track cannot be computed from an estimate."""


def corrected(problem: Problem, estimate: Estimate, start: float = 0.0) -> dict[str, np.ndarray]:
    """Return the corrected track: the INS solution minus the estimated INS errors.

    ``start`` is added to the times [s].

    Returns
    -------
    Columns (K,) by name: ``time_s``, ``latitude_deg``, ``longitude_deg``, ``height_m``,
    ``velocity_east_mps``, ..., ``heading_deg``, ``pitch_deg``, ``roll_deg``, and the standard
    deviations :data:`SIGMAS`, which are NaN if the estimate has no covariance.

    Raises EstimateError if the problem has no track, or the estimate has another shape or is not
    finite.
    """
    if problem.track is None:
        raise EstimateError("the problem has no INS track to correct")
    mean, cov = _arrays(problem, estimate)
    motion = corrected_motion(Motion.of(problem.track), mean)
    sigmas = dict(zip(SIGMAS, _sigmas(mean, cov).T, strict=True))
    return track_columns(start + problem.times, motion) | sigmas


def corrected_samples(
    problem: Problem,
    estimate: Estimate,
    times: np.ndarray,
    indicated: Motion,
    start: float = 0.0,
) -> dict[str, np.ndarray]:
    """Return the corrected track at the INS samples between the first and the last epoch.

    The estimated INS errors are interpolated linearly between epochs.

    Parameters
    ----------
    problem, estimate : as for :func:`corrected`.
    times : (N,) times of the samples [s].
    indicated : INS solution at the samples.
    start : offset added to the times [s].

    Returns
    -------
    Columns as in :func:`corrected`, without standard deviations.

    Raises
    ------
    EstimateError
        As in :func:`corrected`.
    """
    mean, _ = _arrays(problem, estimate)
    inside = (times >= problem.times[0]) & (times <= problem.times[-1])
    within = times[inside]
    errors = np.stack([np.interp(within, problem.times, mean[:, j]) for j in range(9)], axis=-1)
    return track_columns(start + within, corrected_motion(indicated.at(inside), errors))


def _arrays(problem: Problem, estimate: Estimate) -> tuple[np.ndarray, np.ndarray | None]:
    """Return mean and covariance; raise EstimateError for a wrong shape or non-finite values."""
    shape = (problem.epochs, problem.dimension)
    mean, cov = _real("mean", estimate.mean, shape), estimate.cov
    if cov is not None:
        cov = _real("cov", cov, (*shape, problem.dimension))
    for name, array in (("mean", mean), ("cov", cov)):
        if array is not None and not np.isfinite(array).all():
            epoch = int(np.argwhere(~np.isfinite(array))[0, 0])
            raise EstimateError(f"the estimate's {name} is not finite from epoch {epoch} on")
    return mean, cov


def _real(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return an array of an estimate as real numbers; raise EstimateError for a wrong shape."""
    try:
        return run_errors.real_array(name, value, shape)
    except (ValueError, TypeError) as error:
        raise EstimateError(str(error)) from None


def _sigmas(mean: np.ndarray, cov: np.ndarray | None) -> np.ndarray:
    """Return the standard deviations (K, 9) of the first nine states; NaN without covariance."""
    if cov is None:
        return np.full((len(mean), 9), np.nan)
    return np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2)[:, :9], 0.0))


def _whitened(errors: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Return errors (K, m), multiplied by the inverse Cholesky factor of ``cov`` (K, m, m)."""
    try:
        roots = np.linalg.cholesky(cov)
    except np.linalg.LinAlgError:
        raise EstimateError("the estimate's cov is not positive definite") from None
    return np.linalg.solve(roots, errors[..., np.newaxis])[..., 0]


@dataclass(frozen=True)
class Residuals:
    """Residuals or innovations of an estimate.

    Attributes
    ----------
    predicted : (K, m) predicted measurements: from earlier epochs for a filter, else from the
        estimate at the same epoch.
    whitened : (K, m) measurements minus predictions; NaN without a measurement. For a filter they
        are innovations, multiplied by the inverse Cholesky factor of the innovation covariance. If
        the filter is consistent, they are independent and of variance 1. For other estimators they
        are residuals, multiplied by the inverse Cholesky factor of the noise covariance.
    nis : (K,) normalised innovation squared of a filter, from :attr:`.Estimate.nis` if the filter
        provides it; NaN for other estimators.
    innovations : whether ``whitened`` are innovations.
    """

    predicted: np.ndarray
    whitened: np.ndarray
    nis: np.ndarray
    innovations: bool


def residuals(problem: Problem, estimate: Estimate) -> Residuals:
    """Return the residuals or innovations of an estimate.

    Raises EstimateError if the estimate has another shape, is not finite, or its covariance is
    invalid.
    """
    mean, cov = _arrays(problem, estimate)
    there, z = problem.present, problem.measurements
    filters = estimate.causality == "filter" and cov is not None
    if filters:
        assert cov is not None
        differences, spreads = innovations(problem, mean, cov)
        predicted = z - differences
    else:
        predicted = predict_along(problem.model, np.arange(problem.epochs), mean)
        differences = z - predicted
        spreads = np.stack([problem.noise_of(k) for k in range(problem.epochs)])
    whitened = _whitened(differences, spreads)
    nis = np.full(problem.epochs, np.nan)
    if filters:
        any_there = there.any(axis=1)
        squares = np.sum(whitened**2, axis=1)
        if estimate.nis is not None:
            squares = _real("nis", estimate.nis, (problem.epochs,))
        nis[any_there] = squares[any_there]
    return Residuals(
        np.where(there, predicted, np.nan), np.where(there, whitened, np.nan), nis, filters
    )


def residual_columns(
    problem: Problem, differences: Residuals, start: float = 0.0
) -> dict[str, np.ndarray]:
    """Return measurement, prediction and whitened residual of each channel as columns (K,).

    Names of columns contain sensor and channel. Names of measurements and predictions also contain
    the unit. ``..._present`` is 1 if there is a measurement, else 0. Further columns are ``time_s``
    and ``nis``.
    """
    columns = {"time_s": start + problem.times}
    for j, channel in enumerate(problem.channels):
        own = channel.name.removeprefix("gradient ").removeprefix("gravity ")
        name = f"{channel.sensor}_{own}".replace(" ", "_")
        there = problem.present[:, j]
        unit = {"m/s": "mps", "E": "eotvos", "mGal": "mgal"}.get(channel.unit, channel.unit)
        columns |= {
            f"{name}_{unit}": np.where(there, problem.measurements[:, j], np.nan),
            f"{name}_predicted_{unit}": differences.predicted[:, j],
            f"{name}_whitened": differences.whitened[:, j],
            f"{name}_present": there.astype(int),
        }
    return columns | {"nis": differences.nis}


@dataclass(frozen=True)
class AgainstReference:
    """Errors of an estimate against a reference track, at the C epochs with a reference.

    Attributes
    ----------
    times : (C,) times of these epochs [s].
    components : (C, 6) errors of position [m] and velocity [m/s].
    sigmas : (C, 6) reported standard deviations of these errors; NaN if the estimate has no
        covariances.
    nees : (C,) normalised estimation error squared of position and velocity, or of position only if
        the reference has no velocities; NaN without covariances.
    states : number of states of the NEES, 6 or 3.
    windows : metrics of each window. The key is the name of the window. The metrics are
        ``position_mrse_m``, ``horizontal_mrse_m``, ``velocity_mrse_mps`` and ``nees_mean``, as in
        :class:`.judgement.Judgement`.
    """

    times: np.ndarray
    components: np.ndarray
    sigmas: np.ndarray
    nees: np.ndarray
    states: int
    windows: Mapping[str, Mapping[str, float]]


def against(
    problem: Problem, estimate: Estimate, reference: Truth, windows: WindowsSpec | None
) -> AgainstReference:
    """Return the errors of an estimate against a reference track.

    Raises EstimateError if the estimate has another shape, is not finite, or its covariance is
    invalid.
    """
    mean, cov = _arrays(problem, estimate)
    covered = np.isfinite(reference.error_state[:, :3]).all(axis=1)
    times, errors = problem.times[covered], (reference.error_state - mean)[covered, :6]
    states = 6 if np.isfinite(errors).all() else 3
    nees = np.full(len(times), np.nan)
    if cov is not None:
        claimed = cov[covered][:, :states, :states]
        nees = np.sum(_whitened(errors[:, :states], claimed) ** 2, axis=1)
    spec = windows or WindowsSpec(settled_from_s=0.0, last_s=1.0)
    names = run_errors.WINDOWS if windows else ("whole",)
    metrics = {}
    for name in names:
        some = run_errors.window_mask(times, spec, name)
        if some.any():
            metrics[name] = {
                "position_mrse_m": _mrse(errors[some, :3]),
                "horizontal_mrse_m": _mrse(errors[some, :2]),
                "velocity_mrse_mps": _mrse(errors[some, 3:]),
                "nees_mean": float(np.mean(nees[some])),
            }
    sigmas = _sigmas(mean, cov)[covered, :6]
    return AgainstReference(times, errors, sigmas, nees, states, metrics)


def _mrse(errors: np.ndarray) -> float:
    """Return the root of the mean squared length of errors (C, 3)."""
    return math.sqrt(float(np.mean(np.sum(errors**2, axis=1))))
