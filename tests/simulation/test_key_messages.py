"""Messages of the keys of scenarios."""

from __future__ import annotations

import re

import pytest
from small_cases import (
    ASKEW,
    CONSTANT,
    GNSS,
    GRAVIMETER,
    INTEGRATED,
    LEVEL,
    ON_BOARD,
    OUTLIERS,
    ROTATING,
    SEVERAL,
    STATES,
    TILT,
    small_flight,
)

from ggbench.errors import GGBenchError
from ggbench.gravity.gradient_map import MapError
from ggbench.spec.scenario import ScenarioError

ALONE = {"gradiometer": None}
RECEIVER = {"gnss.period_s": 1.0, "gnss.position_noise_m": 1.0}
STERN = {key: value for key, value in SEVERAL.items() if ".stern." in key}
BAR = {"sensor.x.kind": "barometer", "sensor.x.period_s": 1.0, "sensor.x.noise_m": 1.0}
BAROMETER = {"kind": "barometer", "period_s": 1.0, "noise_m": 1.0}
ALL = CONSTANT | STATES | INTEGRATED
LATE = "gradiometer.latency_s"
MOUNTED = {"gradiometer.mounting_sigma_arcmin": 3.0}
JUMP = {
    "truth.gnss.jump_m": [1.0, 0.0, 0.0],
    "truth.gnss.jump_from_s": 5.0,
    "truth.gnss.jump_until_s": 4.0,
}
ROOF = {
    "sensor.roof.kind": "gnss",
    "sensor.roof.period_s": 1.0,
    "sensor.roof.velocity_noise_mps": 0.1,
    "sensor.roof.position_bias_m": 3.0,
}
OTHER_NAME = {key.replace("gravimeter", "sensor.x"): value for key, value in GRAVIMETER.items()}
TOGETHER = "tilt_arcmin and tilt_time_s must be given together"
USED = "this name is already used"
BOARD = "changes a sensor that is not on board"


def fast(**segment):
    """A flight of one segment."""
    return {"trajectory.segment": [segment]}


def of_receiver(table, **changes):
    """A receiver in a table, with changes of it and of the sides."""
    keys = {f"{table}.period_s": 1.0, f"{table}.position_noise_m": 5.0}
    return keys | {key.replace("gnss", table): value for key, value in changes.items()}


def region(*bounds):
    """A map that is cut to bounds."""
    names = ("south_deg", "north_deg", "west_deg", "east_deg")
    keys = {f"field.{name}": bound for name, bound in zip(names, bounds, strict=True)}
    return keys | {"field.source": "map.nc"}


