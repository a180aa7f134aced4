"""The posterior Cramér–Rao bound equals what a linear-Gaussian problem can be known to, exactly.

The oracles know no recursion: the joint distribution of all states and measurements, conditioned
on the measurements at once, and the joint information matrix of the whole trajectory.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from problems import kalman
from scipy.linalg import block_diag
from small_cases import ON_BOARD, rough_map, small_flight

from ggbench.campaign.registry import choose
from ggbench.gravity.field import Field
from ggbench.simulation.bound import posterior_bound
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.flight_bounds import flight_bound, unfiltered_bound
from ggbench.simulation.runs import simulate
from ggbench.spec import scenario

EPOCHS, N, M = 12, 4, 2
ALONE = {"gradiometer": None, "barometer.period_s": 1.0, "barometer.noise_m": 3.0}


def linear_problem(seed: int, singular: bool) -> tuple[np.ndarray, ...]:
    """Φ, Q, P0, H, R of a random problem; ``singular``: the last two states are constants."""
    rng = np.random.default_rng(seed)
    transition = np.eye(N) + 0.3 * rng.normal(size=(EPOCHS, N, N))
    root = 0.4 * rng.normal(size=(EPOCHS, N, N))
    if singular:
        transition[:, 2:] = np.eye(N)[2:]
        root[:, 2:] = 0.0
    prior = rng.normal(size=(N, N))
    noise = rng.normal(size=(M, M))
    return (
        transition,
        root @ root.transpose(0, 2, 1),
        prior @ prior.T + 0.1 * np.eye(N),
        rng.normal(size=(EPOCHS, M, N)),
        noise @ noise.T + 0.1 * np.eye(M),
    )


def conditioned(problem: tuple[np.ndarray, ...], lag: int) -> np.ndarray:
    """Covariance of x_k given z_0..z_{k+lag}, from the joint Gaussian of everything."""
    transition, process_cov, prior_cov, jacobians, noise_cov = problem
    # Every state is a linear function of (x_start, w_0, ..., w_{K-1}).
    source = block_diag(prior_cov, *process_cov)
    maps = [np.hstack([np.eye(N), np.zeros((N, EPOCHS * N))])]
    for k in range(EPOCHS):
        step = transition[k] @ maps[-1]
        step[:, N * (k + 1) : N * (k + 2)] += np.eye(N)
        maps.append(step)
    states = np.array(maps[1:])
    out = np.empty((EPOCHS, N, N))
    for k in range(EPOCHS):
        used = min(k + lag + 1, EPOCHS)
        sensed = np.concatenate([jacobians[i] @ states[i] for i in range(used)])
        gram = sensed @ source @ sensed.T + block_diag(*[noise_cov] * used)
        cross = states[k] @ source @ sensed.T
        out[k] = states[k] @ source @ states[k].T - cross @ np.linalg.solve(gram, cross.T)
    return out


@pytest.mark.parametrize("singular", [False, True])
@pytest.mark.parametrize("lag", [0, 1, 3, EPOCHS - 2, EPOCHS - 1, EPOCHS, 100])
def test_every_lag_is_the_conditional_covariance(lag, singular):
    """Filter, fixed-lag smoother and smoother: the covariance given what each has seen.

    Also with constant states, whose process noise is singular.
    """
    problem = linear_problem(1, singular)
    np.testing.assert_allclose(
        posterior_bound(*problem).fixed_lag(lag), conditioned(problem, lag), rtol=0.0, atol=1e-10
    )


def test_a_lag_is_a_time_where_epochs_are_not_evenly_spaced():
    """Of each epoch the bound of as many later ones as lie within the lag, however many."""
    problem = linear_problem(1, singular=True)
    ticks = np.cumsum(np.random.default_rng(0).integers(1, 5, EPOCHS))
    bound = posterior_bound(*problem, ticks)
    seen = set()
    for k, found in enumerate(bound.fixed_lag(6)):
        ahead = int(np.count_nonzero((ticks > ticks[k]) & (ticks <= ticks[k] + 6)))
        np.testing.assert_allclose(found, conditioned(problem, ahead)[k], rtol=0.0, atol=1e-10)
        seen.add(ahead)
    assert len(seen) > 2
    everything = conditioned(problem, EPOCHS)
    np.testing.assert_allclose(bound.smoothing, everything, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("seed", [2, 3])
def test_smoothing_is_the_inverse_of_the_batch_information(seed):
    """The blocks of the inverse of the whole trajectory's information matrix (Tichavský 1998)."""
    problem = linear_problem(seed, singular=False)
    transition, process_cov, prior_cov, jacobians, noise_cov = problem
    information = np.zeros(((EPOCHS + 1) * N,) * 2)  # the start is block 0
    information[:N, :N] += np.linalg.inv(prior_cov)
    for k in range(EPOCHS):
        rows = slice(N * k, N * (k + 2))
        link = np.hstack([-transition[k], np.eye(N)])
        information[rows, rows] += link.T @ np.linalg.solve(process_cov[k], link)
        now = slice(N * (k + 1), N * (k + 2))
        information[now, now] += jacobians[k].T @ np.linalg.solve(noise_cov, jacobians[k])
    inverse = np.linalg.inv(information)
    blocks = [inverse[N * k : N * (k + 1), N * k : N * (k + 1)] for k in range(1, EPOCHS + 1)]
    np.testing.assert_allclose(posterior_bound(*problem).smoothing, blocks, rtol=0.0, atol=1e-8)


