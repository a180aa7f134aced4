"""Engine of all particle filters, with Kalman filters for some states.

The first d states of a particle are samples. The others, l, have a Gaussian for each particle, with
a common covariance P_l, because dynamics and measurements are linear in l (Schön, Gustafsson &
Nordlund 2005: the Rao–Blackwellised or marginalised filter). With all states drawn, d = n, it is
the bootstrap filter of Gordon, Salmond & Smith (1993), with none the Kalman filter.
"""

from __future__ import annotations

import numpy as np

from ..problem import Estimate, Problem
from .cloud import Cloud
from .moves import Moves


def filtered(problem: Problem, drawn: int, moves: Moves, rng: np.random.Generator) -> Estimate:
    """Run the filter, with the first ``drawn`` of the n states as particles.

    h must be linear in the other states with coefficients that depend on none of them; see
    :func:`.linear_states.mixing`.

    The NIS is that of the Gaussian: innovation from the mean of h, covariance of h plus R. It is
    NaN for particles. The evidence is ln p(z) of all measurements, for the comparison of models;
    artificial noise (``Moves``) biases it.
    """
    epochs, n = problem.epochs, problem.dimension
    mean, cov, nis = np.empty((epochs, n)), np.empty((epochs, n, n)), np.full(epochs, np.nan)
    cloud = Cloud(problem, drawn, moves, rng)
    repairs = 0
    for k in range(epochs):
        cloud.predict(k)
        if problem.present[k].any():
            nis[k] = cloud.update(k)
        mean[k], cov[k], was_repaired = cloud.moments()
        repairs += was_repaired
        cloud.renew_if_poor()
    sizes = cloud.sizes or [float(moves.particles)]
    info = {
        "ess_min": float(np.min(sizes)),
        "ess_median": float(np.median(sizes)),
        "resamplings": cloud.resamplings,
        "tempering_stages": cloud.stages,
        "unique_min": cloud.fewest,
        "covariance_repairs": repairs,
        "map_evaluations": cloud.evaluations,
        "log_evidence": cloud.evidence,
    }
    return Estimate(mean, cov, "filter", info=info, nis=nis)
