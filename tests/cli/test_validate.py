"""What ``ggbench validate`` says of a scenario: its flights, and what is absurd about them."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import invoke
from problems import SMALL
from small_cases import blank_map, rough_map
from thinning import thinned

from ggbench.campaign.campaign import CampaignError, check
from ggbench.cli.flight_limits import examined, flown_of
from ggbench.cli.flight_summary import absurdities, remarks_on_the_prior
from ggbench.display import compiling
from ggbench.display.compiling import Compiled
from ggbench.maps import recipe
from ggbench.maps.recipe import write
from ggbench.numerics.cache import CACHE_VARIABLE
from ggbench.simulation.field_source import map_recipe
from ggbench.spec import scenario

MAPPED = SMALL.replace(
    'source = "normal"',
    'source = "egm2008_qinling"\nsouth_deg = 33.0\nnorth_deg = 34.0\nwest_deg = 107.5\n'
    "east_deg = 109.1\nlowest_m = 9000.0\nhighest_m = 11000.0",
)
"""The small flight, from 33.5° N and 108.5° E, over a map that is built."""


def of(path: Path, text: str) -> scenario.Scenario:
    (path / "own.toml").write_text(text, encoding="utf-8")
    return scenario.load(path / "own.toml")


def noisy_track(path: Path, noise_m: float) -> str:
    """A track of five minutes straight to the east at 60 m/s, once a second, with a GPS's noise."""
    rng = np.random.default_rng(7)
    times = np.arange(300.0)
    east = 60.0 * times / (6.38e6 * math.cos(math.radians(33.5)))
    degrees = np.degrees(noise_m * rng.standard_normal((2, 300)) / 6.38e6)
    rows = [times, 33.5 + degrees[0], 108.0 + np.degrees(east) + degrees[1], np.full(300, 5000.0)]
    names = "time_s,latitude_deg,longitude_deg,height_m"
    np.savetxt(path, np.column_stack(rows), "%.10f", ",", header=names, comments="")
    start = SMALL.index("[trajectory]")
    table = f'[trajectory]\nfile = "{path.name}"\n\n'
    return SMALL[:start] + table + SMALL[SMALL.index("[imu]") :]


@thinned("name", scenario.shipped())
def test_no_shipped_flight_is_absurd(name):
    """The limits leave room around every scenario of the library and its assumptions.

    But for the gusts of ``turbulence``, of which nothing else is absurd.
    """
    loaded = scenario.load(name)
    flights = [*loaded.cases, *(case for study in loaded.assumptions for case in study.cases)]
    seen = {(case.trajectory, case.imu.period_s): case for case in flights}
    gusty = {case.trajectory for case in scenario.load("turbulence").cases}
    for case in seen.values():
        found = list(absurdities(flown_of(case)))
        if case.trajectory in gusty and case.name != "calm":
            found = [what for what in found if "(half a g) is severe turbulence" not in what]
        assert found == [], case.name


def test_a_noisy_track_is_warned_of(tmp_path):
    """1.2 m of noise once a second is a bank beyond 45°: said with the number and the cure."""
    (tmp_path / "own.toml").write_text(noisy_track(tmp_path / "gps.csv", 1.2))
    done = invoke(["validate", "own.toml"], tmp_path)
    assert done.returncode == 0, done.stderr
    bank = re.search(r"largest bank (\d+)°", done.stdout)[1]
    assert int(bank) > 45
    warning = next(line for line in done.stdout.splitlines() if "banks" in line and "Warn" in line)
    assert warning.startswith(f"Warning: in base, noisy, the flight banks by {bank}°")
    assert "smoothing_s" in warning and "roll_deg" in warning


