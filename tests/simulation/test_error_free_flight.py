"""What is the same in every run of a case: epochs, scales, and what a moving instrument feels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frame_oracles import local_axes, metres
from small_cases import ROTATING, small_case, small_flight

from ggbench.errors import GGBenchError
from ggbench.gravity.ellipsoid import ROTATION_RATE
from ggbench.judging.references import CaseBound
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.flight_bounds import flight_bound
from ggbench.simulation.runs import simulate
from ggbench.spec.trajectory import TrajectorySpec
from ggbench.trajectory.manoeuvres import TrajectoryError


@pytest.mark.parametrize("period", [0.3, 0.7, 1.0])
def test_readings_come_at_their_period(period):
    """From its end on, for as long as the flight lasts, though 0.3 is not three times 0.1."""
    flight = small_flight({"gradiometer.period_s": period})
    count = int(20.0 / period + 1e-9)
    np.testing.assert_allclose(flight.times, period * np.arange(1, count + 1), rtol=1e-12)


@pytest.mark.parametrize(("vehicle", "leans"), [("aircraft", True), ("ship", False)])
def test_a_ship_turns_without_leaning(vehicle, leans):
    """Where an aircraft would, by atan(v ω / g), two degrees."""
    turn = {"kind": "turn", "by_heading_deg": 60.0, "turn_rate_deg_per_s": 3.0}
    start = {"trajectory.height_m": 0.0, "trajectory.speed_mps": 6.0}
    flight = small_flight(start | {"trajectory.vehicle": vehicle, "trajectory.segment": [turn]})
    assert (np.abs(flight.trajectory.attitudes[:, 2, 0]).max() > 0.03) == leans
    assert leans or np.abs(flight.trajectory.attitudes[:, 2, 0]).max() < 1e-6


def test_a_flight_that_leaves_the_air_is_told_when_it_does():
    """At the first sample beyond the limit: when the same climb, lower, is 50 m up."""
    climb = {"trajectory.segment": [{"duration_s": 20.0, "climb_rate_deg_per_s": 0.5}]}
    lower = small_flight(climb).trajectory
    expected = lower.times[np.argmax(lower.positions[:, 2] > 10050.0)]
    with pytest.raises(TrajectoryError, match=rf"10000\d m after {expected:g} s and must lie"):
        small_flight(climb | {"trajectory.height_m": 99950.0})


def test_a_track_lasts_as_long_as_its_windows(tmp_path):
    """How long it is, only its file says."""
    times = np.arange(9.0)
    places = [times, 0.0 * times + 33.5, 108.0 + 1e-4 * times, 0.0 * times + 1000.0]
    names = "time_s,latitude_deg,longitude_deg,height_m"
    path = tmp_path / "track.csv"
    np.savetxt(path, np.transpose(places), delimiter=",", header=names, comments="")
    case = small_case().model_copy(update={"trajectory": TrajectorySpec(file=str(path))})
    with pytest.raises(TrajectoryError, match=r"windows.settled_from_s is 10 s and must not lie"):
        prepare(case)


def test_the_final_bound_is_that_of_the_position_at_the_end():
    """All readings are known by then."""
    flight, other = small_flight(), small_flight()
    squared = np.trace(flight_bound(other).smoothing[-1, :3, :3])
    assert CaseBound(flight, flight_bound(flight)).final_m == pytest.approx(
        np.sqrt(squared), rel=1e-12
    )


def test_metres_are_those_of_latitude_longitude_and_height():
    """At each epoch of a climb to the north-east, by the Cartesian coordinates."""
    climb = {"kind": "climb", "by_height_m": 300.0, "climb_angle_deg": 5.0}
    flight = small_flight({"trajectory.segment": [climb], "trajectory.heading_deg": 45.0})
    places = flight.trajectory.positions[flight.epochs]
    expected = [np.diag(metres(place)[[1, 0, 2]]) for place in places]
    np.testing.assert_allclose(flight.metres, expected, rtol=1e-9)


def test_a_longer_reading_of_disks_is_a_quieter_one():
    """√2 a / (b √T), of 1 ng/√Hz over half a metre."""
    for period in (1.0, 4.0):
        flight = small_flight(ROTATING | {"gradiometer.period_s": period})
        expected = np.sqrt(2.0) * 9.80665 / (0.5 * np.sqrt(period))
        assert flight.true.gradiometer.noise_eotvos == pytest.approx(expected)


def test_spin_axes_have_no_order():
    """The channels of the same disks are the same ones, in the same places."""
    one, other = (
        small_flight(ROTATING | {"gradiometer.rotating.spin_axes": axes}).true.gradiometer
        for axes in (["x", "z"], ["z", "x"])
    )
    assert one.components == other.components
    np.testing.assert_array_equal(one.channels, other.channels)


@pytest.mark.parametrize("period", [0.5, 4.0])
def test_a_bias_that_only_walks_starts_from_a_hundredth_of_what_a_reading_adds(period):
    flight = small_flight(
        {"gradiometer.period_s": period, "gradiometer.drift_eotvos_per_sqrt_h": 6.0}
    )
    problem, _ = simulate(flight, 1, 0)
    start, walk = (np.sqrt(np.diag(p))[15:] for p in (problem.prior_cov, problem.process_cov[0]))
    np.testing.assert_allclose(start, 0.01 * walk, rtol=1e-9)


@pytest.mark.parametrize("period", [1.0, 2.0])
def test_errors_that_decay_within_the_filters_delay_are_refused(period):
    """The model takes the state back over the delay, where a decay would be a growth."""
    filtered: dict[str, Any] = {
        "gradiometer.period_s": period,
        "gradiometer.filter": "butterworth",
        "gradiometer.filter_treatment": "delayed",
    }
    made = small_flight(filtered)
    delay = period * made.model.treatment(len(made.times)).delay_samples.max()
    assert delay > 1.5 * period
    filtered["altimeter.noise_m_per_sqrt_hz"] = 1.0
    for table, name in (
        ("imu", "gyro_bias_time_s"),
        ("imu", "accelerometer_bias_time_s"),
        ("model.imu", "gyro_bias_time_s"),
        ("altimeter", "time_constant_s"),
    ):
        small_flight(filtered | {f"{table}.{name}": float(delay) + 0.01})
        with pytest.raises(GGBenchError, match=rf"{name} is .* at least the delay of the filtered"):
            small_flight(filtered | {f"{table}.{name}": float(delay) - 0.01})
    # What decays in truth alone is none of the model's business.
    small_flight(filtered | {"truth.imu.gyro_bias_time_s": float(delay) - 0.01})


@pytest.mark.parametrize("instrument", ["strapdown", "local-level", "platform"])
def test_what_a_rotating_instrument_feels_is_the_mean_of_each_reading(instrument):
    """In level flight to the east: against gravity, less what the Earth's curve and turn take."""
    flight = small_flight(ROTATING | {"gradiometer.instrument": instrument})
    force, rate = flight.motion
    assert force.shape == rate.shape == (len(flight.times), 3)
    np.testing.assert_allclose(np.linalg.norm(force, axis=1), 9.725, atol=0.005)
    latitude, longitude, _ = flight.trajectory.positions[flight.epochs].T
    angle = longitude + ROTATION_RATE * flight.times  # of inertial axes that are the Earth's at 0
    up = {
        "strapdown": [0.0, 0.0, 1.0],
        "local-level": [0.0, 0.0, 1.0],
        "platform": np.stack(
            [np.cos(latitude) * np.cos(angle), np.cos(latitude) * np.sin(angle), np.sin(latitude)],
            axis=-1,
        ),
    }[instrument]
    np.testing.assert_allclose(force, 9.725 * np.ones((20, 3)) * up, atol=0.05)
    # The local level turns by the Earth's rate and by 250 m/s over the Earth's radius.
    turning = np.linalg.norm(rate, axis=1)
    assert (turning < 1.3e-4).all()
    assert (turning > 2e-5).all() == (instrument == "strapdown")


def test_a_mount_feels_what_the_vehicle_feels_in_its_own_axes():
    """With the nose up by 20°: level axes see it upwards, inertial ones turned by where it is."""
    raised = ROTATING | {"trajectory.pitch_deg": 20.0}
    flight = small_flight(raised | {"gradiometer.instrument": "local-level"})
    level, _ = flight.motion
    np.testing.assert_allclose(level, [[0.0, 0.0, 9.725]] * 20, atol=0.05)
    inertial, _ = small_flight(raised | {"gradiometer.instrument": "platform"}).motion
    for k, (latitude, longitude, _) in enumerate(flight.trajectory.positions[flight.epochs]):
        axes = local_axes(latitude, longitude + ROTATION_RATE * flight.times[k])
        np.testing.assert_allclose(inertial[k], axes @ level[k], rtol=1e-12)