ASCENDING = "in ascending order, or none of them"
STANDARD_ERROR = {
    "field.source": "map.nc",
    "gradiometer.instrument": "local-level",
    "gradiometer.components": ["xx", "xy", "xx-yy"],
    "gradiometer.noise_eotvos": 1.0,
    "model.field.standard_error": True,
}
BAD = {
    # Draws.
    "a map error that is none": ({"draw.maps": 2}, r"draw\.maps needs a map error"),
    "no drawn track": ({"draw.tracks": 0}, r"draw\.tracks"),
    "1001 drawn tracks": ({"draw.tracks": 1001}, r"draw\.tracks"),
    "a negative square of starts": ({"draw.start_km": -1.0}, r"draw\.start_km"),
    # Flights.
    "a flight ever faster": (
        fast(duration_s=200.0, acceleration_mps2=50.0),
        "the flight's speed is 80.* between 0 and 8000 m/s",
    ),
    "a flight into space": (
        fast(kind="climb", by_height_m=95e3, vertical_speed_mps=200.0),
        "the flight's height is 10.*000 m",
    ),
    "a flight into the sea": (
        fast(kind="climb", by_height_m=-25e3, vertical_speed_mps=200.0),
        "the flight's height is -110",
    ),
    # Receivers.
    "a duty cycle without end": (
        GNSS | {"truth.gnss.duty_on_s": 5.0}, "duty_on_s and duty_off_s must",
    ),
    "a ramp of nothing": (GNSS | {"truth.gnss.ramp_from_s": 5.0}, "requires ramp_mps"),
    "a jump of nothing": (GNSS | {"truth.gnss.jump_until_s": 5.0}, "requires jump_m"),
    "a jump that ends first": (GNSS | JUMP, "jump_until_s must be later than jump_from_s"),
    "a bias of no positions": (GNSS | ROOF, "needs position_noise_m"),
    "a time of no bias": (GNSS | {"gnss.position_bias_time_s": 3.0}, "needs position_bias_m"),
    "a jump of two parts": (GNSS | {"truth.gnss.jump_m": [1.0, 0.0]}, "jump_m"),
    "a lever arm of two parts": (ON_BOARD | {"gnss.lever_arm_m": [1.0, 2.0]}, "lever_arm_m"),
    "a lever arm of 3 km": (ON_BOARD | {"gnss.lever_arm_m": [1.0, 2.0, 3000.0]}, "lever_arm_m"),
    "a negative deviation of a lever arm": (
        ON_BOARD | {"gnss.lever_arm_sigma_m": -1.0}, "lever_arm_sigma_m",
    ),
    "a receiver without noise": (
        {"gnss.period_s": 1.0}, "give position_noise_m, velocity_noise_mps, or both",
    ),
    "a noise of heights alone": (
        {"gnss.period_s": 1.0, "gnss.velocity_noise_mps": 1.0, "gnss.height_noise_m": 1.0},
        "height_noise_m needs position_noise_m",
    ),
    "velocities of a receiver of positions": (
        RECEIVER | {"truth.gnss.velocity_noise_mps": 1.0},
        "truth.gnss.velocity_noise_mps requires channels that the receiver does not have",
    ),
    "outliers of a receiver without size": (
        ON_BOARD | {"truth.gnss.outlier_share": 0.1}, "outlier_share and outlier_m or outlier_",
    ),
    "a gap of a receiver that ends first": (
        ON_BOARD | {"truth.gnss.dropouts_s": [[5.0, 4.0]]}, "with from < to",
    ),
    # Which sensors there are.
    "no sensor": (ALONE, "no sensor is on board"),
    "a barometer between samples": (
        ON_BOARD | {"barometer.period_s": 0.33}, r"barometer.period_s \(0.33 s\) must be a whole",
    ),
    "a gravimeter without a map": (GRAVIMETER, "gravimeter needs a map"),
    "the truth of no receiver": ({"truth.gnss.dropout_share": 0.1}, f"truth.gnss {BOARD}"),
    "the model of no gradiometer": (
        {"model.gradiometer.noise_eotvos": 2.0} | ALONE | ON_BOARD, f"model.gradiometer {BOARD}",
    ),
    "an axis of a log twice": (
        ON_BOARD | {"velocity_log.components": ["x", "x"]}, "names an axis twice",
    ),
    "a component of a gravimeter twice": (
        GRAVIMETER | {"gravimeter.components": ["scalar"] * 2}, "names a component twice",
    ),
    "one measurement": (
        ON_BOARD | {"gnss.period_s": 15.0, "barometer.period_s": 15.0} | ALONE
        | {"velocity_log.period_s": 15.0},
        "too short for two measurements",
    ),
    # Named sensors.
    "no kind of a sensor": (
        {"sensor.x.period_s": 1.0}, 'sensor.x: kind is missing; allowed: "gnss", ',
    ),
    "an unknown kind of a sensor": (
        STERN | {"sensor.stern.kind": "gps"}, "sensor.stern: kind is 'gps'; allowed: \"gnss\"",
    ),
    "a number as kind": (STERN | {"sensor.stern.kind": 3}, "sensor.stern: kind is 3; allowed"),
    "a list as kind": (
        STERN | {"sensor.stern.kind": ["gnss"]}, r"sensor.stern: kind is \['gnss'\]; allowed",
    ),
    "a second gradiometer": (
        {"sensor.x.kind": "gradiometer"}, "sensor.x: kind .*; only one gradiometer is allowed",
    ),
    "a number as a sensor": ({"sensor.x": 3}, "sensor.x is 3 and must be a table of keys"),
    "a number as sensors": ({"sensor": 3}, "sensor is 3 and must be a table of keys"),
    "a kind alone": ({"sensor.x.kind": "gnss"}, "'sensor.x.period_s' is missing"),
    "a named receiver without noise": (
        {"sensor.x": {"kind": "gnss", "period_s": 1.0}}, "sensor.x: give position_noise_m",
    ),
    "a key of another kind": (
        BAR | {"sensor.x.position_noise_m": 1.0},
        "unknown key 'sensor.x.position_noise_m'.*; known: period_s, kind, noise_m, b",
    ),
    "a negative noise": (
        BAR | {"sensor.x.noise_m": -1.0}, "sensor.x.noise_m is -1.0 and must lie between",
    ),
    "a unit in a noise": (
        BAR | {"sensor.x.noise_m": "1 m"}, "sensor.x.noise_m is '1 m' and must be a plain num",
    ),
    "a named sensor between samples": (
        BAR | {"sensor.x.period_s": 0.33}, r"sensor.x.period_s \(0.33 s\) must be a whole mult",
    ),
    "names alike but for capitals": (
        BAR | {"sensor.X": BAROMETER}, "sensor: X and x differ only in capital letters",
    ),
    **{
        f"the name {name[:9]!r}": ({f"sensor.{name}": BAROMETER}, said)
        for name, said in (
            ("9x", "sensor.9x: the name .* begin with a letter"),
            ("a-b", "sensor.a-b: the name .* underscores"),
            ("é", "without accents"),
            ("x\n", "the name of a sensor must"),
            ("", "the name of a sensor must"),
            ("x" * 31, "at most 30 characters"),
            ("GNSS", f"sensor.GNSS: {USED}"),
            ("gnss", "sensor: .* 'gnss' must have kind = 'gnss', found 'barometer'"),
            ("IMU", f"sensor.IMU: {USED}"),
            ("gyro", f"sensor.gyro: {USED}"),
        )
    },
    "the truth of no named sensor": (
        {"truth.sensor.x.dropout_share": 0.1}, f"truth.sensor.x {BOARD}",
    ),
    "the model of another sensor": (
        BAR | {"model.sensor.y.noise_m": 0.1}, f"model.sensor.y {BOARD}",
    ),
    "a true key of another kind": (
        BAR | {"truth.sensor.x.noise_mps": 1.0}, "unknown key 'truth.sensor.x.noise_mps'",
    ),
    "a true key in the model": (
        BAR | {"model.sensor.x.dropout_share": 0.1}, "unknown key 'model.sensor.x.dropout_",
    ),
    "another kind in the model": (
        BAR | {"model.sensor.x.kind": "gnss"},
        "model.sensor.x.kind is 'gnss', but sensor.x.kind is 'barometer'",
    ),
    "a number as a true sensor": (
        BAR | {"truth.sensor.x": 3}, "truth.sensor.x is 3 and must be a table of keys",
    ),
    "a number as true sensors": (
        BAR | {"truth.sensor": 3}, "truth.sensor is 3 and must be a table of keys",
    ),
    "outliers of a barometer without size": (
        BAR | {"truth.sensor.x.outlier_share": 0.1},
        "truth.sensor.x: outlier_share and outlier_m must be",
    ),
    "outliers of a named receiver without share": (
        STERN | {"sensor.stern.velocity_noise_mps": 1.0, "truth.sensor.stern.outlier_m": 1.0},
        "truth.sensor.stern: outlier_share and outlier_m or outlier_mps must be",
    ),
    "a named gravimeter without a map": (
        OTHER_NAME | {"sensor.x.kind": "gravimeter"}, "sensor.x needs a map",
    ),
    "one sensor in both forms": (
        {"gnss.period_s": 1.0, "sensor.gnss.position_noise_m": 5.0},
        r"\[gnss\] and \[sensor.gnss\] are the same table",
    ),
    **{
        f"{fault} of [{table}]": (of_receiver(table, **changes), message.replace("TABLE", table))
        for table in ("gnss", "sensor.gnss")
        for fault, changes, message in (
            ("negative period", {"gnss.period_s": -1.0}, r": TABLE\.period_s is -1.0 and must"),
            ("unknown key", {"gnss.period": 1.0},
             r": unknown key 'TABLE\.period' .did you mean 'period_s'"),
            ("a word as noise", {"gnss.height_noise_m": "x"},
             r": TABLE\.height_noise_m is 'x' and must be a plain"),
            ("outliers without size", {"truth.gnss.outlier_share": 0.1},
             r": truth\.TABLE: outlier_share and outlier_m"),
            ("outliers in the model", {"model.gnss.outlier_m": 0.1},
             r": unknown key 'model\.TABLE.outlier_m'"),
            ("a number as model", {"model.gnss": 3},
             r": model\.TABLE is 3 and must be a table of keys"),
        )
    },
    **{
        f"no period of [{table}]": (
            {f"{table}.position_noise_m": 5.0}, f": '{table}.period_s' is missing",
        )
        for table in ("gnss", "sensor.gnss")
    },
    # Gravity.
    "a constant that is not felt": (
        {"truth.field.constant_disturbance_mgal": [1.0, 2.0, 3.0]},
        "constant_disturbance_mgal requires field.gravity_disturbance = true",
    ),
    "a constant of two parts": (
        CONSTANT | {"truth.field.constant_disturbance_mgal": [1.0, 2.0]}, "at least 3 items",
    ),
    "a distance without a disturbance": (
        CONSTANT | {"model.disturbance.distance_km": 5.0}, "horizontal_mgal' is missing",
    ),
    "no distance of a disturbance": (
        CONSTANT | STATES | {"model.disturbance.distance_km": 0.0}, "must lie between",
    ),
    "a distance of integrated gradients": (
        ALL | {"model.disturbance.distance_km": 5.0}, "distance_km must not be given",
    ),
    "no gradients to integrate": (ALL | ALONE | ON_BOARD, "needs a gradiometer"),
    "gradients of a platform to integrate": (
        ALL | {"gradiometer.instrument": "platform"}, "local-level",
    ),
    "filtered gradients to integrate": (
        ALL | {"gradiometer.filter": "butterworth"}, "without delay",
    ),
    "biased gradients to integrate": (ALL | {"gradiometer.bias_eotvos": 1.0}, "no states for th"),
    "two gradients to integrate": (
        ALL | {"gradiometer.components": ["xx", "zz"]}, "whole tensor; xx, zz do not",
    ),
    "four gradients to integrate": (
        ALL | {"gradiometer.components": ["xx", "xy", "xz", "yz"]}, "determine the whole tensor",
    ),
    "integrated gradients that are not felt": (STATES | INTEGRATED, "accelerometers measure none"),
    # Maps.
    **{
        f"{key} of {source}": (
            {"field.source": source, f"field.{key}": value},
            rf"field.{key} is {value}, but .* does not use it", MapError,
        )
        for source in ("normal", "map.nc")
        for key, value in (
            ("land_correction", False),
            ("relief_smoothing_deg", 0.1),
            ("density_kg_m3", 2500.0),
            ("drape", True),
        )
    },
    "latitudes in descending order": (region(33.6, 33.5, 108.0, 108.1), ASCENDING, MapError),
    "longitudes in descending order": (region(33.5, 33.6, 108.1, 108.0), ASCENDING, MapError),
    "a longitude twice": (region(33.5, 33.6, 108.0, 108.0), ASCENDING, MapError),
    "latitudes alone": (region(33.5, 33.6, 0.0, 0.0), ASCENDING, MapError),
    "exchanged bounds at 180°": (region(33.45, 33.55, -179.95, -179.99), ASCENDING, MapError),
    "a standard error without a map": (
        STANDARD_ERROR | {"field.source": "normal"}, "model.field.standard_error.*needs a map",
    ),
    "a standard error of a strapdown instrument": (
        STANDARD_ERROR | {"gradiometer.instrument": "strapdown"},
        "model.field.standard_error.*it needs gradiometer.instrument",
    ),
    # Gradiometers.
    "bursts of no outliers": (
        {"truth.gradiometer.outlier_burst_s": 10.0}, "outlier_channels require outlier_share",
    ),
    "channels of no outliers": (
        {"truth.gradiometer.outlier_channels": "all"}, "outlier_channels require outlier_share",
    ),
    "unknown channels of outliers": (
        OUTLIERS | {"truth.gradiometer.outlier_channels": "some"}, "'each' or 'all'",
    ),
    "negative bursts": (
        OUTLIERS | {"truth.gradiometer.outlier_burst_s": -1.0}, "must be 0 or lie between",
    ),
    "noise without a variance": (
        {"truth.gradiometer.noise_freedom": 2.0}, "must lie between 2.01 and 1e6",
    ),
    "a tilt without its time": (LEVEL | {"truth.gradiometer.tilt_arcmin": 1.0}, TOGETHER),
    "a time without its tilt": (LEVEL | {"truth.gradiometer.tilt_time_s": 1.0}, TOGETHER),
    "a tilt of a platform": (
        TILT,
        'tilt_arcmin requires a level mount, instrument = "local-level"; found "platform"',
    ),
    "a tilt of a strapdown instrument": (
        TILT | {"gradiometer.instrument": "strapdown"}, 'found "strapdown"',
    ),
    "a clock of a level instrument": (
        ASKEW | {"gradiometer.instrument": "local-level", "truth.gradiometer.clock_error_s": 100.0},
        r'requires instrument = "platform".* found "local-level"', ScenarioError,
    ),
    "late and filtered readings": (
        {LATE: 1.0, "gradiometer.filter": "butterworth"}, "both late and filtered: set filter",
    ),
    "readings before their time": (
        {LATE: -1.0}, "latency_s is -1.0 and must be 0 or lie between 1e-6 and 600",
    ),
    "late disks that vibrate": (
        ROTATING
        | {f"truth.{LATE}": 1.0, "truth.gradiometer.rotating.vibration_mps2": 1.0},
        "rotating requires gradiometer.latency_s = 0",
    ),
    "late gradients to integrate": (
        INTEGRATED
        | {
            LATE: 1.0,
            "model.disturbance.horizontal_mgal": 10.0,
            "field.gravity_disturbance": True,
            "field.source": "egm2008_qinling",
        },
        "needs measurements without delay",
    ),
    "a bias that decays within the latency": (
        {"imu.gyro_bias_time_s": 5.0, LATE: 5.1},
        "_bias_time_s is 5 s .* latency of the measurements, 5",
    ),
    "a negative deviation of the mounting": (
        {"gradiometer.mounting_sigma_arcmin": -1.0}, "mounting_sigma_arcmin",
    ),
    "a mounting with coloured noise": (
        MOUNTED | {"gradiometer.noise_eotvos": None, "gradiometer.coloured_noise": "vinton2008"},
        "mount whose axes do not turn",
    ),
    "a mounting with integrated gradients": (
        MOUNTED | INTEGRATED
        | {
            "field.gravity_disturbance": True,
            "truth.field.constant_disturbance_mgal": [1.0, 0.0, 0.0],
            "model.disturbance.horizontal_mgal": 20.0,
        },
        "mounting_sigma_arcmin must be 0",
    ),
}  # fmt: skip
"""Changes of the small scenario's keys, messages and, where one kind is meant, the error."""


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_key_is_refused_in_one_sentence(kind):
    """When the case is read or before it flies; in words of files, not of Python."""
    changes, message, *error = BAD[kind]
    with pytest.raises(tuple(error) or GGBenchError, match=message) as caught:
        small_flight(changes)
    assert not re.search(r"Input should|pydantic|validation error", str(caught.value))