def test_a_smooth_track_is_not_warned_of(tmp_path):
    (tmp_path / "own.toml").write_text(noisy_track(tmp_path / "gps.csv", 0.0))
    done = invoke(["validate", "own.toml"], tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stdout
    assert "Flight: 299 s, 18.0 km, 60.1 m/s, 5000 m high, largest bank 0°; no map" in done.stdout


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"bank": 50.0}, "banks by 50°"),
        ({"pitch": 40.0}, "pitches by 40°"),
        ({"vertical": 6.0}, "up or down"),
        ({"vehicle": "ship", "across": 1.5}, "the ship accelerates by 1.5 m/s²"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_each_limit_has_its_sentence(change, said, tmp_path):
    """Beyond it one sentence, below it none; a flight of segments is not told to be smoothed."""
    calm = flown_of(of(tmp_path, SMALL).cases[0])
    angles = {"bank", "pitch"}
    wild = {k: math.radians(v) if k in angles else v for k, v in change.items()}
    assert list(absurdities(calm)) == []
    (sentence,) = absurdities(replace(calm, **wild))
    assert said in sentence and "smooth" not in sentence
    half = {k: 0.5 * v if isinstance(v, float) else v for k, v in wild.items()}
    assert list(absurdities(replace(calm, **half))) == []


def test_numbers_of_a_flight_over_a_map(tmp_path, monkeypatch):
    """5 km to the east over a map whose border is known; nothing is built for that."""
    monkeypatch.setattr(recipe, "build", lambda wanted: pytest.fail("a map was built"))
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    first, noisy = examined(of(tmp_path, MAPPED))
    assert first.flown == noisy.flown
    assert (first.flown.duration, first.readings) == (20.0, {"gradiometer": 20})
    assert first.flown.length == pytest.approx(5000.0, rel=1e-6)
    metres = math.radians(0.5) * 6.378137e6 * math.cos(math.radians(33.5))  # 0.5° to the west
    assert first.margin.side == "west"
    assert first.margin.border == pytest.approx(metres, rel=5e-3)
    # The way to the east is 0.2 m lower in the middle than the circle of latitude would have it.
    assert first.margin.below == pytest.approx(1000.0, abs=3.0)
    assert first.margin.above == pytest.approx(1000.0, abs=3.0)


BAD = {
    "leaves a map that is built": (MAPPED, "east_deg = 109.1", "east_deg = 108.03"),
    "above a map that is built": (MAPPED, "highest_m = 11000.0", "highest_m = 9900.0"),
    "a recipe that cannot be followed": (MAPPED, "south_deg = 33.0", "south_deg = 3.0"),
    "an unknown source": (MAPPED, "egm2008_qinling", "egm2088"),
    "a filter slower than what decays": (
        SMALL,
        "noise_eotvos = 0.01",
        'noise_eotvos = 0.01\nfilter = "butterworth"\nfilter_cutoff_hz = 0.001',
    ),
    "a climb into space": (
        SMALL,
        "duration_s = 20.0",
        "duration_s = 20.0\nclimb_rate_deg_per_s = 3.0",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_run_is_refused_in_the_same_words(name, tmp_path):
    """Or accepted by both: what validate does not fly is as valid as what a campaign flies."""
    text, old, new = BAD[name]
    assert old in text
    loaded = of(tmp_path, text.replace(old, new))
    said = []
    for look in (check, examined):
        try:
            deque(look(loaded), maxlen=0)
        except CampaignError as error:
            said.append(str(error))
        else:
            said.append("")
    assert said[0] == said[1]
    if "map" in name or "recipe" in name or "source" in name:
        assert said[0]


@pytest.mark.parametrize(
    "arguments",
    [["validate", "own.toml"], ["run", "own.toml"], ["run", "own.toml", "--run", "0"]],
    ids=" ".join,
)
def test_the_first_words_come_before_anything_is_loaded(arguments, tmp_path):
    """With an empty cache a command says what comes before it loads NumPy, which takes a while."""
    (tmp_path / "own.toml").write_text(SMALL)
    code = (
        "import sys, click\n"
        "from ggbench.display import compiling\n"
        "def said(text):\n"
        "    assert 'numpy' not in sys.modules\n"
        "    sys.stdout.write(text)\n"
        "    raise SystemExit(7)\n"
        "compiling.click.echo = said\n"
        "from ggbench.cli.main import main\n"
        f"main({arguments})\n"
    )
    environment = os.environ | {CACHE_VARIABLE: str(tmp_path / "cache")}
    environment.pop("NUMBA_CACHE_DIR", None)  # which this process has set for those it starts
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, env=environment
    )
    assert done.returncode == 7, done.stderr
    assert done.stdout.startswith("First use of this version: the code is compiled")
    assert str(tmp_path / "cache") in done.stdout


def test_maps_to_be_built_are_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    field = of(tmp_path, MAPPED).cases[0].field
    compiling.tell_maps([field, field])
    said = capsys.readouterr().out
    assert said.count("Building a map of egm2008_qinling, 33° to 34° N, 107.5° to 109.1° E") == 1
    built = recipe.cached_path(map_recipe(field))
    built.parent.mkdir()
    built.touch()
    compiling.tell_maps([field])
    assert capsys.readouterr().out == ""


def test_compiled_functions_are_counted_as_they_appear(tmp_path, monkeypatch):
    """Those of other processes, too; what was there before does not count."""
    monkeypatch.setattr(compiling, "code_folder", lambda file: tmp_path / "ggbench.ins.imu-0")
    monkeypatch.setattr(compiling, "_LOOK_EVERY_S", -1.0)
    old, new = tmp_path / "ggbench.ins.imu-0", tmp_path / "ggbench.engines.filters-0"
    old.mkdir()
    (old / "one.1.nbc").touch()
    compiled = Compiled()
    assert compiled.text() == ""
    new.mkdir()
    (new / "two.1.nbc").touch()
    assert compiled.text() == "compiled 1 function, the most recent in engines.filters"
    (old / "three.1.nbc").touch()
    (old / "three.1.nbi").touch()
    assert compiled.text() == "compiled 2 functions, the most recent in ins.imu"


def uniform_track(path: Path, height_m: float, seconds_per_row: float) -> str:
    """A track to the east, 60 m from row to row, and the text of a scenario that flies it."""
    rows = np.arange(max(25.0, 25.0 / seconds_per_row))
    east = np.degrees(60.0 * rows / (6.38e6 * math.cos(math.radians(33.5))))
    columns = [seconds_per_row * rows, 33.5 + 0.0 * rows, 108.0 + east, height_m + 0.0 * rows]
    columns.append(90.0 + 0.0 * rows)
    names = "time_s,latitude_deg,longitude_deg,height_m,heading_deg"
    np.savetxt(path, np.column_stack(columns), "%.10f", ",", header=names, comments="")
    table = f'[trajectory]\nfile = "{path.name}"\n\n'
    return SMALL[: SMALL.index("[trajectory]")] + table + SMALL[SMALL.index("[imu]") :]


@pytest.mark.parametrize(
    ("height_m", "seconds_per_row", "said"),
    [
        (40_020.0, 1.0, "If the file has feet, the track is 12198 m high"),
        (3000.0, 1000.0, "If the file has milliseconds, the speed is 60.1 m/s"),
        (3000.0, 1.0 / 60.0, "If the file has minutes, the speed is 60.1 m/s"),
        (12_200.0, 1.0, ""),
        (3000.0, 0.1, ""),
    ],
    ids=["feet", "milliseconds", "minutes", "airliner", "fast"],
)
def test_a_track_in_another_unit_is_warned_of(
    height_m, seconds_per_row, said, tmp_path, monkeypatch
):
    """With the likely unit; a usual flight has no warning, nor have segments of that height."""
    monkeypatch.chdir(tmp_path)
    flown = flown_of(
        of(tmp_path, uniform_track(tmp_path / "t.csv", height_m, seconds_per_row)).cases[0]
    )
    found = [what for what in absurdities(flown) if "the track" in what]
    assert len(found) == bool(said)
    assert said in "".join(found)
    assert not any("the track" in what for what in absurdities(replace(flown, track=False)))


def test_a_run_warns_as_validate_does(tmp_path):
    (tmp_path / "own.toml").write_text(uniform_track(tmp_path / "t.csv", 40_020.0, 1.0))
    checked = invoke(["validate", "own.toml"], tmp_path)
    done = invoke(["run", "own.toml", "-n", "1", "-e", "ins", "-j", "0", "-c", "base"], tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Warning: in base, noisy, the track is 40020 m high" in checked.stdout
    assert "Warning: in base, the track is 40020 m high" in done.stdout


ALTIMETER = "\n[altimeter]\nnoise_m_per_sqrt_hz = 1.0\ntime_constant_s = 100.0\n"


@pytest.mark.parametrize(("altimeter", "warned"), [("", True), (ALTIMETER, False)])
def test_hours_without_an_altimeter_are_warned_of(altimeter, warned, tmp_path):
    """The height error grows by cosh(t / 570 s): by e^25 in four hours."""
    long = SMALL.replace("duration_s = 20.0", "duration_s = 14400.0").replace(
        "period_s = 0.1", "period_s = 1.0"
    )
    assert long.count("14400.0") == 1
    (tmp_path / "own.toml").write_text(long + altimeter)
    done = invoke(["validate", "own.toml"], tmp_path)
    assert ("grows e-fold every 570 s" in done.stdout) == warned


NARROW = MAPPED.replace("east_deg = 109.1", "east_deg = 108.06").replace(
    "lowest_m = 9000.0", "lowest_m = 9990.0"
)
"""The small flight, over a map that ends 570 m behind its end and 10 m below it."""
UNSURE = NARROW.replace("position_m = 5.0", "position_m = 500.0\nheight_m = 30.0")
"""The same from a place that is known to 500 m, and 30 m in height."""


def test_a_flight_at_the_edge_of_its_map_is_warned_of(tmp_path):
    """By the side, the margin and three deviations of the INS's error; each side once."""
    (tmp_path / "own.toml").write_text(UNSURE)
    done = invoke(["validate", "own.toml"], tmp_path)
    assert done.returncode == 0, done.stderr
    said = [line for line in done.stdout.splitlines() if line.startswith("Warning")]
    east, below = (next(line for line in said if word in line) for word in ("east", "lowest"))
    assert len(said) == 2
    metres, needed = map(int, re.search(r" is (\d+) m from .* are (\d+) m", east).groups())
    assert metres == pytest.approx(570.0, abs=20.0) and needed == pytest.approx(1500.0, abs=10.0)
    metres, needed = map(int, re.search(r" is (\d+) m above .* are (\d+) m", below).groups())
    assert metres == pytest.approx(10.0, abs=2.0) and needed == pytest.approx(90.0, abs=5.0)
    assert all(re.search(r"in base, noisy, \d+ s after .*, the flight is", line) for line in said)


@pytest.mark.parametrize(
    ("text", "sides"),
    [
        (UNSURE, {"east", "below"}),
        (NARROW, set()),
        (UNSURE + "\n[gnss]\nperiod_s = 1.0\nposition_noise_m = 3.0\n", set()),
        (UNSURE + "\n[gnss]\nperiod_s = 1.0\nvelocity_noise_mps = 0.1\n", {"east", "below"}),
        (UNSURE + "\n[barometer]\nperiod_s = 1.0\nnoise_m = 3.0\n", {"east"}),
        (UNSURE.replace("108.06", "109.1").replace("9990.0", "9000.0"), set()),
    ],
    ids=["unsure", "sure", "position", "velocity", "height", "wide map"],
)
def test_room_is_needed_only_for_an_error_that_nothing_bounds(text, sides, tmp_path):
    (found, *_) = examined(of(tmp_path, text))
    assert {each.side for each in found.narrow} == sides


def with_estimators(*texts: str) -> str:
    """The small scenario, whose campaign names these estimators."""
    return re.sub("(?m)^estimators = .*$", f"estimators = {json.dumps(texts)}", SMALL, count=1)


@pytest.mark.parametrize("named", ["side/effect.py", "exec:./side/effect"])
def test_validate_runs_no_code_that_a_scenario_names(named, tmp_path):
    """Neither of a file nor of a program, and it says so; control: --estimators loads the file."""
    (tmp_path / "side").mkdir()
    (tmp_path / "side" / "effect.py").write_text("open('ran', 'w').close()")
    (tmp_path / "side" / "effect").write_text("#!/bin/sh\ntouch ran")
    (tmp_path / "side" / "effect").chmod(0o755)
    (tmp_path / "own.toml").write_text(with_estimators("ekf", named))
    done = invoke(["validate", "own.toml"], tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"Not loaded: {named}; --estimators loads them" in done.stdout
    assert not (tmp_path / "ran").exists()
    done = invoke(["validate", "--estimators", "own.toml"], tmp_path)
    if named.endswith(".py"):
        assert (tmp_path / "ran").exists()
        assert "side/effect.py defines 0 estimators" in done.stderr
    else:
        assert (done.returncode, "Not loaded" in done.stdout) == (0, False)


def test_a_wrong_name_of_an_estimator_is_still_found(tmp_path):
    (tmp_path / "own.toml").write_text(with_estimators("ekv", "own.py"))
    done = invoke(["validate", "own.toml"], tmp_path)
    assert done.returncode == 2
    assert "there is no estimator 'ekv'" in done.stderr


@pytest.mark.parametrize(
    ("initial", "said"),
    [
        ("position_m = 5000.0", True),
        ("position_m = 5000.0\nheight_m = 20.0", False),
        ("position_m = 50.0", False),
    ],
)
def test_a_height_as_uncertain_as_the_position_is_said(initial, said, tmp_path):
    text = re.sub(r"(?m)^position_m = .*$", initial, SMALL, count=1)
    found = examined(of(tmp_path, text))
    remarks = list(remarks_on_the_prior(found))
    assert len(remarks) == said
    if said:
        assert "position_m = 5000 is also" in remarks[0] and "give height_m = 20" in remarks[0]
        assert "in base, noisy" in remarks[0]


def test_the_prior_is_compared_with_the_field_of_a_built_map(tmp_path):
    """Over a map from a file; over one that is not built nothing is evaluated."""
    own_map = rough_map(tmp_path / "map.nc")
    text = SMALL.replace('source = "normal"', f'source = "{own_map}"')
    (base, *_) = examined(of(tmp_path, text))
    assert 100.0 < base.correlation_m < 100_000.0
    done = invoke(["validate", "own.toml"], tmp_path, columns=400)
    width = base.case.initial_error.position_m / base.correlation_m
    assert f"Prior: the initial uncertainty is {width:.2g} correlation lengths" in done.stdout
    (plain, *_) = examined(of(tmp_path, SMALL))
    assert math.isnan(plain.correlation_m)


def test_margins_are_those_of_the_present_map(tmp_path):
    """A map that is built again under the same path, within a process: a notebook, say."""
    path = Path(rough_map(tmp_path / "map.nc"))
    text = SMALL.replace('source = "normal"', f'source = "{path}"')
    (before, *_) = examined(of(tmp_path, text))
    assert before.inside
    write(path, replace(blank_map(), height0=20e3))
    os.utime(path, ns=(path.stat().st_mtime_ns + 10**9,) * 2)
    with pytest.raises(CampaignError, match="is outside the gradient map"):
        list(examined(of(tmp_path, text)))
