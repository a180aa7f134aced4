"""Gradiometers of every mount, with any channels and biases: what they read, h, H and noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frame_oracles import local_axes, square
from problems import estimator, propagated
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from small_cases import ASKEW, small_flight

from ggbench.gravity import ellipsoid
from ggbench.judging.references import CaseBound
from ggbench.sensors.gradiometer.instrument import (
    COMPONENTS,
    DIFFERENCES,
    INSTRUMENTS,
    Gradiometer,
    channel,
)
from ggbench.simulation.error_free_flight import Flight
from ggbench.simulation.flight_bounds import flight_bound
from ggbench.simulation.random_streams import RandomStreams
from ggbench.simulation.runs import simulate

SOME = ["xx", "yz", "xx-yy", "zz-xx"]
FILTERS: dict[str, dict[str, Any]] = {
    "unfiltered": {},
    "whitened": {"gradiometer.filter": "butterworth"},
    "delayed": {
        "gradiometer.filter": "butterworth",
        "gradiometer.filter_treatment": "delayed",
        "gradiometer.filter_order": 2,
    },
}


def mounted(instrument: str, **changes: Any) -> Flight:
    """A flight with a gradiometer of a mount; double underscores stand for dots."""
    dotted = {key.replace("__", "."): value for key, value in changes.items()}
    return small_flight(ASKEW | {"gradiometer.instrument": instrument} | dotted)


# What they read.


@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_a_reading_is_the_tensor_seen_from_the_mount(instrument, rough):
    """Γ in space, from east, north and up into the axes in which the mount lies."""
    flight = mounted(instrument, field__source=rough)
    truth, epochs = flight.trajectory, flight.epochs
    for k in (0, 7, 19):
        latitude, longitude, height = truth.positions[epochs[k]]
        c_en = local_axes(latitude, longitude)
        c_ie = Rotation.from_rotvec(
            [0.0, 0.0, ellipsoid.ROTATION_RATE * flight.times[k]]
        ).as_matrix()
        tensor = square(flight.field.tensor(latitude, longitude, height))
        in_space = c_ie @ c_en @ tensor @ (c_ie @ c_en).T
        mount = {
            "platform": np.eye(3),
            "local-level": c_ie @ c_en,
            "strapdown": c_ie @ c_en @ truth.attitudes[epochs[k]],
        }[instrument]
        np.testing.assert_allclose(
            square(flight.noise_free[k]), mount.T @ in_space @ mount, rtol=0.0, atol=1e-9
        )


def test_the_mount_changes_no_invariant(rough):
    """One tensor has one trace and one set of eigenvalues, whatever the axes it is read in."""
    tensors = [mounted(name, field__source=rough).noise_free for name in INSTRUMENTS]
    eigenvalues = [
        np.linalg.eigvalsh(tensor[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]) for tensor in tensors
    ]
    for other in eigenvalues[1:]:
        np.testing.assert_allclose(other, eigenvalues[0], rtol=0.0, atol=1e-9)
    for one, other in ((0, 1), (1, 2), (0, 2)):
        assert np.abs(tensors[one] - tensors[other]).max() > 100.0


def test_channels_are_components_and_half_differences():
    """Sensitivities of a channel, found by tensors of one component each."""
    tensor = np.array([3.0, 5.0, 7.0, 11.0, 13.0, 17.0])
    values = {name: float(channel(name) @ tensor) for name in (*COMPONENTS, *DIFFERENCES)}
    assert values == {
        "xx": 3.0,
        "xy": 5.0,
        "xz": 7.0,
        "yy": 11.0,
        "yz": 13.0,
        "zz": 17.0,
        "xx-yy": -4.0,
        "yy-zz": -3.0,
        "zz-xx": 7.0,
    }


def test_a_channel_has_the_noise_it_has_beside_any_others():
    """Instruments with other channels differ in their channels, not in luck."""
    alone, together = (
        Gradiometer(2.0, None, names).noise(50, np.random.default_rng(1))
        for names in (("yz", "zz-xx"), (*COMPONENTS, *DIFFERENCES))
    )
    np.testing.assert_array_equal(alone, together[:, [4, 8]])
    assert np.abs(np.corrcoef(together.T) - np.eye(9)).max() < 0.7


# h and H.


@pytest.mark.parametrize("treatment", FILTERS)
@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_h_has_the_slope_that_it_claims(instrument, treatment, rough):
    """H is the derivative of h in all 19 states, far from zero: 30° and a kilometre of error.

    Differences of fourth order over steps that a cubic spline does not notice.
    """
    flight = small_flight(
        ASKEW
        | FILTERS[treatment]
        | {
            "gradiometer.instrument": instrument,
            "gradiometer.components": SOME,
            "gradiometer.bias_eotvos": 1.0,
            "field.source": rough,
        }
    )
    problem, _ = simulate(flight, seed=1, run=0)
    assert problem.dimension == 19
    rng = np.random.default_rng(2)
    sizes = np.repeat([300.0, 1.0, 0.3, 1e-5, 1e-2, 3.0], [3, 3, 3, 3, 3, 4])
    steps = np.repeat([2.0, 0.5, 1e-3, 3e-4, 0.1, 1.0], [3, 3, 3, 3, 3, 4])
    seen = np.zeros(19)
    for k in (0, 1, 5, 12, 19):
        state = sizes * rng.standard_normal(19)
        jacobian = problem.model.jacobian(k, state)
        assert jacobian.shape == (4, 19)
        for axis, step in enumerate(steps):
            unit = step * np.eye(19)[axis]
            near, far = (
                problem.model.predict(k, state + n * unit)
                - problem.model.predict(k, state - n * unit)
                for n in (1, 2)
            )
            np.testing.assert_allclose(
                jacobian[:, axis] * step, (8.0 * near - far) / 12.0, rtol=0.0, atol=3e-7
            )
        seen = np.maximum(seen, np.abs(jacobian).max(axis=0) * steps)
    tilted = instrument == "strapdown"
    assert (seen[:3] > 1e-3).all()
    assert ((seen[6:9] > 0.1) == tilted).all()
    assert (seen[15:] > 0.1).all()
    if treatment != "unfiltered":  # the delay brings in velocity, and the rate of tilt
        assert (seen[3:6] > 1e-5).all()
        assert ((seen[9:12] > 1e-3) == tilted).all()


@pytest.mark.parametrize("channels", [list(COMPONENTS), SOME], ids=["six", "some"])
@pytest.mark.parametrize("bias", [0.0, 5.0])
@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_the_innovation_of_the_true_error_is_the_noise(instrument, bias, channels, rough):
    """What h(true error state) leaves of z is what the noise generator drew, reading by reading.

    With attitude errors of 10° and position errors of 300 m: h is no linearisation. So biases,
    their walk, the mount, the channels and the signs of all errors are those of the simulation.
    """
    flight = mounted(
        instrument,
        gradiometer__components=channels,
        gradiometer__bias_eotvos=bias,
        gradiometer__drift_eotvos_per_sqrt_h=bias,
        field__source=rough,
        initial_error__position_m=300.0,
        initial_error__attitude_arcmin=600.0,
    )
    problem, truth = simulate(flight, seed=4, run=2)
    noise = flight.true.gradiometer.noise(problem.epochs, RandomStreams(4, 2)["gradiometer/"])
    left = [
        z - problem.model.predict(k, state)
        for k, (z, state) in enumerate(zip(problem.measurements, truth.error_state, strict=True))
    ]
    np.testing.assert_allclose(left, noise, rtol=0.0, atol=1e-8)
    assert noise.shape == (20, len(channels))
    without = [problem.model.predict(k, np.zeros(problem.dimension)) for k in range(20)]
    assert np.abs(problem.measurements - without - noise).max() > 1.0


@pytest.mark.parametrize("treatment", ["whitened", "delayed"])
def test_a_filtered_strapdown_reading_is_set_beside_the_attitude_of_then(treatment):
    """In a turn of 3°/s the filter's output is that of the body some degrees ago.

    Almost without noise and with tilts of 1′ (1 E), the true error explains the readings to 5 %,
    what a slow signal's delay and gain leave of the filter; set beside the attitude of now they
    would be wrong by the turn within the delay, 10 % or more.
    """
    flight = small_flight(
        FILTERS[treatment]
        | {
            "gradiometer.instrument": "strapdown",
            "gradiometer.noise_eotvos": 1e-6,
            "gradiometer.filter_order": 2,
            "gradiometer.filter_cutoff_hz": 0.1,
            "gradiometer.whitening_regularization": 0.1,
            "trajectory.segment": [{"duration_s": 60.0, "turn_rate_deg_per_s": 3.0}],
            "initial_error.position_m": 0.01,
        }
    )
    problem, truth = simulate(flight, seed=3, run=0)
    left, whole = (
        np.array(
            [problem.measurements[k] - problem.model.predict(k, states[k]) for k in range(10, 60)]
        )
        for states in (truth.error_state, 0.0 * truth.error_state)
    )
    assert np.square(whole).mean() > 0.01
    assert np.square(left).mean() < 0.06**2 * np.square(whole).mean()


@pytest.mark.parametrize(
    ("instrument", "turns"), [("local-level", False), ("platform", False), ("strapdown", True)]
)
def test_only_a_strapdown_gradiometer_depends_on_the_attitude(instrument, turns):
    """A stabilised one neither reads nor predicts another tensor in another attitude."""
    straight, rolled = (
        mounted(instrument, trajectory__roll_deg=roll, initial_error__attitude_arcmin=300.0)
        for roll in (0.0, 40.0)
    )
    difference = np.abs(straight.noise_free - rolled.noise_free).max()
    assert (difference > 100.0) if turns else (difference < 1e-9)
    problem, _ = simulate(straight, seed=1, run=0)
    state = np.zeros(15)
    state[6:9] = 0.1, -0.2, 0.3
    change = np.abs(problem.model.predict(3, state) - problem.model.predict(3, 0.0 * state)).max()
    assert (change > 100.0) if turns else (change == 0.0)


def test_a_local_level_gradiometer_knows_no_clock():
    """In a zonal field it reads the same at any longitude and time; a platform does not."""
    for instrument, still in (("local-level", True), ("platform", False)):
        here, there = (
            mounted(instrument, trajectory__longitude_deg=longitude).noise_free
            for longitude in (10.0, 70.0)
        )
        assert (np.abs(here - there).max() < 1e-9) == still


# The bound.


def test_fewer_channels_never_know_more(rough):
    """The bound of a part of the channels is no less, in any direction of the state."""
    full = mounted("platform", field__source=rough, gradiometer__components=[*COMPONENTS, "xx-yy"])
    scale, bound = np.sqrt(np.diag(full.true.prior_cov)), flight_bound(full).filtering
    best = CaseBound(full, flight_bound(full)).final_m
    for names in (["zz"], ["xy", "zz"], list(COMPONENTS)):
        part = mounted("platform", field__source=rough, gradiometer__components=names)
        excess = (flight_bound(part).filtering - bound) / np.outer(scale, scale)
        assert np.linalg.eigvalsh(excess).min() > -1e-9
        assert CaseBound(part, flight_bound(part)).final_m > best


def test_a_strapdown_gradiometer_is_an_inclinometer():
    """In the normal field 0.01 E is 2e-6 rad of tilt; a level instrument learns of it by its INS.

    3 Γ_UU / 2 = 4600 E between up and level; after n readings 1/√n of it.
    """
    tilts = {}
    for instrument in ("local-level", "strapdown"):
        bound = flight_bound(mounted(instrument)).filtering[-1]
        tilts[instrument] = np.sqrt(np.diag(bound)[6:8])
    assert (tilts["strapdown"] < 0.01 / 4600.0).all()
    assert (tilts["strapdown"] > 0.01 / 4600.0 / np.sqrt(2.0 * 20.0)).all()
    assert (tilts["local-level"] > 1e-5).all()


# Readings that are missing.


@pytest.mark.parametrize("bias", [0.0, 1.0])
@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_a_missing_reading_says_nothing(instrument, bias):
    """There z, h and H are zero, and an update leaves mean and covariance as predicted."""
    flight = mounted(
        instrument,
        gradiometer__bias_eotvos=bias,
        truth__gradiometer__dropouts_s=[[5.0, 8.5], [20.0, 30.0]],
    )
    problem, _ = simulate(flight, seed=2, run=0)
    missing = np.isin(problem.times.round(9), [5.0, 6.0, 7.0, 8.0, 20.0])
    answer = estimator("ekf").estimate(problem, np.random.default_rng(1))
    state = np.ones(problem.dimension)
    for k, lost in enumerate(missing):
        jacobian = problem.model.jacobian(k, state)
        assert (not problem.measurements[k].any()) == lost
        assert (not problem.model.predict(k, state).any()) == lost
        assert (not jacobian.any()) == lost
        if k == 0:
            continue
        phi = problem.transition[k]
        mean = phi @ answer.mean[k - 1]
        cov = phi @ answer.cov[k - 1] @ phi.T + problem.process_cov[k]
        sigma = np.sqrt(np.diag(cov))
        unmoved = np.abs(answer.mean[k] - mean) / sigma
        narrowed = np.abs(answer.cov[k] - cov) / np.outer(sigma, sigma)
        assert (unmoved.max() < 1e-9) == lost
        assert (narrowed.max() < 1e-9) == lost
        bound = flight_bound(flight)
        same = np.allclose(bound.filtering[k], bound.predicted[k], rtol=1e-9, atol=0.0)
        assert same == lost


def test_without_any_reading_there_is_the_ins():
    """A flight whose instrument never reads ends with the prior, propagated."""
    flight = mounted("platform", truth__gradiometer__dropouts_s=[[0.0, 100.0]])
    problem, _ = simulate(flight, seed=2, run=0)
    answer = estimator("ekf").estimate(problem, np.random.default_rng(1))
    _, covs = propagated(problem)
    sigma = np.sqrt(np.einsum("kii->ki", covs))
    np.testing.assert_array_equal(answer.mean, 0.0)
    np.testing.assert_allclose(
        answer.cov / (sigma[:, :, None] * sigma[:, None, :]),
        covs / (sigma[:, :, None] * sigma[:, None, :]),
        rtol=0.0,
        atol=1e-9,
    )
    np.testing.assert_allclose(
        flight_bound(flight).filtering, flight_bound(flight).predicted, rtol=1e-9
    )


# Biases as states.


@pytest.mark.parametrize("known", [True, False])
def test_a_filter_that_knows_of_biases_is_consistent(known):
    """With the biases among its states the EKF's errors have the covariance that it claims.

    60 runs: eᵀ P⁻¹ e of all states at the end against chi-square, false-alarm probability 1e-3.
    A filter that does not know of the same biases is wrong by far.
    """
    names = ("bias_eotvos", "drift_eotvos_per_sqrt_h")
    table = "gradiometer" if known else "truth.gradiometer"
    sizes = {f"{table}.{name}": value for name, value in zip(names, (0.1, 2.0), strict=True)}
    flight = small_flight(ASKEW | {"gradiometer.instrument": "strapdown"} | sizes)
    runs, total = 60, 0.0
    for run in range(runs):
        problem, truth = simulate(flight, seed=5, run=run)
        answer = estimator("ekf").estimate(problem, np.random.default_rng(1))
        error = answer.mean[-1] - truth.error_state[-1, : problem.dimension]
        sigma = np.sqrt(np.diag(answer.cov[-1]))
        total += (error / sigma) @ np.linalg.solve(
            answer.cov[-1] / np.outer(sigma, sigma), error / sigma
        )
    dimension = runs * problem.dimension
    assert problem.dimension == (21 if known else 15)
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], dimension)
    if known:
        assert low < total < high
    else:
        assert total > 3.0 * high


def test_an_attitude_error_beyond_half_a_turn_is_the_turn_that_it_amounts_to():
    """A sigma point or a lost filter may go round: φ and φ + 2π about one axis read the same."""
    problem, _ = simulate(small_flight({"gradiometer.instrument": "strapdown"}), 1, 0)
    rng = np.random.default_rng(4)
    for turns in (1, -1, 3):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        small, large = np.zeros((2, problem.dimension))
        small[6:9], large[6:9] = 0.4 * axis, (0.4 + 2.0 * np.pi * turns) * axis
        one, other = (problem.model.predict(3, x) for x in (small, large))
        np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-6)
        assert np.abs(one - problem.model.predict(3, np.zeros(problem.dimension))).max() > 1.0
