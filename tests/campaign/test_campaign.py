"""Campaigns: reproducible, resumable, indifferent to failing estimators, wary of their folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from campaigns import LABELS, assert_equal, plan, ran, records, small
from problems import SMALL, LinearModel, changed
from thinning import thinned

from ggbench.block import ProblemBlock
from ggbench.campaign import execution, flights, registry, result_keys, runner, running
from ggbench.campaign.campaign import CampaignError
from ggbench.campaign.texts import refusal
from ggbench.report import render
from ggbench.results.folder import Results
from ggbench.simulation.runs import simulate
from ggbench.spec.scenario import ScenarioError

NAUGHTY = """
import os
from dataclasses import dataclass
from typing import Literal
import numpy as np
from ggbench.problem import Estimate, Estimator


class Kilometres(np.ndarray):
    pass


@dataclass(frozen=True)
class Naughty(Estimator):
    kind: Literal[KINDS] = "good"
    name = "naughty"
    causality = "filter"

    def estimate(self, problem, rng):
        mean = np.zeros((problem.epochs, problem.dimension))
        cov = np.tile(problem.prior_cov, (problem.epochs, 1, 1))
        if self.kind == "raises in some runs" and problem.measurements[0, 0] > MEDIAN:
            raise ArithmeticError("not this one")
        if self.kind == "returns nan":
            mean[3] = np.nan
        if self.kind == "returns nan covariance":
            cov[5, 2, 2] = np.nan
        if self.kind == "wrong shape":
            mean = mean[:, :9]
        if self.kind == "wrong covariance shape":
            cov = cov[:-1]
        if self.kind == "nothing":
            return None
        if self.kind == "other causality":
            return Estimate(mean, cov, "batch")
        if self.kind == "singular covariance":
            cov = np.zeros_like(cov)
        if self.kind == "negative variance":
            cov = -cov
        if self.kind == "lists":
            return Estimate(mean.tolist(), cov.tolist(), "filter")
        if self.kind == "odd info":
            return Estimate(mean, cov, "filter", info={"what": object()})
        if self.kind == "complex":
            mean = mean + 1j
        if self.kind == "masked":
            mean = np.ma.array(mean, mask=np.arange(mean.size).reshape(mean.shape) < 4)
        if self.kind == "masked covariance":
            cov = np.ma.masked_less(cov, 0.5)
        if self.kind == "list of masked":
            mean = [np.ma.array(row, mask=row == 0.0) for row in mean]
        if self.kind == "masked nowhere":
            mean, cov = np.ma.array(mean), np.ma.array(cov, mask=False)
        if self.kind == "objects":
            mean = mean.astype(object)
        if self.kind == "texts":
            mean = mean.astype(str)
        if self.kind == "with a unit":
            mean = mean.view(Kilometres)
        return Estimate(mean, cov, "filter")
