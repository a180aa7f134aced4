"""The table by survey line: errors, NEES and the map's next line, beside an independent account."""

from __future__ import annotations

import math
from importlib.resources import files
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from command import invoke
from measured_surveys.__main__ import MAPS

from ggbench.maps.survey_files import read_lines
from ggbench.maps.surveyed import distances_from, lines_behind
from ggbench.report.survey_lines import by_line
from ggbench.spec import scenario

DATA = files("ggbench.scenarios") / "data" / "measured"
CASE, FOLD = "fold-2", "vinton2008_fold2"


def planted(case: str, runs: int, lines: int, seed: int = 1) -> pd.DataFrame:
    """Return runs of two estimators, each line with an error of its own; one run failed."""
    rng = np.random.default_rng(seed)
    rows = [
        {
            "assumption": "",
            "case": case,
            "estimator": estimator,
            "run": run,
            "status": "ok",
            "settled_position_ms": (1.0 + run % lines) * rng.chisquare(3),
            "settled_nees": rng.chisquare(6),
        }
        for estimator in ("ins", "ekf")
        for run in range(runs)
    ]
    rows[3] |= {"status": "failed", "settled_position_ms": math.nan, "settled_nees": math.nan}
    rows.append(rows[0] | {"assumption": "another", "settled_position_ms": 1e9})
    return pd.DataFrame(rows)


def earth_fixed(latitude_deg, longitude_deg, height_m):
    """Return places (3, N) on WGS84 in Earth-fixed axes [m]."""
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    squared = 6.69437999014e-3
    normal = 6378137.0 / np.sqrt(1.0 - squared * np.sin(latitude) ** 2)
    across = (normal + height_m) * np.cos(latitude)
    up = ((1.0 - squared) * normal + height_m) * np.sin(latitude)
    return np.array([across * np.cos(longitude), across * np.sin(longitude), up])


def distance(samples: pd.DataFrame, other: pd.DataFrame) -> float:
    """Return the median distance [m] of samples from a line of many points, without its height."""
    along = np.linspace(0.0, len(other) - 1.0, 20 * len(other))
    keys = ("latitude_deg", "longitude_deg")
    fine = [np.interp(along, np.arange(len(other)), other[key]) for key in keys]
    points = earth_fixed(*fine, np.full(len(along), 80.0))
    own = earth_fixed(*(samples[key].to_numpy() for key in keys), np.full(len(samples), 80.0))
    off = np.linalg.norm(own[:, :, np.newaxis] - points[:, np.newaxis], axis=0)
    return float(np.median(off.min(axis=1)))


@pytest.mark.long
def test_a_row_has_the_error_the_nees_and_the_next_line_of_the_map():
    """Of each line and estimator; distances are those of a search among points of the file."""
    loaded = scenario.load("vinton2008")
    lines = next(case for case in loaded.cases if case.name == CASE).trajectory.lines
    runs = planted(CASE, 25, len(lines))
    table = by_line(SimpleNamespace(scenario=loaded), runs)
    assert list(table["line"].unique()) == list(lines)
    assert len(table) == 2 * len(lines)
    survey = pd.read_csv(DATA / "vinton2008.csv.gz", dtype={"line": str})
    left_out = MAPS[FOLD][1]
    behind = survey[~survey["kind"].isin(left_out) & ~survey["line"].isin(left_out)]
    for row in table.itertuples():
        own = [
            (run["settled_position_ms"], run["settled_nees"])
            for run in runs.to_dict("records")
            if run["estimator"] == row.estimator
            and run["status"] == "ok"
            and not run["assumption"]
            and lines[run["run"] % len(lines)] == row.line
        ]
        squares, nees = np.transpose(own)
        assert row.runs == len(own)
        assert row.rms_m == pytest.approx(math.sqrt(sum(squares) / len(own)))
        assert row.nees == pytest.approx(sum(nees) / len(own))
    assert table["runs"].sum() == len(runs) - 2
    for name, row in table.drop_duplicates("line").set_index("line").iloc[::4].iterrows():
        whole = survey[survey["line"] == name]
        first = (len(whole) - 299) // 2
        flown = whole.iloc[first : first + 299 : 10]
        near = behind[(behind["longitude_deg"] - flown["longitude_deg"].median()).abs() < 0.006]
        found = {
            other: distance(flown, samples)
            for other, samples in near.groupby("line")
            if len(samples) > 50
        }
        assert min(found, key=found.get) == row["next_line"]
        assert row["next_line_m"] == pytest.approx(found[row["next_line"]], abs=3.0)
        assert row["next_line"] not in left_out and 100.0 < row["next_line_m"] < 300.0


@pytest.mark.long
def test_the_lines_behind_a_map_are_those_that_it_was_made_of():
    """As the study has it that makes the maps; a map that is not of lines has none."""
    for source, (survey, left_out, _, quantity) in MAPS.items():
        lines = lines_behind(source)
        made = read_lines(DATA / f"{survey}.csv.gz", quantity=quantity).without(left_out)
        assert lines is not None and lines.names == made.names
    assert lines_behind("egm2008_alps") is None


def test_distances_are_those_of_segments():
    """Beside a segment, beyond the ends, at a point that repeats, and of a single point."""
    line = np.array([[0.0, 0.0], [0.0, 0.0], [10.0, 0.0], [10.0, 5.0]])
    points = np.array([[4.0, 3.0], [-3.0, 4.0], [12.0, 2.0], [10.0, 9.0], [7.0, -1.0]])
    np.testing.assert_allclose(distances_from(line, points), [3.0, 5.0, 2.0, 4.0, 1.0])
    np.testing.assert_allclose(distances_from(line[:1], points[:2]), [5.0, 5.0])


def test_a_scenario_without_survey_lines_has_no_such_table():
    """Nor is there one if no run is finished."""
    loaded = scenario.load("wang2013")
    runs = planted(loaded.cases[0].name, 4, 1)
    assert by_line(SimpleNamespace(scenario=loaded), runs).empty
    survey = scenario.load("vinton2008")
    failed = planted(CASE, 4, 1).assign(status="failed")
    assert by_line(SimpleNamespace(scenario=survey), failed).empty


@pytest.mark.long
def test_a_report_has_the_table_and_its_page_links_it(tmp_path):
    """As a CSV file beside the page, and on the HTML page; not in the markdown itself."""
    words = ["run", "vinton2008", "-c", CASE, "-e", "ins", "-n", "12", "-o", "out", "-j", "0"]
    for arguments in (words, ["report", "out", "-o", "reports"]):
        done = invoke(arguments, tmp_path)
        assert done.returncode == 0, done.stderr
    output = tmp_path / "reports"
    table = pd.read_csv(output / "vinton2008/data/lines.csv", dtype={"line": str})
    assert len(table) == 10 and table["runs"].tolist() == [2, 2, *[1] * 8]
    page = (output / "vinton2008.md").read_text()
    assert "[lines](vinton2008/data/lines.csv)" in page
    assert '"next_line_m"' in (output / "vinton2008.html").read_text()
