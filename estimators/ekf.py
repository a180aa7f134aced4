"""Extended Kalman filter (filterpy): plain, iterated, robust, with adaptive measurement noise.

filterpy does every prediction and every update in Joseph's form. What is chosen here is the point
at which h is linearised and the noise covariance of the update.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..block import BlockEstimator, EstimateBlock, ProblemBlock
from ..engines import filters
from ..engines.cautious_update import gate_limits
from ..engines.iterated_filter import iterated
from ..problem import Causality, Estimate, MeasurementModel, Problem
from . import cautious, robust, told_noise
from .robust import Loss

_HALVINGS = 12
_CONVERGED = 1e-6
"""Decrease of the cost below which an update has converged: a thousandth of a deviation."""


@dataclass(frozen=True)
class ExtendedKalmanFilter(BlockEstimator):
    """Extended Kalman filter (Bar-Shalom, Li & Kirubarajan 2001, ch. 10).

    Parameters
    ----------
    iterations : most linearisations of h per epoch. 1 is the plain filter; with more, the update
        is a Gauss–Newton search for the most probable state (Bell & Cathey 1993), whose steps are
        halved until the cost falls.
    loss : ``huber`` or ``cauchy`` weigh down the components of a reading that fit neither the
        prediction nor each other; see :mod:`ggbench.estimators.robust`.
    threshold : residual [standard deviations of the noise] from which the loss acts; if not
        given, 1.345 for ``huber`` and 2.385 for ``cauchy``.
    noise_memory : number of readings over which the measurement noise is estimated from the
        residuals, a variance for each component (Mohamed & Schwarz 1999, with the forgetting of
        Sage & Husa 1969); 0 believes the given noise.
    noise_scale : factor on the standard deviations of the readings of gravity and its gradients,
        as the estimator is told them; see :mod:`ggbench.estimators.told_noise`.
    gate : probability between 0 and 1 with which a good reading passes; one whose innovation is
        beyond that quantile of χ² is left out. 0 is no gate. See
        :mod:`ggbench.engines.cautious_update`.
    underweighting : β of S = (1 + β) H P Hᵀ + R, for the gain alone; 0 is the optimal gain.
    engine : ``filterpy``, the reference, or ``numba``: the same, compiled, on many runs at once.
    """

    iterations: int = 1
    loss: Loss = "none"
    threshold: float | None = None
    noise_memory: int = 0
    noise_scale: float = 1.0
    gate: float = 0.0
    underweighting: float = 0.0
    engine: Literal["filterpy", "numba"] = "filterpy"

    name = "ekf"

    @property
    def causality(self) -> Causality:
        """Measurements up to each epoch."""
        return "filter"

    @property
    def exact(self) -> bool:
        """Not with a gate, which leaves good readings out, nor with another gain."""
        return not self.gate and not self.underweighting

    @property
    def takes_blocks(self) -> bool:
        """Only the engine ``numba``."""
        return self.engine == "numba"

    def skip(self, problem: Problem) -> str | None:
        """Refuse parameters that mean nothing."""
        if self.iterations < 1:
            return f"iterations must be at least 1, and is {self.iterations}"
        if self.noise_memory < 0 or self.noise_memory == 1:
            return f"noise_memory must be 0 or at least 2, and is {self.noise_memory}"
        if reason := told_noise.refusal(self.noise_scale):
            return reason
        if reason := robust.refusal(self.loss, self.threshold):
            return reason
        if reason := cautious.refusal(
            self.gate, self.underweighting, self.loss, self.iterations, self.noise_memory
        ):
            return reason
        return super().skip(problem) if self.takes_blocks else None

    def estimate_block(self, block: ProblemBlock) -> EstimateBlock:
        """Filter all runs of a block."""
        block = told_noise.told(block, self.noise_scale)
        if self.iterations == 1 and self.loss == "none" and not self.noise_memory:
            mean, cov, nis, rejected = filters.extended(block, self.gate, self.underweighting)
            linearisations = evaluations = np.full(block.runs, block.epochs)
        else:
            threshold = robust.threshold_of(self.loss, self.threshold)
            rejected = np.zeros(block.runs, dtype=int)
            mean, cov, nis, counts = iterated(
                block, self.iterations, self.loss, threshold, self.noise_memory
            )
            linearisations, evaluations = counts.T
        info = {"linearisations": linearisations, "map_evaluations": evaluations}
        if self.gate:
            info["rejected"] = rejected
        return EstimateBlock(mean, cov, self.causality, nis=nis, info=info)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Predict with Φ and Q, update with h linearised where it fits, epoch by epoch."""
        if self.takes_blocks:
            return super().estimate(problem, rng)
        # Not at the top: it loads as slowly as all the rest, and to be listed needs none of it.
        from filterpy.kalman import ExtendedKalmanFilter as FilterpyEKF

        problem = told_noise.told(problem, self.noise_scale)
        n, m = problem.dimension, problem.measurements.shape[1]
        ekf = FilterpyEKF(dim_x=n, dim_z=m)
        ekf.x = problem.prior_mean.copy()  # filterpy's default (n, 1) would broadcast with a 1-D z
        ekf.P = problem.prior_cov.copy()
        noise = _AdaptiveNoise(m, self.noise_memory)
        threshold = robust.threshold_of(self.loss, self.threshold)
        limits = gate_limits(self.gate, problem.present)
        mean = np.empty((problem.epochs, n))
        cov = np.empty((problem.epochs, n, n))
        linearisations = rejected = 0
        for k in range(problem.epochs):
            ekf.F, ekf.Q = problem.transition[k], problem.process_cov[k]
            ekf.predict()
            update = _Update(
                problem.model, k, problem.measurements[k], ekf.x, ekf.P,
                noise.of(problem.noise_of(k)),
                self.loss, threshold,
            )  # fmt: skip
            if self.iterations > 1:
                update.minimise(self.iterations)
            linearisations += update.linearisations
            if limits[k] < np.inf and update.square(self.underweighting) > limits[k]:
                rejected += 1
            else:
                ekf.update(
                    problem.measurements[k],
                    HJacobian=lambda x, u: u.rows,
                    Hx=lambda x, u: u.h,
                    R=update.underweighted_noise(self.underweighting),
                    args=(update,),
                    hx_args=(update,),
                )
                if self.underweighting:  # filterpy took the noise of the gain for that of readings
                    ekf.P = cautious.joseph(update.cov, ekf.K, update.rows, update.noise_cov)
            if self.iterations > 1:
                ekf.x = update.x  # filterpy takes the whole of one step, from the prediction
            ekf.P = 0.5 * (ekf.P + ekf.P.T)
            mean[k], cov[k] = ekf.x, ekf.P
            if self.noise_memory:
                noise.learn(
                    problem.noise_of(k),
                    problem.present[k],
                    problem.measurements[k] - problem.model.predict(k, ekf.x),
                    update.rows @ ekf.P @ update.rows.T,
                    update.noise_cov,
                )
        info = {"linearisations": linearisations}
        if self.gate:
            info["rejected"] = rejected
        estimate = Estimate(mean, cov, self.causality, info=info)
        return told_noise.with_own_nis(estimate, problem, self.noise_scale)


