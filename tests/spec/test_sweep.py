"""Sweeps: a grid becomes cases, mistakes have their sentence, and the report answers rightly."""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from problems import SMALL

from ggbench.cli.main import main
from ggbench.simulation import true_motion
from ggbench.simulation.error_free_flight import prepare
from ggbench.spec import scenario, sweep
from ggbench.spec.axes import AxisSpec
from ggbench.spec.scenario import Scenario, ScenarioError
from ggbench.spec.sweep import largest_within

BASE = SMALL[: SMALL.index("[[case]]")]
SWEEP = """
[sweep]
targets_m = [8.0]

[[sweep.axis]]
name = "noise"
label = "noise RMS per reading"
unit = "E"
scale = "log"
values = [1e-4, 0.01]
key = "gradiometer.noise_eotvos"

[[sweep.axis]]
name = "rate"
label = "update rate"
unit = "Hz"
values = { value = [0.5, 1], provenance = "assumed: any" }
changes = [{ gradiometer.period_s = 2.0 }, { gradiometer.period_s = 1.0 }]
"""
ALTITUDE = """
[[sweep.axis]]
name = "altitude"
label = "height above the ellipsoid"
unit = "km"
values = [5.0, 10.0]
changes = [{ trajectory.height_m = 5000.0 }, { trajectory.height_m = 10000.0 }]
"""


def load(tmp_path: Path, text: str) -> Scenario:
    path = tmp_path / "grid.toml"
    path.write_text(text)
    return scenario.load(str(path))


def test_a_grid_becomes_ordinary_cases(tmp_path):
    """Every point is the base with the changes of its coordinates, and says where it lies."""
    loaded = load(tmp_path, BASE + SWEEP)
    assert [case.name for case in loaded.cases] == [
        "noise-0.0001_rate-0.5",
        "noise-0.0001_rate-1",
        "noise-0.01_rate-0.5",
        "noise-0.01_rate-1",
    ]
    assert loaded.cases[2].title == "noise 0.01 E, rate 0.5 Hz"
    for case in loaded.cases:
        noise, rate = loaded.sweep.points[case.name].indices
        assert case.gradiometer.noise_eotvos == loaded.sweep.axes[0].values[noise]
        assert case.gradiometer.period_s == 1.0 / loaded.sweep.axes[1].values[rate]
    plain = load(tmp_path, SMALL).cases[0]
    assert loaded.case("noise-0.01_rate-1").content_hash == plain.content_hash
    assert loaded.provenance["sweep.axis[1].values"] == "assumed: any"
    again = scenario.from_text(loaded.source, "grid", "")
    assert (again.cases, again.sweep) == (loaded.cases, loaded.sweep)


def test_a_grid_is_laid_over_every_case(tmp_path):
    """With several cases each point is named after its case, and published numbers fall away."""
    changed = SMALL.replace("gradiometer.noise_eotvos = 0.1", "initial_error.position_m = 50.0")
    loaded = load(tmp_path, changed + SWEEP)
    assert len(loaded.cases) == 8
    case = loaded.case("noisy_noise-0.01_rate-1")
    assert case.title == "with ten times the noise: noise 0.01 E, rate 1 Hz"
    assert case.initial_error.position_m == 50.0
    assert loaded.sweep.points[case.name] == sweep.Point("noisy", (1, 1))
    assert not any(case.reference for case in loaded.cases)
    one = load(tmp_path, changed[: changed.index('[[case]]\nname = "noisy"')] + SWEEP)
    assert one.cases[0].name == "noise-0.0001_rate-0.5"


def test_a_grid_flies_shipped_survey_lines():
    """They are found among the shipped data, whatever the working directory is."""
    case = scenario.load("vinton2008_biases").cases[0]
    assert Path(case.trajectory.file).is_file() and len(case.trajectory.lines) == 21


def test_a_case_needs_to_be_whole_only_on_the_grid(tmp_path):
    """A key that an axis gives may be absent from the base, or be given there in its other form."""
    noise = "noise_eotvos = 0.01"
    for instead in ("", "noise_density_eotvos_per_sqrt_hz = 0.02"):
        loaded = load(tmp_path, BASE.replace(noise, instead) + SWEEP)
        assert loaded.cases[0].gradiometer.noise_eotvos == 1e-4


@pytest.mark.parametrize(
    ("value", "text"),
    [(1e-4, "0.0001"), (3e-6, "3e-6"), (1.0, "1"), (2e7, "2e7"), (0.123456789, "0.123456789")],
)
def test_numbers_in_names_are_short_and_exact(value, text):
    """A name can be read, typed and told from its neighbour's."""
    assert sweep.number(value) == text
    assert float(text) == value


