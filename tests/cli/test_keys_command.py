"""``ggbench keys``, the page of keys and the JSON schema say what the specification has."""

from __future__ import annotations

import importlib.util
import json
import re
import tomllib
from pathlib import Path

import jsonschema
import pytest
from click.testing import CliRunner
from command import invoke
from problems import SMALL
from thinning import thinned

from ggbench.cli.keys import tables, unit_of
from ggbench.cli.main import main
from ggbench.score import card
from ggbench.spec import json_schema
from ggbench.spec.scenario import load, shipped
from ggbench.spec.tables import Section

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "docs" / "scripts" / "key_tables.py"
VALIDATOR = jsonschema.Draft7Validator(json_schema.scenario_schema())
DIMENSIONLESS = {
    "c_nb",
    "density_factor",
    "dropout_share",
    "noise_freedom",
    "outlier_share",
    "published",
    "values",
    "whitening_regularization",
}
"""Numbers without a unit, or with the unit of something else."""


def models(base: type[Section] = Section) -> set[type[Section]]:
    """Every model of the specification."""
    return {base}.union(*map(models, base.__subclasses__()))


def test_every_key_of_every_model_has_a_meaning():
    """A new key stands in some table, and with words."""
    assert len(models()) > 30
    known = {key.name for table in tables().values() for key in table.all_keys()}
    known |= {part for name in tables() for part in name.split(".")}
    for model in models():
        assert model.model_fields.keys() <= known, model.__name__
    for table in tables().values():
        assert table.about.endswith(".")
        for key in table.all_keys():
            assert key.meaning.endswith("."), f"{table.name}.{key.name}"


def test_every_number_has_its_unit():
    """The unit follows from the key's name, which ends with it."""
    for table in tables().values():
        for key in table.all_keys():
            if key.kind.endswith(("number", "numbers")) and key.kind != "whole number":
                assert bool(key.unit) != (key.name in DIMENSIONLESS), key.name
    assert unit_of("gyro_noise_deg_per_sqrt_h") == "°/√h"
    assert unit_of("acceleration_mps2") == "m/s²"
    assert unit_of("biases") == ""


def test_the_page_and_the_schema_are_the_specifications():
    """docs/ holds what ``make keys`` writes, and the page every table but those alike."""
    spec = importlib.util.spec_from_file_location("docs_key_tables", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    text = script.PAGE.read_text(encoding="utf-8")
    assert script.filled_in(text) == text, "run: make keys"
    assert script.SCHEMA.read_text(encoding="utf-8") == json_schema.schema_text(), "run: make keys"
    assert script.CARD_SCHEMA.read_text(encoding="utf-8") == card.schema_text(), "run: make keys"
    shown = set(re.findall(r"<!-- keys: (\S+) -->", text))
    alike = {"truth.field.error", "model.field.error", "assumption"}
    assert shown == set(tables()) - alike


def test_the_schema_is_printed(tmp_path):
    printed = invoke(["keys", "--schema"], tmp_path)
    assert printed.returncode == 0
    jsonschema.Draft7Validator.check_schema(json.loads(printed.stdout))


@thinned("name", shipped())
def test_the_schema_accepts_every_shipped_scenario(name):
    """With provenance, changes of cases and assumptions, sweeps and claims."""
    VALIDATOR.validate(tomllib.loads(load(name).source))


SENSOR = '[sensor.stern]\nkind = "gnss"\nperiod_s = 2.0\nposition_noise_m = 2.0\n[windows]'


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("speed_mps = 250.0", "speed_mps = 9000.0", "trajectory.speed_mps"),
        ("speed_mps = 250.0", "speeds_mps = 250.0", "trajectory"),
        ("speed_mps = 250.0", 'speed_mps = "fast"', "trajectory.speed_mps"),
        ("speed_mps = 250.0", "speed_mps = { value = 250.0 }", "trajectory.speed_mps"),
        ("speed_mps = 250.0", 'speed_mps = { value = 250.0, provenance = "x" }', ""),
        ("[windows]", "[window]", ""),
        ("[windows]", "[truth.imu]\nbiases = 'fixed'\n[windows]", "truth.imu"),
        ("[windows]", SENSOR, ""),
        ("[windows]", f"[truth.sensor.stern]\ndropout_share = 0.1\n{SENSOR}", ""),
        ("[windows]", SENSOR.replace("gnss", "gps"), "sensor.stern"),
        ("[windows]", SENSOR.replace("2.0", "0.0"), "sensor.stern"),
    ],
)
def test_the_schema_finds_what_loading_refuses(old, new, where, tmp_path):
    """And at the place where it is; what loads is accepted."""
    text = SMALL.replace(old, new, 1)
    found = {".".join(map(str, e.path)) for e in VALIDATOR.iter_errors(tomllib.loads(text))}
    (tmp_path / "small.toml").write_text(text)
    done = invoke(["validate", "small.toml"], tmp_path)
    assert (done.returncode == 0) == (found == set())
    assert found <= {where}


