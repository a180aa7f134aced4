"""Blocks of runs: the same runs as one by one, whatever the block."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from oracles import dense_model
from small_cases import ON_BOARD, ROTATING, over_the_normal_field, rough_map, small_flight
from thinning import thinned

from ggbench.block import ProblemBlock
from ggbench.gravity.field import Field
from ggbench.ins.known_gravity import NORMAL_GRAVITY, of_map
from ggbench.ins.strapdown import navigate, navigate_lanes
from ggbench.maps.recipe import read
from ggbench.numerics.kernels import LANES
from ggbench.numerics.lanes import in_lanes, lanes
from ggbench.problem import Problem
from ggbench.simulation.error_free_flight import Flight, prepare
from ggbench.simulation.runs import Truth, simulate, simulate_block
from ggbench.spec import scenario

SEED = 5
FAULTS: dict[str, dict[str, Any]] = {
    "altimeter": {"altimeter.noise_m_per_sqrt_hz": 1.0, "altimeter.time_constant_s": 20.0},
    "wandering biases": {"imu.gyro_bias_time_s": 30.0, "imu.accelerometer_bias_time_s": 60.0},
    "one wandering bias": {"imu.gyro_bias_time_s": 30.0},
    "one decay of nothing": {"imu.gyro_bias_deg_per_h": 0.0, "imu.gyro_bias_time_s": 30.0},
    "scale factors": {
        "truth.imu.gyro_scale_factor_ppm": 100.0,
        "truth.imu.accelerometer_misalignment_arcmin": 1.0,
    },
    "strapdown": {"gradiometer.instrument": "strapdown"},
    "strapdown, delayed": {
        "gradiometer.instrument": "strapdown",
        "gradiometer.filter": "butterworth",
        "gradiometer.filter_treatment": "delayed",
    },
    "gradiometer biases": {
        "gradiometer.bias_eotvos": 1.0,
        "gradiometer.drift_eotvos_per_sqrt_h": 1.0,
    },
    "readings": {
        "truth.gradiometer.scale_factor_ppm": 50.0,
        "truth.gradiometer.misalignment_arcmin": 1.0,
        "truth.gradiometer.outlier_share": 0.1,
        "truth.gradiometer.outlier_eotvos": 3.0,
        "truth.gradiometer.dropout_share": 0.2,
        "truth.gradiometer.dropouts_s": [[2.0, 4.0]],
    },
    "times": {"truth.gradiometer.clock_error_s": 0.1, "truth.gradiometer.timing_jitter_s": 0.02},
    "other sensors": {
        **ON_BOARD,
        "truth.gnss.dropout_share": 0.3,
        "truth.velocity_log.outlier_share": 0.2,
        "truth.velocity_log.outlier_mps": 3.0,
        "truth.barometer.bias_m": 7.0,
    },
    "disks": ROTATING | {"truth.gradiometer.rotating.scale_factor_ppm": 10.0},
    "worse truth": {"truth.gradiometer.noise_eotvos": 3.0, "truth.initial_error.position_m": 30.0},
}


def arrays(block: ProblemBlock, truth: Truth, run: int) -> dict[str, np.ndarray]:
    """All numbers of one run of a block."""
    problem = block.problem(run)
    return numbers_of(problem) | {"error": truth.error_state[run]}


def numbers_of(problem: Problem) -> dict[str, np.ndarray]:
    """All numbers of a problem, those of its model included."""
    found = {k: v for k, v in vars(problem).items() if isinstance(v, np.ndarray)}
    found |= {f"track.{name}": value for name, value in vars(problem.track).items()}
    return found | {f"model.{k}": v for k, v in numbers_in(problem.model.arrays).items()}


def numbers_in(record: object) -> dict[str, np.ndarray]:
    """All numbers of a record, those of the records in it included."""
    found = {}
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        inner = numbers_in(value) if dataclasses.is_dataclass(value) else {"": np.asarray(value)}
        found |= {f"{field.name}.{name}": number for name, number in inner.items()}
    return found


def assert_same(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    assert one.keys() == other.keys()
    for name, array in one.items():
        np.testing.assert_array_equal(array, other[name], err_msg=name)


def assert_runs_are_the_same_in_any_block(flight: Flight) -> None:
    """In a block that is not filled, in two that are, and alone; bit by bit."""
    together, truths = simulate_block(flight, SEED, range(LANES + 3))
    assert together.runs == LANES + 3
    other, other_truths = simulate_block(flight, SEED, [40, LANES + 1, 2])
    problem, truth = simulate(flight, SEED, 2)
    for run, at in ((LANES + 1, 1), (2, 2)):
        one = arrays(together, truths, run)
        assert all(np.isfinite(array).all() for array in one.values())
        assert_same(one, arrays(other, other_truths, at))
    alone = numbers_of(problem) | {"error": truth.error_state}
    assert_same(alone, arrays(together, truths, 2))
    # Runs differ where they should.
    assert (truths.error_state[0] != truths.error_state[1]).any()
    assert (together.measurements[0] != together.measurements[1]).any()


@thinned("what", FAULTS)
def test_a_run_is_the_same_in_any_block(what):
    """With every kind of error that a run can have: its lane and its neighbours do not matter."""
    assert_runs_are_the_same_in_any_block(small_flight(FAULTS[what]))


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.long if number % 6 != 1 else ())
        for number, name in enumerate(sorted(scenario.shipped()))
    ],
)
def test_a_run_of_a_shipped_scenario_is_the_same_in_any_block(name):
    """In the first ten epochs of its first case, over the normal field, as maps take their time."""
    flight = prepare(over_the_normal_field(scenario.load(name).cases[0]))
    epochs = flight.epochs[:10]
    count, truth = epochs[-1] + 1, flight.trajectory
    short = dataclasses.replace(
        flight,
        trajectory=dataclasses.replace(
            truth,
            times=truth.times[:count],
            positions=truth.positions[:count],
            velocities=truth.velocities[:count],
            attitudes=truth.attitudes[:count],
        ),
        delta_angles=flight.delta_angles[: count - 1],
        delta_velocities=flight.delta_velocities[: count - 1],
        epochs=epochs,
        noise_free=flight.noise_free[:10],
        measured=None if flight.measured is None else flight.measured[:10],
        measured_errors={},  # no gravimeter is read so early
    )
    assert_runs_are_the_same_in_any_block(short)


SYSTEMS = ["strapdown", "altimeter", "wandering biases", "one decay of nothing"]


@pytest.mark.parametrize("what", [*SYSTEMS, "both", "map", "gravity"])
def test_error_model_along_tracks_is_that_of_each_track(what, tmp_path):
    """Φ, Q and delayed rows of runs in their lanes are those that F, formed ahead, leads to.

    With a map's gravity added, too, which each run looks up where it believes to be.
    """
    both = FAULTS["altimeter"] | FAULTS["wandering biases"]
    unknown = {"model.disturbance.horizontal_mgal": 20.0, "model.disturbance.distance_km": 20.0}
    known = {"both": both, "map": both, "gravity": FAULTS["altimeter"] | unknown}
    changes = known[what] if what in known else FAULTS[what]
    gravity = NORMAL_GRAVITY
    if what == "map":
        rough = rough_map(tmp_path / "map.nc", rms=300.0)
        gravity = of_map(Field.from_map(read(rough)).disturbance_map)
    flight = small_flight(changes)
    truth, model, dt = flight.trajectory, flight.model, flight.trajectory.dt
    rng = np.random.default_rng(1)
    exact = np.hstack([flight.delta_angles, flight.delta_velocities])
    increments = in_lanes(exact + 1e-4 * rng.normal(size=(3, *exact.shape)))
    start = np.concatenate([truth.positions[0], truth.velocities[0], truth.attitudes[0].ravel()])
    track = lanes(len(exact) + 1, 15)
    navigate_lanes(
        initial=in_lanes(start.reshape(1, 1, 15)),
        increments=increments,
        dt=dt,
        heights=lanes(0, 1),
        gains=(0.0, 0.0),
        gravity=gravity,
        track=track,
    )
    # Delays that reach before the start, to it, into an interval, over several, two into the same.
    epochs = np.array([1, 7, 8, 12, 13, 20, 30])
    delays = dt * np.array([1.4, 7.0, 0.0, 0.3, 3.0, 8.9, 19.6])
    transition, process_cov = np.empty((2, 3, len(epochs), model.dimension, model.dimension))
    rows = np.empty((3, len(epochs), 6, 15))
    model.along(
        track=track,
        increments=increments,
        epochs=epochs,
        delays=delays,
        dt=dt,
        gravity=gravity,
        transition=transition,
        process_cov=process_cov,
        rows=rows,
    )
    for run in range(3):
        one = navigate(
            truth.positions[0],
            truth.velocities[0],
            truth.attitudes[0],
            increments[:, :3, run],
            increments[:, 3:, run],
            dt,
            gravity=gravity,
        )
        np.testing.assert_array_equal(one[0], track[:, :3, run])
        plain = dense_model.system_matrices(*one, increments[:, 3:, run], dt, gravity)
        matrices, noise = dense_model.completed(plain, model.imu, model.altimeter)
        expected = dense_model.transitions(matrices, one[0], epochs, dt, noise)
        # Of the disturbance of gravity as a state no other one's Φ knows, but their Q does.
        phi = transition[run, :, :15, :15]
        np.testing.assert_allclose(phi, expected[0], rtol=1e-12, atol=1e-15)
        scale = np.sqrt(np.maximum(np.diagonal(expected[1], axis1=1, axis2=2), 1e-60))
        scale = scale[:, :, np.newaxis] * scale[:, np.newaxis]
        if what != "gravity":
            np.testing.assert_allclose(process_cov[run] / scale, expected[1] / scale, atol=1e-11)
        late = dense_model.delayed_rows(matrices, one[0], epochs, delays, dt)
        # Taken back by what takes forward; in decays their series differ by 1e-9 of a bias.
        np.testing.assert_allclose(rows[run], late, rtol=1e-12, atol=1e-11)
