"""Innovations and their normalised squares."""

from __future__ import annotations

import numpy as np

from ..problem import Problem
from ..sensors.model import SensorModel
from ..sensors.model_kernels import linearised


def innovations(
    problem: Problem, mean: np.ndarray, cov: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the innovations (K, m) of a filter's estimates, and their covariances (K, m, m).

    The prediction is the filter's estimate at the previous epoch, propagated with Φ and Q; at the
    first epoch it is the propagated prior. ``mean`` (K, n) and ``cov`` (K, n, n) must come from a
    filter, not a smoother. Innovations of missing measurements are zero. The evaluations of h and H
    are not counted in ``evaluations``.
    """
    epochs, channels = problem.measurements.shape
    last_mean = np.concatenate([problem.prior_mean[np.newaxis], mean[:-1]])
    last_cov = np.concatenate([problem.prior_cov[np.newaxis], cov[:-1]])
    phi = problem.transition
    predicted = np.einsum("kij,kj->ki", phi, last_mean)
    spread = phi @ last_cov @ phi.transpose(0, 2, 1) + problem.process_cov
    there = np.flatnonzero(problem.present.any(axis=1))
    found = np.zeros((epochs, channels))
    rows = np.zeros((epochs, channels, problem.dimension))
    if isinstance(problem.model, SensorModel):
        arrays = problem.model.arrays.as_block()
        found[there], rows[there] = linearised(arrays, there, predicted[there])
    else:
        for k in map(int, there):
            found[k] = problem.model.predict(k, predicted[k])
            rows[k] = problem.model.jacobian(k, predicted[k])
    found[there] = problem.measurements[there] - found[there]
    return found, rows @ spread @ rows.transpose(0, 2, 1) + problem.noise_cov


def innovations_squared(problem: Problem, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Return the normalised innovation squared (K,) of a filter's estimates.

    The innovations are those of :func:`innovations`. The NIS is NaN without a measurement.
    """
    nis = np.full(problem.epochs, np.nan)
    there = problem.present.any(axis=1)
    found, spreads = (values[there] for values in innovations(problem, mean, cov))
    white = np.linalg.solve(spreads, found[..., np.newaxis])[..., 0]
    nis[there] = np.einsum("ki,ki->k", found, white)
    return nis