"""
FAULTS = {
    "returns nan": "mean is not finite from epoch 3 on",
    "returns nan covariance": "cov is not finite from epoch 5 on",
    "wrong shape": r"mean has shape \(20, 9\), not \(20, 15\)",
    "wrong covariance shape": r"cov has shape \(19, 15, 15\), not \(20, 15, 15\)",
    "nothing": "NoneType",
    "other causality": "'batch'.*declares 'filter'",
    "singular covariance": "(?i)singular|definite",
    "negative variance": "(?i)definite|negative",
    "complex": "(?i)complex|real",
    "masked": "mean is masked in 4 of 300 places",
    "masked covariance": r"cov is masked in \d+ of 4500 places",
    "list of masked": "mean is masked in 15 of 15 places",
    "objects": "mean holds object, not real numbers",
    "texts": "mean holds <U32, not real numbers",
    "with a unit": "mean is a Kilometres, not a plain array of numbers",
}
HARMLESS = ("lists", "odd info", "masked nowhere")


def naughty(tmp_path: Path, median: float = 0.0) -> str:
    """The path of an estimator file that does wrong in the way it is asked to."""
    path = tmp_path / "naughty.py"
    kinds = ("good", "raises in some runs", *FAULTS, *HARMLESS)
    path.write_text(
        NAUGHTY.replace("KINDS", ", ".join(map(repr, kinds))).replace("MEDIAN", repr(median))
    )
    return str(path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Results:
    """The small campaign, run to its end in this process."""
    return ran(tmp_path_factory.mktemp("whole"))


@pytest.mark.long
def test_results_do_not_depend_on_the_number_of_processes(whole, tmp_path):
    """The same seed gives the same records and series, in one process or in two."""
    alone, together = whole, ran(tmp_path, "two", jobs=2)
    expected = records(alone)
    assert len(expected) == 2 * len(LABELS) * 3
    assert {r["status"] for r in expected.values()} == {"ok"}
    assert_equal(alone, together)


def test_runs_differ_and_cases_are_paired(whole, tmp_path):
    """Another run or another seed is another draw; two cases share what they have in common."""
    first, other = records(whole), records(ran(tmp_path, "b", seed=6))
    final = "final_position_error_m"
    assert len({r["base", "ins", run][final] for r in (first, other) for run in range(3)}) == 6
    for run in range(3):
        assert first["base", "ins", run][final] == first["noisy", "ins", run][final]
        assert first["base", "ekf", run][final] != first["noisy", "ekf", run][final]


def test_results_do_not_depend_on_the_company(whole, tmp_path):
    """An estimator's records are the same whichever others run beside it, in whatever order."""
    expected = records(whole)
    mixed = records(ran(tmp_path, "some", labels=("ukf[points=merwe]", "ins")))
    assert mixed == {key: expected[key] for key in mixed}


QUICK = ("returns nan", "wrong shape", "negative variance", "masked")


@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=() if kind in QUICK else pytest.mark.long) for kind in FAULTS],
)
def test_an_estimator_that_fails_becomes_records(kind, tmp_path):
    """What an estimator does wrong is the reason in its record; the others are not touched."""
    label = f"{naughty(tmp_path)}[kind={kind}]"
    results = ran(tmp_path, labels=(label, "ekf"), runs=2)
    found = records(results)
    for key, record in found.items():
        if key[1] == "ekf":
            assert record["status"] == "ok"
        else:
            assert record["status"] == "failed"
            assert record["name"] == "naughty"
            with pytest.raises(ValueError, match=FAULTS[kind]):
                raise ValueError(record["reason"])
    summary = results.metrics()
    counts = summary.groupby("name")["failed"].max()
    assert counts.to_dict() == {"naughty": 2, "ekf": 0}


@thinned("kind", HARMLESS)
def test_what_is_odd_but_harmless_does_not_stop_a_campaign(kind, tmp_path):
    """Lists for arrays, remarks that no file can hold: accepted or recorded, never a crash."""
    label = f"{naughty(tmp_path)}[kind={kind}]"
    found = records(ran(tmp_path, labels=(label, "ekf"), runs=1))
    assert found["base", "ekf", 0]["status"] == "ok"
    assert found["base", label, 0]["status"] in ("ok", "failed")


ASKING = """
from dataclasses import dataclass
import numpy as np
from ggbench.problem import Estimate, Estimator


@dataclass(frozen=True)
class Asking(Estimator):
    points: int = 1
    name = "asking"
    causality = "filter"

    def estimate(self, problem, rng):
        states = np.zeros((problem.epochs, problem.dimension))
        problem.model.predict(1, np.zeros((2, self.points, problem.dimension)))
        problem.model.predict(2, states[0])
        problem.model.jacobian(3, states[0])
        assert not hasattr(problem.model, "left_by_another")
        problem.model.left_by_another = True
        return Estimate(states, None, "filter")
"""


def asking(tmp_path: Path) -> str:
    """The path of an estimator that asks h at 2 times some points and at one, and H at one."""
    (tmp_path / "asking.py").write_text(ASKING)
    return str(tmp_path / "asking.py")


