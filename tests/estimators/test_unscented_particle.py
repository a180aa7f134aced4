"""The unscented particle filter: exact where it can be, its weights, and strong tracking."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from problems import (
    changed,
    deviation,
    estimator,
    kalman,
    linear_problem,
    noisy_problem,
    refusal,
    rng,
)
from rough_field import LENGTH, rough_flight
from scipy.stats import multivariate_normal

from ggbench.engines.innovations import innovations
from ggbench.estimators import strong_tracking
from ggbench.estimators.unscented_particle import UnscentedCloud, UnscentedParticle
from ggbench.problem import Estimate, Problem

WHITE_ALONE = 1e9
"""A β with which no innovation is ever large enough to fade anything."""


@pytest.mark.parametrize("particles", [1, 7, 100])
@pytest.mark.parametrize("seed", range(3))
def test_a_mixture_of_kalman_filters_is_the_kalman_filter(seed, particles):
    """Where h is linear and the prior not split: any number of them, to 1e-9, never resampled."""
    problem = linear_problem(seed)
    found = UnscentedParticle(particles=particles).estimate(problem, rng())
    mean, cov, _, _ = kalman(problem)
    assert max(deviation(found.mean, found.cov, mean, cov)) < 1e-9
    assert found.info["resamplings"] == 0
    assert found.info["ess_min"] == pytest.approx(particles)


def test_particles_make_up_a_wide_prior():
    """Ten thousand Gaussians of 150 m have the mean and the covariance of a prior of 1 km.

    Of 15 means and 120 covariances the first within 5, the second within 6 deviations of their
    sampling errors: a false alarm in 1e5 seeds.
    """
    problem, _ = rough_flight(0, 1000.0, epochs=2)
    count = 10_000
    mean, cov = UnscentedCloud(UnscentedParticle(particles=count), problem, rng()).moments()
    assert np.abs(mean).max() < 5.0 / np.sqrt(count)
    prior = problem.prior_cov / np.outer(*2 * [np.sqrt(np.diag(problem.prior_cov))])
    assert np.abs(cov - prior).max() < 6.0 * np.sqrt(2.0 / count)
    alone = UnscentedCloud(UnscentedParticle(particles=count, width_m=2e3), problem, rng())
    assert len(alone.states) == 1  # a prior that is no wider is not split


@functools.cache
def wide() -> list[tuple[Problem, np.ndarray]]:
    """Flights with a prior as wide as the field's correlation length."""
    return [rough_flight(seed, LENGTH, epochs=60) for seed in range(10)]


def final_errors(label: str) -> np.ndarray:
    answers = [estimator(label).estimate(problem, rng()) for problem, _ in wide()]
    pairs = zip(answers, wide(), strict=True)
    return np.array([np.linalg.norm((a.mean - truth)[-1, :3]) for a, (_, truth) in pairs])


@pytest.mark.long
def test_a_mixture_finds_a_place_that_one_filter_loses():
    """In ten flights of ten; a single particle, the UKF, loses its way in some of them."""
    assert (final_errors("unscented-particle[width_m=300]") < 100.0).sum() == 10
    assert (final_errors("unscented-particle[particles=1,width_m=100000]") < 100.0).sum() < 10


def test_particles_are_weighed_by_the_density_of_what_they_predicted():
    """Two Gaussians of unequal place and width: their weights are N(z; Hx, HPHᵀ + R), to 1e-9."""
    problem = linear_problem(2)
    cloud = UnscentedCloud(UnscentedParticle(particles=2), problem, rng())
    cov = cloud.covs[0]
    cloud.states = np.array([cloud.states[0], cloud.states[0] + 0.3])
    cloud.covs = np.array([cov, 4.0 * cov])
    cloud.copies, cloud.log_weights = np.ones(2, dtype=int), np.zeros(2)
    cloud.power = np.zeros((2, 2))
    h, r = problem.model.rows[0] * cloud.scale, problem.noise_of(0)
    told = [
        multivariate_normal.logpdf(problem.measurements[0], h @ x, h @ p @ h.T + r)
        for x, p in zip(cloud.states, cloud.covs, strict=True)
    ]
    cloud.update(0, problem.present[0])
    assert np.diff(cloud.log_weights)[0] == pytest.approx(np.diff(told)[0], rel=1e-9)


