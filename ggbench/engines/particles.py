"""Engine of all particle filters, with some states in Kalman filters.

The first d states of a particle are drawn, the others, l, are a Gaussian for each particle, all of
one covariance P_l, because the dynamics are linear and the readings linear in l (Schön, Gustafsson
& Nordlund 2005: the Rao–Blackwellised or marginalised filter). With all states drawn, d = n, it is
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

    NIS is that of the Gaussian: innovation against the mean of h, covariance of h over it plus R.
    It is NaN where there is a cloud. The evidence is ln p(z) of all readings, by which models of
    one flight may be compared; what blurs a cloud (``Moves``) biases it.
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
