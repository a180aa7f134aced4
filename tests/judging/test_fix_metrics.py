"""Fixes of matchers judged: right, false or none, how far off, and over all thresholds."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from campaigns import finished, ran, small
from problems import SMALL

from ggbench.judging import fix_metrics
from ggbench.judging.statistics import wilson
from ggbench.problem import Fixes
from ggbench.results.database import Result, StoreError
from ggbench.results.store import Store

TIMES = np.arange(10.0, 60.0, 10.0)
FOUND = Fixes(
    np.array([1, 3]),
    np.array([[30.0, 40.0, 5.0], [1.0, 2.0, 0.0]]),
    np.array([np.diag([100.0, 400.0, 9.0]), np.diag([4.0, 4.0, 9.0])]),
    np.array([False, True]),
    np.array([-np.inf, 12.5]),
)


def test_a_fix_is_judged_at_its_own_epoch_east_and_north():
    """Error and NEES of two dimensions by hand; an infinite statistic can be stored."""
    truth = np.zeros((5, 9))
    truth[1, :3], truth[3, :3] = (30.0, 20.0, 500.0), (4.0, 6.0, 500.0)
    first, second = fix_metrics.judge(FOUND, truth, TIMES)
    assert first == {
        "time_s": 20.0,
        "error_m": 20.0,
        "nees": 1.0,
        "statistic": -np.finfo(float).max,
        "accepted": False,
    }
    assert second == {
        "time_s": 40.0,
        "error_m": 5.0,
        "nees": pytest.approx(25.0 / 4.0),
        "statistic": 12.5,
        "accepted": True,
    }


def test_the_nees_knows_of_correlations():
    """An error along the long axis of its ellipse is no surprise, one across it is."""
    cov = np.array([[100.0, 99.0], [99.0, 100.0]])
    truth = np.zeros((1, 2))
    for mean, wanted in (((7.0, 7.0), 98.0 / 199.0), ((7.0, -7.0), 98.0 / 1.0)):
        one = Fixes(np.array([0]), np.array([mean]), cov[None], np.array([True]), np.ones(1))
        assert fix_metrics.judge(one, truth, TIMES)[0]["nees"] == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("flaw", "said"),
    [
        ({"epoch": np.array([3, 3])}, "must increase from 0 to 4"),
        ({"epoch": np.array([3, 1])}, "must increase from 0 to 4"),
        ({"epoch": np.array([1, 5])}, "must increase from 0 to 4"),
        ({"epoch": np.array([1.5, 3.0])}, "must increase from 0 to 4"),
        ({"mean": np.zeros((2, 1))}, "two or three dimensions"),
        ({"mean": np.zeros((3, 3))}, "fixes.mean has shape (3, 3), not (2, 3)"),
        ({"mean": np.full((2, 3), np.nan)}, "fixes.mean is not finite"),
        ({"cov": np.zeros((2, 3, 3))}, "fixes.cov is not positive definite"),
        ({"cov": np.zeros((2, 2, 2))}, "fixes.cov has shape"),
        ({"statistic": np.array([np.nan, 1.0])}, "fixes.statistic is NaN"),
        ({"accepted": np.array([True])}, "fixes.accepted has shape"),
    ],
)
def test_what_is_no_fix_is_told(flaw, said):
    """In a sentence that names the part."""
    fix_metrics.checked(FOUND, 5)
    with pytest.raises(ValueError, match="fixes") as told:
        fix_metrics.checked(replace(FOUND, **flaw), 5)
    assert said in str(told.value)


def table(*rows: tuple[int, float, float, float, bool]) -> pd.DataFrame:
    """Rows of run, time, error, statistic, accepted; the NEES is a hundredth of the error."""
    names = ["run", "time_s", "error_m", "statistic", "accepted"]
    found = pd.DataFrame(rows, columns=names)
    return found.assign(nees=found["error_m"] / 100.0)


TRIED = table(
    (0, 20.0, 900.0, 1.0, False),
    (0, 40.0, 10.0, 15.0, True),
    (0, 60.0, 800.0, 11.0, True),
    (1, 20.0, 700.0, 13.0, True),
    (1, 40.0, 30.0, 30.0, True),
    (2, 20.0, 600.0, -np.finfo(float).max, False),
)


def test_runs_are_counted_by_the_first_fix_that_they_accept():
    """One right, one false, one refuses all, and a fourth tried none; other fixes do not count."""
    found = fix_metrics.metrics(TRIED, 4, 50.0)
    assert tuple(found) == fix_metrics.COLUMNS
    assert (found["fixes"], found["accepted"], found["false"]) == (6, 4, 2)
    for name, hits in (("right", 1), ("false", 1), ("none", 2)):
        wanted = wilson(hits, 4)
        assert tuple(found[f"{name}_{k}"] for k in ("share", "lo", "hi")) == wanted
    assert found["right_time_median_s"] == 40.0 and math.isnan(found["right_time_lo"])
    assert found["cep50_m"] == pytest.approx(365.0)  # of 10, 30, 700, 800
    assert found["nees"] == pytest.approx((10 + 800 + 700 + 30) / 400.0)
    assert found["nees_lo"] < 2.0 < found["nees_hi"]


def test_without_an_accepted_fix_there_are_no_errors_of_fixes():
    """Not zero."""
    for none in (table(), table((0, 1.0, 2.0, 3.0, False))):
        found = fix_metrics.metrics(none.astype({"accepted": bool}), 3, 50.0)
        assert (found["none_share"], found["accepted"]) == (1.0, 0)
        assert all(math.isnan(found[k]) for k in ("cep50_m", "nees", "right_time_median_s"))


FIXER = '''
"""Fixes: one right, one far off, one refused; or such as are none."""
from dataclasses import dataclass

import numpy as np

import ggbench as gg
from ggbench.problem import Fixes


@dataclass(frozen=True)
class Fixer(gg.Estimator):
    good: bool = True
    name = "fixer"

    @property
    def causality(self):
        return "filter"

    def estimate(self, problem, rng):
        k, n = problem.epochs, problem.dimension
        cov = np.tile(problem.prior_cov, (k, 1, 1))
        found = Fixes(
            np.array([0, 1, 2]), np.array([[0.0, 0.0], [1e6, 0.0], [0.0, 0.0]]),
            np.tile(1e4 * np.eye(2), (3, 1, 1)), np.array([True, True, False]),
            np.array([20.0, 15.0, 1.0]) if self.good else np.zeros(2),
        )
        return gg.Estimate(np.zeros((k, n)), cov, "filter", fixes=found)
'''


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A campaign with a matcher whose fixes are known, and one whose fixes are broken."""
    path = tmp_path_factory.mktemp("fixes")
    (path / "fixer.py").write_text(FIXER)
    text = SMALL.replace("last_s = 5.0", "last_s = 5.0\nrequired_m = 1000.0")
    labels = ("ins", "ekf", f"{path}/fixer.py", f"{path}/fixer.py[good=false]")
    return ran(path, labels=labels, runs=4, cases=("base",), scenario=small(path, text))


