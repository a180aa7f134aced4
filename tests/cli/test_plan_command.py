"""`ggbench plan`: tracks ranked by their bound, those that leave the map, bad input."""

from __future__ import annotations

import dataclasses
import math
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command import invoke
from matplotlib.collections import QuadMesh
from matplotlib.image import imread
from matplotlib.quiver import Quiver
from problems import SMALL
from small_cases import blank_map, rough_map, small_case

from ggbench.errors import GGBenchError
from ggbench.figures.planned import planned_tracks
from ggbench.gravity.ellipsoid import metres_along
from ggbench.gravity.field import Field
from ggbench.judging.planned import bound_of, tracks
from ggbench.maps.recipe import read, write
from ggbench.recorded.motion import angles_of
from ggbench.score.decision_page import over_map
from ggbench.simulation.true_motion import trajectory_of
from ggbench.spec import scenario
from ggbench.spec.draws import moved


def test_a_track_has_the_bound_of_its_flight():
    """Each row is the bound of the moved and turned flight; the smallest comes first."""
    case = small_case()
    found = tracks(case, [(0.0, 0.0), (3.0, -2.0)], [0.0, 90.0])
    assert found["bound_m"].is_monotonic_increasing and len(found) == 4
    assert found.loc[found["present"], ["east_km", "north_km"]].to_numpy().tolist() == [[0.0, 0.0]]
    for row in found.itertuples():
        turn = row.heading_deg - np.degrees(case.trajectory.start().heading)
        flown = moved(case.trajectory, row.east_km, row.north_km, turn)
        expected = bound_of(case.model_copy(update={"trajectory": flown}))
        assert row.bound_m == pytest.approx(expected, rel=1e-9)


def test_tracks_are_ranked_and_drawn(tmp_path):
    """A table, a file and a figure, and how many tracks allow the target.

    Two starts along a side leave the present start out: the present flight is added.
    """
    (tmp_path / "own.toml").write_text(SMALL, encoding="utf-8")
    command = [
        *shlex.split("plan own.toml --headings 4 --grid 2 --target 1e6 -o tracks.csv"),
        *shlex.split("--figure tracks.png"),
    ]
    done = invoke(command, tmp_path, columns=120)
    assert done.returncode == 0, done.stderr
    assert "the best of 17 tracks" in done.stdout
    assert "The track of the case has a bound of" in done.stdout
    assert "17 tracks of 17 have a bound of at most" in done.stdout
    assert len(pd.read_csv(tmp_path / "tracks.csv")) == 17
    assert imread(tmp_path / "tracks.png").shape[1] > 400


def test_eight_headings_of_one_start_are_eight_arrows(recwarn):
    """Whole arrows within the axes, over the map, the present flight among them; no warning."""
    angles = np.arange(0.0, 360.0, 45.0)
    table = pd.DataFrame({"east_km": 0.0, "north_km": 0.0, "heading_deg": angles})
    table = table.assign(bound_m=1.0 + angles, present=angles == 90.0, reason="")
    field = Field.from_map(blank_map())
    middle = 0.5 * (field.lower + field.upper)
    flown = middle + np.linspace(0.0, 1.0, 50)[:, np.newaxis] * [0.0, 1e-3, 0.0]
    figure = planned_tracks(table, field, flown, "as it is")
    figure.canvas.draw()
    axis = figure.axes[0]
    (arrows,) = [each for each in axis.collections if isinstance(each, Quiver)]
    ends = arrows.get_offsets() + np.column_stack([arrows.U, arrows.V])
    assert arrows.N == 8 and len(np.unique(ends.round(6), axis=0)) == 8
    reach = float(np.hypot(*(flown[-1] - flown[0])[[1, 0]] * metres_along(flown[:1])[0])) / 1e3
    assert np.hypot(*ends.T) == pytest.approx(reach)
    low, high = np.sort(axis.get_xlim()), np.sort(axis.get_ylim())
    assert (ends >= [low[0], high[0]]).all() and (ends <= [low[1], high[1]]).all()
    assert [each for each in axis.collections if isinstance(each, QuadMesh)]
    assert [text.get_text() for text in axis.get_legend().get_texts()] == ["present flight"]
    assert not recwarn.list


@pytest.mark.parametrize("turn", [360.0, -360.0])
def test_the_map_is_drawn_beside_the_flight(turn, tmp_path):
    """On either side of the date line: the picture is that of a map in the turn of the flight."""
    source = rough_map(tmp_path / "m.nc")
    one = {"east_km": 0.0, "north_km": 0.0, "heading_deg": 90.0, "bound_m": 1.0}
    table = pd.DataFrame([one | {"present": True, "reason": ""}])
    meshes = []
    for longitude in (0.0, math.radians(turn)):
        found = read(Path(source))
        write(
            tmp_path / "other.nc",
            dataclasses.replace(found, longitude0=found.longitude0 + longitude),
        )
        other = small_case({"field.source": str(tmp_path / "other.nc")})
        axis = over_map(table, other).axes[0]
        meshes += [each for each in axis.collections if isinstance(each, QuadMesh)]
        (tmp_path / "other.nc").rename(tmp_path / f"{turn}-{longitude}.nc")
    here, there = meshes
    np.testing.assert_allclose(there.get_coordinates(), here.get_coordinates(), atol=1e-6)
    np.testing.assert_allclose(there.get_array(), here.get_array(), atol=1e-5)
    assert np.ptp(here.get_array()) > 1.0 and (np.diff(here.get_coordinates()[0, :, 0]) > 0).all()