def test_what_a_particle_has_seen_goes_on_with_it():
    """State, covariance and power of innovations are those of the particle that is resampled."""
    problem, _ = rough_flight(0, 1000.0, epochs=2)
    cloud = UnscentedCloud(UnscentedParticle(particles=20, strong_tracking=True), problem, rng())
    cloud.power = np.arange(20.0)[:, np.newaxis] * np.ones(6)
    cloud.covs = cloud.covs * np.arange(1.0, 21.0)[:, np.newaxis, np.newaxis]
    states, covs = cloud.states.copy(), cloud.covs.copy()
    cloud.log_weights[:] = -100.0
    cloud.log_weights[[3, 11]] = 0.0
    mean, _ = cloud.moments()
    cloud.resample()
    np.testing.assert_array_equal(cloud.copies, [10, 10])
    np.testing.assert_array_equal(cloud.power[:, 0], [3.0, 11.0])
    np.testing.assert_array_equal(cloud.states, states[[3, 11]])
    np.testing.assert_array_equal(cloud.covs, covs[[3, 11]])
    np.testing.assert_allclose(cloud.moments()[0], mean, atol=1e-12)
    # Few copies carried once are as many particles: nothing is left to resample.
    cloud.resample()
    assert cloud.resamplings == 1
    assert cloud.sizes[-1] == pytest.approx(20.0)


def relative(estimate: Estimate, problem: Problem) -> float:
    """Distance of a mean from the Kalman filter's, rms in posterior deviations."""
    mean, cov, _, _ = kalman(problem)
    variance = np.diagonal(cov, axis1=1, axis2=2)
    return float(np.sqrt(np.mean((estimate.mean - mean) ** 2 / variance)))


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_readings_that_count_twice_bias_the_answer(seed):
    """With the ratio of densities the answer nears the Kalman filter's, without it does not.

    At 3000 particles 0.05 of a deviation against 0.3 and more: the first is sampling error, the
    second none. Limits are twice the first, and two thirds of the second, as measured.
    """
    problem = noisy_problem(seed)
    solvers = [UnscentedParticle(particles=3000, weights=w) for w in ("exact", "likelihood")]
    right, wrong = (relative(solver.estimate(problem, rng()), problem) for solver in solvers)
    assert right < 0.12
    assert wrong > 0.2


def test_where_one_particle_has_all_the_weight_a_covariance_is_left():
    """Process noise a millionth of what is unknown: weights of densities leave one particle alive.

    Its covariance is none; it is repaired to the smallest that can be judged, and counted.
    """
    problem = noisy_problem(0)
    problem = changed(problem, process_cov=1e-6 * problem.process_cov)
    found = UnscentedParticle(particles=50, weights="exact").estimate(problem, rng())
    assert found.info["ess_median"] < 1.5
    assert found.info["covariance_repairs"] > problem.epochs // 2
    sigma = np.sqrt(np.diagonal(found.cov, axis1=1, axis2=2))
    assert np.linalg.eigvalsh(found.cov / (sigma[:, :, None] * sigma[:, None, :])).min() > 0.0
    fine = UnscentedParticle(particles=50, weights="likelihood").estimate(problem, rng())
    assert fine.info["covariance_repairs"] == 0


def test_weights_of_a_density_that_does_not_exist_are_refused():
    """Process noise of rank 2 of 5, in a sentence; of full rank it is taken."""
    exact = UnscentedParticle(weights="exact")
    assert "rank 2 of 5" in (exact.skip(linear_problem(0)) or "")
    assert exact.skip(noisy_problem(0)) is None
    assert UnscentedParticle(weights="likelihood").skip(linear_problem(0)) is None


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ("particles=0", "parameter 'particles' is"),
        ("particles=1000000000", "parameter 'particles' is"),
        ("width_m=0", "parameter 'width_m' is"),
        ("width_m=nan", "parameter 'width_m' is"),
        ("kappa=-5", "n + kappa"),
        ("kappa=inf", "n + kappa"),
        ("rho=-0.1", "parameter 'rho' is"),
        ("rho=1.1", "parameter 'rho' is"),
        ("rho=nan", "parameter 'rho' is"),
        ("beta=0.9", "parameter 'beta' is"),
        ("beta=nan", "parameter 'beta' is"),
    ],
)
def test_settings_that_mean_nothing_are_refused(setting, reason):
    assert reason in refusal(f"unscented-particle[{setting}]", linear_problem(0))


