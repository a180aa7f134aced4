"""Errors and consistency of runs, and validation of estimates.

Estimates are blocks (R, K, ...) of R runs and K epochs; a single run is a block with R = 1. The
kernels process one run after the other, so that results do not depend on other runs of the block.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtri

from ..engines.innovations import innovations_squared
from ..numerics.kernels import compiled, copied
from ..problem import Estimate, Problem
from ..simulation.runs import Truth
from ..spec.case import WindowsSpec

WINDOWS = ("whole", "settled", "last20")
METRICS = {
    "position_ms": True,
    "velocity_ms": True,
    "nees": False,
    "nis": False,
    "coverage": False,
}
"""Metrics of a run in each window; true if every run has a value, which is then at least zero."""
JUDGED = 6
"""Number of states whose consistency is tested: position and velocity errors."""
COVERAGE = 0.95
_INSIDE = float(chdtri(JUDGED, 1.0 - COVERAGE))
"""95 % quantile of the NEES of a consistent estimate."""
_FLAWS = (
    "",
    "the estimate's mean is not finite from epoch {} on",
    "the estimate's cov is not finite from epoch {} on",
    "the estimate's cov is not positive definite at epoch {}",
)
_MEAN, _COV, _DEFINITE = 1, 2, 3
_PLAIN = (np.ndarray, np.matrix, np.memmap)
"""Types of arrays without a mask or units."""
_ROUNDING = 1e-9


def window_mask(times: np.ndarray, windows: WindowsSpec, name: str) -> np.ndarray:
    """Return a mask (K,) of the epochs in a window.

    The window ``whole`` has all epochs, ``settled`` those from ``settled_from_s`` on, and
    ``last20`` those of the last ``last_s`` seconds.
    """
    if name == "whole":
        return np.ones(len(times), dtype=bool)
    if name == "settled":
        return times >= windows.settled_from_s - 1e-9
    return times > times[-1] - windows.last_s + 1e-9


@dataclass(frozen=True)
class Evaluation:
    """Errors and consistency of R runs, or of a single run (then without the leading axis).

    Attributes
    ----------
    position_error, velocity_error : (R, K) 3-D errors, the Euclidean norms [m], [m/s].
    nees : (R, K) normalised estimation error squared of position and velocity, 6 if consistent; NaN
        without covariances.
    nis : (R, K) normalised innovation squared; NaN if not available.
    components : (R, K, 6) errors of position [m] and velocity [m/s], ENU, estimated − true.
    sigmas : (R, K, 6) reported standard deviations of ``components``.
    """

    position_error: np.ndarray
    velocity_error: np.ndarray
    nees: np.ndarray
    nis: np.ndarray
    components: np.ndarray
    sigmas: np.ndarray


def real_array(name: str, array: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return an array of an estimate as contiguous floats of a given shape (...).

    Raises
    ------
    ValueError
        If the array has another shape, a mask or units, or has elements that are not real numbers.
    """
    require_plain(name, array)
    values = np.asarray(array)
    if values.shape != shape:
        raise ValueError(f"the estimate's {name} has shape {values.shape}, not {shape}")
    if values.dtype.kind == "c":
        raise ValueError(f"the estimate's {name} is complex")
    if values.dtype.kind not in "biuf":
        raise ValueError(f"the estimate's {name} holds {values.dtype}, not real numbers")
    return np.ascontiguousarray(values, dtype=float)


def require_plain(name: str, array: Any) -> None:
    """Raise ValueError if an array, or an array in a list, has a mask or units."""
    if isinstance(array, list | tuple):
        for item in array:
            if not isinstance(item, float):  # by far most of them
                require_plain(name, item)
    elif isinstance(array, np.ma.MaskedArray):
        masked = int(np.ma.count_masked(array))
        if masked:
            raise ValueError(f"the estimate's {name} is masked in {masked} of {array.size} places")
    elif isinstance(array, np.ndarray) and type(array) not in _PLAIN:
        kind = type(array).__name__
        raise ValueError(f"the estimate's {name} is a {kind}, not a plain array of numbers")


