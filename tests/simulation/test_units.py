"""Every number of a scenario file, in the unit that its key names, becomes the SI value in use.

The unit is read from the key by astropy; the value where the simulation or the model takes it. A
key that is new fails the last test until it has a row here, or is said to have no unit.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any, get_args, get_origin

import astropy.units as u
import numpy as np
import pytest
from key_units import E, si, unit_of
from pydantic import BaseModel
from small_cases import (
    GRAVIMETER,
    ON_BOARD,
    ROTATING,
    small_flight,
)
from test_units_of_flights import ERROR, FIELD, MOVES, SEGMENT, SIDES, TRACK, TRAJECTORY
from thinning import thinned

from ggbench.ins.error_model import added_by
from ggbench.ins.system_matrix import DECAY
from ggbench.sensors.aiding import Motion, position_error
from ggbench.simulation.error_free_flight import Flight, gradiometer_places
from ggbench.simulation.runs import simulate
from ggbench.simulation.sensor_suite import SensorSuite
from ggbench.spec.aiding import KINDS
from ggbench.spec.axes import SweepSpec
from ggbench.spec.campaign import CampaignSpec
from ggbench.spec.case import CaseSpec
from ggbench.spec.named_sensors import NamedSensors

# Sensors and initial errors: what a flight has.

Read = Callable[[Flight, SensorSuite], Any]
Row = tuple[Any, Read] | tuple[Any, Read, dict[str, Any]]


def root(psd: Callable[[np.ndarray], float]) -> Read:
    """A root of the noise that drives the error model."""
    return lambda f, e: math.sqrt(psd(added_by(e.imu, e.altimeter)[1]))


def prior(state: int) -> Read:
    return lambda f, e: math.sqrt(e.prior_cov[state, state])


def decay(triad: int) -> Read:
    return lambda f, e: -1.0 / added_by(e.imu, e.altimeter)[0][DECAY + triad]


def noise(f: Flight, e: SensorSuite) -> float:
    """RMS of a reading, as R has it."""
    return E * math.sqrt(e.noise_cov[0, 0])


def walk(f: Flight, e: SensorSuite) -> float:
    """The root of what Q adds to a bias of the gradiometer in a second."""
    still = Motion(
        *(a[:11] for a in (f.trajectory.positions, f.trajectory.velocities)),
        f.trajectory.attitudes[:11],
    )
    _, q = e.system(still, np.zeros((10, 3)), np.array([10]), 0.1)
    return E * math.sqrt(q[0, 15, 15])


def behind(f: Flight, e: SensorSuite) -> float:
    """RMS of what is drawn, by the same numbers as a noise before the filter."""
    drawn = e.gradiometer.noise_behind(50, np.random.default_rng(1))
    unit = e.gradiometer.noise(50, np.random.default_rng(1)) / e.gradiometer.noise_eotvos
    return E * float(np.median(drawn / unit))


def accelerometer(f: Flight, e: SensorSuite) -> float:
    """Root PSD of one of four whose signals a disk of baseline b adds up over T: √2 a / (b √T)."""
    return noise(f, e) * 0.5 / math.sqrt(2.0)


def channel(name: str) -> Read:
    """RMS of a reading of a channel, as R has it, the rate of whose sensor need not be known."""

    def read(f: Flight, e: SensorSuite) -> float:
        at = [c.name for c in e.channels].index(name)
        unit = 1e-5 if e.channels[at].unit == "mGal" else 1.0
        return unit * math.sqrt(e.noise_cov[at, at])

    return read


def bias(block: str) -> Read:
    """σ of the bias of a sensor at the start."""

    def read(f: Flight, e: SensorSuite) -> float:
        states = {b.name: b for b in e.layout}[block]
        unit = 1e-5 if states.unit == "mGal" else 1.0
        return unit * math.sqrt(e.prior_cov[states.slice, states.slice][0, 0])

    return read


def sensor(name: str, read: Callable[[Any], float]) -> Read:
    return lambda f, e: read({s.name: s for s in e.aiding}[name])


def outlier(name: str, place: int, unit: float = 1.0) -> Read:
    return sensor(name, lambda s: unit * s.faults.outlier[place])


FILTERED = {"gradiometer.filter": "butterworth"}
DENSITY = {"gradiometer.noise_eotvos": None}
WEIGHING = GRAVIMETER | {"field": {"source": "the map", "gravity_disturbance": True}}


A_SECOND = np.ones(1)
RAMP = {"truth.gnss.ramp_mps": [0.1, 0.2, 0.3]}
JUMP = {"truth.gnss.jump_m": [1.0, 2.0, 3.0]}


def arm(f: Flight, e: SensorSuite) -> np.ndarray:
    """How far from the INS the gradiometer is: east, north, up while the body's axes are these."""
    start = f.trajectory.positions[:1]
    found = gradiometer_places(f.case, start, np.eye(3)[np.newaxis])
    return -position_error(start, found)[0]


