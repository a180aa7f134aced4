"""`ggbench plan`: tracks ranked by their bound, those that leave the map, bad input."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from command import invoke
from matplotlib.image import imread
from problems import SMALL
from small_cases import small_case

from ggbench.judging.planned import bound_of, tracks
from ggbench.spec import scenario
from ggbench.spec.draws import moved


def test_a_track_has_the_bound_of_its_flight():
    """Each row is the bound of the moved and turned flight; the smallest comes first."""
    case = small_case()
    found = tracks(case, [(0.0, 0.0), (3.0, -2.0)], [0.0, 90.0])
    assert found["bound_m"].is_monotonic_increasing and len(found) == 4
    for row in found.itertuples():
        turn = row.heading_deg - np.degrees(case.trajectory.start().heading)
        flown = moved(case.trajectory, row.east_km, row.north_km, turn)
        expected = bound_of(case.model_copy(update={"trajectory": flown}))
        assert row.bound_m == pytest.approx(expected, rel=1e-9)


def test_tracks_are_ranked_and_drawn(tmp_path):
    """A table, a file and a figure, and how many tracks allow the target."""
    (tmp_path / "own.toml").write_text(SMALL, encoding="utf-8")
    command = ["plan", "own.toml", "--headings", "4", "--grid", "2", "--target", "1e6", "-o",
               "tracks.csv", "--figure", "tracks.png"]  # fmt: skip
    done = invoke(command, tmp_path, columns=120)
    assert done.returncode == 0, done.stderr
    assert "the best of 16 tracks" in done.stdout
    assert "16 tracks of 16 allow" in done.stdout
    assert len(pd.read_csv(tmp_path / "tracks.csv")) == 16
    assert imread(tmp_path / "tracks.png").shape[1] > 400


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
    assert "0 tracks of 2 allow" in done.stdout


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
        (["plan", "turbulence"], "a track from a file cannot be moved"),
        (["bound", "wide_prior", "--all", "-c", "1km"], "--all prints all cases"),
    ],
)
def test_bad_input_is_a_sentence(arguments, said, tmp_path):
    done = invoke(arguments, tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