def test_ends_of_the_family():
    """No lag is filtering; a lag as long as the flight is smoothing; the last epoch is the same."""
    bound = posterior_bound(*linear_problem(4, singular=True))
    np.testing.assert_array_equal(bound.fixed_lag(0), bound.filtering)
    np.testing.assert_array_equal(bound.fixed_lag(EPOCHS), bound.smoothing)
    for lag in range(EPOCHS):
        np.testing.assert_array_equal(bound.fixed_lag(lag)[-1], bound.filtering[-1])


def test_more_measurements_never_hurt():
    """The bound falls, as a matrix, with every epoch that may be used, and below the prediction."""
    bound = posterior_bound(*linear_problem(5, singular=True))
    chain = [bound.predicted, *(bound.fixed_lag(lag) for lag in range(EPOCHS))]
    for wider, narrower in itertools.pairwise(chain):
        assert np.linalg.eigvalsh(wider - narrower).min() > -1e-10
    assert np.trace(chain[-1][0]) < 0.9 * np.trace(chain[1][0])


def test_units_do_not_matter():
    """In units of radians per second or of kilometres the bound is the same bound."""
    transition, process_cov, prior_cov, jacobians, noise_cov = linear_problem(6, singular=True)
    units = np.array([1e3, 1.0, 1e-7, 1e-4])
    outer = np.outer(units, units)
    rescaled = posterior_bound(
        transition * units[:, None] / units,
        process_cov * outer,
        prior_cov * outer,
        jacobians / units,
        noise_cov,
    )
    plain = posterior_bound(transition, process_cov, prior_cov, jacobians, noise_cov)
    for lag in (0, 2, EPOCHS):
        np.testing.assert_allclose(
            rescaled.fixed_lag(lag) / outer, plain.fixed_lag(lag), rtol=0.0, atol=1e-11
        )


def test_the_bound_of_any_sensors_is_what_a_filter_claims_where_all_is_linear():
    """A receiver with an outage, a log, a barometer: deviations to a thousandth, at every epoch.

    H and Φ are taken at the truth there, along the INS's track here.
    """
    flight = small_flight(ON_BOARD | {"gradiometer": None, "truth.gnss.dropouts_s": [[5.0, 12.0]]})
    problem, _ = simulate(flight, 1, 0)
    claimed = choose("ekf").estimator.estimate(problem, np.random.default_rng(0)).cov
    sigmas = [
        np.sqrt(np.diagonal(p, axis1=1, axis2=2)) for p in (claimed, flight_bound(flight).filtering)
    ]
    np.testing.assert_allclose(sigmas[0], sigmas[1], rtol=1e-3)


def test_a_bound_knows_only_the_share_of_readings_that_come():
    """Half of them by chance: the information of half as many; none in an outage."""
    half = small_flight(ALONE | {"truth.barometer.dropout_share": 0.5})
    noisier = small_flight(ALONE | {"barometer.noise_m": 3.0 * 2.0**0.5})
    np.testing.assert_allclose(
        flight_bound(half).filtering, flight_bound(noisier).filtering, rtol=1e-9
    )
    none = small_flight(ALONE | {"truth.barometer.dropouts_s": [[0.0, 100.0]]})
    height = flight_bound(none).filtering[:, 2, 2]
    np.testing.assert_allclose(height, flight_bound(none).predicted[:, 2, 2], rtol=1e-9)
    assert height[-1] > 2.0 * flight_bound(half).filtering[-1, 2, 2]


def test_bound_of_the_papers_flight_in_the_normal_field():
    """Six gradients of 0.01 E at 1 Hz, of the normal field alone, hold the position to 3.7 m.

    The number of an independent calculation, over the last 20 s; a map only helps.
    """
    study = next(a for a in scenario.load("wang2013").assumptions if a.name == "normal-field")
    flight = prepare(next(c for c in study.cases if c.name == "0.01E-1Hz"))
    last = unfiltered_bound(flight).filtering[flight.times > 180.0]
    position = np.sqrt(np.trace(last[:, 0:3, 0:3], axis1=1, axis2=2).mean())
    assert position == pytest.approx(3.7, abs=0.05)