@pytest.mark.parametrize("weights", ["mixture", "likelihood"])
def test_a_fading_factor_of_one_changes_no_bit(weights):
    """λ ≡ 1 gives the filter without strong tracking, resampling and all; β = 1 does not."""
    problem, _ = rough_flight(1, 500.0, epochs=30)
    plain = UnscentedParticle(particles=50, weights=weights)
    never = dataclasses.replace(plain, strong_tracking=True, beta=WHITE_ALONE)
    often = dataclasses.replace(plain, strong_tracking=True)
    first, same, other = (e.estimate(problem, rng()) for e in (plain, never, often))
    assert first.mean.tobytes() == same.mean.tobytes()
    assert first.cov.tobytes() == same.cov.tobytes()
    assert first.mean.tobytes() != other.mean.tobytes()
    assert first.info["resamplings"] > 0


def test_fading_without_derivatives_is_fading_with_them():
    """Where h is linear, tr N and tr M of sigma points are those of H, to 1e-12; so is λ.

    With and without R in P_zz, as the two published forms have it, and with process noise that is
    singular: what has to be positive definite is the predicted covariance.
    """
    problem = linear_problem(3)
    cloud = UnscentedCloud(UnscentedParticle(strong_tracking=True), problem, rng())
    for k in range(3):
        cloud.predict(k)
        past = cloud.covs[0] - cloud.process_cov[k]
        roots = cloud.square_roots(cloud.covs)
        _, slope, spread = cloud.linear_regression(k, roots)
        rows = np.linalg.solve(np.swapaxes(roots, 1, 2), slope)[0].T
        noise_root = np.linalg.cholesky(problem.noise_of(k))
        h = np.linalg.solve(noise_root, problem.model.rows[k]) * cloud.scale
        np.testing.assert_allclose(rows, h, rtol=0.0, atol=1e-12 * np.abs(h).max())
        q = cloud.process_cov[k]
        assert np.linalg.matrix_rank(q) == 2
        m_trace = np.trace(h @ past @ h.T)
        of_noise = np.diag(rows @ q @ rows.T)
        assert np.trace(spread[0]) - of_noise.sum() == pytest.approx(m_trace, rel=1e-12)
        power = np.array([5.0, 7.0]) ** (k + 1)
        n_trace = power.sum() - np.trace(h @ q @ h.T) - 2.0 * 1.5
        with_noise = np.trace(spread[0] + np.eye(2)) - power.sum() + n_trace + (1.5 - 1.0) * 2.0
        assert with_noise == pytest.approx(m_trace, rel=1e-12)
        factor = strong_tracking.fading_factors(
            power[None], np.diag(spread[0])[None], of_noise[None], 1.5
        )
        wanted = np.clip(n_trace / m_trace, 1.0, strong_tracking.MOST)
        assert factor[0] == pytest.approx(wanted, rel=1e-11)
        faded = strong_tracking.faded(cloud.covs, q, factor)
        np.testing.assert_allclose(
            faded[0], factor[0] * past + q, rtol=0.0, atol=1e-12 * faded.max()
        )
        cloud.update(k, problem.present[k])


def test_power_of_innovations_forgets_by_rho_and_begins_with_the_first():
    """V_1 = γ_1γ_1ᵀ, then (ρ V + γγᵀ)/(1 + ρ), of each channel from its own first reading on."""
    seen = np.array([False, True])
    power = strong_tracking.innovation_power(
        np.array([[9.0, 9.0]]), np.array([[2.0, 2.0]]), seen, 0.5
    )
    np.testing.assert_allclose(power, [[4.0, (0.5 * 9.0 + 4.0) / 1.5]])


