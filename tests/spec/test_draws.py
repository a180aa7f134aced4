"""Tracks and map errors that are drawn: the same in every campaign, and within what is stated."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest
from small_cases import small_case

from ggbench.errors import GGBenchError
from ggbench.gravity.ellipsoid import metres_per_radian
from ggbench.spec.case import CaseSpec

TURNING = {
    "trajectory.segment": [
        {"duration_s": 10.0},
        {"kind": "turn", "to_heading_deg": 60.0, "turn_rate_deg_per_s": 3.0},
    ]
}
TRACKS = {"draw.tracks": 40, "draw.start_km": 3.0, "draw.heading_deg": 60.0}
MAPS = {"draw.maps": 3, "field.error.density_factor": 1.1, "field.error.seed": 7}
FIRST = (2.083, -0.226, 19.015)
"""East and north [km] and turn [deg] of track 0 in a square of 3 km; campaigns rely on it."""


def displacement(case: CaseSpec, run: int) -> np.ndarray:
    """East and north of the start [m], and the turn [deg], of a run against its case."""
    own, declared = case.of_run(run).trajectory.start(), case.trajectory.start()
    metres = metres_per_radian(declared.position)
    moved = (own.position - declared.position)[:2] * metres
    return np.array([moved[1], moved[0], np.degrees(own.heading - declared.heading)])


def test_a_case_without_draws_is_every_runs():
    case = small_case()
    assert not case.drawn and case.of_run(17) is case


def test_tracks_are_the_same_in_every_campaign():
    """Run r flies track r modulo their number; two tracks are never the same."""
    case = small_case(TRACKS)
    found = [case.of_run(run) for run in range(80)]
    assert found[:40] == found[40:]
    assert len({one.trajectory for one in found}) == 40
    assert not any(one.drawn for one in found)
    assert small_case(TRACKS).of_run(3) == found[3]
    np.testing.assert_allclose(displacement(case, 0) / [1e3, 1e3, 1.0], FIRST, atol=2e-3)


def test_tracks_fill_the_square_and_the_angle():
    """Uniformly, each of the three by itself; false-alarm rate 1e-3 each."""
    case = small_case(TRACKS | {"draw.tracks": 500})
    found = np.array([displacement(case, run) for run in range(500)]) / [3e3, 3e3, 60.0]
    assert np.abs(found).max() <= 1.0 + 1e-9
    for column in found.T:
        assert kstest(column, "uniform", (-1.0, 2.0)).pvalue > 1e-3
    assert np.abs(np.corrcoef(found.T) - np.eye(3)).max() < 0.15


def test_a_track_keeps_its_shape():
    """Headings that segments turn to are turned as the start is; nothing else changes."""
    case = small_case(TURNING | TRACKS)
    for run in range(5):
        own = case.of_run(run)
        turn = displacement(case, run)[2]
        assert own.trajectory.segment[0] == case.trajectory.segment[0]
        assert own.trajectory.segment[1].to_heading_deg == pytest.approx(60.0 + turn)
        same = own.trajectory.model_copy(
            update={
                key: getattr(case.trajectory, key)
                for key in ("latitude_deg", "longitude_deg", "heading_deg", "segment")
            }
        )
        assert same == case.trajectory
        assert own.model_copy(update={"trajectory": case.trajectory, "draw": case.draw}) == case


@pytest.mark.parametrize("side", ["", "truth.", "model."])
def test_map_errors_are_those_of_consecutive_seeds(side):
    """Of the side that states them, and no other."""
    changes = {"draw.maps": 3, f"{side}field.error.density_factor": 1.1}
    case = small_case(changes | {f"{side}field.error.seed": 7, "field.source": "any.nc"})
    for run in range(7):
        own = case.of_run(run)
        errors = own.map_errors()
        assert {name: error.seed for name, error in errors.items()} == {
            side.rstrip("."): 7 + run % 3
        }
        assert own.trajectory == case.trajectory


@pytest.mark.parametrize("stated", [None, 2])
def test_a_side_has_the_drawn_seed_of_both_unless_it_states_one(stated):
    changes = MAPS | {"field.source": "any.nc", "model.field.error.resolution_km": 0.2}
    if stated is not None:
        changes["model.field.error.seed"] = stated
    case = small_case(changes)
    for run in range(4):
        errors = [case.of_run(run).side(side).field.error for side in ("truth", "model")]
        assert [error.seed for error in errors] == [7 + run % 3, (stated or 7) + run % 3]
        assert [error.resolution_km for error in errors] == [None, 0.2]
        assert errors[1].density_factor == 1.1


def test_a_side_may_have_no_error_of_a_kind_that_both_have():
    """A value that a table has by default replaces another one, too."""
    changes = {"field.error.white_noise_eotvos": 2.0, "model.field.error.white_noise_eotvos": 0.0}
    case = small_case(changes | {"field.source": "any.nc"})
    noise = [case.side(side).field.error.white_noise_eotvos for side in ("truth", "model")]
    assert noise == [2.0, 0.0]
    same = changes | {"model.field.error.density_factor": 1.0}
    del same["model.field.error.white_noise_eotvos"]
    assert small_case(same | {"field.source": "any.nc"}).content_hash != case.content_hash


@pytest.mark.parametrize(
    ("changes", "clusters"),
    [
        ({}, [0, 1, 2, 3, 4, 5, 6, 7]),
        ({"draw.tracks": 4}, [0, 1, 2, 3, 0, 1, 2, 3]),
        (MAPS, [0, 1, 2, 0, 1, 2, 0, 1]),
        (MAPS | {"draw.tracks": 6}, [0, 1, 2, 0, 1, 2, 0, 1]),
    ],
)
def test_runs_that_share_a_draw_are_one_cluster(changes, clusters):
    """Of the map error where one is drawn, else of the track, else each run its own."""
    case = small_case(changes)
    assert [case.cluster(run) for run in range(8)] == clusters


def test_a_recorded_track_cannot_be_drawn(tmp_path):
    rows = "time_s,latitude_deg,longitude_deg,height_m\n0,33.5,108,10000\n20,33.5,108.05,10000\n"
    (tmp_path / "track.csv").write_text(rows)
    flown = dict.fromkeys(
        ("latitude_deg", "longitude_deg", "height_m", "speed_mps", "heading_deg", "segment")
    )
    changes = {f"trajectory.{key}": None for key in flown}
    changes |= {"trajectory.file": str(tmp_path / "track.csv"), "draw.tracks": 2}
    with pytest.raises(GGBenchError, match=r"draw\.tracks needs segments"):
        small_case(changes)
