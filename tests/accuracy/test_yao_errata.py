"""Errata of Yao's strong-tracking unscented particle filter: printed form, corrected form, truth.

Where a formula is wrong, a test shows that the corrected form is right and the printed one is not.
That the filter is called a "strong trace filter" needs none: it is Zhou's strong tracking filter.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from frame_oracles import mechanization_jacobian
from problems import kalman, linear_problem, rng, simulated
from rough_field import rough_flight

from ggbench.estimators.strong_tracking import faded, fading_factors
from ggbench.estimators.unscented_particle import UnscentedCloud, UnscentedParticle
from ggbench.gravity import ellipsoid
from ggbench.problem import Problem
from ggbench.reduced import drifting, horizontal

MINUTE = 60.0
STANDARD_GRAVITY = 9.80665
"""What a µg is a millionth of [m/s²]."""
F = np.zeros((4, 4))
"""Two positions and two velocities, which is what is left of an INS over a minute."""
F[:2, 2:] = np.eye(2)


def gamma(period: float) -> np.ndarray:
    """Γ (4, 4) = T (I + T F / 2), as printed."""
    return period * (np.eye(4) + 0.5 * period * F)


def test_velocity_error_is_east_and_north_not_east_and_west():
    """East and west are one axis: a filter of both has nothing that moves it to the north.

    The north position of an INS changes by the north velocity's error, T metres for a metre per
    second, and by the east one's hardly at all.
    """
    problem, _ = simulated("0.01E-1Hz-unfiltered")
    east, north, velocity_east, velocity_north = horizontal(problem, velocity=True)
    phi = problem.transition[0]
    period = problem.times[0]
    assert phi[north, velocity_north] == pytest.approx(period, rel=1e-3)
    assert phi[east, velocity_east] == pytest.approx(period, rel=1e-3)
    assert abs(phi[north, velocity_east]) < 1e-3 * period


def test_gamma_takes_a_rate_that_is_constant_and_not_a_density():
    """Γ σ² Γᵀ of σ² = q / T is the covariance of white acceleration but for its highest order.

    Put in for q itself it is wrong by a factor of T in the velocities. The truth is composed of a
    thousand short steps.
    """
    q, steps = 0.01, 1000
    short = MINUTE / steps
    phi, truth = np.eye(4) + short * F, np.zeros((4, 4))
    for _ in range(steps):
        truth = phi @ truth @ phi.T
        truth[2:, 2:] += q * short * np.eye(2)
    corrected = drifting(np.array([MINUTE]), q)[0]
    np.testing.assert_allclose(corrected, truth, rtol=2e-3)
    rate = np.diag([0.0, 0.0, q, q])
    printed = gamma(MINUTE) @ rate @ gamma(MINUTE).T
    assert printed[2, 2] / truth[2, 2] == pytest.approx(MINUTE, rel=1e-3)
    held = gamma(MINUTE) @ rate @ gamma(MINUTE).T / MINUTE
    np.testing.assert_allclose(held[2:, 2:], truth[2:, 2:], rtol=1e-3)
    np.testing.assert_allclose(held[:2, 2:], truth[:2, 2:], rtol=2e-3)


def test_process_noise_may_be_singular():
    """What the form without derivatives inverts is ΦPΦᵀ + Q, not Q: H is found with Q of rank 2.

    The printed text asks for a positive definite Q; an inertial system has none.
    """
    problem = linear_problem(0)
    cloud = UnscentedCloud(UnscentedParticle(), problem, rng())
    cloud.predict(0)
    q = cloud.process_cov[0]
    assert np.linalg.matrix_rank(q) < len(q)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(q)
    roots = cloud.square_roots(cloud.covs)
    _, slope, _ = cloud.linear_regression(0, roots)
    rows = np.linalg.solve(roots[0].T, slope[0]).T
    h = problem.model.rows[0] * cloud.scale
    white = np.linalg.solve(np.linalg.cholesky(problem.noise_of(0)), h)
    np.testing.assert_allclose(rows, white, rtol=0.0, atol=1e-12 * np.abs(white).max())


def test_without_tilt_and_biases_a_minute_misses_more_than_its_noise():
    """10″ of tilt and 50 µg accelerate by 1e-3 m/s²: 6 cm/s and 1.8 m in a minute, for an hour.

    Over 42 minutes tilt swings to its opposite, as Schuler has it: what is left out is no white
    noise, and four states have no such period.
    """
    place = np.array([np.radians(15.2), 0.0, 0.0])
    gravity, _, _ = ellipsoid.normal_gravity(place[0], 0.0)
    motion, _ = mechanization_jacobian(
        place, np.zeros(3), np.eye(3), np.array([0.0, 0.0, gravity]), np.zeros(3)
    )
    tilt, bias = np.radians(10.0 / 3600.0), 50e-6 * STANDARD_GRAVITY
    acceleration = abs(motion[3, 7]) * tilt + abs(motion[3, 12]) * bias
    assert acceleration == pytest.approx(1e-3, rel=0.05)
    assert acceleration * MINUTE == pytest.approx(0.06, rel=0.05)
    assert 0.5 * acceleration * MINUTE**2 == pytest.approx(1.8, rel=0.05)
    frequencies = np.abs(np.linalg.eigvals(motion[:9, :9]).imag)
    schuler = np.sqrt(gravity / 6.371e6)
    assert np.abs(frequencies / schuler - 1.0).min() < 0.05
    assert not np.linalg.eigvals(F).any()


@functools.cache
def bent() -> Problem:
    """Readings that bend over a prior of 300 m."""
    return rough_flight(3, 300.0, epochs=2)[0]


def test_sigma_points_are_drawn_anew_after_fading():
    """Of the faded covariance: else the innovation's covariance is that of the one before.

    Where h is linear both have H P⁻ Hᵀ; the printed form keeps P_zz of the points before fading, as
    if nothing had faded. By how much an innovation is expected to scatter then is wrong by λ.
    """
    problem = linear_problem(0)
    cloud = UnscentedCloud(UnscentedParticle(), problem, rng())
    cloud.predict(0)
    _, _, before = cloud.linear_regression(0, cloud.square_roots(cloud.covs))
    factor = np.array([9.0])
    cloud.covs = faded(cloud.covs, cloud.process_cov[0], factor)
    _, _, after = cloud.linear_regression(0, cloud.square_roots(cloud.covs))
    root = np.linalg.cholesky(problem.noise_of(0))
    rows = np.linalg.solve(root, problem.model.rows[0]) * cloud.scale
    true = rows @ cloud.covs[0] @ rows.T
    np.testing.assert_allclose(after[0], true, rtol=1e-10)
    assert np.trace(true) > 3.0 * np.trace(before[0])


def test_the_filter_draws_its_points_anew():
    """Its own update is that of a filter that begins with the faded covariance, bent h or not."""
    problem = bent()
    tracking = UnscentedCloud(UnscentedParticle(particles=1, strong_tracking=True), problem, rng())
    tracking.predict(0)
    tracking.power[:], tracking.seen[:] = 1e4, True
    plain = UnscentedCloud(UnscentedParticle(particles=1), problem, rng())
    plain.predict(0)
    there = problem.present[0]
    begun = tracking.covs.copy()
    tracking.update(0, there)
    factor = np.array(tracking.factors)
    assert factor[0] > 2.0
    plain.covs = faded(begun, plain.process_cov[0], factor)
    plain.update(0, there)
    np.testing.assert_array_equal(tracking.states, plain.states)
    np.testing.assert_array_equal(tracking.covs, plain.covs)


def test_fading_grows_the_past_and_not_the_noise():
    """λ Φ P Φᵀ + Q: of the noise alone nothing is faded, and λ = 1 is the prediction to the bit."""
    problem = linear_problem(0)
    _, _, _, predicted = kalman(problem)
    q = problem.process_cov[5]
    past = predicted[5] - q
    grown = faded(predicted[5][None], q, np.array([4.0]))[0]
    size = np.sqrt(np.outer(np.diag(predicted[5]), np.diag(predicted[5])))
    np.testing.assert_allclose(grown / size, (4.0 * past + q) / size, atol=1e-12)
    assert faded(predicted[5][None], q, np.ones(1)).tobytes() == predicted[5].tobytes()
    assert fading_factors(np.zeros((1, 2)), np.ones((1, 2)), np.zeros((1, 2)), 1.0)[0] == 1.0