class _Update:
    """The search for the state x at which one reading's h is to be linearised.

    It minimises J(x) = ½ (x − x⁻)ᵀ P⁻¹ (x − x⁻) + Σ ρ(r(x)) with r the whitened residuals. Every
    x it visits is x⁻ + P λ, so that the first term is ½ λᵀ P λ and P needs no inverse.
    """

    def __init__(
        self,
        model: MeasurementModel,
        k: int,
        measurement: np.ndarray,
        predicted: np.ndarray,
        cov: np.ndarray,
        noise_cov: np.ndarray,
        loss: Loss,
        threshold: float,
    ) -> None:
        self.model, self.k, self.measurement = model, k, measurement
        self.predicted, self.cov, self.given = predicted, cov, noise_cov
        self.loss, self.threshold = loss, threshold
        self.linearisations = 0
        self.x, self.dual = predicted, np.zeros(len(predicted))
        self.h = model.predict(k, predicted)
        self._linearise()

    def _linearise(self) -> None:
        """Linearise h at x; reweigh the noise by what the linear update leaves."""
        self.linearisations += 1
        self.rows = self.model.jacobian(self.k, self.x)
        self.noise_cov = self.given
        if self.loss != "none":
            innovation, spread = self._innovation()
            self.noise_cov = robust.reweighted_noise(
                innovation, spread, self.given, self.loss, self.threshold
            )

    def _innovation(self) -> tuple[np.ndarray, np.ndarray]:
        expected = self.h + self.rows @ (self.predicted - self.x)
        return self.measurement - expected, self.rows @ self.cov @ self.rows.T

    def _cost(self, dual: np.ndarray, h: np.ndarray) -> float:
        white = np.linalg.solve(np.linalg.cholesky(self.given), self.measurement - h)
        left = robust.losses(white, self.loss, self.threshold)
        return float(0.5 * dual @ self.cov @ dual + left.sum())

    def underweighted_noise(self, underweighting: float) -> np.ndarray:
        """Return R + β H P Hᵀ, the noise with which a filter has the underweighted gain."""
        if not underweighting:
            return self.noise_cov
        return self.noise_cov + underweighting * self._innovation()[1]

    def square(self, underweighting: float) -> float:
        """Return yᵀ S⁻¹ y of the innovation, by the S of the gain."""
        innovation, spread = self._innovation()
        noise_cov = self.underweighted_noise(underweighting)
        return cautious.normalised_square(innovation, spread + noise_cov)

    def minimise(self, iterations: int) -> None:
        """Move x to the minimum of J by Gauss–Newton steps, each halved until J falls."""
        cost = self._cost(self.dual, self.h)
        for iteration in range(iterations):
            if iteration:
                self._linearise()
            innovation, spread = self._innovation()
            step = self.rows.T @ np.linalg.solve(spread + self.noise_cov, innovation) - self.dual
            before = cost
            for halving in range(_HALVINGS):
                dual = self.dual + 0.5**halving * step
                x = self.predicted + self.cov @ dual
                h = self.model.predict(self.k, x)
                new = self._cost(dual, h)
                if new < cost:
                    self.x, self.dual, self.h, cost = x, dual, h, new
                    break
            if before - cost < _CONVERGED:
                break


