"""Readings that are delivered late: taken where the vehicle was, unknown to estimators or known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from laws import likely
from scipy.stats import chi2
from small_cases import residuals_at_the_truth, rough_map, small_flight

from ggbench.estimators.ekf import ExtendedKalmanFilter
from ggbench.judging.references import CaseBound
from ggbench.judging.run_errors import evaluate
from ggbench.sensors.gradiometer.instrument import readings
from ggbench.simulation.flight_bounds import flight_bound
from ggbench.simulation.runs import simulate, simulate_block

UNKNOWN, KNOWN = "truth.gradiometer.latency_s", "gradiometer.latency_s"
TURNING = {"trajectory.segment": [{"duration_s": 20.0, "turn_rate_deg_per_s": 3.0}]}
FAST = {"initial_error.velocity_mps": 2.0, "gradiometer.noise_eotvos": 1e-3}
"""A velocity that errs by ten metres in five seconds, and readings that see a metre or two."""


@pytest.fixture(scope="module")
def rough(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A map of 300 E, so that readings are of their places."""
    path = Path(tmp_path_factory.mktemp("maps")) / "map.nc"
    return {"field.source": rough_map(path, rms=300.0)}


@pytest.mark.parametrize("instrument", ["platform", "local-level", "strapdown"])
def test_a_late_reading_is_the_tensor_of_then(rough, instrument):
    """Place, attitude and inertial axes are those of t - latency, to rounding."""
    flown = rough | TURNING | {"gradiometer.instrument": instrument}
    right, late = small_flight(flown), small_flight(flown | {UNKNOWN: 0.3})
    truth, samples = right.trajectory, right.epochs - 3
    then = readings(
        right.field,
        truth.positions[samples],
        truth.times[samples],
        truth.attitudes[samples],
        instrument,
    )
    on_time, delayed = (simulate(f, 5, 2)[0].measurements for f in (right, late))
    assert np.abs(then - right.noise_free).max() > 0.5
    np.testing.assert_allclose(delayed - on_time, then - right.noise_free, rtol=0.0, atol=1e-8)


def test_a_latency_of_a_period_delivers_the_reading_before(rough):
    """And nothing is read before the flight: the first readings are those of its start."""
    right, late = small_flight(rough), small_flight(rough | {UNKNOWN: 3.0})
    np.testing.assert_allclose(late.noise_free[3:], right.noise_free[:-3], rtol=0.0, atol=1e-8)
    truth = right.trajectory
    start = readings(right.field, truth.positions[:1], truth.times[:1])
    np.testing.assert_allclose(late.noise_free[:3], np.tile(start, (3, 1)), rtol=0.0, atol=1e-8)


def test_between_samples_the_place_is_between_them(rough):
    """Half a sample late is the mean of two readings, where the field is nearly straight."""
    level = rough | {"gradiometer.instrument": "local-level"}
    none, half, whole = (
        small_flight(level | {UNKNOWN: late}).noise_free for late in (0.0, 0.05, 0.1)
    )
    assert np.abs(whole - none).max() > 0.5
    np.testing.assert_allclose(half, 0.5 * (none + whole), rtol=0.0, atol=0.02)


def test_jitter_is_about_the_late_time(rough):
    """Both together do what each does alone, where the field is nearly straight."""
    jitter, late = {"truth.gradiometer.timing_jitter_s": 0.01}, {UNKNOWN: 1.0}
    neither, one, other, both = (
        simulate(small_flight(rough | changes), 5, 2)[0].measurements
        for changes in ({}, jitter, late, jitter | late)
    )
    # The rates are those of a second ago; the last reading of the flight cannot come late.
    rates = np.gradient(neither, axis=0)
    lateness = ((one - neither) * rates).sum(axis=1) / (rates**2).sum(axis=1)
    expected = lateness[2:-1, np.newaxis] * rates[1:-2]
    assert np.abs((both - other)[2:-1] - expected).max() < 0.1 * np.abs(expected).max()