def wrong(read: Callable[[Any], Any]) -> Read:
    return sensor("gnss", lambda s: read(s.errors))


def struck(name: str) -> dict[str, Any]:
    return {f"truth.{name}.outlier_share": 0.1}


ALTIMETER = {"altimeter.noise_m_per_sqrt_hz": 5.0}

SHARED: dict[str, Row] = {
    "imu.period_s": (0.05, lambda f, e: f.trajectory.dt),
    "imu.gyro_bias_deg_per_h": (3.0, prior(9)),
    "imu.gyro_noise_deg_per_sqrt_h": (0.2, root(lambda q: q[6, 6])),
    "imu.accelerometer_bias_ug": (700.0, prior(12)),
    "imu.accelerometer_noise_ug_per_sqrt_hz": (70.0, root(lambda q: q[3, 3])),
    "imu.gyro_bias_time_s": (40.0, decay(0)),
    "imu.accelerometer_bias_time_s": (60.0, decay(1)),
    "altimeter.noise_m_per_sqrt_hz": (4.0, lambda f, e: math.sqrt(e.altimeter[1])),
    # Two poles at −1/T.
    "altimeter.time_constant_s": (50.0, lambda f, e: 2.0 / e.altimeter[0][0], ALTIMETER),
    "initial_error.position_m": (30.0, prior(0)),
    "initial_error.height_m": (7.0, prior(2)),
    "initial_error.velocity_mps": (0.3, prior(3)),
    "initial_error.attitude_arcmin": (2.0, prior(6)),
    "initial_error.heading_arcmin": (9.0, prior(8)),
    "gradiometer.period_s": (2.0, lambda f, e: float(f.times[1] - f.times[0])),
    "gradiometer.noise_eotvos": (0.7, noise),
    # N² = D² f / 2, f = 1 Hz.
    "gradiometer.noise_density_eotvos_per_sqrt_hz": (
        0.3,
        lambda f, e: noise(f, e) * math.sqrt(2.0),
        DENSITY,
    ),
    "gradiometer.bias_eotvos": (0.9, lambda f, e: E * math.sqrt(e.prior_cov[15, 15])),
    "gradiometer.drift_eotvos_per_sqrt_h": (6.0, walk),
    "gradiometer.mounting_sigma_arcmin": (0.8, bias("gradiometer mounting error")),
    "gradiometer.noise_behind_filter_eotvos": (0.004, behind, FILTERED),
    "gradiometer.latency_s": (0.3, lambda f, e: e.gradiometer.latency),
    "gradiometer.filter_cutoff_hz": (
        0.3,
        lambda f, e: e.gradiometer.lowpass.cutoff_hz,
        FILTERED,
    ),
    "gradiometer.rotating.baseline_m": (0.3, lambda f, e: f.disks.instrument.baseline),
    "gradiometer.rotating.rotation_hz": (
        1.5,
        lambda f, e: f.disks.instrument.rotation_rate_hz,
    ),
    "gradiometer.rotating.accelerometer_noise_ng_per_sqrt_hz": (0.2, accelerometer, ROTATING),
    "gnss.period_s": (2.0, sensor("gnss", lambda s: s.period), ON_BOARD),
    "gnss.position_noise_m": (6.0, channel("position N"), ON_BOARD),
    "gnss.height_noise_m": (9.0, channel("position U"), ON_BOARD),
    "gnss.velocity_noise_mps": (0.07, channel("velocity U"), ON_BOARD),
    "gnss.position_bias_m": (2.5, bias("gnss bias"), ON_BOARD),
    "gnss.position_bias_time_s": (
        45.0,
        sensor("gnss", lambda s: s.bias_time),
        ON_BOARD | {"gnss.position_bias_m": 2.5},
    ),
    "gnss.lever_arm_m": ([1.0, 2.0, 3.0], sensor("gnss", lambda s: s.lever), ON_BOARD),
    "gnss.lever_arm_sigma_m": (1.5, bias("gnss lever arm error"), ON_BOARD),
    "velocity_log.period_s": (4.0, sensor("velocity_log", lambda s: s.period), ON_BOARD),
    "velocity_log.noise_mps": (0.3, channel("velocity forward"), ON_BOARD),
    "velocity_log.bias_mps": (0.4, bias("velocity log bias"), ON_BOARD),
    "velocity_log.bias_time_s": (50.0, sensor("velocity_log", lambda s: s.bias_time), ON_BOARD),
    "barometer.period_s": (2.5, sensor("barometer", lambda s: s.period), ON_BOARD),
    "barometer.noise_m": (4.0, channel("height"), ON_BOARD),
    "barometer.bias_m": (6.0, bias("barometer bias"), ON_BOARD),
    "barometer.bias_time_s": (70.0, sensor("barometer", lambda s: s.bias_time), ON_BOARD),
    "gravimeter.period_s": (3.0, sensor("gravimeter", lambda s: s.period), WEIGHING),
    "gravimeter.noise_mgal": (0.8, channel("gravity scalar"), WEIGHING),
    "gravimeter.bias_mgal": (0.6, bias("gravimeter bias"), WEIGHING),
    "gravimeter.bias_time_s": (80.0, sensor("gravimeter", lambda s: s.bias_time), WEIGHING),
}
"""Value, where it is in use, and what must be said besides."""

