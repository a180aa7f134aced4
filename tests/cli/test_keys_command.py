"""``ggbench keys`` and the documentation tell every key as the specification has it."""

from __future__ import annotations

import importlib.util
import re
import tomllib
from importlib import resources
from pathlib import Path

import pytest
from click.testing import CliRunner
from command import invoke

from ggbench.cli import key_tables
from ggbench.cli.key_tables import tables
from ggbench.cli.main import main
from ggbench.spec.oddities import limits_of
from ggbench.spec.scenario import load, shipped
from ggbench.spec.tables import Section

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "docs" / "scripts" / "key_tables.py"
DIMENSIONLESS = {
    "c_nb", "density_factor", "dropout_share", "noise_freedom", "outlier_share", "published",
    "values", "whitening_regularization",
}  # fmt: skip
"""Numbers without a unit, or with the unit of something else."""


def written_keys(table: dict, name: str = "") -> set[tuple[str, str]]:
    """The tables and keys that a scenario file writes, by the names that keys are told under."""
    found = set()
    for key, value in table.items():
        path = f"{name}.{key}" if name else key
        if isinstance(value, dict) and set(value) != {"value", "provenance"}:
            found |= written_keys(value, path)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for item in value:
                found |= written_keys(item, path)
        else:
            found.add((name or key_tables.TOP, key))
    return found


def test_every_key_has_a_meaning_and_every_meaning_a_key():
    """A key that is new cannot be left without words, nor words of one that is gone."""
    keys = {(t.name, key.name) for t in tables().values() for key in t.all_keys()}
    assert not [(t.name, k.name) for t in tables().values() for k in t.all_keys() if not k.meaning]
    told = {re.sub(r"^(truth|model)\.", "", table): set() for table, _ in keys}
    for table, key in keys:
        told[re.sub(r"^(truth|model)\.", "", table)].add(key)
    told["recorded"] = {key.name for t in tables().values() for key in t.recorded}
    told["further"] = {"kind"}
    text = resources.files("ggbench.cli").joinpath("key_meanings.toml").read_text(encoding="utf-8")

    def surplus(texts: dict, name: str = "") -> list[str]:
        found = []
        for key, value in texts.items():
            path = f"{name}.{key}" if name else key
            if isinstance(value, dict) and "meaning" not in value:
                found += surplus(value, path)
            elif key not in told.get(name, ()):
                found.append(path)
        return found

    texts = tomllib.loads(text)
    assert set(texts.pop("about")) <= set(tables())
    assert surplus(texts) == []


def models(base: type[Section] = Section) -> set[type[Section]]:
    """Every model of the specification."""
    return {base}.union(*map(models, base.__subclasses__()))


def test_the_specification_is_told_whole():
    """Every number of every model stands in some table with its limits, and every other key."""
    assert len(models()) > 30
    told = {(key.name, key.allowed) for table in tables().values() for key in table.all_keys()}
    names = {name for name, _ in told} | {part for name in tables() for part in name.split(".")}
    for model in models():
        for name, field in model.model_fields.items():
            assert name in names, f"{model.__name__}.{name}"
            if (limits := limits_of(field)) is not None:
                highest = {a.rpartition(" ")[2] for n, a in told if n == name and a}
                assert limits.highest in map(float, highest), f"{model.__name__}.{name}"


@pytest.mark.parametrize("name", shipped())
def test_every_key_of_a_shipped_scenario_is_told(name):
    """What the library's own files write, changes of cases and studies included, has its words."""
    written = written_keys(tomllib.loads(load(name).source))
    for table, key in written:
        if table.startswith("campaign.") or table == "sweep.axis.changes":
            continue  # labels of estimators; changes are of other tables
        inner = re.sub(r"^(case|assumption|sweep\.axis\.changes)\.(?!reference$)", "", table)
        inner = re.sub(r"^assumption\.reference$", "case.reference", inner)
        inner = key_tables.named(inner)
        if table in ("case", "assumption") and key not in ("name", "title"):
            continue
        assert key_tables.find(f"{inner}.{key}"), f"{inner}.{key}"


def test_every_number_has_its_unit():
    """The unit follows from the key's name, which ends with it."""
    for table in tables().values():
        for key in table.all_keys():
            if key.kind.endswith(("number", "numbers")) and key.kind != "whole number":
                assert bool(key.unit) != (key.name in DIMENSIONLESS), key.name
    assert key_tables.unit_of("gyro_noise_deg_per_sqrt_h") == "°/√h"
    assert key_tables.unit_of("acceleration_mps2") == "m/s²"
    assert key_tables.unit_of("biases") == ""


def test_the_pages_tables_are_the_specifications():
    """docs/scenario_files.md holds what ``make keys`` writes, and every table but those alike."""
    spec = importlib.util.spec_from_file_location("docs_key_tables", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    text = script.PAGE.read_text(encoding="utf-8")
    assert script.filled_in(text) == text, "run: make keys"
    shown = set(re.findall(r"<!-- keys: (\S+) -->", text))
    alike = {"truth.field.error", "model.field.error", "assumption"}
    assert shown == set(tables()) - alike


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
    assert "Tables within it: [truth.gradiometer.rotating]." in other


@pytest.mark.parametrize(
    ("name", "headings"),
    [
        ("imu.period_s", ["imu.period_s"]),
        ("trajectory.segment[2].bank_deg", ["trajectory.segment.bank_deg"]),
        ("truth.further.stern.outlier_m", []),
        ("further.stern.noise_mps", ["velocity_log.noise_mps"]),
        ("lock_m", ["windows.lock_m"]),
        ("dropout_share", [f"truth.{s}.dropout_share" for s in ("gradiometer", "gnss")]),
    ],
)
def test_a_key_is_told_wherever_it_stands(name, headings, tmp_path):
    told = invoke(["keys", name], tmp_path)
    assert (told.returncode == 0) == bool(headings)
    for heading in headings:
        assert f"\n{heading}\n" in f"\n{told.stdout}"


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