def test_what_is_unknown_changes_the_readings_alone(rough):
    """The estimators' model is the one without latency, and it can still be fed back."""
    right, late = (simulate(small_flight(rough | c), 5, 2)[0] for c in ({}, {UNKNOWN: 1.0}))
    for name in ("rows", "offset", "times", "gain"):
        np.testing.assert_array_equal(
            getattr(right.model.arrays, name), getattr(late.model.arrays, name)
        )
    assert (right.measurements != late.measurements).all()
    assert right.replay is not None and late.replay is not None


@pytest.mark.parametrize("instrument", ["platform", "strapdown"])
@pytest.mark.parametrize("latency", [0.3, 5.0])
def test_what_is_known_leaves_the_noise(instrument, latency):
    """At the truth h is the reading, though the INS's error was another when it was taken.

    40 runs of 20 readings and six channels: chi-square for each channel, false-alarm probability
    1e-4. Its errors of 2 m/s are some 10 m in five seconds: many times the noise. What gyros add
    to the attitude in the meantime is neglected, and left out here.
    """
    exact = {"imu.gyro_noise_deg_per_sqrt_h": 0.0}
    changes = FAST | TURNING | exact | {"gradiometer.instrument": instrument, KNOWN: latency}
    block, truth = simulate_block(small_flight(changes), 7, range(40))
    squares, count = residuals_at_the_truth(block, truth)
    for found, number in zip(squares, count, strict=True):
        assert likely(found, chi2(number))
    assert block.problem(0).replay is None


def test_a_latency_that_is_taken_back_is_none(rough):
    """What the shared table says holds for both sides, unless one of them is changed."""
    known = small_flight(rough | {KNOWN: 2.0})
    late = small_flight(rough | {KNOWN: 2.0, "model.gradiometer.latency_s": 0.0})
    early = small_flight(rough | {KNOWN: 2.0, UNKNOWN: 0.0})
    unknown = small_flight(rough | {UNKNOWN: 2.0})
    np.testing.assert_array_equal(known.noise_free, unknown.noise_free)
    np.testing.assert_array_equal(late.noise_free, unknown.noise_free)
    np.testing.assert_array_equal(early.noise_free, small_flight(rough).noise_free)
    assert (late.model.gradiometer.latency, early.model.gradiometer.latency) == (0.0, 2.0)


@pytest.mark.parametrize("instrument", ["platform", "local-level"])
def test_the_bound_knows_the_latency(rough, instrument):
    """A filter that knows it claims the bound's covariance, in a problem that is nearly linear.

    A platform sees the turning of the local level, one that is held level the map alone.
    """
    base = FAST | {"gradiometer.instrument": instrument}
    base |= rough if instrument == "local-level" else {}
    flights = [small_flight(base | changes) for changes in ({}, {KNOWN: 5.0}, {UNKNOWN: 5.0})]
    on_time, known, unknown = (
        CaseBound(flight, flight_bound(flight)).final_m for flight in flights
    )
    assert known == unknown
    assert known > 1.2 * on_time
    problem, truth = simulate(flights[1], 7, 0)
    estimate = ExtendedKalmanFilter().estimate(problem, np.random.default_rng(0))
    claimed = np.sqrt(np.trace(estimate.cov[-1, :3, :3]))
    assert claimed == pytest.approx(known, rel=0.01)
    assert evaluate(problem, estimate, truth).nees.mean() < 60.0


def test_a_filtered_instrument_may_be_late_unknown_to_estimators(rough):
    """Its output is then that of the late readings."""
    filtered = rough | {"gradiometer.filter": "butterworth"}
    late = small_flight(filtered | {UNKNOWN: 1.0})
    on_time = small_flight(filtered)
    change = simulate(late, 5, 2)[0].measurements - simulate(on_time, 5, 2)[0].measurements
    channels = late.true.gradiometer.channels
    passed = late.true.gradiometer.lowpass.apply(
        (late.noise_free - on_time.noise_free) @ channels.T
    )
    treatment = late.model.treatment(len(late.times))
    np.testing.assert_allclose(change, treatment.apply(passed), rtol=0.0, atol=1e-6)


def test_errors_that_decay_slower_than_a_latency_are_flown():
    """And, where the model does not know the latency, faster ones."""
    decaying = {"imu.gyro_bias_time_s": 5.0}
    small_flight(decaying | {KNOWN: 4.9})
    small_flight(decaying | {UNKNOWN: 5.1})