def test_points_at_which_the_map_was_evaluated_are_each_estimators_own(tmp_path):
    """A record counts what its own estimator asked in its own run, and nothing of the others'."""
    labels = [f"{asking(tmp_path)}[points={points}]" for points in (5, 7, 0)]
    found = records(ran(tmp_path, labels=("filterpy-ekf", "ins", *labels), runs=2))
    for case, label, run in found:
        counts = dict(zip(labels, (12, 16, 2), strict=True)) | {"filterpy-ekf": 40, "ins": 0}
        assert found[case, label, run]["map_evaluations"] == counts[label]


def test_a_model_that_counts_nothing_has_no_evaluations(tmp_path, monkeypatch):
    """Any measurement model can be judged in a campaign: 0 points of one that does not count."""
    real = ProblemBlock.problem

    def over_lines(block, run):
        problem = real(block, run)
        rows = np.zeros((problem.epochs, problem.measurements.shape[1], problem.dimension))
        return changed(problem, model=LinearModel(rows))

    monkeypatch.setattr(ProblemBlock, "problem", over_lines)
    for record in ran(tmp_path, labels=("filterpy-ekf",), runs=1).records():
        assert (record["status"], record["map_evaluations"]) == ("ok", 0)


@pytest.mark.long
def test_an_estimator_that_fails_in_some_runs(tmp_path, monkeypatch):
    """Failed runs are counted and left out; the finished ones are judged and reported."""
    monkeypatch.chdir(tmp_path)  # a whole path would be too long for the figures of the report
    case = small(tmp_path).cases[0]
    problems = [simulate(flights.flight_of(case), 5, run)[0] for run in range(4)]
    firsts = sorted(problem.measurements[0, 0] for problem in problems)
    naughty(tmp_path, float(np.mean(firsts[1:3])))
    label = "naughty.py[kind=raises in some runs]"
    results = ran(tmp_path, labels=("ins", label), runs=4)
    statuses = [records(results)["base", label, run]["status"] for run in range(4)]
    assert sorted(statuses) == ["failed", "failed", "ok", "ok"]
    assert {r["reason"] for r in results.records()} == {"", "ArithmeticError: not this one"}
    table = results.metrics()
    row = table[(table["case"] == "base") & (table["name"] == "naughty")].iloc[0]
    assert (row["runs"], row["failed"]) == (4, 2)
    assert np.isfinite(row["rms_m"])
    text = render.write(results.folder, tmp_path / "reports")[0].read_text()
    failures = tmp_path / "reports" / "small" / "data" / "failures.csv"
    count = sum(record["status"] == "failed" for record in results.records())
    assert f"{count} failed runs" in text
    assert failures.read_text().count("ArithmeticError: not this one") == count > 2


def test_a_campaign_of_nothing_but_failures_is_summed_up(tmp_path):
    """Even if every run of every estimator fails, there is a table, and it counts them."""
    label = f"{naughty(tmp_path)}[kind=nothing]"
    results = ran(tmp_path, labels=(label,), runs=2)
    table = results.metrics()
    assert table["failed"].tolist() == [2] * len(table)


def test_an_estimator_that_cannot_take_the_problem_is_left_out(tmp_path):
    """A reason to skip is told before anything runs; if none is left, nothing runs."""
    bad = "ukf[kappa=-20]"
    work = plan(tmp_path, "out", ("ins", bad))
    store, (reason,) = work.open()
    assert reason.startswith(f"{bad} is left out: n + kappa must be positive")
    assert {label for task in work.tasks(store) for label, _ in task.estimators} == {"ins"}
    work = plan(tmp_path, "none", (bad,))
    with pytest.raises(CampaignError, match=r"all estimators refuse this scenario: .*n \+ kappa"):
        work.open()