def test_without_an_argument_all_tables_are_listed(tmp_path):
    told = invoke(["keys"], tmp_path)
    assert told.returncode == 0
    for table in tables().values():
        assert f"\n{table.heading}\n" in f"\n{told.stdout}"


def test_a_table_tells_its_keys(tmp_path):
    """Unit, type, default and limits of each."""
    told = invoke(["keys", "[imu]"], tmp_path).stdout
    assert (
        "period_s\n    s, number; must be given; allowed: 0.0001 to 10, usual: 0.001 to 1" in told
    )
    assert '    "drawn", "fixed"; default: "drawn"\n' in told
    other = invoke(["keys", "truth.gradiometer"], tmp_path).stdout
    assert "default: as in [gradiometer]; allowed: 1e-9 to 1e6" in other
    assert "Subtables: [truth.gradiometer.rotating]." in other


@pytest.mark.parametrize(
    ("name", "headings"),
    [
        ("imu.period_s", ["imu.period_s"]),
        ("trajectory.segment[2].bank_deg", ["trajectory.segment.bank_deg"]),
        ("truth.sensor.stern.outlier_m", []),
        ("sensor.stern.noise_mps", ["velocity_log.noise_mps"]),
        ("sensor.gnss.period_s", ["gnss.period_s"]),
        ("truth.sensor.gnss.outlier_m", ["truth.gnss.outlier_m"]),
        ("required_m", ["windows.required_m"]),
        ("dropout_share", [f"truth.{s}.dropout_share" for s in ("gradiometer", "gnss")]),
    ],
)
def test_a_key_is_told_wherever_it_stands(name, headings, tmp_path):
    told = invoke(["keys", name], tmp_path)
    assert (told.returncode == 0) == bool(headings)
    for heading in headings:
        assert f"\n{heading}\n" in f"\n{told.stdout}"


def test_a_sensor_that_is_called_by_its_kind_has_the_keys_of_that_kind_alone(tmp_path):
    assert "barometer.period_s" in invoke(["keys", "sensor.stern.period_s"], tmp_path).stdout
    assert "barometer.period_s" not in invoke(["keys", "sensor.gnss.period_s"], tmp_path).stdout
    table = invoke(["keys", "truth.sensor.gnss"], tmp_path).stdout
    assert table == invoke(["keys", "truth.gnss"], tmp_path).stdout != ""


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("imu.periods", "'imu.period_s'"),
        ("gradiometr", "'gradiometer'"),
        ("gyro_bias", "'gyro_bias_"),
        ("qqqq", "'ggbench keys' lists the tables"),
    ],
)
def test_an_unknown_key_ends_in_a_sentence(name, near, tmp_path):
    """With what is like it, and exit code 2."""
    told = invoke(["keys", name], tmp_path)
    assert told.returncode == 2
    assert told.stdout == ""
    assert told.stderr.startswith(f"ggbench: a scenario file has no table and no key '{name}'")
    assert near in told.stderr
    assert ("did you mean" in told.stderr) == (name != "qqqq")


@pytest.mark.parametrize("width", [60, 80, 120])
def test_lines_fit_the_terminal(width, monkeypatch):
    """No line is longer than the terminal is wide, and no name is cut."""
    monkeypatch.setattr("ggbench.cli.keys.console.width", width)
    for name in tables():
        told = CliRunner().invoke(main, ["keys", name]).output
        assert max(map(len, told.splitlines())) <= width
        for key in tables()[name].all_keys():
            assert f"\n{key.name}\n" in told