def test_fading_has_its_limits():
    """No more than the largest factor, no less than one, and one where the past shows nothing."""
    power = np.array([[1e9], [0.1], [1e9]])
    spread = np.array([[2.0], [2.0], [1.0]])
    factors = strong_tracking.fading_factors(power, spread, np.ones((3, 1)), 1.0)
    np.testing.assert_array_equal(factors, [strong_tracking.MOST, 1.0, 1.0])


def correlation(estimate: Estimate, problem: Problem) -> float:
    """Correlation of one innovation with the next, of the whitened innovations of an estimate."""
    found, spreads = innovations(problem, estimate.mean, estimate.cov)
    white = np.linalg.solve(np.linalg.cholesky(spreads), found[..., None])[..., 0][10:]
    return float(np.sum(white[1:] * white[:-1]) / np.sum(white**2))


def walk(seed: int, told: float, epochs: int = 400) -> Problem:
    """Two positions that walk, each measured; the noise of their steps is told too small."""
    problem = noisy_problem(seed, epochs, n=2, m=2)
    generator = np.random.default_rng(seed)
    x = np.cumsum(0.3 * generator.normal(size=(epochs, 2)), axis=0)
    eye = np.tile(np.eye(2), (epochs, 1, 1))
    measurements = x + generator.normal(size=(epochs, 2))
    rows = dataclasses.replace(problem.model, rows=eye)
    return changed(
        problem,
        measurements=measurements,
        transition=eye,
        process_cov=told * 0.09 * eye,
        model=rows,
    )


@pytest.mark.long
def test_strong_tracking_whitens_the_innovations_of_a_wrong_model():
    """Told a hundredth of the process noise, innovations correlate; fading takes most of that away.

    Over three walks of 400 steps. A white sequence of 780 numbers has a correlation of 0.036 rms at
    random, 0.021 in the mean of three: the limits are eight of those apart.
    """
    right, plain, fading = [], [], []
    for seed in range(3):
        for told, found in ((1.0, right), (0.01, plain)):
            problem = walk(seed, told)
            found.append(
                correlation(estimator("unscented-particle").estimate(problem, rng()), problem)
            )
        answer = estimator("unscented-particle[strong_tracking=true]").estimate(problem, rng())
        fading.append(correlation(answer, problem))
    assert abs(np.mean(right)) < 0.1
    assert np.mean(plain) > 0.3
    assert np.mean(fading) < 0.5 * np.mean(plain)


def test_fading_is_rare_where_the_model_is_right():
    """The median of the factors of a right model is one, with β = 1 and with β = 3.

    The innovations of one epoch scatter so much that λ can never be one at all of them.
    """
    problem = walk(0, told=1.0)
    for beta in (1.0, 3.0):
        told = UnscentedParticle(strong_tracking=True, beta=beta).estimate(problem, rng()).info
        assert told["fading_median"] < 1.1


def test_readings_that_are_missing_change_nothing():
    """Nothing is updated, drawn or resampled at an epoch without any, whatever the weights."""
    problem, _ = rough_flight(2, 500.0, epochs=6)
    present = np.zeros_like(problem.present)
    problem = changed(problem, present=present, measurements=np.zeros_like(problem.measurements))
    for weights in ("mixture", "likelihood"):
        generator = rng()
        cloud = UnscentedCloud(UnscentedParticle(weights=weights), problem, generator)
        state = generator.bit_generator.state
        begun = cloud.states.copy()
        for k in range(problem.epochs):
            cloud.predict(k)
        phi = np.linalg.multi_dot(cloud.transition[::-1])
        np.testing.assert_allclose(cloud.states, begun @ phi.T, rtol=1e-9, atol=1e-9)
        found = UnscentedParticle(weights=weights).estimate(problem, again := rng())
        assert found.info["resamplings"] == 0
        assert again.bit_generator.state == state  # the prior was drawn, and nothing else