CHOOSY = """
from dataclasses import dataclass

import numpy as np

from ggbench.problem import Estimate, Estimator


@dataclass(frozen=True)
class Choosy(Estimator):
    name = "choosy"
    causality = "filter"

    def skip(self, problem):
        return "its noise is too large" if problem.noise_cov.max() > 1e-3 else None

    def estimate(self, problem, rng):
        cov = np.tile(problem.prior_cov, (problem.epochs, 1, 1))
        return Estimate(np.zeros((problem.epochs, problem.dimension)), cov, "filter")
"""


def test_an_estimator_is_left_out_of_the_case_that_it_cannot_take(tmp_path):
    """It runs in the others; the folder states the reason, and a page can be written."""
    (tmp_path / "choosy.py").write_text(CHOOSY)
    label = str(tmp_path / "choosy.py")
    work = plan(tmp_path, "out", ("ins", label))
    store, (reason,) = work.open()
    assert reason == f"{label} is left out of noisy: its noise is too large"
    runs = {(t.case.name, k) for t in work.tasks(store) for k, _ in t.estimators}
    assert runs == {("base", "ins"), ("noisy", "ins"), ("base", label)}
    store.close()
    results = running.fly(work, jobs=0)
    assert results.manifest["left_out"] == {label: {"noisy": "its noise is too large"}}
    held = results.runs()
    assert set(held[held["estimator"] == label]["case"]) == {"base"}
    assert set(held[held["estimator"] == "ins"]["case"]) == {"base", "noisy"}
    assert not len(results.failures())
    page = render.write(results.folder, tmp_path / "reports")[0].read_text()
    assert "choosy" in page
    results.store.close()
    # A further campaign of the other case keeps the reason.
    again = plan(tmp_path, "out", ("ins", label), cases=("base",))
    results = running.fly(again, jobs=0)
    assert results.manifest["left_out"] == {label: {"noisy": "its noise is too large"}}
    results.store.close()


class Hesitant(registry.choose("ins").estimator.__class__):
    """An estimator whose skip raises a long text, or returns one."""

    raises = False

    def skip(self, problem):
        if self.raises:
            raise KeyError("a" * 9000)
        return "b\n" * 9000


def test_a_refusal_is_one_short_line():
    """Whatever a skip returns or raises; no reason is an empty text."""
    estimator = Hesitant()
    reason = refusal(estimator, None)
    assert reason.startswith("b b b") and len(reason) <= 300
    object.__setattr__(estimator, "raises", True)
    reason = refusal(estimator, None)
    assert reason.startswith("its skip raises KeyError: 'aaa") and len(reason) <= 300
    assert refusal(registry.choose("ins").estimator, None) == ""


def missing(work, store) -> set[tuple[str, str, int]]:
    """What a campaign would still run: case, estimator, run."""
    return {
        (t.case.name, label, run)
        for t in work.tasks(store)
        for label, _ in t.estimators
        for run in t.runs
    }


def test_a_campaign_goes_on_where_it_stopped(whole, tmp_path):
    """What is stored is not run again; more runs and more estimators are added to it."""
    ran(tmp_path, "parts", labels=LABELS[:2], runs=1).store.close()
    work = plan(tmp_path, "parts", LABELS)
    store, remarks = work.open()
    assert remarks == []
    assert missing(work, store) == {k for k in records(whole) if k[2] > 0 or k[1] == LABELS[2]}
    running.execute(execution.in_process(work.tasks(store)), store, lambda batch: None)
    assert_equal(Results(store.folder, store), whole)
    assert work.tasks(store).results == 0


def test_estimators_asked_for_before_stay_in_the_tables(tmp_path):
    """A command that adds an estimator to a folder reports the stored ones beside it."""
    ran(tmp_path, labels=LABELS[:2], runs=2).store.close()
    later = ran(tmp_path, labels=LABELS[2:], runs=1)
    assert later.labels == list(LABELS)
    assert later.metrics().groupby("estimator")["runs"].first().to_dict() == {
        "ins": 2,
        "ekf": 2,
        LABELS[2]: 1,
    }