def _survey_track(path, heading_columns=False):
    """A track at 33.5° N: east for a minute, then a left turn to the north-east."""
    times = np.arange(0.0, 120.0)
    turn = np.radians(45.0) / (1.0 + np.exp(-(times - 60.0) / 5.0))
    east = np.cumsum(60.0 * np.cos(turn)) / (6.384e6 * np.cos(np.radians(33.5)))
    north = np.cumsum(60.0 * np.sin(turn)) / 6.359e6
    rows = [times, 33.5 + np.degrees(north), 108.0 + np.degrees(east), np.full(120, 3000.0)]
    names = "time_s,latitude_deg,longitude_deg,height_m"
    if heading_columns:
        rows, names = [*rows, 90.0 - np.degrees(turn)], f"{names},heading_deg"
    np.savetxt(path, np.column_stack(rows), "%.10f", ",", header=names, comments="")


def _with_track(path, **move):
    start, end = SMALL.index("[trajectory]"), SMALL.index("[imu]")
    keys = "".join(f"{key} = {value}\n" for key, value in move.items())
    text = f'{SMALL[:start]}[trajectory]\nfile = "{path / "track.csv"}"\n{keys}\n{SMALL[end:]}'
    (path / "own.toml").write_text(text, encoding="utf-8")
    return scenario.load(path / "own.toml").cases[0]


def _flown(case):
    return trajectory_of(case.trajectory, case.imu.period_s)


@pytest.mark.parametrize("heading_columns", [False, True])
def test_a_track_from_a_file_is_moved_and_turned(heading_columns, tmp_path):
    """Headings grow by the turn, speeds and heights stay, and the start is where it was asked."""
    _survey_track(tmp_path / "track.csv", heading_columns)
    as_it_is = _flown(_with_track(tmp_path))
    moved_case = _with_track(tmp_path, shift_east_km=30.0, shift_north_km=-20.0, turn_deg=100.0)
    turned = _flown(moved_case)
    metres = (turned.positions[0] - as_it_is.positions[0])[[1, 0]] * metres_along(
        as_it_is.positions[:1]
    )[0]
    assert metres == pytest.approx([30e3, -20e3], abs=1.0)
    speeds = [np.linalg.norm(each.velocities, axis=1) for each in (as_it_is, turned)]
    assert speeds[1] == pytest.approx(speeds[0], rel=7e-3)
    grown = np.degrees(
        np.diff([angles_of(each.attitudes)[:, 0] for each in (as_it_is, turned)], axis=0)
    )
    assert (grown % 360.0) == pytest.approx(100.0, abs=0.3)
    assert np.ptp(turned.positions[:, 2]) < 1.0


def test_tracks_of_a_file_are_ranked(tmp_path):
    _survey_track(tmp_path / "track.csv")
    found = tracks(_with_track(tmp_path), [(0.0, 0.0)], [0.0, 180.0])
    assert list(found["reason"]) == ["", ""] and found["bound_m"].notna().all()
    present = found[found["present"]]["heading_deg"].iloc[0]
    assert present == pytest.approx(90.0, abs=0.5)
    assert sorted(found["heading_deg"])[1] == pytest.approx(present + 180.0)


@pytest.mark.parametrize(("north", "words"), [(9000.0, "starts"), (6157.5, "comes")])
def test_a_track_is_not_moved_to_a_pole(north, words, tmp_path):
    _survey_track(tmp_path / "track.csv")
    with pytest.raises(GGBenchError, match=f"the moved track {words} closer than 1° to a pole"):
        _flown(_with_track(tmp_path, shift_north_km=north))


def test_survey_lines_are_not_moved(tmp_path):
    with pytest.raises(GGBenchError, match=r"shift_east_km.*flown where they were measured"):
        _with_track(tmp_path, lines='["1"]', shift_east_km=5.0)


@pytest.mark.long
def test_a_track_that_leaves_the_map_is_said():
    """Control: 500 km away from the start there is no map."""
    case = scenario.load("wide_prior").cases[0]
    found = tracks(case, [(0.0, 0.0), (500.0, 0.0)], [0.0])
    assert found["reason"].iloc[0] == "" and np.isfinite(found["bound_m"].iloc[0])
    assert "map" in found["reason"].iloc[1] and np.isnan(found["bound_m"].iloc[1])


def test_a_target_out_of_reach_is_exit_code_one(tmp_path):
    (tmp_path / "own.toml").write_text(SMALL, encoding="utf-8")
    done = invoke(["plan", "own.toml", "--headings", "2", "--target", "1e-9"], tmp_path)
    assert done.returncode == 1
    assert "0 tracks of 2 have a bound of at most" in done.stdout


def test_the_bounds_of_all_cases_are_in_one_table(tmp_path):
    (tmp_path / "own.toml").write_text(SMALL, encoding="utf-8")
    done = invoke(["bound", "own.toml", "--all", "-o", "all.csv"], tmp_path, columns=120)
    assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "all.csv")
    assert list(table["case"]) == ["base", "noisy"]
    assert (table["smoothing_bound_m"] <= table["bound_m"]).all()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["plan", "wide_prior", "--grid", "0"], "--grid"),
        (["plan", "wide_prior", "-o", "tracks.txt"], ".csv"),
        (["bound", "wide_prior", "--all", "-c", "1km"], "--all prints all cases"),
    ],
)
def test_bad_input_is_a_sentence(arguments, said, tmp_path):
    done = invoke(arguments, tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
