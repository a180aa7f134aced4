"""An estimate that leaves the map: the run says so, where it was silent."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
import pytest
from campaigns import ran, small
from command import invoke
from frame_oracles import metres
from problems import SMALL
from small_cases import rough_map, small_flight

import ggbench as gg
from ggbench.campaign import records
from ggbench.report import render
from ggbench.report.answers import left_the_map
from ggbench.spec.scenario import Scenario

FAR = """
from dataclasses import dataclass
import numpy as np
from ggbench.problem import Estimate, Estimator


@dataclass(frozen=True)
class Far(Estimator):
    east_m: float = 0.0
    name = "far"
    causality = "filter"

    def estimate(self, problem, rng):
        mean = np.zeros((problem.epochs, problem.dimension))
        mean[-1, 0] = -self.east_m  # the INS is that far to the west, it believes
        return Estimate(mean, None, "filter")
"""


def outside(flight, east: float = 0.0, north: float = 0.0, up: float = 0.0) -> bool:
    """Whether a single estimate, off by so much, is found outside."""
    errors = np.zeros((2, len(flight.times), 6))
    errors[1, 7, :3] = east, north, up
    first, second = records.outside_map(flight, errors)
    assert not first
    return bool(second)


def test_an_estimate_is_outside_beyond_the_border_by_a_tenth_of_a_nodes_distance(tmp_path):
    """In each direction, whichever epoch it is; nodes are 772, 926 and 200 m apart."""
    flight = small_flight({"field.source": rough_map(tmp_path / "map.nc")})
    field, place = flight.model_field, flight.trajectory.positions[flight.epochs][7]
    scale = metres(place)[[1, 0, 2]].diagonal()
    distances = field.step, field.upper - place, place - field.origin
    step, room, behind = scale * np.stack(distances)
    for axis, name in enumerate(("north", "east", "up")):
        for sign, distance in ((1.0, room[axis]), (-1.0, behind[axis])):
            assert distance > step[axis]
            for share, expected in ((-0.1, False), (0.05, False), (0.15, True), (1000.0, True)):
                off = sign * (distance + share * step[axis])
                assert outside(flight, **{name: off}) == expected, (name, sign, share)


def test_the_normal_field_has_no_border():
    assert not outside(small_flight(), east=1e6)


@pytest.fixture
def scenario(tmp_path, monkeypatch) -> Scenario:
    """The small scenario over a map, in a folder with an estimator that believes to be far away."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "far.py").write_text(FAR)
    return small(
        tmp_path,
        SMALL.replace('source = "normal"', f'source = "{rough_map(tmp_path / "map.nc")}"'),
    )


def test_a_run_that_leaves_the_map_is_remarked_in_table_report_and_show(scenario, tmp_path):
    """Of the estimator that left it; the INS alone asks no map, wherever it is."""
    labels = ("far.py", "far.py[east_m=1e6]", "ins")
    results = ran(tmp_path, labels=labels, runs=2, scenario=scenario, cases=("base",))
    table = results.runs()
    assert (table["status"] == "ok").all()
    assert table["remark"].tolist() == ["", "", records.OUTSIDE, records.OUTSIDE, "", ""]
    shown = invoke(["show", str(results.folder)], tmp_path).stdout
    assert "left the map" in " ".join(shown.split())


def test_a_notebook_is_warned_of_an_estimate_outside_the_map(scenario):
    """Once, with the first time; of an estimate within it, or without aiding, nothing is said."""
    problem, _ = gg.simulate(scenario.case("base"))
    with pytest.warns(UserWarning, match=r"leave the map at 1 of 20 epochs, first 20 s after"):
        gg.estimate(problem, "far.py[east_m=1e6]")
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        gg.estimate(problem, "far.py")
        gg.estimate(problem, "ins")


@pytest.mark.long
@pytest.mark.parametrize("runs", [1, 3])
def test_a_report_counts_the_runs_that_left_the_map(runs, scenario, tmp_path):
    labels = ("far.py[east_m=1e6]", "ins")
    results = ran(tmp_path, labels=labels, runs=runs, scenario=scenario, cases=("base",))
    render.write(results.folder, tmp_path / "reports")
    remarks = pd.read_csv(next((tmp_path / "reports").glob("*/data/remarks.csv")))
    assert remarks.to_numpy().tolist() == [["base", "far[east_m=1e6]", records.OUTSIDE, runs]]


@pytest.mark.long
def test_a_page_names_the_estimators_that_left_the_map(scenario, tmp_path):
    """Below its table, where it is more than 5% of the runs, and of no other estimator."""
    labels = ("far.py[east_m=1e6]", "ekf", "ins")
    results = ran(tmp_path, labels=labels, runs=2, scenario=scenario, cases=("base",))
    (page, *_) = render.write(results.folder, tmp_path / "reports")
    text = page.read_text(encoding="utf-8")
    remark = text.index("\n`far[east_m=1e6]` sometimes left the map.\n")
    assert text.index("|case|") < remark < text.index("## Conditions")


def test_an_answer_leaves_out_the_odd_run_outside():
    runs = pd.DataFrame({"assumption": "", "estimator": ["ekf"] * 40 + ["ukf"] * 40, "remark": ""})
    runs.loc[:1, "remark"] = records.OUTSIDE  # 2 of 40 are 5%
    assert left_the_map(runs) == []
    runs.loc[:2, "remark"] = records.OUTSIDE
    assert left_the_map(runs) == ["ekf"]
    runs.loc[:2, "assumption"] = "another"
    assert left_the_map(runs) == []
