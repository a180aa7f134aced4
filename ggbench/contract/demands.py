"""Requirements of the contract: one function for each.

Every function receives an estimator and a problem. It raises :class:`Broken` if the requirement is
not met, and :class:`Refused` if the estimator refuses the problem. Exceptions of the estimator pass
unchanged.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..judging import fix_metrics as matchers
from ..problem import Estimate, Estimator, Fixes, Problem
from .references import deviation, exact
from .within import arrays_within

EXACT = 1e-9
"""Allowed difference from the exact estimate, in posterior standard deviations."""
NEARLY_EXACT = 1e-5
"""Difference up to which an estimator passes with a remark; the UKF of dynamax has 3e-6."""
LOSSY = 1e-4
"""Allowed difference of an estimator that amplifies rounding errors."""
NEAR, SPREAD = 0.3, 0.3
"""Allowed RMS difference of approximate means [σ], and relative error of standard deviations."""
_SYMMETRIC = 1e-12
_UNMOVED, _MOVED = 1e-12, 1e-6
"""Limits of a change [prior σ]: below the first, no change; above the second, a change."""
_SHIFT = 10.0
"""Change of the measurements, in standard deviations of their noise."""
_ROUNDINGS, _SCATTER = 4, 10.0
"""Number of priors with a different last digit; largest ratio of an error to the scatter."""


class Broken(Exception):
    """A requirement is not met; the message states the violation with numbers."""


class Refused(Exception):
    """The estimator refuses the problem; the message is the estimator's reason."""


def generator() -> np.random.Generator:
    """Return the random generator for estimators; every call has the same seed."""
    return np.random.default_rng(7)


def answer(estimator: Estimator, problem: Problem, gaussian: bool = False) -> Estimate:
    """Return the estimate of a new instance of the estimator; check shapes and causality.

    ``gaussian`` sets the threshold of a robust loss to infinity, so that the loss is least squares.
    """
    if gaussian and vars(estimator).get("loss", "none") != "none":
        estimator = dataclasses.replace(estimator, threshold=np.inf)  # type: ignore[call-arg]
    reason = estimator.skip(problem)
    if reason is not None and not isinstance(reason, str):
        raise Broken(f"skip() must return a text or None, not {_kind(reason)}")
    if reason:
        raise Refused(reason)
    estimate = dataclasses.replace(estimator).estimate(problem, generator())
    declared(estimate, estimator, problem)
    return estimate


def declared(estimate: Any, estimator: Estimator, problem: Problem) -> None:
    """Require that an estimate is valid and has the causality and lag of its estimator.

    A valid estimate is an :class:`.Estimate` of correct shapes with finite real numbers.
    """
    if not isinstance(estimate, Estimate):
        raise Broken(f"estimate() must return an Estimate, not {_kind(estimate)}")
    if estimate.causality != estimator.causality:
        raise Broken(
            f"the causality of the estimate is '{estimate.causality}', that of the estimator "
            f"'{estimator.causality}'"
        )
    lag = vars(estimator).get("lag") if estimator.causality == "fixed-lag" else None
    if estimate.lag != lag:
        raise Broken(f"the lag of the estimate is {estimate.lag}, that of the estimator {lag}")
    epochs, n = problem.epochs, problem.dimension
    _require_numbers("mean", estimate.mean, (epochs, n))
    if estimate.cov is not None:
        _require_numbers("cov", estimate.cov, (epochs, n, n))
    if estimate.fixes is not None:
        try:
            matchers.checked(estimate.fixes, epochs)
        except ValueError as error:
            raise Broken(str(error)) from None


def _require_numbers(name: str, values: Any, shape: tuple[int, ...]) -> None:
    array = np.asarray(values)
    if array.shape != shape:
        hint = ""
        if array.size == np.prod(shape):
            hint = "; the number of elements is right, so reshape or ravel the array"
        raise Broken(f"{name} has the shape {array.shape} and must have {shape}{hint}")
    if array.dtype.kind not in "fiu":
        raise Broken(f"{name} has elements of type {array.dtype} and must have real numbers")
    bad = ~np.isfinite(array.reshape(shape[0], -1)).all(axis=1)
    if bad.any():
        raise Broken(f"{name} is not finite at {bad.sum()} epochs, first at epoch {bad.argmax()}")


