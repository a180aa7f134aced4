"""The shipped scenario file, and the cases of scenario files."""

from __future__ import annotations

import re
import tomllib

from problems import CASES, SMALL
from scenario_files import load_and_fly, small

from ggbench.spec import scenario
from ggbench.spec.toml_files import strip_provenance

PAPER_TABLE = {
    "trajectory.latitude_deg": 33.5,
    "trajectory.longitude_deg": 108.0,
    "trajectory.height_m": 10000.0,
    "trajectory.speed_mps": 250.0,
    "trajectory.heading_deg": 90.0,
    "trajectory.segment[0].duration_s": 200.0,
    "imu.period_s": 0.05,
    "imu.gyro_bias_deg_per_h": 0.015,
    "imu.gyro_noise_deg_per_sqrt_h": 0.005,
    "imu.accelerometer_bias_ug": 500.0,
    "imu.accelerometer_noise_ug_per_sqrt_hz": 100.0,
    "gradiometer.period_s": 1.0,
    "gradiometer.noise_eotvos": 0.01,
    "gradiometer.filter_order": 7,
    "gradiometer.filter_cutoff_hz": 0.2,
}


def values_of(source: str) -> dict[str, object]:
    """The value of every dotted key of a scenario's text, without provenance."""
    flat: dict[str, object] = {}

    def walk(node: object, path: str) -> None:
        if isinstance(node, dict):
            for key, item in node.items():
                walk(item, f"{path}.{key}" if path else key)
        elif isinstance(node, list) and any(isinstance(item, dict) for item in node):
            for i, item in enumerate(node):
                walk(item, f"{path}[{i}]")
        else:
            flat[path] = node

    walk(strip_provenance(tomllib.loads(source), "", {}, ""), "")
    return flat


def test_the_shipped_scenario_is_the_papers():
    """Its values are those of the paper's table, and its cases come in the paper's order."""
    loaded = scenario.load("wang2013")
    assert tuple(case.name for case in loaded.cases[:5]) == CASES
    assert [case.name for case in loaded.cases[5:]] == ["0.01E-1Hz-level", "0.001E-1Hz-level"]
    values = values_of(loaded.source)
    assert {key: values[key] for key in PAPER_TABLE} == PAPER_TABLE
    published = [case.reference for case in loaded.cases[:3]]
    assert [(r.position_mrse_m, r.velocity_mrse_mps) for r in published] == [
        (3.5136, 0.2147),
        (0.8877, 0.1211),
        (6.0755, 0.2848),
    ]
    assert not any(case.reference for case in loaded.cases[3:])


def test_every_value_of_the_shipped_scenario_says_where_it_comes_from():
    """No value of the base tables without a provenance, 'paper: ...' or 'assumed: ...'."""
    loaded = scenario.load("wang2013")
    physical = ("trajectory", "imu", "initial_error", "gradiometer", "field", "windows")
    keys = [k for k in values_of(loaded.source) if k.split(".")[0] in physical]
    assert len(keys) > 30
    for key in keys:
        bare = re.sub(r"\[\d+\]", "", key)
        note = loaded.provenance.get(key, loaded.provenance.get(bare, ""))
        assert re.match(r"(paper|assumed): \S", note), f"{key}: provenance {note!r}"
    for key, note in loaded.provenance.items():
        assert re.match(r"(paper|assumed): \S", note), f"{key}: provenance {note!r}"


def test_cases_are_the_base_with_their_changes():
    """A case differs from the base in what it names, and an assumption from every paper case."""
    loaded = scenario.load("wang2013")
    base = loaded.case("0.01E-1Hz").model_dump(exclude={"name", "title", "reference"})
    sharp = loaded.case("0.001E-1Hz").model_dump(exclude={"name", "title", "reference"})
    assert sharp["gradiometer"].pop("noise_eotvos") == 0.001
    assert base["gradiometer"].pop("noise_eotvos") == 0.01
    assert sharp == base
    assert loaded.case("0.01E-0.2Hz").gradiometer.period_s == 5.0
    assert loaded.case("0.01E-0.2Hz").gradiometer.filter == "none"
    study = {s.name: s for s in loaded.assumptions}["position-20m"]
    assert [case.name for case in study.cases] == list(CASES[:3])
    assert {case.initial_error.position_m for case in study.cases} == {20.0}
    assert study.cases[1].gradiometer.noise_eotvos == 0.001


def test_provenance_changes_no_result(tmp_path):
    """A value means the same with and without provenance; a change of a value changes the hash."""
    plain = load_and_fly(small(tmp_path))
    noted = scenario.load(
        small(tmp_path, "speed_mps = 250.0", 'speed_mps = { value = 250.0, provenance = "paper" }')
    )
    assert noted.cases == plain.cases
    assert noted.content_hash == plain.content_hash
    assert noted.provenance["trajectory.speed_mps"] == "paper"
    other = scenario.load(small(tmp_path, "speed_mps = 250.0", "speed_mps = 250.5"))
    assert other.content_hash != plain.content_hash
    assert other.cases[0].content_hash != plain.cases[0].content_hash
    again = scenario.from_text(plain.source, "small", "")
    assert (again.cases, again.content_hash) == (plain.cases, plain.content_hash)


def test_a_shipped_name_is_not_hidden_by_a_folder(tmp_path, monkeypatch):
    """A folder called wang2013, as a report makes one, does not stand before the scenario."""
    (tmp_path / "wang2013").mkdir()
    monkeypatch.chdir(tmp_path)
    assert scenario.load("wang2013").name == "wang2013"


def test_notes_are_read_from_beside_the_file(tmp_path):
    """A scenario may append notes to its report."""
    path = tmp_path / "small.toml"
    (tmp_path / "notes.md").write_text("Note well.")
    path.write_text('notes = "notes.md"\n' + SMALL)
    assert scenario.load(str(path)).notes == "Note well."
