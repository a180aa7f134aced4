"""Engine of all particle filters, optionally with Kalman filters for some states.

The first d of n states of a particle are samples. Dynamics and measurements are linear in the other
states l. Therefore each particle has a Gaussian of l, with one covariance P_l for all particles
(Rao–Blackwellised or marginalised filter: Schön, Gustafsson & Nordlund 2005). With d = n the filter
is the bootstrap filter of Gordon, Salmond & Smith (1993), with d = 0 the Kalman filter.
"""

from __future__ import annotations

import numpy as np

from ..problem import Estimate, Problem
from .cloud import Cloud
from .moves import Moves


def filtered(problem: Problem, drawn: int, moves: Moves, rng: np.random.Generator) -> Estimate:
    """Run a particle filter in which the first ``drawn`` of the n states are sampled.

    h must be linear in the other states, with coefficients that do not depend on any state; see
    :func:`.linear_states.mixing`.

    While the cloud is a Gaussian, the innovation in the NIS is z minus the mean of h. Its
    covariance is the covariance of h plus R. For particles the NIS is NaN. ``info`` contains the
    evidence, ln p(z) of all measurements, for the comparison of models. Artificial noise
    (:class:`.Moves`) biases the evidence.
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