def real_covariance(estimate: Estimate) -> None:
    """Require that every covariance is symmetric and positive definite.

    The eigenvalues of the correlation matrix are tested, because units of different size could hide
    a negative eigenvalue of the covariance.
    """
    if estimate.cov is None:
        return
    cov = np.asarray(estimate.cov, dtype=float)
    variances = np.diagonal(cov, axis1=1, axis2=2)
    if (variances <= 0.0).any():
        epoch, state = np.argwhere(variances <= 0.0)[0]
        raise Broken(
            f"the variance of state {state} at epoch {epoch} is {variances[epoch, state]:.2g} "
            "and must be positive; Joseph's form of the update keeps it positive"
        )
    sigma = np.sqrt(variances)
    correlation = cov / (sigma[:, :, np.newaxis] * sigma[:, np.newaxis, :])
    apart = np.abs(correlation - correlation.transpose(0, 2, 1)).max(axis=(1, 2))
    if apart.max() >= _SYMMETRIC:
        raise Broken(
            f"the covariance at epoch {apart.argmax()} is not symmetric: largest difference of "
            f"correlations {apart.max():.2g}, allowed {_SYMMETRIC:g}; return 0.5 * (P + P.T)"
        )
    least = np.linalg.eigvalsh(correlation).min(axis=1)
    if least.min() <= 0.0:
        raise Broken(
            f"the covariance at epoch {least.argmin()} is not positive definite: its correlation "
            f"matrix has the eigenvalue {least.min():.2g}"
        )


def repeatable(estimator: Estimator, problem: Problem, first: Estimate | None = None) -> None:
    """Require that two calls with equal arguments return the same estimate, bit for bit.

    ``first`` is the estimate of the first call. If it is None, the function makes this call.
    """
    first = first or answer(estimator, problem)
    again = answer(estimator, problem)
    for name in ("mean", "cov"):
        one, other = getattr(first, name), getattr(again, name)
        if (one is None) != (other is None):
            raise Broken(
                f"with the same problem and generator, {name} is present in one call and missing "
                "in the other"
            )
        if one is None or np.asarray(one).tobytes() == np.asarray(other).tobytes():
            continue
        differs = (np.asarray(one) != np.asarray(other)).reshape(len(one), -1).any(axis=1)
        raise Broken(
            f"two calls with the same problem and generator gave different values of {name}, "
            f"first at epoch {differs.argmax()}: draw only from rng, and keep no state between "
            "calls"
        )


def inputs_kept(estimator: Estimator, problem: Problem) -> None:
    """Require that the estimator changes no byte of the problem and its model."""
    before = {id(a): (a, a.tobytes()) for a in arrays_within(problem)}
    named = {
        id(getattr(problem, item.name)): f"problem.{item.name}"
        for item in dataclasses.fields(problem)
    }
    answer(estimator, problem)
    after = {id(a) for a in arrays_within(problem)}
    for key, (array, content) in before.items():
        if array.tobytes() != content:
            what = named.get(key, f"an array {array.shape} of the model")
            raise Broken(
                f"{what} was changed: work on a copy, because all estimators receive the same "
                "problem"
            )
    if after != set(before):
        raise Broken("estimate() replaced arrays of the problem or its model")


