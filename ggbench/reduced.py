"""Problems reduced to a few states; all other states are assumed known.

Much of the literature estimates only a few states. A reduced problem has the dynamics of the chosen
states, with all other states at their propagated prior means. Additional process noise represents
the effect of the other states. :meth:`Reduction.embedded` extends the estimate to all states, for
comparison with other estimators.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .problem import CountingModel, Estimate, MeasurementModel, Problem, StateBlock
from .sensors.model import SensorModel


@dataclass(frozen=True)
class Reduction:
    """A problem with r of the n states of an original problem.

    Attributes
    ----------
    problem : problem of the chosen states, as differences from the propagated prior mean.
    states : (r,) indices of the chosen states in the original problem.
    mean, cov : (K, n), (K, n, n) propagated prior of all n states.
    """

    problem: Problem
    states: tuple[int, ...]
    mean: np.ndarray
    cov: np.ndarray

    def embedded(self, estimate: Estimate) -> Estimate:
        """Extend an estimate of the reduced problem to all n states.

        The other states have the mean and covariance of the propagated prior, uncorrelated with the
        chosen states. The result has no innovations, because the innovations of the original
        problem are different. The propagated prior mean of the first two or
        three chosen states is added to the means of position fixes.
        """
        chosen = list(self.states)
        mean, cov = self.mean.copy(), None
        mean[:, chosen] += estimate.mean
        if estimate.cov is not None:
            cov = self.cov.copy()
            cov[:, chosen, :] = 0.0
            cov[:, :, chosen] = 0.0
            cov[:, np.array(chosen)[:, np.newaxis], chosen] = estimate.cov
        info = dict(estimate.info)
        if isinstance(self.problem.model, CountingModel):
            info["map_evaluations"] = self.problem.model.evaluations
        nis = np.full(len(mean), np.nan) if estimate.causality == "filter" else None
        fixes = estimate.fixes
        if fixes is not None:
            nominal = self.mean[fixes.epoch][:, chosen[: fixes.mean.shape[1]]]
            fixes = replace(fixes, mean=fixes.mean + nominal)
        return Estimate(
            mean=mean,
            cov=cov,
            causality=estimate.causality,
            lag=estimate.lag,
            info=info,
            nis=nis,
            fixes=fixes,
        )


@dataclass
class _Embedded:
    """Measurement model of the chosen states; all other states have the propagated prior mean."""

    model: MeasurementModel
    states: tuple[int, ...]
    mean: np.ndarray
    evaluations: int = 0

    def _whole(self, k: int, x: np.ndarray) -> np.ndarray:
        self.evaluations += int(np.prod(np.shape(x)[:-1], dtype=int))
        whole = np.broadcast_to(self.mean[k], (*np.shape(x)[:-1], self.mean.shape[1])).copy()
        whole[..., list(self.states)] += x
        return whole

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return h(k, x) (..., m) at reduced states (..., r)."""
        return self.model.predict(k, self._whole(k, x))

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return ∂h/∂x (..., m, r) at reduced states (..., r)."""
        return self.model.jacobian(k, self._whole(k, x))[..., list(self.states)]


def reduced(problem: Problem, states: Sequence[int], noise: np.ndarray) -> Reduction:
    """Reduce a problem to some of its states; all other states are assumed known.

    The original state is x_k = m_k + E δ_k. The vector m_k is the propagated prior mean, and δ_k
    contains the r chosen states. The matrix E (n, r) assigns each chosen state to its index in x_k.
    Φ_k and Q_k are the transition matrix and process noise covariance of the original problem. The
    transition matrix of δ is the block of Φ_k with the rows and columns ``states``. The process
    noise covariance of δ is the same block of Q_k plus ``noise``.

    Parameters
    ----------
    states : (r,) indices of the states to keep, each once.
    noise : (K, r, r) additional process noise covariance for the omitted states; may be zero.

    Raises
    ------
    ValueError
        If a state does not exist, or the noise has a wrong shape.
    """
    chosen = tuple(int(state) for state in states)
    n, count = problem.dimension, len(chosen)
    if not chosen or len(set(chosen)) < count or not all(0 <= state < n for state in chosen):
        raise ValueError(f"states must be different numbers from 0 to {n - 1}, not {chosen}")
    if noise.shape != (problem.epochs, count, count):
        raise ValueError(f"noise must be ({problem.epochs}, {count}, {count}), not {noise.shape}")
    mean, cov = _unaided(problem)
    chosen_block = np.ix_(range(problem.epochs), chosen, chosen)
    unnamed = StateBlock("state", slice(0), "1")
    blocks = {i: block for block in problem.layout for i in range(*block.slice.indices(n))}
    flat = replace(
        problem,
        transition=problem.transition[chosen_block],
        process_cov=problem.process_cov[chosen_block] + noise,
        prior_mean=np.zeros(count),
        prior_cov=problem.prior_cov[np.ix_(chosen, chosen)],
        model=_model(problem, chosen, mean),
        layout=tuple(
            replace(blocks.get(state, unnamed), slice=slice(i, i + 1))
            for i, state in enumerate(chosen)
        ),
        replay=None,
    )
    return Reduction(flat, chosen, mean, cov)


def _model(problem: Problem, states: tuple[int, ...], mean: np.ndarray) -> MeasurementModel:
    """Return the measurement model of the chosen states, with compiled kernels if possible.

    Kernels need a zero ``mean``, chosen states among the INS states, and channels without
    linear terms.
    """
    model = problem.model
    if isinstance(model, SensorModel) and not mean.any():
        arrays = model.arrays
        inertial = all(state < arrays.rows.shape[-1] for state in states)
        if inertial and arrays.first_linear == arrays.offset.shape[-1]:
            chosen = list(states)
            rows, linear = arrays.rows[..., chosen], arrays.linear[..., chosen]
            return SensorModel(replace(arrays, dimension=len(states), rows=rows, linear=linear))
    return _Embedded(model, states, mean)


def _unaided(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (K, n) and covariance (K, n, n) of the prior, propagated without updates."""
    n = problem.dimension
    means, covs = np.empty((problem.epochs, n)), np.empty((problem.epochs, n, n))
    mean, cov = problem.prior_mean, problem.prior_cov
    for k, (phi, q) in enumerate(zip(problem.transition, problem.process_cov, strict=True)):
        mean, cov = phi @ mean, phi @ cov @ phi.T + q
        means[k], covs[k] = mean, 0.5 * (cov + cov.T)
    return means, covs


