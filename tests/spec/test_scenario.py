"""Scenario files: the shipped one is complete, and every mistake in one has its sentence."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from problems import CASES, SMALL

from ggbench.errors import GGBenchError
from ggbench.simulation.error_free_flight import prepare
from ggbench.spec import scenario
from ggbench.spec.flight import load as load_flight
from ggbench.spec.scenario import ScenarioError
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


def small(tmp_path: Path, old: str = "", new: str = "") -> str:
    """The path of a file with the small scenario, one text in it replaced."""
    assert old in SMALL
    path = tmp_path / "small.toml"
    path.write_text(SMALL.replace(old, new, 1) if old else SMALL)
    return str(path)


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


def load_and_fly(path: str) -> scenario.Scenario:
    """What `ggbench validate` does with a file."""
    loaded = scenario.load(path)
    for case in loaded.cases:
        prepare(case)
    return loaded


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


NOISE = "noise_eotvos = 0.01"
CASE = '[[case]]\nname = "noisy"'
EGM = 'source = "egm2008_qinling"\nlowest_m = 9000.0\nhighest_m = 11000.0\n'
BAD = {
    "unknown key": (
        NOISE, NOISE + "\nnoise_eotovs = 1.0",
        r"case 'base'.*unknown key 'gradiometer.noise_eotovs' \(did you mean 'noise_eotvos'\?\)",
    ),
    "unknown table": (
        "[windows]", "[window]\nlast_s = 1.0\n[windows]",
        r"unknown key 'window' \(did you mean 'windows'\?\); known: name, title, trajectory",
    ),
    "unknown campaign key": (
        "[campaign]", "[campaign]\nrun = 3",
        r"campaign: unknown key 'run' \(did you mean 'runs'\?\)",
    ),
    "unit in a value": (
        NOISE, 'noise_eotvos = "0.01 E"',
        r"gradiometer.noise_eotvos is '0.01 E' and must be a plain number in the unit",
    ),
    "unit in a value with provenance": (
        NOISE, 'noise_eotvos = { value = "0.01 E", provenance = "paper" }',
        r"gradiometer.noise_eotvos is '0.01 E' and must be a plain number in the unit",
    ),
    "bool for a number": (
        NOISE, "noise_eotvos = true",
        r"gradiometer.noise_eotvos is True and must be a plain number",
    ),
    "list for a number": (
        NOISE, "noise_eotvos = [0.01]",
        r"gradiometer.noise_eotvos is \[0.01\] and must be a plain number",
    ),
    "number for a table": (CASE, CASE + "\nimu = 3", r"case 'noisy': imu is 3 and must be"),
    "NaN": (NOISE, "noise_eotvos = nan", r"gradiometer.noise_eotvos is not a number"),
    "infinity": (NOISE, "noise_eotvos = inf", r"gradiometer.noise_eotvos is inf and must lie"),
    "NaN elsewhere": (
        "heading_deg = 90.0", "heading_deg = nan", r"trajectory.heading_deg is not a number",
    ),
    "negative noise": (
        NOISE, "noise_eotvos = -0.01",
        r"gradiometer.noise_eotvos is -0.01 and must lie between 1e-9 and 1e6",
    ),
    "no noise at all": (NOISE, "noise_eotvos = 0.0", r"noise_eotvos is 0.0 and must lie between"),
    "negative gyro noise": (
        "gyro_noise_deg_per_sqrt_h = 0.005", "gyro_noise_deg_per_sqrt_h = -1.0",
        r"imu.gyro_noise_deg_per_sqrt_h is -1.0 and must be 0 or lie between 1e-9 and 3600",
    ),
    "both kinds of noise": (
        NOISE, NOISE + "\nnoise_density_eotvos_per_sqrt_hz = 0.01",
        r"gradiometer: give exactly one of noise_eotvos .* noise_density_eotvos_per_sqrt_hz",
    ),
    "neither kind of noise": (NOISE, "", r"gradiometer: give exactly one of noise_eotvos"),
    "cut-off at Nyquist": (
        NOISE, NOISE + '\nfilter = "butterworth"\nfilter_cutoff_hz = 0.5',
        r"filter_cutoff_hz is 0.5 Hz and must lie below the Nyquist frequency .*0.5 Hz",
    ),
    "unknown filter": (
        NOISE, NOISE + '\nfilter = "chebyshev"',
        r"gradiometer.filter is 'chebyshev' and must be 'butterworth' or 'none'",
    ),
    "period no multiple": (
        "period_s = 1.0", "period_s = 0.25",
        r"gradiometer.period_s \(0.25 s\) must be a whole multiple of imu.period_s \(0.1 s\)",
    ),
    "flight too short": ("duration_s = 20.0", "duration_s = 1.0", r"the flight lasts 1 s"),
    "window beyond the flight": (
        "settled_from_s = 10.0", "settled_from_s = 21.0",
        r"windows.settled_from_s is 21 s and must not lie beyond the last reading, at 20 s",
    ),
    "latitude beyond the pole": (
        "latitude_deg = 33.5", "latitude_deg = 133.5", r"trajectory.latitude_deg is 133.5 and must",
    ),
    "speed of a meteor": ("speed_mps = 250.0", "speed_mps = 1e300", r"speed_mps"),
    "unknown map source": (
        'source = "normal"', 'source = "egm2088"', r"(?i)source 'egm2088'.*egm2008_qinling",
    ),
    "map beside the flight": (
        'source = "normal"',
        EGM + "south_deg = 33.3\nnorth_deg = 33.7\nwest_deg = 109.0\neast_deg = 109.4",
        r"position 33.50000° N, 108.0.* is outside the gradient map, which covers 33.300° to",
    ),
    "map outside its source": (
        'source = "normal"',
        EGM + "south_deg = 0.0\nnorth_deg = 1.0\nwest_deg = 108.0\neast_deg = 109.0",
        r"south_deg.* 0.0 .*28.5 to 38.5",
    ),
    "duplicate case": (CASE, '[[case]]\nname = "base"', r"case 'base' is defined twice"),
    "case named like a path": (CASE, '[[case]]\nname = "../x"', r"name is '../x' and"),
    "case without a name": (CASE, "[[case]]", r"'name' is missing"),
    "one case as a table": (
        SMALL[SMALL.index("[[case]]") :], '[case]\nname = "x"', r"'case' must be written as \[\[",
    ),
    "no case": (SMALL[SMALL.index("[[case]]") :], "", r"has no \[\[case\]\]"),
    "missing section": ("[windows]\nsettled_from_s = 10.0\nlast_s = 5.0", "", r"'windows' is miss"),
    "missing key": ("last_s = 5.0", "", r"'windows.last_s' is missing"),
    "missing title": ('title = "A short', 'titel = "A short', r"needs a text 'title'"),
    "assumption without a title": (
        "[[case]]", '[[assumption]]\nname = "a"\n[[case]]', r"assumption 'a': needs a name and",
    ),
    "unknown key in an assumption": (
        "[[case]]", '[[assumption]]\nname = "a"\ntitle = "b"\nimu.noise = 1.0\n[[case]]',
        r"assumption 'a', case 'base': unknown key 'imu.noise'",
    ),
    "value without provenance": (
        NOISE, "noise_eotvos = { value = 0.01 }", r"gradiometer.noise_eotvos: a value with prov",
    ),
    "no estimators": ('estimators = ["ins", "ekf"]', "estimators = []", r"estimators is \[\] and"),
    "no runs": ("[campaign]", "[campaign]\nruns = 0", r"campaign: runs is 0 and must be greater"),
    "negative seed": ("[campaign]", "[campaign]\nseed = -1", r"campaign: seed is -1 and must be"),
    "invalid TOML": ("[windows]", "[windows", r"is not valid TOML: .*line 3\d"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_a_mistake_has_its_sentence(kind, tmp_path):
    """One line that names the key, what was found and what is allowed.

    It begins with the file's name wherever the file itself is wrong, and speaks no pydantic.
    """
    old, new, expected = BAD[kind]
    path = small(tmp_path, old, new)
    with pytest.raises(GGBenchError, match=expected) as caught:
        load_and_fly(path)
    message = str(caught.value)
    assert "\n" not in message
    assert not re.search(r"Input should|pydantic|Spec\b|validation error", message)
    if isinstance(caught.value, ScenarioError):
        assert message.startswith(f"{path}: ")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"\xff\xfe\x00", "is not UTF-8 text"),
        ('title = "é"'.encode("latin-1"), "is not UTF-8 text"),
        (b"", "needs a text 'title'"),
        (b"a = \x00", "is not valid TOML"),
    ],
)
def test_what_is_no_scenario_has_its_sentence(content, expected, tmp_path):
    """Binary, foreign encodings and empty files are told apart from scenarios, by name."""
    path = tmp_path / "odd.toml"
    path.write_bytes(content)
    with pytest.raises(ScenarioError, match=rf"^{re.escape(str(path))}: {expected}"):
        scenario.load(str(path))


def test_a_file_that_cannot_be_read_has_its_sentence(tmp_path):
    """A missing file, a folder and an unknown name are named, and what is shipped with them."""
    with pytest.raises(ScenarioError, match=r"nowhere.toml: cannot be read: No such file"):
        scenario.load(str(tmp_path / "nowhere.toml"))
    with pytest.raises(ScenarioError, match="cannot be read: Is a directory"):
        scenario.load(str(tmp_path))
    with pytest.raises(ScenarioError, match=r"'wang2012' \(did you mean 'wang2013'\?\)"):
        scenario.load("wang2012")


def test_a_shipped_name_is_not_hidden_by_a_folder(tmp_path, monkeypatch):
    """A folder called wang2013, as a report makes one, does not stand before the scenario."""
    (tmp_path / "wang2013").mkdir()
    monkeypatch.chdir(tmp_path)
    assert scenario.load("wang2013").name == "wang2013"


def test_notes_are_read_from_beside_the_file_and_nowhere_else(tmp_path):
    """A scenario may append notes to its report; it cannot reach into other folders for them."""
    path = tmp_path / "small.toml"
    (tmp_path / "notes.md").write_text("Note well.")
    path.write_text('notes = "notes.md"\n' + SMALL)
    assert scenario.load(str(path)).notes == "Note well."
    for name in ('"../notes.md"', '"/etc/hostname"', "3"):
        path.write_text(f"notes = {name}\n" + SMALL)
        with pytest.raises(ScenarioError, match="notes must name a file next to the scenario"):
            scenario.load(str(path))
    path.write_text('notes = "gone.md"\n' + SMALL)
    with pytest.raises(ScenarioError, match=r"small.toml: notes gone.md: cannot be read"):
        scenario.load(str(path))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x = " + "9" * 5000, "is not valid TOML: Exceeds the limit"),
        (".".join("a" * 3000) + " = 1", "nested at most 16 deep"),
        ("x = " + "[" * 40 + "]" * 40, "nested at most 16 deep"),
        ("x = " + "[" * 5000 + "]" * 5000, "is not valid TOML"),
        ("x = " + "{a=" * 3000 + "1" + "}" * 3000, "is not valid TOML"),
    ],
)
def test_toml_without_measure_is_refused(text, said, tmp_path):
    """Of a scenario and of a recorded flight; control: tables as deep as keys are read on."""
    path = tmp_path / "deep.toml"
    path.write_text(f"{text}\n{SMALL}")
    for read in (scenario.load, lambda file: load_flight(Path(file))):
        with pytest.raises(GGBenchError, match=said):
            read(str(path))
    path.write_text(".".join("a" * 15) + f" = 1\n{SMALL}")
    with pytest.raises(ScenarioError, match="unknown key 'a'"):
        scenario.load(str(path))


def test_too_many_cases_are_refused_before_they_are_read(tmp_path):
    cases = "".join(f'[[case]]\nname = "c{n}"\ntitle = "t"\n' for n in range(10_001))
    path = tmp_path / "many.toml"
    path.write_text(SMALL + cases)
    with pytest.raises(ScenarioError, match=r"has 10003 cases .*at most 10000 cases"):
        scenario.load(str(path))