DISKS = ROTATING | {"truth.gradiometer.rotating.scale_factor_mismatch_ppm": 1.0}
LEVEL = {"gradiometer.instrument": "local-level"}
GRAVITY = {"model.disturbance.horizontal_mgal": 20.0}
OF_THE_MODEL: dict[str, Row] = {
    "disturbance.horizontal_mgal": (30.0, prior(16)),
    "disturbance.vertical_mgal": (40.0, prior(17), GRAVITY),
    "disturbance.distance_km": (50.0, lambda f, e: e.disturbance.distance, GRAVITY),
}
OF_THE_TRUTH: dict[str, Row] = {
    "imu.gyro_scale_factor_ppm": (30.0, lambda f, e: e.imu.gyro_errors.scale_factor),
    "imu.accelerometer_scale_factor_ppm": (
        40.0, lambda f, e: e.imu.accelerometer_errors.scale_factor,
    ),
    "imu.gyro_misalignment_arcmin": (0.5, lambda f, e: e.imu.gyro_errors.misalignment),
    "imu.accelerometer_misalignment_arcmin": (
        0.6, lambda f, e: e.imu.accelerometer_errors.misalignment,
    ),
    "gradiometer.scale_factor_ppm": (50.0, lambda f, e: f.faults.scale_factor),
    "gradiometer.misalignment_arcmin": (0.7, lambda f, e: f.faults.misalignment),
    "gradiometer.outlier_eotvos": (
        8.0, lambda f, e: E * f.faults.outlier, {"truth.gradiometer.outlier_share": 0.1},
    ),
    "gradiometer.clock_error_s": (0.2, lambda f, e: f.faults.clock),
    "gradiometer.timing_jitter_s": (0.03, lambda f, e: f.faults.jitter),
    "gradiometer.scale_drift_ppm_per_sqrt_h": (40.0, lambda f, e: f.faults.scale_drift),
    "gradiometer.tilt_arcmin": (
        1.5, lambda f, e: f.faults.tilt, LEVEL | {"truth.gradiometer.tilt_time_s": 30.0},
    ),
    "gradiometer.tilt_time_s": (
        30.0, lambda f, e: f.faults.tilt_time, LEVEL | {"truth.gradiometer.tilt_arcmin": 1.0},
    ),
    "gradiometer.outlier_burst_s": (
        9.0, lambda f, e: f.faults.burst,
        {"truth.gradiometer.outlier_share": 0.1, "truth.gradiometer.outlier_eotvos": 8.0},
    ),
    "gradiometer.rotating.scale_factor_ppm": (11.0, lambda f, e: f.disks.scale_factor),
    "gradiometer.rotating.scale_factor_mismatch_ppm": (
        12.0, lambda f, e: f.disks.scale_factor_mismatch,
    ),
    "gradiometer.rotating.baseline_error_ppm": (13.0, lambda f, e: f.disks.baseline),
    "gradiometer.rotating.misalignment_arcmin": (0.14, lambda f, e: f.disks.misalignment),
    "gradiometer.rotating.demodulation_phase_arcmin": (
        0.15, lambda f, e: f.disks.demodulation_phase,
    ),
    "gradiometer.rotating.rotation_rate_error_ppm": (16.0, lambda f, e: f.disks.rotation_rate),
    "gradiometer.rotating.vibration_mps2": (0.17, lambda f, e: f.disks.vibration),
    "gnss.outlier_m": (30.0, outlier("gnss", 2), ON_BOARD | struck("gnss")),
    "gnss.outlier_mps": (2.0, outlier("gnss", 5), ON_BOARD | struck("gnss")),
    "gnss.ramp_mps": ([0.1, 0.2, 0.3], wrong(lambda e: e.at(A_SECOND)[0]), ON_BOARD),
    "gnss.ramp_from_s": (4.0, wrong(lambda e: e.ramp_from), ON_BOARD | RAMP),
    "gnss.jump_m": ([1.0, 2.0, 3.0], wrong(lambda e: e.at(A_SECOND)[0]), ON_BOARD),
    "gnss.jump_from_s": (4.0, wrong(lambda e: e.jump_within[0]), ON_BOARD | JUMP),
    "gnss.jump_until_s": (4.0, wrong(lambda e: e.jump_within[1]), ON_BOARD | JUMP),
    "gradiometer.mounting_error_arcmin": ([1.0, 2.0, 3.0], lambda f, e: f.faults.mount),
    "gradiometer.lever_arm_error_m": ([1.0, 2.0, 3.0], arm),
    "gradiometer.noise_doubles_at_deg_per_s": (5.0, lambda f, e: f.faults.doubling[0]),
    "gradiometer.noise_doubles_at_mps2": (3.0, lambda f, e: f.faults.doubling[1]),
    "gradiometer.duty_on_s": (
        3.0, lambda f, e: f.faults.duty[0], {"truth.gradiometer.duty_off_s": 9.0},
    ),
    "gradiometer.duty_off_s": (
        3.0, lambda f, e: f.faults.duty[1], {"truth.gradiometer.duty_on_s": 9.0},
    ),
    **{
        f"{name}.duty_{this}_s": (
            3.0, sensor(name, lambda s, at=at: s.faults.duty[at]),
            (WEIGHING if name == "gravimeter" else ON_BOARD)
            | {f"truth.{name}.duty_{other}_s": 9.0},
        )
        for name in KINDS for at, (this, other) in enumerate((("on", "off"), ("off", "on")))
    },
    "velocity_log.outlier_mps": (
        3.0, outlier("velocity_log", 0), ON_BOARD | struck("velocity_log"),
    ),
    "barometer.outlier_m": (40.0, outlier("barometer", 0), ON_BOARD | struck("barometer")),
    "gravimeter.outlier_mgal": (
        50.0, outlier("gravimeter", 0, 1e-5), WEIGHING | struck("gravimeter"),
    ),
}  # fmt: skip