def test_readings_that_drop_out_inform_by_their_share():
    """Of readings of which three quarters are missing the bound is that of noise twice as large.

    Information adds up over readings: a share of them is worth that share of 1/σ².
    """
    missing = flight_bound(small_flight({"truth.gradiometer.dropout_share": 0.75}))
    noisy = flight_bound(small_flight({"gradiometer.noise_eotvos": 0.02}))
    whole = flight_bound(small_flight())
    np.testing.assert_allclose(missing.filtering, noisy.filtering, rtol=1e-6)
    assert np.trace(noisy.filtering[-1]) > 1.01 * np.trace(whole.filtering[-1])


def test_a_filter_and_the_noise_behind_it_raise_the_bound():
    """In every direction of the state; the unfiltered bound has neither, whatever the treatment.

    Without a filter, noise behind it is noise as any other.
    """
    plain = flight_bound(small_flight()).filtering
    scale = np.sqrt(np.diag(plain[0]))
    units, below = np.outer(scale, scale), plain
    for behind in (None, 0.001, 0.01 * np.sqrt(3.0)):
        changes = {"gradiometer.filter": "butterworth"}
        if behind is not None:
            changes |= {"gradiometer.noise_behind_filter_eotvos": behind}
        for treatment in ("delayed", "whitened"):
            flown = small_flight(changes | {"gradiometer.filter_treatment": treatment})
            np.testing.assert_array_equal(unfiltered_bound(flown).filtering, plain)
        found = flight_bound(flown).filtering
        assert np.linalg.eigvalsh((found - below) / units).min() > -1e-9
        assert np.trace(found[-1, :3, :3]) > 1.01 * np.trace(below[-1, :3, :3])
        below = found
    twice = flight_bound(small_flight({"gradiometer.noise_eotvos": 0.02})).filtering
    alone = small_flight({"gradiometer.noise_behind_filter_eotvos": 0.01 * np.sqrt(3.0)})
    np.testing.assert_allclose(flight_bound(alone).filtering, twice, rtol=1e-6)


@pytest.mark.parametrize(
    "changes",
    [
        {"gradiometer.instrument": "platform"},
        {
            "gradiometer.instrument": "strapdown",
            "gradiometer.noise_eotvos": 1e-4,
            "initial_error.attitude_arcmin": 0.03,
        },
        {"truth.gradiometer.dropouts_s": [[3.0, 7.5]]},
        {"gradiometer.bias_eotvos": 0.1, "gradiometer.drift_eotvos_per_sqrt_h": 1.0},
    ],
    ids=str,
)
def test_it_is_what_a_filter_near_the_truth_says_of_itself(changes):
    """With its correlations, to a hundredth: the textbook's filter, metres off the truth."""
    flight = small_flight(changes)
    _, expected, _, _ = kalman(simulate(flight, 1, 0)[0])
    sigma = np.sqrt(np.diagonal(expected, axis1=1, axis2=2))
    difference = (flight_bound(flight).filtering - expected) / (
        sigma[:, :, None] * sigma[:, None, :]
    )
    assert np.abs(difference).max() < 0.01


def test_added_gravity_changes_with_the_error_of_the_position(tmp_path):
    """An INS that adds the map's gravity falls by its gradient more for each metre it errs."""
    path = rough_map(tmp_path / "map.nc", rms=300.0)
    rough = {"field.source": path, "field.gravity_disturbance": True}
    plain, adding = (
        small_flight(rough | {"model.field.compensate": compensate}) for compensate in (False, True)
    )
    change = (flight_bound(adding).predicted - flight_bound(plain).predicted)[0, 3:6, 0:3] / 5.0**2
    place = adding.trajectory.positions[5]
    xx, xy, xz, yy, yz, zz = adding.field.tensor(*place) - Field.normal().tensor(*place)
    gradient = 1e-9 * np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    np.testing.assert_allclose(change, gradient, atol=0.1 * np.abs(gradient).max())


def test_what_is_believed_does_not_change_what_can_be_known():
    """The bound is of the true sensors, the true prior and the true gaps in the readings."""
    beliefs = {
        "model.initial_error.position_m": 50.0,
        "model.imu.gyro_bias_deg_per_h": 0.1,
        "model.imu.accelerometer_noise_ug_per_sqrt_hz": 1000.0,
        "model.gradiometer.noise_eotvos": 0.1,
    }
    np.testing.assert_array_equal(
        flight_bound(small_flight(beliefs)).filtering, flight_bound(small_flight()).filtering
    )
