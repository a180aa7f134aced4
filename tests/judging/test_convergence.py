"""Locking on: when a run has it, what is a false claim of it, and the statistics of many runs."""

from __future__ import annotations

import json
import math
import sqlite3

import numpy as np
import pandas as pd
import pytest
from campaigns import ran, small
from problems import SMALL
from scipy.stats import binom, chi2

from ggbench.judging.convergence import (
    COLUMNS,
    claimed_radius,
    figures,
    judge,
    median_interval,
    share_by_time,
    wilson,
)
from ggbench.judging.summary import EXTRA_COLUMNS
from ggbench.report import scenario_report
from ggbench.results import formats
from ggbench.spec import scenario
from ggbench.spec.case import WindowsSpec

TIMES = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
SURE, UNSURE = np.full((5, 3), 1.0), np.full((5, 3), 100.0)
LOCKING = SMALL.replace("[windows]", "[windows]\nlock_m = 100.0", 1)


@pytest.mark.parametrize(
    ("errors", "sigmas", "time", "false"),
    [
        ([50, 9, 9, 9, 9], SURE, 2.0, False),
        ([9, 9, 9, 9, 9], SURE, 1.0, False),
        ([9, 9, 11, 9, 9], SURE, 4.0, False),  # lost again in between: only the last time counts
        ([9, 9, 9, 9, 10], SURE, None, True),  # the limit itself is not below it
        ([9, 9, 9, 9, 11], UNSURE, None, False),
        ([50, 50, 50, 50, 9], UNSURE, 5.0, False),  # found its place without claiming so
        ([50, 50, 50, 50, math.inf], SURE, None, True),
        ([50, 50, 50, 50, 50], np.full((5, 3), math.nan), None, False),  # no covariance, no claim
    ],
)
def test_a_lock_lasts_to_the_end(errors, sigmas, time, false):
    """Locked is who stays below the limit to the end; who claims it and is not has a false lock."""
    found = judge(np.array([errors], dtype=float), sigmas[-1:], TIMES, 10.0)
    assert found[0].tolist() == pytest.approx([math.nan if time is None else time], nan_ok=True)
    assert found[1].tolist() == [false]


@pytest.mark.parametrize("shape", [(1.0, 0.0, 0.0), (1.0, 1.0, 1.0), (5.0, 2.0, 0.1), (1, 1, 0)])
def test_the_claimed_radius_holds_95_percent_whatever_the_shape(shape):
    """At least 95 % of a Gaussian lie within its claimed radius; of one on a line, just 95 %.

    200 000 draws: five standard deviations are 0.25 %, a false alarm in 3e6 per shape.
    """
    sigmas = np.array([shape], dtype=float)
    draws = np.random.default_rng(4).standard_normal((200_000, 3)) * sigmas
    inside = np.mean(np.linalg.norm(draws, axis=1) <= claimed_radius(sigmas)[0])
    assert inside > 0.9475
    if shape == (1.0, 0.0, 0.0):
        assert inside < 0.9525


@pytest.mark.parametrize("hits", [0, 1, 7, 20])
def test_the_share_of_runs_has_wilsons_interval(hits):
    """Its ends are the shares of which the one found is 1.96 of *their* deviations away."""
    runs = 20
    share, low, high = wilson(hits, runs)
    assert share == hits / runs
    assert 0.0 <= low <= share <= high <= 1.0
    for end, outermost in ((low, 0.0), (high, 1.0)):
        if share != outermost:
            distance = (share - end) ** 2
            assert distance == pytest.approx(chi2.ppf(0.95, 1) * end * (1.0 - end) / runs)
        else:
            assert end == outermost
    assert all(math.isnan(value) for value in wilson(0, 0))


def test_the_share_is_covered_as_promised():
    """Wilson's intervals hold the true share in 95 % of campaigns, on average over the shares."""
    runs = 50
    intervals = [wilson(k, runs) for k in range(runs + 1)]
    covered = [
        sum(binom.pmf(k, runs, p) for k, (_, lo, hi) in enumerate(intervals) if lo <= p <= hi)
        for p in np.linspace(0.02, 0.98, 97)
    ]
    assert 0.945 < np.mean(covered) < 0.965
    assert min(covered) > 0.88


@pytest.mark.parametrize("count", [6, 9, 25, 100])
def test_the_median_is_covered_whatever_the_law(count):
    """Between the order statistics the median lies with 95 % or more, and not much more.

    The interval of 1..n names the ranks; a median lies between them unless too few or too many of
    the values are below it, which a fair coin decides.
    """
    value, low, high = median_interval(np.random.default_rng(1).permutation(count) + 1)
    assert value == (count + 1) / 2
    outside = binom.cdf(low - 1, count, 0.5) + binom.sf(high - 1, count, 0.5)
    assert outside <= 0.05
    narrower = binom.cdf(low, count, 0.5) + binom.sf(high - 2, count, 0.5)
    assert narrower > 0.05