def causal(estimator: Estimator, problem: Problem, exactly: bool = True) -> None:
    """Require that no estimate depends on measurements that its causality excludes.

    Measurements after the middle epoch are shifted by ten standard deviations of the noise. The
    requirements depend on the causality:

    - ``filter`` and ``fixed-lag``: some estimates must not use the shifted measurements. Their
      means must change by less than 1e-12 prior σ. If ``exactly`` is true, their covariances must
      not change at all. If the estimator returns no fixes (:class:`.Fixes`), the first estimate
      that may use shifted measurements must change. If it returns fixes, the shift must not change
      any fix up to the middle epoch. It must change at least one estimate or one later fix.
    - ``batch``: all estimates up to the middle epoch must change.
    - ``none``: no estimate may change.
    """
    last_same = problem.epochs // 2
    measurements = problem.measurements.copy()
    shift = _SHIFT * np.sqrt(np.diag(problem.noise_of(0))) * problem.present
    measurements[last_same + 1 :] += shift[last_same + 1 :]
    first = answer(estimator, problem)
    second = answer(estimator, dataclasses.replace(problem, measurements=measurements))
    sigma = np.sqrt(np.diag(problem.prior_cov))
    moved = (np.abs(np.asarray(second.mean) - first.mean) / sigma).max(axis=1)
    change = (
        f"measurements after epoch {last_same} were shifted by {_SHIFT:g} standard deviations "
        "of their noise"
    )
    if first.causality == "none":
        if moved.max() != 0.0:
            raise Broken(
                f"causality is 'none', but when {change} the estimate at epoch {moved.argmax()} "
                f"moved by {moved.max():.2g} prior standard deviations"
            )
        return
    if first.causality == "batch":
        if first.cov is not None and second.cov is not None:
            # A path of cells stays in its cell, and is less sure of it.
            changes = np.diagonal(second.cov - first.cov, axis1=1, axis2=2)
            moved = np.maximum(moved, (np.abs(changes) / sigma**2).max(axis=1))
        before = moved[: last_same + 1]
        if before.min() <= _MOVED:
            raise Broken(
                f"causality is 'batch', but when {change} the estimate at epoch {before.argmin()} "
                "did not move: declare 'filter' if it uses no later measurements"
            )
        return
    reach = (first.lag or 0.0) if first.causality == "fixed-lag" else 0.0
    blind = problem.times + reach < problem.times[last_same + 1]
    if not blind.any():
        raise Refused(f"the lag of {reach:g} s is longer than the problem")
    ahead = blind & (moved >= _UNMOVED)
    if ahead.any():
        epoch = int(ahead.argmax())
        raise Broken(
            f"it uses later measurements although its causality is '{first.causality}': when "
            f"{change}, the estimate at epoch {epoch} moved by {moved[epoch]:.2g} prior standard "
            "deviations"
        )
    if first.fixes is None:
        if moved[~blind][0] <= _MOVED:
            raise Broken(
                f"when {change} the estimate at epoch {int((~blind).argmax())} did not move, "
                f"although its causality is '{first.causality}': declare 'none' for an estimator "
                "without aiding"
            )
    else:  # a matcher waits for its window, and may refuse what it finds: its fixes have seen them
        _require_causal_fixes(first, second, last_same, float(moved.max()), change)
    if exactly and first.cov is not None and second.cov is not None:
        other = (first.cov[blind] != second.cov[blind]).reshape(int(blind.sum()), -1).any(axis=1)
        if other.any():
            raise Broken(
                "its covariance uses later measurements although its causality is "
                f"'{first.causality}': when {change}, the covariance at epoch {other.argmax()} "
                "changed"
            )


def _require_causal_fixes(
    first: Estimate, second: Estimate, last: int, moved: float, change: str
) -> None:
    assert first.fixes is not None
    if second.fixes is None:
        raise Broken(f"the estimator returned fixes for a problem, but none when {change}")
    before, after = _rows(first.fixes), _rows(second.fixes)
    ones, others = (rows[rows[:, 0] <= last] for rows in (before, after))
    if not np.array_equal(ones, others):
        raise Broken(f"fixes up to epoch {last} use later measurements: they changed when {change}")
    ones, others = (rows[rows[:, 0] > last] for rows in (before, after))
    if moved <= _MOVED and np.array_equal(ones, others):
        raise Broken(f"no estimate and no fix moved when {change}")


def _rows(fixes: Fixes) -> np.ndarray:
    """Return epochs, positions and statistics of fixes, with a row for each fix."""
    return np.column_stack([fixes.epoch, fixes.mean, fixes.statistic])


