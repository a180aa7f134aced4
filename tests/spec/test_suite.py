"""The standard suite: few cases, many fields, equal runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ggbench.results import digest
from ggbench.simulation.error_free_flight import prepare
from ggbench.spec import scenario
from ggbench.spec.rosters import rosters

SUITE = scenario.load("suite")
REPORT = Path(__file__).parents[2] / "reports" / "suite" / digest.FOLDER
LEFT_OUT = {"rao-blackwellised", "tercom", "factor-graph[mode=fixed-lag]"}
"""Two take most of the time; a lag of 30 s is shorter than a ship's measurement period."""


def test_the_suite_spreads_over_fields_and_vehicles():
    assert len(SUITE.cases) <= 16
    assert SUITE.campaign.runs == 200
    assert len({case.field.source for case in SUITE.cases}) >= 5
    assert {case.trajectory.vehicle for case in SUITE.cases} == {"aircraft", "ship"}
    assert len({case.title for case in SUITE.cases}) == len(SUITE.cases)


def test_every_run_has_its_own_track_and_every_tenth_its_map_error():
    for case in SUITE.cases:
        starts = {case.of_run(run).trajectory.start().position.tobytes() for run in range(200)}
        assert len(starts) == 200
        assert case.draw.maps == (20 if case.map_errors() else 1)


def test_the_whole_standard_roster_flies():
    assert set(rosters()["standard"]) - LEFT_OUT <= set(SUITE.campaign.estimators)


def test_every_case_declares_its_required_error():
    assert all(case.windows.required_m is not None for case in SUITE.cases)


@pytest.mark.long
@pytest.mark.parametrize("case", SUITE.cases, ids=lambda case: case.name)
def test_tracks_stay_on_their_map(case):
    """Six of the 200 tracks, and the farthest start; a flight off its map is refused."""
    runs = {*range(6), max(range(200), key=lambda run: distance(case, run))}
    for run in runs:
        prepare(case.of_run(run))


def distance(case, run: int) -> float:
    moved = case.of_run(run).trajectory.start().position - case.trajectory.start().position
    return float(np.abs(moved[:2]).max())


def test_the_committed_matrix_has_all_runs_in_every_cell():
    if not REPORT.exists():
        pytest.skip("the suite has no committed report")
    table = digest.read(REPORT).metrics
    assert len(table) == len(SUITE.cases) * len(SUITE.campaign.estimators)
    assert (table["runs"] == 200).all()