def test_few_times_have_no_interval():
    """Five values cannot bound a median with 95 %; none have no median."""
    value, low, high = median_interval([3.0, 1.0, 2.0, 5.0, 4.0])
    assert value == 3.0
    assert math.isnan(low) and math.isnan(high)
    assert all(math.isnan(v) for v in median_interval([]))


def test_failed_runs_have_not_locked():
    """Shares are of all runs, the median time is of those that locked."""
    found = figures(np.array([4.0, math.nan, 8.0]), 1, 4)
    assert (found["lock_share"], found["false_lock_share"]) == (0.5, 0.25)
    assert found["lock_time_median_s"] == 6.0
    nothing = figures(np.array([]), 0, 4)
    assert (nothing["lock_share"], nothing["false_lock_share"]) == (0.0, 0.0)
    assert math.isnan(nothing["lock_time_median_s"])
    times = np.array([4.0, math.nan, 8.0])
    shares = share_by_time(times, 4, np.array([0.0, 4.0, 7.9, 8.0, 9.0]))
    assert shares.tolist() == [0.0, 0.25, 0.25, 0.5, 0.5]


def test_a_limit_is_part_of_a_case_and_none_changes_nothing():
    """A case without a limit is what it was before there were limits; one with it is another."""
    old = WindowsSpec(settled_from_s=3.0, last_s=2.0)
    assert old.model_dump(exclude_defaults=True) == {"settled_from_s": 3.0, "last_s": 2.0}
    plain, locking = (
        scenario.parse(scenario.tomllib.loads(text), "s", "s").cases[0].content_hash
        for text in (SMALL, LOCKING)
    )
    assert plain != locking


@pytest.mark.parametrize("value", ["0.0", "-1.0", "inf", "nan", '"10 m"'])
def test_a_limit_that_is_none_is_refused(tmp_path, value):
    """A limit is a positive number of metres; else a sentence that names the key."""
    with pytest.raises(scenario.ScenarioError, match=r"windows\.lock_m"):
        small(tmp_path, LOCKING.replace("lock_m = 100.0", f"lock_m = {value}"))


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A campaign in which locks are judged, with a narrow and a wide prior."""
    path = tmp_path_factory.mktemp("convergence")
    text = LOCKING + (
        '[[case]]\nname = "wide"\ntitle = "wide prior"\ninitial_error.position_m = 2000.0\n'
    )
    return ran(path, labels=("ins", "ekf"), runs=8, scenario=small(path, text))


def test_records_and_tables_hold_the_locks(results):
    """What a record says of its lock is what its own series says, and the tables count it."""
    table = results.runs()
    for case, label, run in table[["case", "estimator", "run"]].itertuples(index=False):
        errors = results.series_of(case, label, run)[:, 0]
        times = results.arrays(case)["times"]
        below = [k for k in range(len(times)) if (errors[k:] < 100.0).all()]
        own = table[
            (table["case"] == case) & (table["estimator"] == label) & (table["run"] == run)
        ].iloc[0]
        if below:
            assert own["lock_time_s"] == pytest.approx(times[below[0]])
        else:
            assert math.isnan(own["lock_time_s"])
    counted = pd.read_csv(results.folder / "convergence.csv")
    assert len(counted) == 2 * 3
    for row in counted.to_dict("records"):
        own = table[(table["case"] == row["case"]) & (table["estimator"] == row["label"])]
        assert row["lock_share"] == own["lock_time_s"].notna().mean()
        assert row["false_lock_share"] == own["false_lock"].mean()
    summary = results.summary()
    assert set(COLUMNS) <= set(EXTRA_COLUMNS) <= set(summary.columns)
    assert (summary.groupby(["case", "label"])["lock_share"].nunique() == 1).all()


@pytest.mark.long
def test_the_report_tells_of_convergence(results, tmp_path):
    """The section has its table, its figures and a sentence for every case."""
    text = scenario_report.write(results.folder, tmp_path).read_text()
    section = text[text.index("## Convergence") : text.index("## Results")]
    assert "below 100 m" in section
    for file in ("convergence.png", "locks_over_time.png"):
        assert f"small/{file}" in section
        assert (tmp_path / "small" / file).stat().st_size > 5000
    assert section.count("\n| ") == 2 + 3 * 2  # the head, and each estimator in each case
    for case in results.scenario.cases:
        assert f"- **{case.title}** (σ " in section


def test_a_folder_from_before_there_were_locks_can_be_read(tmp_path):
    """Records without a word of locks are valid; false words are damage."""
    found = ran(tmp_path, labels=("ins",), runs=1)
    record = next(iter(found.records()))
    assert "lock_time_s" not in record
    assert found.summary()["lock_share"].isna().all()
    assert not (found.folder / "convergence.csv").exists()
    assert "## Convergence" not in scenario_report.write(found.folder, tmp_path).read_text()
    stored = sqlite3.connect(found.folder / "records.sqlite").execute("SELECT record FROM records")
    plain = json.loads(stored.fetchone()[0])
    assert formats.flaw_of_record(plain) is None
    for bad in ({"lock_time_s": -1.0}, {"lock_time_s": "soon"}, {"false_lock": 1}):
        assert next(iter(bad)) in formats.flaw_of_record(plain | bad)
