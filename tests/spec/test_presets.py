"""Presets of IMU and gradiometer: they are numbers, and what a file writes holds."""

from __future__ import annotations

import typing

import pytest
from problems import SMALL

from ggbench.cli.keys import presets_of
from ggbench.simulation.error_free_flight import prepare
from ggbench.spec import presets, scenario
from ggbench.spec.scenario import ScenarioError

NUMBERS = """gyro_bias_deg_per_h = 0.015
gyro_noise_deg_per_sqrt_h = 0.005
accelerometer_bias_ug = 500.0
accelerometer_noise_ug_per_sqrt_hz = 100.0
"""


def load(tmp_path, imu: str = NUMBERS, more: str = "", gradiometer: str = "noise_eotvos = 0.01"):
    """The small scenario with another IMU or gradiometer."""
    assert NUMBERS in SMALL
    text = SMALL.replace(NUMBERS, imu).replace("noise_eotvos = 0.01", gradiometer, 1) + more
    path = tmp_path / "preset.toml"
    path.write_text(text)
    return scenario.load(path)


@pytest.mark.parametrize("grade", presets.IMU_GRADES)
def test_a_grade_is_its_numbers(tmp_path, grade):
    """The case equals the one that writes the numbers, by its identity, too."""
    named = load(tmp_path, f'grade = "{grade}"\n').cases[0]
    values = presets.IMU_GRADES[grade].values
    written = load(tmp_path, "".join(f"{key} = {value}\n" for key, value in values.items()))
    assert named.imu == written.cases[0].imu
    assert named.content_hash == written.cases[0].content_hash
    assert presets.grade_of(named.imu.gyro_bias_deg_per_h) == grade


def test_a_written_key_holds(tmp_path):
    imu = load(tmp_path, 'gyro_bias_deg_per_h = 3.0\ngrade = "tactical"\n').cases[0].imu
    assert imu.gyro_bias_deg_per_h == 3.0 and imu.accelerometer_bias_ug == 1000.0


def test_an_unknown_grade_names_the_known_ones(tmp_path):
    with pytest.raises(ScenarioError) as error:
        load(tmp_path, 'grade = "militray"\n')
    for grade in presets.IMU_GRADES:
        assert f"'{grade}'" in str(error.value)
    assert "imu.grade is 'militray'" in str(error.value)


def test_a_change_to_a_grade_replaces_numbers(tmp_path):
    """In a case of the file, on one side, and in Python; what the change writes holds."""
    more = '[[case]]\nname = "t"\ntitle = "T"\nimu.grade = "tactical"\n'
    more += 'model.imu = { grade = "consumer", gyro_bias_deg_per_h = 7.0 }\n'
    case = load(tmp_path, more=more).case("t")
    assert case.imu.gyro_bias_deg_per_h == 10.0
    assumed = case.side("model").imu
    assert (assumed.gyro_bias_deg_per_h, assumed.accelerometer_bias_ug) == (7.0, 10e3)
    assert case.changed("imu.grade", "strategic").imu.gyro_bias_deg_per_h == 0.0003


@pytest.mark.parametrize("name", presets.GRADIOMETERS)
def test_every_gradiometer_flies(tmp_path, name):
    """Also as a change of a case with another noise, whose noise can be written in its place."""
    change = load(tmp_path).cases[0].changed("gradiometer", {"preset": name})
    spec = prepare(change) and change.gradiometer
    values = presets.GRADIOMETERS[name].values
    assert list(spec.components) == values["components"] and spec.noise_eotvos is None
    louder = change.changed("gradiometer.noise_eotvos", 3.0).gradiometer
    assert louder.noise_eotvos == 3.0 and louder.components == spec.components
    quiet = load(tmp_path, gradiometer=f'preset = "{name}"\nnoise_eotvos = 0.2').cases[0]
    assert quiet.gradiometer.noise_eotvos == 0.2


def test_presets_are_those_that_are_allowed():
    """Types, tables and what `ggbench keys` prints name the same presets, each with a source."""
    assert typing.get_args(presets.Grade) == tuple(presets.IMU_GRADES)
    assert typing.get_args(presets.PublishedGradiometer) == tuple(presets.GRADIOMETERS)
    for table, (key, known) in presets.PRESETS.items():
        shown = presets_of(table)
        assert [head for head, _ in shown] == [f'{key} = "{name}"' for name in known]
        assert all("Source: " in text for _, text in shown)