def evaluate_block(
    error_state: np.ndarray, mean: np.ndarray, cov: np.ndarray | None
) -> tuple[Evaluation, list[str]]:
    """Evaluate estimates of the INS error against the true INS error; the NIS stays NaN.

    The corrected navigation solution is INS − x̂, so the error of this solution is x_true − x̂.

    Parameters
    ----------
    error_state : (R, K, n) true INS error.
    mean : (R, K, n) estimates x̂.
    cov : (R, K, n, n) reported covariances, or None. Only the lower triangles of the block of
        position and velocity are used.

    Returns
    -------
    The evaluation, and a text for each run. The text describes the fault of the run; it is "" if
    the run has no fault. A fault is a number that is not finite, or a covariance of position and
    velocity that is not positive definite. The evaluation of such a run is invalid.
    """
    runs, epochs, _ = mean.shape
    errors = np.full((2, runs, epochs), np.nan)
    nees = np.full((runs, epochs), np.nan)
    components = np.full((runs, epochs, JUDGED), np.nan)
    sigmas = np.full((runs, epochs, JUDGED), np.nan)
    flaws = np.zeros((runs, 2), dtype=np.int64)
    covariances = np.empty((0, 0, 0, 0)) if cov is None else cov
    _evaluate(
        error_state=error_state,
        mean=mean,
        cov=covariances,
        errors=errors,
        nees=nees,
        components=components,
        sigmas=sigmas,
        flaws=flaws,
    )
    nis = np.full((runs, epochs), np.nan)
    sentences = [_FLAWS[flaw].format(epoch) for flaw, epoch in flaws.tolist()]
    return Evaluation(errors[0], errors[1], nees, nis, components, sigmas), sentences


@compiled
def _finite(array: np.ndarray) -> bool:
    """Return whether all numbers of a contiguous array are finite."""
    wrong = 0  # counted to the end, which becomes vector instructions
    for value in array.ravel():
        wrong += not abs(value) < math.inf
    return wrong == 0


@copied
def _first_flaw(mean: np.ndarray, cov: np.ndarray) -> tuple[int, int]:
    """Return the code and the epoch of the first value that is not finite in a run.

    The mean (K, n) is examined before the covariances (K, n, n). Their definiteness is not tested.
    The result is 0, 0 if all values are finite.
    """
    for k in range(mean.shape[0]):
        if not _finite(mean[k]):
            return _MEAN, k
    for k in range(cov.shape[0]):
        if not _finite(cov[k]):
            return _COV, k
    return 0, 0


@copied
def _consistency(
    cov: np.ndarray, error: np.ndarray, lower: np.ndarray, white: np.ndarray, sigma: np.ndarray
) -> float:
    """Return the NEES eᵀP⁻¹e of the judged states, or −1 if P is not positive definite.

    ``sigma`` (6,) is filled with the standard deviations. The correlation matrix is factorised
    instead of P, because the states have different units. ``lower`` (6, 6) and ``white`` (6,) are
    scratch.
    """
    for i in range(JUDGED):
        if not cov[i, i] > 0.0:
            return -1.0
        sigma[i] = math.sqrt(cov[i, i])
    total = 0.0
    for i in range(JUDGED):
        for j in range(i):
            value = cov[i, j] / (sigma[i] * sigma[j])
            for m in range(j):
                value -= lower[i, m] * lower[j, m]
            lower[i, j] = value / lower[j, j]
        pivot = 1.0
        residual = error[i] / sigma[i]
        for m in range(i):
            pivot -= lower[i, m] * lower[i, m]
            residual -= lower[i, m] * white[m]
        if not pivot > 0.0:
            return -1.0
        lower[i, i] = math.sqrt(pivot)
        white[i] = residual / lower[i, i]
        total += white[i] * white[i]
    return total


@compiled
def _evaluate(
    error_state: np.ndarray,
    mean: np.ndarray,
    cov: np.ndarray,
    errors: np.ndarray,
    nees: np.ndarray,
    components: np.ndarray,
    sigmas: np.ndarray,
    flaws: np.ndarray,
) -> None:
    """Fill the errors, NEES, standard deviations and flaws of every run.

    ``cov`` has shape (0, ...) if there are no covariances. ``flaws`` (R, 2) are code and epoch.
    """
    lower, white = np.zeros((JUDGED, JUDGED)), np.zeros(JUDGED)
    error, sigma = np.empty(JUDGED), np.empty(JUDGED)
    nothing = np.empty((0, 0, 0))
    for r in range(mean.shape[0]):
        claimed = cov[r] if cov.shape[0] else nothing
        flaw, epoch = _first_flaw(mean[r], claimed)
        for k in range(mean.shape[1]):
            if flaw:
                break
            for i in range(JUDGED):
                error[i] = error_state[r, k, i] - mean[r, k, i]
                components[r, k, i] = error[i]
            for part in range(2):
                square = 0.0
                for i in range(3 * part, 3 * part + 3):
                    square += error[i] * error[i]
                errors[part, r, k] = math.sqrt(square)
            if claimed.shape[0]:
                nees[r, k] = _consistency(claimed[k], error, lower, white, sigma)
                if nees[r, k] < 0.0:
                    flaw, epoch = _DEFINITE, k
                for i in range(JUDGED):
                    sigmas[r, k, i] = sigma[i]
        flaws[r, 0], flaws[r, 1] = flaw, epoch


