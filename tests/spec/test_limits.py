"""Numbers without meaning are refused, odd ones are named, and every number has its limits."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner
from problems import SMALL
from small_cases import ROTATING, small_case
from test_hashable import TABLES
from thinning import thinned

from ggbench.cli.main import main
from ggbench.errors import GGBenchError
from ggbench.spec import scenario
from ggbench.spec.axes import SweepSpec
from ggbench.spec.campaign import CampaignSpec
from ggbench.spec.case import ReferenceSpec
from ggbench.spec.unusual_values import limits_of, unusual_values

SMALLEST = 5e-324
ABSURD = {
    "trajectory.latitude_deg": (-89.5, 91.0),
    "trajectory.longitude_deg": (-181.0, 361.0),
    "trajectory.height_m": (-12e3, 101e3, 1e300),
    "trajectory.speed_mps": (-1.0, 1e4, 1e6),
    "trajectory.heading_deg": (1e9,),
    "trajectory.pitch_deg": (91.0, 1e300),
    "trajectory.roll_deg": (-181.0,),
    "imu.period_s": (SMALLEST, 1e-9, 60.0),
    "imu.gyro_bias_deg_per_h": (SMALLEST, -1.0, 1e6, 1e300),
    "imu.gyro_noise_deg_per_sqrt_h": (SMALLEST, 1e6),
    "imu.accelerometer_bias_ug": (SMALLEST, 1e8),
    "imu.accelerometer_noise_ug_per_sqrt_hz": (SMALLEST, 1e8),
    "imu.gyro_bias_time_s": (SMALLEST, 1e300),
    "imu.accelerometer_bias_time_s": (SMALLEST, 1e300),
    "initial_error.position_m": (SMALLEST, 0.0, 1e7),
    "initial_error.velocity_mps": (SMALLEST, 0.0, 1e5),
    "initial_error.attitude_arcmin": (SMALLEST, 0.0, 1e4),
    "initial_error.height_m": (SMALLEST, 0.0, 1e6),
    "altimeter.noise_m_per_sqrt_hz": (SMALLEST, 0.0, 1e5),
    "gradiometer.period_s": (SMALLEST, 1e9),
    "gradiometer.noise_eotvos": (SMALLEST, 0.0, 1e9),
    "gradiometer.bias_eotvos": (SMALLEST, -1.0, 1e9),
    "gradiometer.drift_eotvos_per_sqrt_h": (SMALLEST, 1e300),
    "gradiometer.filter_cutoff_hz": (SMALLEST, 0.0),
    "gradiometer.rotating.baseline_m": (SMALLEST, 1e3),
    "gradiometer.rotating.rotation_hz": (SMALLEST, 1e9),
    "field.lowest_m": (-1e5, 1e300),
    "field.highest_m": (1e6,),
    "field.spacing_arcmin": (SMALLEST, 1e5),
    "field.height_spacing_m": (SMALLEST, 1e9),
    "field.density_kg_m3": (SMALLEST, 1e5),
    "field.relief_smoothing_deg": (SMALLEST, 2.0),
    "model.field.error.white_noise_eotvos": (SMALLEST, 1e300),
    "model.field.error.correlated_noise_eotvos": (SMALLEST, 1e300),
    "model.field.error.resolution_km": (SMALLEST, 1e9),
    "model.field.error.density_factor": (SMALLEST, 1e9),
    "model.initial_error.attitude_arcmin": (SMALLEST,),
    "model.gradiometer.noise_eotvos": (SMALLEST, 1e12),
    "truth.imu.gyro_bias_deg_per_h": (SMALLEST, 1e300),
    "truth.imu.gyro_scale_factor_ppm": (SMALLEST, 1e9),
    "truth.gradiometer.timing_jitter_s": (SMALLEST, 1e9),
    "truth.gradiometer.clock_error_s": (SMALLEST, 1e9),
    "truth.gradiometer.outlier_share": (SMALLEST, 1.0),
    "truth.gradiometer.dropout_share": (SMALLEST, 1.0),
    "windows.settled_from_s": (SMALLEST, 1e9),
    "windows.last_s": (SMALLEST, 25.0, 1e9),
    "windows.required_m": (SMALLEST, 1e300),
}
"""Values without meaning, of keys of the small scenario, whose flight lasts 20 s."""
SEGMENTS = {
    "rates": {
        "duration_s": (SMALLEST, 1e9),
        "acceleration_mps2": (1e3,),
        "turn_rate_deg_per_s": (1e3,),
        "climb_rate_deg_per_s": (1e3,),
    },
    "cruise": {"distance_km": (SMALLEST, 1e6)},
    "climb": {
        "by_height_m": (1e6,),
        "to_height_m": (-12e3, 1e6),
        "climb_angle_deg": (SMALLEST, 89.0),
        "vertical_speed_mps": (SMALLEST, 1e6),
    },
    "turn": {
        "by_heading_deg": (1e9,),
        "to_heading_deg": (1e9,),
        "bank_deg": (SMALLEST, 89.9),
        "radius_m": (SMALLEST, 1e9),
    },
    "speed": {"to_speed_mps": (1e6,), "acceleration_mps2": (1e3,)},
    "terrain-following": {"clearance_m": (SMALLEST, 1e9), "max_climb_angle_deg": (SMALLEST, 89.0)},
}


def values(table: dict[str, tuple[float, ...]]) -> list[tuple[str, float]]:
    return [(key, value) for key, absurd in table.items() for value in absurd]


@thinned(("key", "value"), values(ABSURD), every=2)
def test_a_value_without_meaning_is_refused(key, value):
    """The sentence says which key, what was found and what is allowed."""
    name = re.escape(key.removeprefix("model.").removeprefix("truth.").rpartition(".")[2])
    found = f"({re.escape(repr(value))}|{re.escape(f'{value:g}')})"
    with pytest.raises(GGBenchError, match=rf"{name} is {found}.* must (not|be 0 or|lie) "):
        small_case((ROTATING if "rotating" in key else {}) | {key: value})


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [(kind, *item) for kind, table in SEGMENTS.items() for item in values(table)],
)
def test_a_manoeuvre_without_meaning_is_refused(kind, key, value):
    segment = {"kind": kind, key: value}
    with pytest.raises(GGBenchError, match=rf"segment\[0\].{key} is .* must (be 0 or )?lie betwe"):
        small_case({"trajectory.segment": [segment]})


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.__name__)
def test_every_number_has_limits(table):
    """No key takes any number at all: a new one says what its quantity may be."""
    for name, field in table.model_fields.items():
        if "float" not in str(field.annotation) or (table.__name__, name) == ("AxisSpec", "values"):
            continue  # the values of an axis are held to the limits of the key that takes them
        limits = limits_of(field)
        assert limits is not None, f"{table.__name__}.{name}"
        assert abs(limits.lowest) < limits.highest <= 1e9 or limits.lowest == -limits.highest
        if limits.usual is not None:
            assert limits.lowest <= limits.usual[0] < limits.usual[1] <= limits.highest


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        (CampaignSpec, "time_limit_s", 0.0),
        (CampaignSpec, "runs", 10**9),
        (CampaignSpec, "assumption_runs", 10**9),
        (ReferenceSpec, "position_mrse_m", SMALLEST),
        (ReferenceSpec, "velocity_mrse_mps", 1e300),
        (SweepSpec, "targets_m", [0.0]),
    ],
)
def test_what_is_no_part_of_a_flight_has_limits_too(table, key, value):
    with pytest.raises(ValueError, match=rf"\n{key}"):
        table.model_validate({key: value})


ODD = SMALL.replace("speed_mps = 250.0", "speed_mps = 2500.0").replace(
    "attitude_arcmin = ", "attitude_arcmin = 0.00001 # "
)
SENTENCES = (
    "trajectory.speed_mps = 2500 is unusual (0.5 to 1000 is usual)",
    "initial_error.attitude_arcmin = 1e-05 is unusual (0.0001 to 300 is usual)",
)


def test_odd_values_are_named():
    """Each once, however many cases have it; 0 where nothing is meant is not odd."""
    assert unusual_values(scenario.parse(tomllib.loads(ODD), "odd", "odd")) == [
        f"{sentence}, in case base and 1 more" for sentence in SENTENCES
    ]
    plain = SMALL.replace("gyro_bias_deg_per_h = ", "gyro_bias_deg_per_h = 0.0 # ")
    assert unusual_values(scenario.parse(tomllib.loads(plain), "plain", "plain")) == []


@thinned("name", scenario.shipped())
def test_nothing_of_the_library_is_odd(name):
    """But for the speed of the one flight that is hypersonic, which is meant."""
    meant = {"richeson2008": ["trajectory.speed_mps = 1800 is unusual"]}
    found = [sentence.partition(" (")[0] for sentence in unusual_values(scenario.load(name))]
    assert found == meant.get(name, [])


@pytest.mark.parametrize(
    "words", [["validate"], ["run", "-n", "1", "-j", "0", "-e", "ins"], ["run", "--run", "0"]]
)
def test_the_user_is_told_of_odd_values(words, tmp_path, monkeypatch):
    """Whoever validates or runs the scenario reads of them, and it runs."""
    monkeypatch.chdir(tmp_path)
    Path("odd.toml").write_text(ODD)
    told = CliRunner().invoke(main, [words[0], "odd.toml", *words[1:]])
    assert told.exit_code == 0, told.output
    for sentence in SENTENCES:
        assert told.output.count(sentence) == 1, told.output


def test_the_documented_limits_are_those_that_hold():
    """docs/scenario_files.md states the limits of every number of a scenario."""
    document = (Path(__file__).parents[2] / "docs" / "scenario_files.md").read_text()
    rows = re.findall(
        r"^\| `(\w+)` \| \S* +\| (?:list[^,|]*, each )?(0 or )?(\S+) to ([^\s;]+)"
        r"(?:; usual: (\S+) to (\S+))? \|",
        document,
        re.MULTILINE,
    )
    stated = {
        (key, bool(zero), *(number and float(number) for number in numbers))
        for key, zero, *numbers in rows
    }
    held = {
        (name, w.or_zero, w.lowest, w.highest, *(w.usual or ("", "")))
        for table in TABLES
        for name, field in table.model_fields.items()
        if (w := limits_of(field)) is not None
    }
    assert held <= stated
