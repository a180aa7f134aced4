"""Problems reduced to a few states; all other states count as known.

An estimator of few states, as much of the literature has, is an estimator of another problem: its
dynamics are those of the chosen states with all others at their prior's mean, and the noise that it
declares has to stand for what the others do. A reduced problem says so and is a problem like any
other; :meth:`Reduction.embedded` brings an estimate of it back among all states, where it can be
compared with estimators of the whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .problem import CountingModel, Estimate, MeasurementModel, Problem, StateBlock
from .sensors.model import SensorModel


@dataclass(frozen=True)
class Reduction:
    """A problem of r of the n states of another one.

    Attributes
    ----------
    problem : of the chosen states, as what is to be added to the prior's mean carried along.
    states : which of the n they are (r,).
    mean, cov : (K, n), (K, n, n) of the whole state without any reading: the prior carried along.
    """

    problem: Problem
    states: tuple[int, ...]
    mean: np.ndarray
    cov: np.ndarray

    def embedded(self, estimate: Estimate) -> Estimate:
        """Return an estimate of the reduced problem as one of all n states.

        The others keep the mean and the covariance that they have without any reading, and no
        correlation with the chosen ones: of those the estimator knew nothing. It says nothing of
        innovations, which the whole problem would predict in another way. Fixes are of the first
        chosen states.
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
    """The measurement model of a whole problem, as one of some of its states."""

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
    """Return a problem of some of the states of another one, all others known.

    x = m_k + E δ with m_k the prior's mean carried along and δ the chosen states: δ_k is moved by
    the block of Φ_k that leads from them to themselves, and driven by that block of Q_k and by the
    declared noise.

    Parameters
    ----------
    states : which of the n states are kept (r,), each once.
    noise : (K, r, r) process noise that stands for what is left out; may be zero.

    Raises
    ------
    ValueError
        If the states are none of the problem's, or the noise is not of their shape.
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
    """Return h of the chosen states: kernels where they can be, so that compiled engines run."""
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
    """Return mean (K, n) and covariance (K, n, n) of the prior carried along, without readings."""
    n = problem.dimension
    means, covs = np.empty((problem.epochs, n)), np.empty((problem.epochs, n, n))
    mean, cov = problem.prior_mean, problem.prior_cov
    for k, (phi, q) in enumerate(zip(problem.transition, problem.process_cov, strict=True)):
        mean, cov = phi @ mean, phi @ cov @ phi.T + q
        means[k], covs[k] = mean, 0.5 * (cov + cov.T)
    return means, covs


def horizontal(problem: Problem, velocity: bool) -> tuple[int, ...]:
    """Return the states that are the position error east and north, and those of velocity.

    The first two of the first block in metres, and of the first one in metres per second; ``()``
    where the layout has none.
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
    """Return the covariance (K, r, r) of what the states left out do to the chosen ones in a step.

    Φ P Φᵀ with the block of Φ_k that leads from them to the chosen ones, and their prior carried
    along without a reading: what an INS's velocity errors may move its position by. As noise it is
    white, where the error itself lasts.
    """
    chosen = list(states)
    others = [i for i in range(problem.dimension) if i not in chosen]
    _, covs = _unaided(problem)
    before = np.concatenate([problem.prior_cov[np.newaxis], covs[:-1]])
    across = problem.transition[:, chosen][:, :, others]
    return np.asarray(across @ before[:, others][:, :, others] @ across.transpose(0, 2, 1))


def walking(times: np.ndarray, density: float) -> np.ndarray:
    """Return the covariance (K, 2, 2) [m²] of two positions that white velocities move.

    Parameters
    ----------
    times : (K,) epochs [s]; the first step begins at zero.
    density : of the velocity [m²/s].
    """
    return np.diff(times, prepend=0.0)[:, np.newaxis, np.newaxis] * density * np.eye(2)


def drifting(times: np.ndarray, density: float) -> np.ndarray:
    """Return the covariance (K, 4, 4) of two positions and two velocities [m, m/s].

    That white accelerations of a density q [m²/s³] cause over T: q T for velocity, q T²/2 for
    position with velocity, q T³/3 for position. A rate held constant over T, of variance σ², would
    be Γ σ² Γᵀ with Γ = T (I + T F / 2): q is σ² T, not σ².
    """
    step = np.diff(times, prepend=0.0)[:, np.newaxis, np.newaxis]
    eye = np.eye(2)
    cov = np.zeros((len(times), 4, 4))
    cov[:, :2, :2] = density * step**3 / 3.0 * eye
    cov[:, :2, 2:] = cov[:, 2:, :2] = density * step**2 / 2.0 * eye
    cov[:, 2:, 2:] = density * step * eye
    return cov
