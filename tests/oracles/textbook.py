"""Extended Kalman filter in NumPy, of any measurement model: plain, iterated or robust.

The compiled filters need the package's own model. This one needs h and its Jacobian alone, and has
their equations: Joseph's form of every update, with h linearised at the most probable state.
"""

from __future__ import annotations

import numpy as np

from ggbench.engines.robust_weights import losses, reweighted_noise
from ggbench.estimators.robust import Loss
from ggbench.problem import Estimate, Problem

_HALVINGS = 12
_CONVERGED = 1e-6
"""Decrease of the cost below which an update has converged: a thousandth of a deviation."""


def extended(problem: Problem, iterations: int, loss: Loss, threshold: float) -> Estimate:
    """Return the filter's estimate of one run.

    Parameters
    ----------
    iterations : most linearisations of h per epoch; 1 is the plain filter.
    loss : robust loss on each component of a whitened residual.
    threshold : residual from which the loss acts [standard deviations of the noise].
    """
    n = problem.dimension
    x, cov = problem.prior_mean, problem.prior_cov
    mean, covs = np.empty((problem.epochs, n)), np.empty((problem.epochs, n, n))
    linearisations = 0
    for k, (phi, q) in enumerate(zip(problem.transition, problem.process_cov, strict=True)):
        x, cov = phi @ x, phi @ cov @ phi.T + q
        update = Update(
            problem=problem,
            k=k,
            predicted=x,
            cov=cov,
            noise_cov=problem.noise_of(k),
            loss=loss,
            threshold=threshold,
        )
        if iterations > 1:
            update.minimise(iterations)
        linearisations += update.linearisations
        x, cov = update.corrected(iterated=iterations > 1)
        mean[k], covs[k] = x, cov
    return Estimate(mean, covs, "filter", info={"linearisations": linearisations})


class Update:
    """The search for the state x at which the h of one measurement is linearised.

    It minimises J(x) = ½ (x − x⁻)ᵀ P⁻¹ (x − x⁻) + Σ ρ(r(x)) with r the whitened residuals (Bell &
    Cathey 1993). Every x it visits is x⁻ + P λ, so that the first term is ½ λᵀ P λ and P needs no
    inverse.
    """

    def __init__(
        self,
        problem: Problem,
        k: int,
        predicted: np.ndarray,
        cov: np.ndarray,
        noise_cov: np.ndarray,
        loss: Loss,
        threshold: float,
    ) -> None:
        self.model, self.k, self.measurement = problem.model, k, problem.measurements[k]
        self.predicted, self.cov, self.given = predicted, cov, noise_cov
        self.loss, self.threshold = loss, threshold
        self.linearisations = 0
        self.x, self.dual = predicted, np.zeros(len(predicted))
        self.h = self.model.predict(k, predicted)
        self._linearise()

    def _linearise(self) -> None:
        """Linearise h at x; reweigh the noise by the residuals of the linear update."""
        self.linearisations += 1
        self.rows = self.model.jacobian(self.k, self.x)
        self.noise_cov = self.given
        if self.loss != "none":
            innovation, spread = self.innovation()
            self.noise_cov = reweighted_noise(
                innovation, spread, self.given, self.loss, self.threshold
            )

    def innovation(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the innovation (m,) by the linearised h, and H P Hᵀ (m, m)."""
        expected = self.h + self.rows @ (self.predicted - self.x)
        return self.measurement - expected, self.rows @ self.cov @ self.rows.T

    def _cost(self, dual: np.ndarray, h: np.ndarray) -> float:
        white = np.linalg.solve(np.linalg.cholesky(self.given), self.measurement - h)
        left = losses(white, self.loss, self.threshold)
        return float(0.5 * dual @ self.cov @ dual + left.sum())

    def minimise(self, iterations: int) -> None:
        """Move x to the minimum of J by Gauss–Newton steps, each halved until J falls."""
        cost = self._cost(self.dual, self.h)
        for iteration in range(iterations):
            if iteration:
                self._linearise()
            innovation, spread = self.innovation()
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

    def corrected(self, iterated: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return state (n,) and covariance (n, n) after the update, by Joseph's form.

        The state is the minimum that was found, or the whole of one step from the prediction.
        """
        innovation, spread = self.innovation()
        gain = np.linalg.solve(spread + self.noise_cov, self.rows @ self.cov).T
        kept = np.eye(len(self.cov)) - gain @ self.rows
        cov = kept @ self.cov @ kept.T + gain @ self.noise_cov @ gain.T
        return self.x if iterated else self.predicted + gain @ innovation, 0.5 * (cov + cov.T)