class _AdaptiveNoise:
    """Variances of the components of the whitened noise, estimated from what updates leave."""

    def __init__(self, channels: int, memory: int) -> None:
        self._memory = memory
        self._readings, self._variances = np.ones(channels), np.ones(channels)

    def of(self, given: np.ndarray) -> np.ndarray:
        """Return what is believed by now of a noise covariance that is given."""
        if not self._memory:
            return given
        root = np.linalg.cholesky(given)
        return np.asarray((root * self._variances) @ root.T)

    def learn(
        self,
        given: np.ndarray,
        there: np.ndarray,
        residual: np.ndarray,
        spread: np.ndarray,
        weighted_cov: np.ndarray,
    ) -> None:
        """Take in a residual after the update: its expected square is R − H P⁺ Hᵀ.

        Of the channels that are ``there``; R was ``given`` so, and ``weighted_cov`` used.
        """
        root = np.linalg.cholesky(given)
        white = np.linalg.solve(root, residual)
        certain = np.linalg.solve(root, np.linalg.solve(root, spread).T)
        # A component that a robust loss holds for an outlier counts as little as it did there.
        weighted = np.linalg.solve(root, np.linalg.solve(root, weighted_cov).T)
        weight = self._variances / np.diag(weighted)
        self._readings[there] = np.minimum(self._readings + 1.0, self._memory)[there]
        new = weight * white**2 + np.diag(certain)
        self._variances[there] += ((new - self._variances) / self._readings)[there]
