"""``ggbench new``: files that run as they are, under any name that is one."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from command import invoke
from problems import SMALL
from problems import estimator as chosen
from small_cases import rough_map
from terrain_fields import rough_terrain
from thinning import thinned

from ggbench import maps
from ggbench.campaign import registry
from ggbench.contract.catalogue import CHECKS, flight
from ggbench.contract.demands import generator
from ggbench.maps.geoid import geoid_heights
from ggbench.spec import scenario

ROOT = Path(__file__).parents[2]


@thinned("name", ["my_filter", "x", "robust-EKF-2", "numpy", "NAME", "TITLE"], every=2)
def test_an_estimator_begins_as_one_that_keeps_the_contract(tmp_path, name):
    done = invoke(["new", "estimator", name], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"ggbench check {name}.py" in done.stdout
    file = tmp_path / f"{name}.py"
    estimator = registry.choose(str(file)).estimator
    assert estimator.name == name
    assert type(estimator).__name__.lower() == name.replace("_", "").replace("-", "").lower()
    for check in CHECKS:
        check.ask(estimator)
    ours = chosen("ekf").estimate(flight(), generator())
    theirs = estimator.estimate(flight(), generator())
    sigma = np.sqrt(np.diag(flight().prior_cov))
    np.testing.assert_allclose(theirs.mean / sigma, ours.mean / sigma, rtol=0, atol=1e-9)
    with pytest.raises(registry.EstimatorError, match="'iterations' is '0' and must be a whole"):
        registry.choose(f"{file}[iterations=0]")


def test_what_is_begun_is_as_tidy_as_the_package(tmp_path):
    """Style and format are those of this repository, without words of the template left."""
    invoke(["new", "estimator", "my-filter", "-o", "mine"], tmp_path)
    invoke(["new", "scenario", "my-filter", "-o", "mine"], tmp_path)
    for suffix in ("py", "toml"):
        text = (tmp_path / "mine" / f"my-filter.{suffix}").read_text()
        assert not {"TITLE", "NAME", "DESCRIPTION", "Template"} & set(
            text.replace(".", " ").split()
        )
        assert "My filter" in text
    ruff = [sys.executable, "-m", "ruff"]
    options = ["--config", str(ROOT / "pyproject.toml"), "--no-cache", "mine"]
    for command in (["check"], ["format", "--check"]):
        done = subprocess.run(
            [*ruff, *command, *options], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr


def test_a_scenario_begins_as_a_valid_one(tmp_path):
    done = invoke(["new", "scenario", "my-flight"], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "ggbench validate my-flight.toml" in done.stdout
    loaded = scenario.load(str(tmp_path / "my-flight.toml"))
    assert (loaded.name, loaded.title) == ("my-flight", "My flight")
    assert [case.name for case in loaded.cases] == ["as-it-is", "better", "dropouts"]
    done = invoke(["validate", "my-flight.toml"], tmp_path)
    assert done.returncode == 0
    assert "Warning" not in done.stdout


def test_a_scenario_begins_with_a_track_and_a_map_of_ones_own(tmp_path):
    """In place of those of the template, whatever the files are called; all else stays."""
    track, own_map = 'my "flight".csv', "übermap.nc"
    for name in (track, own_map):
        (tmp_path / name).touch()
    done = invoke(["new", "scenario", "mine", "--track", track, "--map", own_map], tmp_path)
    assert (done.returncode, done.stderr) == (0, "") and "Note" not in done.stdout
    invoke(["new", "scenario", "plain"], tmp_path)
    mine, plain = (tomllib.loads((tmp_path / f"{n}.toml").read_text()) for n in ("mine", "plain"))
    assert mine["trajectory"] == {"file": track, "smoothing_s": 10.0}
    assert mine["field"] == {"source": own_map}
    assert mine["description"].startswith("My own flight")
    replaced = {"trajectory", "field", "title", "description"}
    assert {k: mine[k] for k in mine.keys() - replaced} == {
        k: plain[k] for k in plain.keys() - replaced
    }
    gone = invoke(["new", "scenario", "other", "--track", "gone.csv"], tmp_path)
    assert gone.returncode == 2 and "'gone.csv' does not exist" in gone.stderr
    assert not (tmp_path / "other.toml").exists()


def test_a_flight_over_ones_own_map_lies_in_its_middle(tmp_path):
    """A third of the way up, away from every border; it is valid, and no warning is needed."""
    rough_map(tmp_path / "own.nc")
    chart = maps.read(tmp_path / "own.nc")
    done = invoke(["new", "scenario", "mine", "--map", "own.nc"], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "Look at its flights: ggbench validate mine.toml" in done.stdout
    flight = tomllib.loads((tmp_path / "mine.toml").read_text())["trajectory"]
    counts, steps = chart.tensor.shape, (chart.latitude_step, chart.longitude_step)
    middle = np.degrees(chart.latitude0 + 0.5 * (counts[0] - 1) * steps[0])
    assert flight["latitude_deg"] == pytest.approx(middle, abs=1e-4)
    top = chart.height0 + (counts[2] - 1) * chart.height_step
    assert flight["height_m"] == pytest.approx((2 * chart.height0 + top) / 3, abs=1.0)
    done = invoke(["validate", "mine.toml"], tmp_path)
    assert done.returncode == 0, done.stderr
    (tmp_path / "bad.nc").write_text("no map")
    bad = invoke(["new", "scenario", "other", "--map", "bad.nc"], tmp_path)
    assert bad.returncode == 2 and "bad.nc" in bad.stderr and "Traceback" not in bad.stderr


def test_a_flight_goes_through_ones_own_waypoints(tmp_path):
    """It runs as it is: slow enough for its turns, and with a barometer."""
    rough_map(tmp_path / "own.nc")
    places = [(33.4, 107.9), (33.45, 107.95), (33.45, 108.05), (33.4, 108.05)]
    rows = "".join(f"{latitude},{longitude}\n" for latitude, longitude in places)
    (tmp_path / "way.csv").write_text(f"latitude,longitude\n{rows}")
    words = ["new", "scenario", "mine", "--map", "own.nc", "--waypoints", "way.csv"]
    done = invoke(words, tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    written = tomllib.loads((tmp_path / "mine.toml").read_text())
    flown = written["trajectory"]
    segments = [(each["latitude_deg"], each["longitude_deg"]) for each in flown["segment"]]
    assert [(flown["latitude_deg"], flown["longitude_deg"]), *segments] == places
    assert {each["kind"] for each in flown["segment"]} == {"waypoint"}
    assert "barometer" in written
    done = invoke(["validate", "mine.toml"], tmp_path)
    assert done.returncode == 0, done.stderr
    assert "largest bank 25°" in done.stdout
    for wrong in ([], ["--map", "own.nc", "--track", "way.csv"]):
        done = invoke(["new", "scenario", "x", "--waypoints", "way.csv", *wrong], tmp_path)
        assert done.returncode == 2 and "--waypoints requires --map" in done.stderr
    (tmp_path / "bad.csv").write_text("a,b\n1,2\n")
    done = invoke(["new", "scenario", "x", "--map", "own.nc", "--waypoints", "bad.csv"], tmp_path)
    assert done.returncode == 2 and "bad.csv line 1 names no column latitude_deg" in done.stderr


@pytest.mark.parametrize(
    ("vehicle", "speed", "grade", "noise"),
    [
        ("helicopter", 50.0, "tactical", 1.0),
        ("drone", 20.0, "tactical", 5.0),
        ("ship", 8.0, "navigation", 1.0),
    ],
)
def test_a_vehicle_brings_its_speed_and_its_sensors(vehicle, speed, grade, noise, tmp_path):
    """At most its own speed through waypoints; a ship turns without bank; the file is valid."""
    rough_map(tmp_path / "own.nc")
    (tmp_path / "way.csv").write_text("latitude,longitude\n33.4,107.9\n33.45,107.95\n33.45,108\n")
    words = ["new", "scenario", "mine", "--map", "own.nc", "--waypoints", "way.csv"]
    done = invoke([*words, "--vehicle", vehicle], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    written = tomllib.loads((tmp_path / "mine.toml").read_text())
    assert written["trajectory"]["speed_mps"] == speed
    assert written["trajectory"].get("vehicle") == ("ship" if vehicle == "ship" else None)
    assert written["imu"] == {"period_s": 0.05, "grade": grade}
    assert written["gradiometer"]["noise_eotvos"] == noise
    assert written["case"][0]["title"] == f"{noise:g} E at 1 Hz"
    assert written["case"][1]["gradiometer"]["noise_eotvos"] == pytest.approx(0.1 * noise)
    assert scenario.load(tmp_path / "mine.toml").cases[0].trajectory.duration_s > 0.0


def test_a_speed_is_flown_or_refused(tmp_path):
    rough_map(tmp_path / "own.nc")
    words = ["new", "scenario", "mine", "--map", "own.nc"]
    done = invoke([*words, "--speed", "31"], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert tomllib.loads((tmp_path / "mine.toml").read_text())["trajectory"]["speed_mps"] == 31.0
    for more, said in (
        (["--speed", "900"], "900 m/s is too fast"),
        (["--speed", "30", "--track", "own.nc"], "--speed requires --map and excludes --track"),
    ):
        done = invoke([*words[:2], "other", *words[3:], *more], tmp_path)
        assert done.returncode == 2 and said in done.stderr
    for option in (["--vehicle", "drone"], ["--speed", "30"]):
        done = invoke(["new", "scenario", "other", *option], tmp_path)
        assert done.returncode == 2 and f"{option[0]} requires --map" in done.stderr


def test_a_track_of_ones_own_has_a_height_above_the_ground(tmp_path):
    """Ellipsoidal heights of the track over a plain 300 m above sea level."""
    head = "ncols 60\nnrows 60\nxllcorner 107.7\nyllcorner 33.2\ncellsize 0.01\n"
    np.savetxt(tmp_path / "dem.asc", np.full((60, 60), 300.0), "%g", header=head, comments="")
    rows = [f"{t},{33.4 + 1e-4 * t},107.9,{1000 + t}" for t in range(100)]
    track = "time_s,latitude_deg,longitude_deg,height_m\n" + "\n".join(rows)
    (tmp_path / "way.csv").write_text(track)
    words = ["new", "scenario", "mine", "--track", "way.csv", "--terrain", "dem.asc"]
    geoid = float(geoid_heights(np.array([33.4]), np.array([107.9]))[0])
    assert abs(geoid) > 10.0
    done = invoke([*words, "--clearance", "100"], tmp_path, columns=300)
    assert (done.returncode, done.stderr) == (0, "")
    assert "under the track with 'ggbench map build'" in done.stdout
    low, high = round(700.0 - geoid), round(799.0 - geoid)
    assert f"The track is {low} to {high} m above the ground of dem.asc" in done.stdout
    assert "least 0 s after the start" in done.stdout
    written = tomllib.loads((tmp_path / "mine.toml").read_text())["trajectory"]
    assert written["file"] == "way.csv"
    assert "barometer" not in tomllib.loads((tmp_path / "mine.toml").read_text())
    done = invoke([*words[:2], "low", *words[3:], "--clearance", "900"], tmp_path)
    assert done.returncode == 2 and "--clearance is 900 m" in done.stderr
    assert not (tmp_path / "low.toml").exists()


def test_a_flight_that_follows_ones_own_terrain_stays_in_ones_own_map(tmp_path):
    """Without any height of the user's; a part that lies below the map is lifted into it."""
    rough_map(tmp_path / "own.nc")
    bottom = maps.read(tmp_path / "own.nc").height0
    head = "ncols 60\nnrows 60\nxllcorner 107.7\nyllcorner 33.2\ncellsize 0.01\n"
    ground = np.where(np.arange(60) < 40, 0.0, 400.0) * np.ones((60, 1))
    np.savetxt(tmp_path / "dem.asc", ground, "%g", header=head, comments="")
    words = ["new", "scenario", "mine", "--map", "own.nc", "--terrain", "dem.asc"]
    done = invoke([*words, "--clearance", f"{bottom - 300.0:g}"], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    written = (tmp_path / "mine.toml").read_text()
    assert "height_m" not in tomllib.loads(written)["trajectory"]
    assert "barometer" in tomllib.loads(written)
    done = invoke(["validate", "mine.toml"], tmp_path)
    assert done.returncode == 0, done.stderr
    lowest = float(re.search(r"mps, ([0-9.]+) to", done.stdout.replace("m/s", "mps"))[1])
    assert bottom + 20.0 <= lowest < bottom + 25.0
    assert "Warning" not in done.stdout
    (tmp_path / "low.toml").write_text(re.sub("lowest_m = .*", "", written))
    done = invoke(["validate", "low.toml"], tmp_path)
    assert done.returncode == 2
    assert "% of the flight lies below the map: set lowest_m = " in done.stderr
    (tmp_path / "lifted.toml").write_text(
        re.sub("lowest_m = .*", re.search("lowest_m = [0-9]+", done.stderr)[0], written)
    )
    assert invoke(["validate", "lifted.toml"], tmp_path).returncode == 0
    for wrong in (["--terrain", "dem.asc"], ["--map", "own.nc", "--clearance", "5"]):
        assert invoke(["new", "scenario", "other", *wrong], tmp_path).returncode == 2


def draped_map(folder, *words, name="low.nc"):
    """Build a draped map over rough ground of 900 m relief, 17 m below the ellipsoid."""
    terrain = rough_terrain(72, 900.0)
    names = ("south_deg", "west_deg", "latitude_step_deg", "longitude_step_deg", "height_m")
    np.savez(folder / "dem.npz", **{name: getattr(terrain, name) for name in names})
    built = invoke(
        [
            *("map", "build", "-o", name),
            *shlex.split("--terrain dem.npz --drape --geoid-height -17"),
            *shlex.split("--spacing-arcsec 8 --height-spacing 100"),
            *words,
        ],
        folder,
    )
    assert built.returncode == 0, built.stderr


def test_a_flight_below_the_summits_stays_in_a_draped_map(tmp_path):
    """At its clearance above the ground, whose zero level is that of the map."""
    draped_map(tmp_path, "--clearance-to", "800")
    words = ["new", "scenario", "mine", "--map", "low.nc"]
    done = invoke([*words, "--terrain", "dem.npz", "--clearance", "200"], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    written = tomllib.loads((tmp_path / "mine.toml").read_text())
    (segment,) = written["trajectory"]["segment"]
    assert segment["geoid_height_m"] == -17.0 and "lowest_m" not in segment
    done = invoke(["validate", "mine.toml"], tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    told = " ".join(done.stdout.split())
    assert "m above its base surface" in told, told
    above = int(re.search(r"at least (\d+) m above its base surface", told)[1])
    assert 60 <= above <= 200
    lowest = float(re.search(r"m/s, ([0-9.]+) to [0-9.]+ m high", told)[1])
    assert lowest < rough_terrain(72, 900.0).height_m.max() - 17.0


@pytest.mark.long
def test_the_clearance_of_a_flight_chooses_the_draped_layers(tmp_path):
    """No layer is stated, and flights of each vehicle are inside; control: 600 m higher are not."""
    draped_map(tmp_path, "--clearance", "300")
    words = ["--map", "low.nc", "--terrain", "dem.npz"]
    for vehicle in ("helicopter", "drone"):
        stated = ["--clearance", "300", "--vehicle", vehicle]
        done = invoke(["new", "scenario", vehicle, *words, *stated], tmp_path)
        assert done.returncode == 0, done.stderr
        done = invoke(["validate", f"{vehicle}.toml"], tmp_path)
        assert done.returncode == 0, done.stderr
        assert not re.search("Warning: .* (lowest|highest) height", done.stdout), done.stdout
    start = tomllib.loads((tmp_path / "drone.toml").read_text())["trajectory"]
    north, east = start["latitude_deg"], start["longitude_deg"]
    rows = [f"{t},{north},{east + 2e-4 * t},3000" for t in range(40)]
    track = "time_s,latitude_deg,longitude_deg,height_m\n" + "\n".join(rows)
    (tmp_path / "way.csv").write_text(track)
    done = invoke(["new", "scenario", "tracked", *words, "--track", "way.csv"], tmp_path)
    assert done.returncode == 0, done.stderr
    assert "barometer" in tomllib.loads((tmp_path / "tracked.toml").read_text())
    done = invoke(["new", "scenario", "high", *words, "--clearance", "900"], tmp_path)
    assert done.returncode == 2 and "build the map with --clearance-from" in done.stderr


@pytest.mark.long
def test_a_flight_in_a_draped_map_is_planned_bounded_and_advised_on(tmp_path):
    """By the commands, and with a map error that is correlated; the map is scored."""
    draped_map(tmp_path, "--clearance-to", "800", "--clearance-from", "100")

    def output(words, code=0):
        done = invoke(words.split(), tmp_path, columns=300)
        assert done.returncode == code, done.stdout + done.stderr
        return " ".join((done.stdout + done.stderr).split())

    output("new scenario mine --map low.nc --terrain dem.npz --clearance 200")
    bound = float(re.findall(r"130 ([0-9.]+) ([0-9.]+)", output("bound mine.toml"))[0][0])
    assert 0.01 < bound < 10.0
    planned = output("plan mine.toml --headings 4")
    assert "The track of the case has a bound of" in planned
    assert "3 tracks cannot be flown" in planned and "above its base surface" in planned
    score = "map score low.nc --cell-deg 0.02 --sigma-km 0.1"
    assert "4 cells of 0.02° at 100 m above the base surface" in output(score)
    assert "at 150 m above the base surface" in output(f"{score} --height 150")
    outside = output(f"{score} --height 2000", code=2)
    assert "outside low.nc, which has 100 to 800 m above the base surface" in outside
    advice = output("advise mine.toml -n 2 -j 0 -o advice")
    assert "After landing" in advice and "Error sources that limit the accuracy" in advice
    text = (tmp_path / "mine.toml").read_text()
    wrong = "[model.field.error]\ncorrelated_noise_eotvos = 3.0\ncorrelation_km = {}\n\n[imu]"
    (tmp_path / "wrong.toml").write_text(text.replace("[imu]", wrong.format(1.5), 1))
    assert "above its base surface" in output("validate wrong.toml")
    assert "of the position" in output("bound wrong.toml")
    (tmp_path / "short.toml").write_text(text.replace("[imu]", wrong.format(0.4), 1))
    refused = output("validate short.toml", code=2)
    assert "correlation_km = 0.4, too short for the base surface, whose lowest point is" in refused


def test_a_flight_into_the_ground_or_out_of_a_draped_map_is_refused(tmp_path):
    draped_map(tmp_path, name="deep.nc")
    words = ["new", "scenario", "low", "--map", "deep.nc"]
    done = invoke([*words, "--terrain", "dem.npz", "--clearance", "5"], tmp_path)
    said = " ".join(done.stderr.split())
    assert done.returncode == 2 and "build the map with --clearance-from " in said, said
    for more, wanted in (
        ([], "give the same --terrain"),
        (["--waypoints", "way.csv"], "flights through waypoints are level"),
    ):
        (tmp_path / "way.csv").write_text("latitude,longitude\n45.02,7.02\n45.03,7.03\n")
        done = invoke([*words, *more], tmp_path)
        assert done.returncode == 2 and wanted in " ".join(done.stderr.split())
    level = SMALL.replace('source = "normal"', 'source = "deep.nc"')
    table, rest = level.index("[trajectory]"), level.index("[imu]")
    flight = (
        "[trajectory]\nlatitude_deg = 45.03\nlongitude_deg = 7.03\nheight_m = 300.0\n"
        "speed_mps = 30.0\nheading_deg = 90.0\n[[trajectory.segment]]\nduration_s = 20.0\n\n"
    )
    (tmp_path / "level.toml").write_text(level[:table] + flight + level[rest:])
    done = invoke(["validate", "level.toml"], tmp_path)
    said = " ".join(done.stderr.split())
    assert done.returncode == 2
    assert "position 45.03000° N, 7.03" in said and "above its base surface, which lies at" in said
    assert re.search(r"fly \d+ m higher, or build the map with a lower --clearance-from", said), (
        said
    )


@pytest.mark.long
def test_a_scenario_that_is_begun_runs(tmp_path):
    """Over a shipped map; aiding helps, and a better gradiometer helps more."""
    invoke(["new", "scenario", "mine"], tmp_path)
    done = invoke(["run", "mine.toml", "-n", "3", "-j", "1"], tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0/0" in done.stdout
    done = invoke(["report", "results/mine"], tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["scenario", "a/b"], "'a/b' is not allowed as a name"),
        (["scenario", ""], "'' is not allowed as a name"),
        (["estimator", "2fast"], "'2fast' is not allowed as a name"),
        (["estimator", "filter.py"], "; give the name without .py; -o DIR chooses"),
        (["scenario", "naïve"], "'na\\xefve' is not allowed as a name"),
        (["estimator", "a" * 61], "at most 60"),
        (["estimator", "none"], "None is a Python keyword or a class"),
        (["estimator", "estimator"], "Estimator is a Python keyword or a class"),
        (["estimator", "there"], "there.py exists and is not overwritten"),
        (["scenario", "x", "-o", "there.py/in"], "cannot write "),
    ],
)
def test_what_cannot_be_begun_is_said(tmp_path, arguments, said):
    (tmp_path / "there.py").write_text("mine")
    done = invoke(["new", *arguments], tmp_path)
    assert done.returncode == 2
    assert said in done.stderr and "Traceback" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["there.py"]
    assert (tmp_path / "there.py").read_text() == "mine"
