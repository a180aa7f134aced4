"""What the readings say to a filter's estimates: innovations, and their normalised squares."""

from __future__ import annotations

import numpy as np

from ..problem import Problem


def innovations(
    problem: Problem, mean: np.ndarray, cov: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the innovations (K, m) of a filter's estimates, and their covariances (K, m, m).

    The innovation is that of the estimate at the previous epoch, predicted with Φ and Q. Only a
    filter has innovations; the first epoch's is that of the prior. It is zero where a channel
    delivers nothing.
    """
    epochs, channels = problem.measurements.shape
    found, spreads = np.zeros((epochs, channels)), np.empty((epochs, channels, channels))
    x, p = problem.prior_mean, problem.prior_cov
    for k in range(problem.epochs):
        phi = problem.transition[k]
        x, p = phi @ x, phi @ p @ phi.T + problem.process_cov[k]
        spreads[k] = problem.noise_of(k)
        if problem.present[k].any():
            h = problem.model.jacobian(k, x)
            found[k] = problem.measurements[k] - problem.model.predict(k, x)
            spreads[k] = h @ p @ h.T + problem.noise_of(k)
        x, p = mean[k], cov[k]
    return found, spreads


def innovations_squared(problem: Problem, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Return the NIS (K,) of a filter's estimates, from its own mean and covariance.

    Of its :func:`innovations`; NaN where no channel delivers anything.
    """
    nis = np.full(problem.epochs, np.nan)
    found, spreads = innovations(problem, mean, cov)
    for k in np.flatnonzero(problem.present.any(axis=1)):
        nis[k] = found[k] @ np.linalg.solve(spreads[k], found[k])
    return nis