_HEAD, _BASE, _NOISY = SMALL.split("[[case]]")
REORDERED = "[[case]]".join([_HEAD, _NOISY, _BASE])
FASTER = SMALL.replace("speed_mps = 250.0", "speed_mps = 251.0")
SAME_CONTENT = {
    "title": SMALL.replace('title = "as it is"', 'title = "something else"'),
    "description": SMALL.replace("For tests", "For all tests"),
    "name of a case": SMALL.replace('name = "base"', 'name = "first"'),
    "order of the cases": REORDERED,
    "a default spelt out": SMALL.replace("[windows]", "gravity_disturbance = false\n\n[windows]"),
    "a reference": SMALL.replace("value = 6.0", "value = 5.0"),
    "one case more": SMALL + '\n[[case]]\nname = "third"\ntitle = "x"\nimu.biases = "fixed"\n',
}


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(
            change,
            marks=pytest.mark.long if change in ("title", "description", "a reference") else (),
        )
        for change in SAME_CONTENT
    ],
)
def test_stored_runs_are_known_by_their_content(change, tmp_path):
    """Names, titles, order, other cases: what does not change a result does not run it again."""
    ran(tmp_path, runs=1).store.close()
    loaded = small(tmp_path, SAME_CONTENT[change])
    work = plan(tmp_path, "out", tuple(reversed(LABELS)), runs=1, scenario=loaded)
    store, remarks = work.open()
    assert {case for case, _, _ in missing(work, store)} <= {"third"}
    assert remarks == []
    names = {case.name for case in loaded.cases} - {"third"}
    results = Results(store.folder, store)
    assert {(r["case"], r["estimator"]) for r in results.records()} == {
        (name, label) for name in names for label in LABELS
    }


@pytest.mark.long
@pytest.mark.parametrize("change", ["noise_eotvos = 0.2", "name"])
def test_a_folder_is_joined_by_content(change, tmp_path):
    """After an edit of one case, a command for the other one reports what is still true.

    Results of the edited case are out, those of a renamed one are in.
    """
    ran(tmp_path, labels=("ins", "ekf"), runs=3).store.close()
    text = SMALL.replace('name = "noisy"', 'name = "loud"')
    if change != "name":
        text = SMALL.replace("gradiometer.noise_eotvos = 0.1", f"gradiometer.{change}")
        assert text != SMALL
    loaded = small(tmp_path, text)
    results = ran(tmp_path, labels=("ekf",), runs=1, cases=("base",), scenario=loaded)
    expected = ["base", "loud"] if change == "name" else ["base"]
    assert results.manifest["cases"] == expected
    assert len(results.runs()) == len(expected) * 2 * 3
    assert "-n 3 " in render.write(results.folder, tmp_path / "reports")[0].read_text()


def test_a_map_is_its_content(tmp_path):
    """Where a map's file lies is no part of what is simulated; what it holds is."""
    case = small(tmp_path).cases[0]
    problems = []
    for name, content in (("a.npz", b"map"), ("b.npz", b"map"), ("c.npz", b"other map")):
        (tmp_path / name).write_bytes(content)
        field = case.field.model_copy(update={"source": str(tmp_path / name)})
        problems.append(result_keys.problem_key(case.model_copy(update={"field": field}), 1))
    problems.append(result_keys.problem_key(case, 1))
    assert problems[0] == problems[1]
    assert len(set(problems)) == 3


def test_two_spellings_of_one_estimator_are_one(tmp_path):
    """Defaults spelt out are no other estimator, in one command or in two."""
    ran(tmp_path, labels=("ukf",), runs=1).store.close()
    results = ran(tmp_path, labels=("ukf[points=julier]",), runs=1)
    assert results.labels == ["ukf[points=julier]"]
    assert len(results.runs()) == 2
    chosen = registry.choose_all(["ukf", "ekf", "ukf[points=julier]"])
    assert [choice.label for choice in chosen] == ["ukf", "ekf"]