OWN = "a_"
"""What the name of the named sensor of each kind begins with."""


def keys_of(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Dotted keys of all numbers of a table, and of two sensors of each kind, one of its name."""

    def parts(annotation: Any) -> Iterator[Any]:
        yield annotation
        for part in get_args(annotation):
            yield from parts(part)

    for name, field in model.model_fields.items():
        if get_origin(field.annotation) is NamedSensors:
            for table in get_args(get_args(field.annotation)[0]):
                kind = table.model_fields["kind"].default
                yield from keys_of(table, f"{prefix}{name}.{OWN}{kind}.")
                yield from keys_of(table, f"{prefix}{kind}.")
            continue
        found = list(parts(field.annotation))
        tables = [t for t in found if isinstance(t, type) and issubclass(t, BaseModel)]
        for table in tables:
            yield from keys_of(table, f"{prefix}{name}.")
        if not tables and {float, int}.intersection(t for t in found if isinstance(t, type)):
            yield prefix + name


KEYS = {*keys_of(CaseSpec), *keys_of(CampaignSpec, "campaign."), *keys_of(SweepSpec, "sweep.")}
NAMED = {
    f"{side}sensor.{OWN}{key}": (f"{side}{key}", row, sides)
    for rows, ways in (
        (SHARED, (("", ("true", "model")), ("truth.", ("true",)), ("model.", ("model",)))),
        (OF_THE_TRUTH, (("truth.", ("true",)),)),
    )
    for key, row in rows.items()
    for side, sides in ways
    if key.partition(".")[0] in KINDS and f"{side}{key}" in KEYS
}
"""Keys of named sensors: that of the kind's own table, its row, and which sides have it."""
SENSORS = {
    **{key: (row, ("true", "model")) for key, row in SHARED.items()},
    **{f"truth.{key}": (row, ("true",)) for key, row in SHARED.items() if f"truth.{key}" in KEYS},
    **{f"model.{key}": (row, ("model",)) for key, row in SHARED.items() if f"model.{key}" in KEYS},
    **{f"truth.{key}": (row, ("true",)) for key, row in OF_THE_TRUTH.items()},
    **{f"model.{key}": (row, ("model",)) for key, row in OF_THE_MODEL.items()},
}


@thinned("key", SENSORS)
def test_sensors_and_initial_errors(key, rough):
    """Of the shared tables for both sides, of ``[truth]`` and ``[model]`` for their own."""
    (value, read, *rest), sides = SENSORS[key]
    context = dict(rest[0]) if rest else {}
    if key.startswith(("truth.", "model.")):
        context = {name: x for name, x in context.items() if x is not None}
    if "rotating" in key:
        context |= DISKS
    if "field" in context:
        context["field"] = context["field"] | {"source": rough}
    flight = small_flight(context | {key: value})
    for side in sides:
        assert read(flight, getattr(flight, side)) == pytest.approx(si(key, value), rel=1e-9)


@thinned("key", NAMED)
def test_named_sensors(key, rough):
    """Each key is, of a named sensor, what it is in the own table of the sensor's kind."""
    of_kind, (value, read, *rest), sides = NAMED[key]
    kind = of_kind.split(".")[-2]
    context = dict(rest[0]) | ({"field": {"source": rough}} if "field" in rest[0] else {})
    own = {name.replace(f"{kind}.", f"sensor.{OWN}{kind}."): x for name, x in context.items()}
    flight = small_flight(own | {f"sensor.{OWN}{kind}.kind": kind, key: value})
    for side in sides:
        suite = dataclasses.replace(
            getattr(flight, side),
            aiding=tuple(
                dataclasses.replace(s, label="") if s.label == f"{OWN}{kind}" else s
                for s in getattr(flight, side).aiding
            ),
        )
        assert read(flight, suite) == pytest.approx(si(key, value), rel=1e-9)


def test_the_truth_draws_what_the_rows_read():
    """Biases, their walk and the sensors' noise come from the numbers above, in the same units.

    A hundred draws of three axes: within a third, six deviations.
    """
    changes = {
        key: SHARED[key][0] for key in SHARED if key.startswith("imu.") and "time" not in key
    }
    imu = small_flight(changes).true.imu
    drawn = np.array([imu.draw_biases(np.random.default_rng(n)) for n in range(100)])
    for sensor, key in enumerate(("imu.gyro_bias_deg_per_h", "imu.accelerometer_bias_ug")):
        assert drawn[:, sensor].std() == pytest.approx(si(key, changes[key]), rel=0.33)
    key = "imu.gyro_noise_deg_per_sqrt_h"
    assert imu.gyro_root_psd == pytest.approx(si(key, changes[key]), rel=1e-12)
    key = "imu.accelerometer_noise_ug_per_sqrt_hz"
    assert imu.accelerometer_root_psd == pytest.approx(si(key, changes[key]), rel=1e-12)
    key = "gradiometer.drift_eotvos_per_sqrt_h"
    truth = small_flight({key: 6.0}).true.gradiometer
    assert E * truth.drift == pytest.approx(si(key, 6.0), rel=1e-12)


def test_gradients_are_in_eotvos():
    """Γ_UU of a sphere's field is 2 GM/r³, 3.08e-6 /s² near the ground, and so are its readings."""
    flight = small_flight({"gradiometer.instrument": "local-level"})
    expected = (2.0 * 3.986004418e14 * u.m**3 / u.s**2 / (6381e3 * u.m) ** 3).si.value
    assert E * -flight.noise_free[:, 0] == pytest.approx(0.5 * expected, rel=0.01)
    assert E * flight.noise_free[:, 5] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("sensor", ["gradiometer", *KINDS])
def test_dropouts(sensor, rough):
    key, value = f"truth.{sensor}.dropouts_s", (3.0, 7.5)
    every = {f"{name}.period_s": 1.0 for name in ("gradiometer", *KINDS)}
    flight = small_flight(
        ON_BOARD | GRAVIMETER | every | {key: [list(value)], "field": {"source": rough}}
    )
    problem, _ = simulate(flight, 1, 0)
    there = np.array([channel.sensor == sensor for channel in problem.channels])
    assert problem.present[:, ~there].all()
    missing = problem.times[~problem.present[:, there].any(axis=1)]
    assert missing.min() == pytest.approx(si(key, 3.0))
    assert missing.max() <= si(key, 7.5) < missing.max() + 1.0


def test_constant_disturbance():
    key = "truth.field.constant_disturbance_mgal"
    felt = {"field": {"source": "normal", "gravity_disturbance": True}}
    flight = small_flight(felt | {key: [10.0, -20.0, 30.0]})
    found = flight.field.gravity_disturbance(*flight.motion_at_epochs.positions[0])
    assert found == pytest.approx([si(key, value) for value in (10.0, -20.0, 30.0)])


# Completeness.

ONLY_SHOWN = {"reference.position_mrse_m", "reference.velocity_mrse_mps", "sweep.targets_m"}
"""What reports print beside results; nothing is computed from it."""
IN_SECONDS = {"campaign.time_limit_s"}
"""Given as it is to the clock that a run is held to."""
WITHOUT_UNIT = {
    "gradiometer.filter_order", "gradiometer.whitening_regularization",
    "truth.gradiometer.noise_freedom",
    *(f"truth.{name}.{what}_share" for name in ("gradiometer", *KINDS)
      for what in ("outlier", "dropout")), "trajectory.repeat",
    *(f"truth.sensor.{OWN}{name}.{what}_share" for name in KINDS
      for what in ("outlier", "dropout")),
    "draw.tracks", "draw.maps",
    "campaign.runs", "campaign.seed", "campaign.assumption_runs", "sweep.axis.values",
    *(f"{side}field.error.{key}" for side in SIDES for key in ("density_factor", "seed")),
}  # fmt: skip


def test_every_number_has_a_row():
    """A key that is new names its unit, and has a row above, or is said to have none."""
    rows = {
        *SENSORS,
        *TRAJECTORY,
        *TRACK,
        *MOVES,
        "trajectory.middle_s",
        *(f"truth.{name}.dropouts_s" for name in ("gradiometer", *KINDS)),
        "truth.field.constant_disturbance_mgal",
        *(f"trajectory.segment.{key}" for key in SEGMENT),
        *(f"{side}field.{key}" for side in SIDES for key in FIELD),
        *(f"{side}field.error.{key}" for side in SIDES for key in ERROR),
        "draw.start_km",
        "draw.heading_deg",
        *(f"windows.{key}" for key in ("settled_from_s", "last_s", "required_m")),
        *ONLY_SHOWN,
        *IN_SECONDS,
        *NAMED,
        *(f"truth.sensor.{OWN}{name}.dropouts_s" for name in KINDS),
    }
    assert rows | WITHOUT_UNIT == KEYS
    assert [key for key in rows if unit_of(key) is None] == []
    assert [key for key in WITHOUT_UNIT if unit_of(key) is not None] == []