def test_a_campaign_keeps_and_counts_fixes(results):
    """Records, the table, the file and the report; who makes no fixes has none."""
    ((case, label), tried), *_ = results.fixes.items()
    assert (case, len(results.fixes), len(tried)) == ("base", 1, 12)
    (row,) = results.fix_metrics().to_dict("records")
    assert row["estimator"] == label and row["runs"] == 4
    assert (row["right_share"], row["false"], row["accepted"]) == (1.0, 4, 8)
    stored = pd.read_csv(results.folder / "fixes.csv")
    assert stored.columns.tolist() == ["case", "estimator", "run", *fix_metrics.ROWS]
    assert stored["error_m"].tolist() == pytest.approx(tried["error_m"].tolist())
    times = results.arrays("base")["times"]
    assert sorted(set(stored["time_s"])) == pytest.approx(times[:3])


def test_broken_fixes_fail_their_run_alone(results):
    """With a sentence; the others' are not touched."""
    failed = results.failures()
    assert len(failed) == 4 and failed["estimator"].str.endswith("[good=false]").all()
    assert failed["reason"].str.contains("fixes.statistic has shape").all()


def test_fixes_go_with_the_record_that_they_are_of(tmp_path):
    """Of a run that is stored again only the new ones are there; runs without any are a matcher's.

    They are of the columns that are judged.
    """
    fixes = fix_metrics.judge(FOUND, np.zeros((5, 15)), TIMES)
    store = Store(tmp_path / "out", create=True)
    store.add([Result("k", finished(run, fixes=2), fixes=fixes) for run in range(2)])
    store.add([Result("none", finished(fixes=0)), Result("other", finished())])
    store.add([Result("k", finished(1, fixes=1), fixes=fixes[1:])])
    found = store.fixes({"k", "none", "other"}, 9)
    assert {key: table["run"].tolist() for key, table in found.items()} == {
        "k": [0, 0, 1],
        "none": [],
    }
    assert found["k"].columns.tolist() == ["run", *fix_metrics.ROWS]
    assert found["k"].iloc[1:, 1:].to_dict("records") == [fixes[1], fixes[1]]
    store.close()


@pytest.mark.parametrize(
    "bad", [{"error_m": -1.0}, {"accepted": 2}, {"statistic": None}, {"time_s": "soon"}]
)
def test_fixes_that_are_none_are_not_stored(bad, tmp_path):
    """A wrong type or an impossible number: the database refuses it with its record."""
    fix = fix_metrics.judge(FOUND, np.zeros((5, 15)), TIMES)[0] | bad
    store = Store(tmp_path / "out", create=True)
    with pytest.raises(StoreError, match=next(iter(bad))):
        store.add([Result("k", finished(fixes=1), fixes=[fix])])
    assert list(store.records("k", 1)) == []
    store.close()