OTHER_CONTENT = {
    "seed": {"seed": 6},
    "scenario": {"text": FASTER},
    "estimator's source": {"median": 1.0},
    "estimator's parameter": {"kind": "lists"},
    "library": {"numpy": "0.0"},
}


@thinned("change", OTHER_CONTENT, every=2)
def test_runs_of_other_content_are_neither_used_nor_lost(change, tmp_path, monkeypatch):
    """Whatever a result depends on is in its key: if it changes, the run is run again.

    What was stored before stays in the folder: the first command finds it again.
    """
    first = naughty(tmp_path)
    before = ran(tmp_path, labels=(first,), runs=1)
    expected = records(before)
    before.store.close()
    new = OTHER_CONTENT[change]
    if "median" in new:
        naughty(tmp_path, **new)
    label = f"{first}[kind={new['kind']}]" if "kind" in new else first
    if "numpy" in new:
        changed = result_keys.environment() | {"versions": {"numpy": "0.0"}}
        monkeypatch.setattr(result_keys, "environment", lambda: changed)
        monkeypatch.setattr(runner, "key_of", runner.key_of.__wrapped__)
    runner.chosen.cache_clear()
    loaded = small(tmp_path, new.get("text", SMALL))
    options = {"runs": 1, "seed": new.get("seed", 5), "scenario": loaded}
    work = plan(tmp_path, "out", (label,), **options)
    store, remarks = work.open()
    assert missing(work, store) == {(case, label, 0) for case in ("base", "noisy")}
    if change != "estimator's parameter":  # then both are of this campaign
        assert "contains 2 results of another seed" in remarks[0]
        assert list(Results(store.folder, store).records()) == []
    store.close()

    monkeypatch.undo()
    naughty(tmp_path)
    runner.chosen.cache_clear()
    work = plan(tmp_path, "out", (first,), runs=1)
    store, _ = work.open()
    assert work.tasks(store).results == 0
    found = records(Results(store.folder, store))
    assert {key: found[key] for key in expected} == expected


@pytest.mark.long
def test_a_worker_runs_nothing_but_what_was_planned(tmp_path):
    """An estimator's file that changes while a campaign runs ends it; nothing is stored wrongly."""
    label = naughty(tmp_path)
    work = plan(tmp_path, "out", (label,), runs=1)
    store, _ = work.open()
    tasks = work.tasks(store)
    naughty(tmp_path, median=1.0)
    with pytest.raises(runner.OtherSourceError, match="differs from that of the campaign"):
        running.execute(execution.in_processes(tasks, 1, 60.0), store, lambda batch: None)
    assert store.finished() == {}


def test_some_cases_only(tmp_path):
    """Cases can be chosen, and added later; a wrong name is told with what there is."""
    results = ran(tmp_path, labels=("ins",), runs=1, cases=("noisy",))
    assert {r["case"] for r in results.records()} == {"noisy"}
    assert [case.name for case in results.scenario.cases] == ["noisy"]
    results.store.close()
    results = ran(tmp_path, labels=("ins",), runs=1, cases=("base",))
    assert [case.name for case in results.scenario.cases] == ["base", "noisy"]
    with pytest.raises(ScenarioError, match=r"no case 'nosy' \(did you mean 'noisy'\?\)"):
        ran(tmp_path, cases=("nosy",))


def test_runs_in_a_notebook(tmp_path):
    """The Parquet file holds one row per run and estimator, with what the records say."""
    results = ran(tmp_path, runs=2)
    table = pd.read_parquet(tmp_path / "out" / "runs.parquet")
    assert len(table) == 2 * len(LABELS) * 2
    for row in table.to_dict("records"):
        record = records(results)[row["case"], row["estimator"], row["run"]]
        assert row["settled_position_ms"] == record["settled_position_ms"]
        assert row["status"] == "ok" and row["seed"] == 5
        assert f"--case {row['case']} " in row["command"]
    pd.testing.assert_frame_equal(table, results.runs())