def horizontal(problem: Problem, velocity: bool) -> tuple[int, ...]:
    """Return the state indices of the horizontal position errors, optionally also of velocity.

    Position errors are the first two states of the first block in metres. If ``velocity`` is
    True, the first two states of the first block in m/s follow. The result is ``()`` if a block is
    missing.
    """
    states: list[int] = []
    for unit in ("m", "m/s") if velocity else ("m",):
        blocks = [block for block in problem.layout if block.unit == unit]
        inside = range(*blocks[0].slice.indices(problem.dimension)) if blocks else range(0)
        if len(inside) < 2:
            return ()
        states += inside[:2]
    return tuple(states)


def displacing(problem: Problem, states: Sequence[int]) -> np.ndarray:
    """Return the covariance (K, r, r) that omitted states add to the chosen states at each step.

    The covariance is Φ P Φᵀ. Φ is the block of the transition matrix that maps the omitted to the
    chosen states. P is the propagated prior covariance of the omitted states. An example is the
    position change by velocity errors. Process noise with this covariance is white. In contrast,
    the errors of the omitted states are correlated in time.
    """
    chosen = list(states)
    others = [i for i in range(problem.dimension) if i not in chosen]
    _, covs = _unaided(problem)
    before = np.concatenate([problem.prior_cov[np.newaxis], covs[:-1]])
    across = problem.transition[:, chosen][:, :, others]
    return np.asarray(across @ before[:, others][:, :, others] @ across.transpose(0, 2, 1))


def walking(times: np.ndarray, density: float) -> np.ndarray:
    """Return the covariance (K, 2, 2) [m²] that white velocities add to two positions per step.

    Parameters
    ----------
    times : (K,) epochs [s]; the first step begins at zero.
    density : power spectral density of the velocity [m²/s].
    """
    return np.diff(times, prepend=0.0)[:, np.newaxis, np.newaxis] * density * np.eye(2)


def drifting(times: np.ndarray, density: float) -> np.ndarray:
    """Return the covariance (K, 4, 4) that white acceleration adds to two positions and velocities.

    The states are in m and m/s. For a power spectral density q = ``density`` [m²/s³] and a step T
    [s], the variance of a velocity is q T, that of a position q T³/3, and their covariance q T²/2.
    An acceleration of variance σ² that is constant over T corresponds to q = σ² T.
    """
    step = np.diff(times, prepend=0.0)[:, np.newaxis, np.newaxis]
    eye = np.eye(2)
    cov = np.zeros((len(times), 4, 4))
    cov[:, :2, :2] = density * step**3 / 3.0 * eye
    cov[:, :2, 2:] = cov[:, 2:, :2] = density * step**2 / 2.0 * eye
    cov[:, 2:, 2:] = density * step * eye
    return cov
