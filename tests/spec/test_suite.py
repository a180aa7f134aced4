"""The standard suite: few cases, many fields, equal runs."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import numpy as np
import pytest

from ggbench.results import digest
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.random_streams import RandomStreams
from ggbench.spec import scenario
from ggbench.spec.rosters import rosters

SUITE = scenario.load("suite")
REPORT = Path(__file__).parents[2] / "reports" / "suite" / digest.FOLDER
LEFT_OUT = {"ekf[iterations=5]", "factor-graph", "factor-graph[mode=fixed-lag]", "tercom"}
"""Two answer as the EKF does, a lag of 30 s is shorter than a ship's measurement period, and
TERCOM is compared with other matchers elsewhere."""

REGISTERED = "bfa9fffbd95e31646a28fa2bc8117477203c743a97424558e414061e21d8940f"
"""SHA-256 of the contents of the cases of version 2."""


def test_the_suite_spreads_over_fields_and_vehicles():
    assert len(SUITE.cases) <= 20
    assert SUITE.campaign.runs == 200
    assert len({case.field.source for case in SUITE.cases}) >= 5
    assert {case.trajectory.vehicle for case in SUITE.cases} == {"aircraft", "ship"}
    assert len({case.title for case in SUITE.cases}) == len(SUITE.cases)


def test_every_run_has_its_own_track_and_every_tenth_its_map_error():
    for case in SUITE.cases:
        starts = {start(case, run).tobytes() for run in range(200)}
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


def start(case, run: int) -> np.ndarray:
    return case.of_run(run).trajectory.start().position


def distance(case, run: int) -> float:
    moved = start(case, run) - case.trajectory.start().position
    return float(np.abs(moved[:2]).max())


def test_twins_share_their_runs_and_other_cases_share_none():
    """Cases that share runs would be one experiment, counted several times."""
    cases = {case.name: case for case in SUITE.cases}
    for name, case in cases.items():
        assert case.draw.name == name.removesuffix("-known")
        twin = cases[case.draw.name]
        np.testing.assert_array_equal(start(case, 7), start(twin, 7))
    firsts = {name: RandomStreams(1, 0, cases[name].draw.name)["imu/"].random() for name in cases}
    assert len(set(firsts.values())) == len({case.draw.name for case in SUITE.cases})


def test_a_twin_differs_from_its_case_in_the_model_or_the_fault_alone():
    """A twin that flies another track, field or IMU would not be the mark for its case."""
    cases = {case.name: case for case in SUITE.cases}
    twins = [name for name in cases if name.endswith("-known")]
    assert len(twins) == 4
    for name in twins:
        one, other = cases[name.removesuffix("-known")], cases[name]
        for table in ("trajectory", "imu", "initial_error", "windows", "draw", "altimeter"):
            assert getattr(one, table) == getattr(other, table), (name, table)


def test_a_map_holds_the_prior_around_every_track():
    """No case is decided by a border: 3 deviations of the prior lie inside it, at the start."""
    for case in SUITE.cases:
        latitude, _, _ = case.trajectory.start().position
        north = 111.2 * min(
            case.field.north_deg - math.degrees(latitude),
            math.degrees(latitude) - case.field.south_deg,
        )
        prior = case.initial_error.position_m / 1e3
        assert 3.0 * prior + case.draw.start_km < north, case.name


def test_the_suite_is_the_registered_one():
    """Its cases, seed and runs may not change while estimators are compared on them.

    A change makes a new version, whose runs are flown again for every estimator.
    """
    assert "version 2" in SUITE.title
    assert (SUITE.campaign.seed, SUITE.campaign.runs) == (3702, 200)
    contents = hashlib.sha256("".join(case.content_hash for case in SUITE.cases).encode())
    assert contents.hexdigest() == REGISTERED


def test_the_committed_matrix_has_all_runs_in_every_cell():
    if not REPORT.exists():
        pytest.skip("the suite has no committed report")
    table = digest.read(REPORT).metrics
    assert len(table) == len(SUITE.cases) * len(SUITE.campaign.estimators)
    assert (table["runs"] == 200).all()