KEY = 'key = "gradiometer.noise_eotvos"'
CHANGES = "changes = [{ gradiometer.period_s = 2.0 }, { gradiometer.period_s = 1.0 }]"
BAD = {
    "unknown key": (
        KEY,
        'key = "gradiometer.noise_eotovs"',
        r"sweep at noise 0.0001 E, rate 0.5 Hz: unknown key 'gradiometer.noise_eotovs' "
        r"\(did you mean 'noise_eotvos'\?\)",
    ),
    "unknown table": (KEY, 'key = "gradiometre.noise"', r"unknown key 'gradiometre' \(did you m"),
    "key that is a table": (KEY, 'key = "imu"', r"rate 0.5 Hz: imu is 0.0001 and must be a table"),
    "axes of a table and its key": (
        KEY,
        'key = "gradiometer"',
        r"axes 'noise' and 'rate' both change gradiometer",
    ),
    "key that is no value": (KEY, 'key = "name"', r"axis 'noise' changes 'name', which does not"),
    "neither key nor changes": (KEY, "", r"axis 'noise' needs exactly one of 'key' and 'changes'"),
    "key and changes": (CHANGES, CHANGES + '\nkey = "imu.period_s"', r"axis 'rate' needs exactly"),
    "too few changes": (
        CHANGES,
        "changes = [{ gradiometer.period_s = 2.0 }]",
        r"axis 'rate' has 2 values and 1 changes; give one change for each value",
    ),
    "value that is impossible": (
        CHANGES,
        CHANGES.replace("2.0", "0.25"),
        r"sweep at noise 0.0001 E, rate 0.5 Hz: gradiometer.period_s \(0.25 s\) must be a whole mu",
    ),
    "axes of one name": ('"rate"', '"noise"', r"sweep: axis 'noise' is defined twice"),
    "axes of one key": (
        CHANGES,
        KEY,
        r"axes 'noise' and 'rate' both change gradiometer.noise_eotvos",
    ),
    "values that fall": ("[1e-4, 0.01]", "[0.01, 1e-4]", r"axis 'noise' must increase strictly"),
    "values that repeat": ("[1e-4, 0.01]", "[0.01, 0.01]", r"axis 'noise' must increase strictly"),
    "one value": ("[1e-4, 0.01]", "[1e-4]", r"axis\[0\].values is \[0.0001\] and"),
    "text for a value": ("[1e-4, 0.01]", '["a", 0.01]', r"values\[0\] is 'a' and must be a plain"),
    "zero on a logarithmic axis": ("[1e-4, 0.01]", "[0.0, 0.01]", r"must be positive on a logar"),
    "unknown scale": ('"log"', '"cubic"', r"axis\[0\].scale is 'cubic' and must be 'linear' or"),
    "unknown key of the sweep": ("targets_m", "target_m", r"sweep: unknown key 'target_m' \(did y"),
    "negative target": ("[8.0]", "[-8.0]", r"targets_m\[0\] is -8.0 and must lie between 1e-6"),
    "no axis": (SWEEP, "\n[sweep]\n", r"sweep: needs at least one \[\[sweep.axis\]\]"),
    "no table": (BASE + SWEEP, "sweep = 3\n" + BASE, r"sweep: it is 3 and must be a table"),
    "too many points": (
        SWEEP,
        SWEEP.replace("[1e-4, 0.01]", str([0.01 + 1e-6 * i for i in range(6000)])),
        r"sweep: has 12000 grid points; at most 10000 are allowed",
    ),
    "a name too long": (
        SWEEP,
        SWEEP.replace('"noise"', '"noiseOfEachReading"')
        .replace('"rate"', '"updateRate"')
        .replace("[0.5, 1]", "[0.51234567890123, 1]")
        .replace("1e-4", "0.0012345678901234"),
        r"name is 'noiseOf\S+' and must have at most 60 characters",
    ),
    "an assumption beside it": (
        "[sweep]",
        '[[assumption]]\nname = "a"\ntitle = "b"\n[sweep]',
        r"\[\[assumption\]\] cannot be given with \[sweep\]",
    ),
    "a case without a name": ("[sweep]", '[[case]]\ntitle = "b"\n[sweep]', r"case\[0\]: needs"),
    "a limit of no time": ("[campaign]", "[campaign]\ntime_limit_s = 0.0", r"time_limit_s is 0.0"),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_mistake_has_its_sentence(kind, tmp_path):
    """One line with the file, the key or the grid point, what was found and what is allowed."""
    old, new, expected = BAD[kind]
    text = BASE + SWEEP
    assert old in text
    text = text.replace(old, new, 1)
    with pytest.raises(ScenarioError, match=expected) as caught:
        load(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'grid.toml'}: ")
    assert "\n" not in message
    assert not re.search(r"Input should|String should|pydantic|Spec\b|validation error", message)


def test_a_time_limit_can_be_given(tmp_path):
    """Ten minutes for one run of one estimator, unless the file says otherwise."""
    assert load(tmp_path, SMALL).campaign.time_limit_s == 600.0
    limited = SMALL.replace("[campaign]", "[campaign]\ntime_limit_s = 5")
    assert load(tmp_path, limited).campaign.time_limit_s == 5.0


def test_what_cases_share_is_made_once_and_changes_nothing(tmp_path):
    """A flight is the same whether its truth was made for it or for a neighbour before."""
    cases = load(tmp_path, BASE + SWEEP + ALTITUDE).cases
    together = [prepare(case) for case in cases]
    assert together[0].trajectory is together[2].trajectory  # they differ in the rate only
    assert together[0].trajectory is not together[1].trajectory  # and these in the altitude
    for case, shared in zip(cases, together, strict=True):
        true_motion.error_free_motion.cache_clear()
        alone = prepare(case)
        for name in ("delta_angles", "delta_velocities", "epochs", "noise_free"):
            assert np.array_equal(getattr(alone, name), getattr(shared, name))
        for name, value in vars(alone.trajectory).items():
            assert np.array_equal(value, vars(shared.trajectory)[name])


DECADES = AxisSpec(
    name="noise", label="noise", unit="E", scale="log", values=(0.01, 0.1, 1.0), key="k"
)
STEPS = AxisSpec(name="age", label="age", unit="h", scale="linear", values=(0.0, 1.0, 3.0), key="k")


@pytest.mark.parametrize(
    ("axis", "errors", "target", "expected"),
    [
        (DECADES, [1.0, 10.0, 100.0], 3.0, 0.03),  # error in proportion to noise
        (DECADES, [1.0, 100.0, 1e4], 100.0, 0.1),  # to its square; a grid point itself
        (DECADES, [1.0, 10.0, 100.0], 100.0, math.inf),
        (DECADES, [1.0, 10.0, 100.0], 0.5, -math.inf),
        (DECADES, [1.0, 50.0, 2.0], 5.0, 0.01 * 10 ** (math.log(5.0) / math.log(50.0))),
        (DECADES, [1.0, math.nan, 2.0], 5.0, 0.01),  # nothing is claimed beyond a gap
        (STEPS, [1.0, 2.0, 8.0], 4.0, 2.0),  # exponential in a linear coordinate
    ],
)
def test_a_requirement_lies_between_grid_points_as_a_power_law_has_it(
    axis, errors, target, expected
):
    """The largest value within a target, where the answer is known."""
    assert largest_within(axis, np.array(errors), target) == pytest.approx(expected)


def test_a_requirement_is_unknown_where_nothing_has_run():
    """A column without a first error is neither reached nor missed."""
    assert math.isnan(largest_within(DECADES, np.array([math.nan, 1.0, 2.0]), 5.0))


@pytest.mark.long
def test_a_sweep_from_file_to_report(tmp_path, monkeypatch):
    """Run and report, as a user does: every point has its row, every figure its file."""
    monkeypatch.chdir(tmp_path)
    load(tmp_path, BASE + SWEEP)
    for command in (["run", "grid.toml", "-n", "2", "-j", "0", "-o", "out"], ["report", "out"]):
        result = CliRunner().invoke(main, command)
        assert result.exit_code == 0, result.output
    (path,) = tmp_path.glob("**/grid.md")
    text = path.read_text(encoding="utf-8")
    assert re.search(r"for (any |no )?noise", text)
    assert "|RMS error [m]|case|bound|EKF|" in text
    assert "ggbench run grid.toml -n 2" in text
    for target in re.findall(r"\]\(([^)]+\.png)\)", text):
        assert (path.parent / target).exists()
    metrics = pd.read_csv(path.parent / "grid" / "data" / "metrics.csv")
    assert set(metrics["case"]) == set(scenario.load("grid.toml").sweep.points)


def test_the_shipped_sweep_covers_what_an_engineer_asks():
    """The paper's flight, 1e-4 to 10 E in half decades, 0.1 to 10 Hz: 77 points on each mount."""
    loaded = scenario.load("noise_rate_sweep")
    assert len(loaded.cases) == len(loaded.sweep.points) == 2 * 77
    mounts = Counter(case.gradiometer.instrument for case in loaded.cases)
    assert mounts == {"platform": 77, "local-level": 77}
    assert loaded.sweep.targets_m == (1.0, 10.0, 100.0)
    noise, rate = (axis.values for axis in loaded.sweep.axes)
    assert (noise[0], noise[-1], rate[0], rate[-1]) == (1e-4, 10.0, 0.1, 10.0)
    assert max(b / a for a, b in itertools.pairwise(noise)) < 3.5
    base = scenario.load("wang2013").case("0.01E-1Hz-unfiltered").model_dump()
    for case in loaded.cases:
        i, j = loaded.sweep.points[case.name].indices
        here = case.model_dump()
        assert here["gradiometer"]["noise_eotvos"] == noise[i]
        assert here["gradiometer"]["period_s"] == pytest.approx(1.0 / rate[j])
        mount = {"inertial": "platform", "level": "local-level"}[
            loaded.sweep.points[case.name].base
        ]
        assert here["gradiometer"]["instrument"] == mount
        for table in ("trajectory", "imu", "initial_error", "field", "windows"):
            assert here[table] == base[table]