def as_exact(estimator: Estimator, problem: Problem) -> str:
    """Require the exact estimate of a linear Gaussian problem; return a remark or "".

    The estimate must equal a reference to 1e-9 posterior standard deviations. The reference is

    - for a filter, the Kalman filter in Joseph form,
    - for a smoother, the Rauch–Tung–Striebel smoother,
    - for a fixed-lag smoother, the Rauch–Tung–Striebel smoother on each window,
    - for an estimator without aiding, the propagated prior.

    Two kinds of larger differences pass with a remark. Differences up to 1e-5 pass, because some
    libraries regularise or iterate. Differences up to 1e-4 pass if amplified rounding errors
    explain them (:func:`rounding`); the remark states their size. Without a covariance only the
    mean is tested.
    """
    estimate = answer(estimator, problem, gaussian=True)
    right = exact(problem, estimate)
    alone = estimate.cov is None
    cov = right[1] if estimate.cov is None else estimate.cov
    mean_off, cov_off = deviation(estimate.mean, cov, *right)
    if not max(mean_off, cov_off) < EXACT:
        off, scatter = max(mean_off, cov_off), rounding(estimator, problem, right[1])
        if off < min(_SCATTER * scatter, LOSSY):
            return (
                f"rounding errors are large: the result is {off:.2g} posterior standard "
                "deviations from the exact one, and a change of the last digit of the prior "
                f"moves it by {scatter:.2g}; typical cause: large weights of opposite sign, as "
                "of sigma points with a small alpha"
            )
        if off < NEARLY_EXACT:
            return (
                f"the result differs from the exact one by {off:.2g} posterior standard "
                f"deviations, above {EXACT:g}; typical causes: regularisation, or an iteration "
                "that ends early"
            )
        name = {"none": "the propagated prior", "filter": "the Kalman filter"}.get(
            estimate.causality, "the Rauch–Tung–Striebel smoother"
        )
        raise Broken(
            f"the mean differs by up to {mean_off:.2g} and the covariance by {cov_off:.2g} "
            f"posterior standard deviations from {name}, allowed {NEARLY_EXACT:g}: correct the "
            "estimator, or declare exact_if_linear_gaussian = False"
        )
    return "no covariance: only the mean is compared" if alone else ""


def rounding(estimator: Estimator, problem: Problem, posterior_cov: np.ndarray) -> float:
    """Return the change of an estimate [posterior σ] if the prior changes by its rounding error.

    ``posterior_cov`` (K, n, n) is the exact posterior covariance.
    """
    answers = []
    for ulps in range(_ROUNDINGS):
        factor = 1.0 + ulps * np.finfo(float).eps
        mean, cov = problem.prior_mean * factor, problem.prior_cov * factor
        moved = dataclasses.replace(problem, prior_mean=mean, prior_cov=cov)
        answers.append(answer(estimator, moved, gaussian=True))
    sigma = np.sqrt(np.diagonal(posterior_cov, axis1=1, axis2=2))
    means = np.ptp([each.mean for each in answers], axis=0) / sigma
    if any(each.cov is None for each in answers):
        return float(means.max())
    covs = np.ptp([np.asarray(each.cov) for each in answers], axis=0)
    return float(max(means.max(), (covs / (sigma[:, :, None] * sigma[:, None, :])).max()))


def near_exact(estimator: Estimator, problem: Problem) -> None:
    """Require that an approximate estimate of a noisy linear problem is near the exact one.

    The RMS difference of the means may be at most 0.3 posterior standard deviations. For each
    state, the RMS over the epochs of the ratio of standard deviations (estimated to exact) must lie
    between 0.7 and 1.3.
    """
    estimate = answer(estimator, problem)
    if estimate.fixes is not None:
        raise Refused("it returns only fixes")
    mean, cov = exact(problem, estimate)
    variance = np.diagonal(cov, axis1=1, axis2=2)
    off = float(np.sqrt(np.mean((np.asarray(estimate.mean) - mean) ** 2 / variance)))
    if not off < NEAR:
        raise Broken(
            f"the mean differs by {off:.2g} posterior standard deviations (RMS) from the exact "
            f"one, allowed {NEAR:g}: a particle filter may need more particles"
        )
    if estimate.cov is None:
        return
    ratio = np.diagonal(estimate.cov, axis1=1, axis2=2) / variance
    spread = np.abs(np.sqrt(np.mean(ratio, axis=0)) - 1.0)
    if not spread.max() < SPREAD:
        raise Broken(
            f"the standard deviation of state {spread.argmax()} is "
            f"{np.sqrt(ratio.mean(axis=0)[spread.argmax()]):.2g} times the exact one, allowed "
            f"{1.0 - SPREAD:g} to {1.0 + SPREAD:g}"
        )


def _kind(item: object) -> str:
    return "None" if item is None else f"a {type(item).__name__}"