def evaluate(problem: Problem, estimate: Estimate, truth: Truth) -> Evaluation:
    """Evaluate one estimate (:func:`evaluate_block`), including the NIS of a filter.

    Raises
    ------
    ValueError
        If numbers of the estimate are not finite or its covariance is invalid.
    """
    shape = (problem.epochs, problem.dimension)
    mean = real_array("mean", estimate.mean, shape)
    cov = estimate.cov
    if cov is not None:
        cov = real_array("cov", cov, (*shape, problem.dimension))
    block, flaws = evaluate_block(
        np.ascontiguousarray(truth.error_state)[None],
        mean[None],
        None if cov is None else cov[None],
    )
    if flaws[0]:
        raise ValueError(flaws[0])
    evaluation = Evaluation(**{name: values[0] for name, values in vars(block).items()})
    if estimate.causality == "filter" and estimate.nis is not None:
        return replace(evaluation, nis=real_array("nis", estimate.nis, (problem.epochs,)))
    if estimate.causality == "filter" and cov is not None:
        return replace(evaluation, nis=innovations_squared(problem, mean, cov))
    return evaluation


def window_means(evaluation: Evaluation, times: np.ndarray, windows: WindowsSpec) -> np.ndarray:
    """Return the :data:`METRICS` (R, W, 5) of each run in each of :data:`WINDOWS`.

    The metrics are mean squared position and velocity error, mean NEES, mean NIS over the epochs
    with innovations, and the share of epochs with a NEES below the 95 % quantile of χ².
    """
    masks = np.array([window_mask(times, windows, name) for name in WINDOWS])
    out = np.empty((len(evaluation.nees), len(WINDOWS), len(METRICS)))
    _window_means(
        position=evaluation.position_error,
        velocity=evaluation.velocity_error,
        nees=evaluation.nees,
        nis=np.ascontiguousarray(evaluation.nis, dtype=float),
        masks=masks,
        limit=_INSIDE,
        out=out,
    )
    return out


@compiled
def _window_means(
    position: np.ndarray,
    velocity: np.ndarray,
    nees: np.ndarray,
    nis: np.ndarray,
    masks: np.ndarray,
    limit: float,
    out: np.ndarray,
) -> None:
    for r in range(position.shape[0]):
        for w in range(masks.shape[0]):
            sums = np.zeros(5)
            epochs, innovations = 0, 0
            for k in range(position.shape[1]):
                if not masks[w, k]:
                    continue
                epochs += 1
                sums[0] += position[r, k] * position[r, k]
                sums[1] += velocity[r, k] * velocity[r, k]
                sums[2] += nees[r, k]
                if not math.isnan(nis[r, k]):
                    innovations += 1
                    sums[3] += nis[r, k]
                if math.isnan(nees[r, k]):
                    sums[4] = math.nan
                elif nees[r, k] <= limit:
                    sums[4] += 1.0
            for i in range(5):
                out[r, w, i] = sums[i] / (innovations if i == 3 else epochs)


def window_metrics(
    evaluation: Evaluation, times: np.ndarray, windows: WindowsSpec
) -> dict[str, dict[str, float]]:
    """Return the metrics of one run by name of the window (:func:`window_means`).

    ``times`` (K,) are the epochs [s].
    """
    block = Evaluation(**{name: values[None] for name, values in vars(evaluation).items()})
    means = window_means(block, times, windows)[0].tolist()
    return {
        window: dict(zip(METRICS, values, strict=True))
        for window, values in zip(WINDOWS, means, strict=True)
    }


def has_diverged(final_error: float, final_bound: float, final_ins_error: float) -> bool:
    """Return whether a run has diverged at the last epoch.

    A run has diverged if its final position error exceeds ten times the bound, and also exceeds the
    INS error. All arguments are in metres. A relative excess of at most 1e-9 over the INS error is
    ignored, because the estimator ``ins`` rounds differently.
    """
    return final_error > max(10.0 * final_bound, (1.0 + _ROUNDING) * final_ins_error)
