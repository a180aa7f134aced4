"""Campaigns: reproducible, resumable, indifferent to failing estimators, wary of their folder."""

from __future__ import annotations

import json
import pickle
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from problems import SMALL

from ggbench import campaign, metrics, report, runner, scenario
from ggbench.campaign import Campaign, CampaignError
from ggbench.errors import GGBenchError
from ggbench.store import Store, StoreError

LABELS = ("ins", "ekf", "ukf[points=merwe]")
NAUGHTY = """
import os
from dataclasses import dataclass
from typing import Literal
import numpy as np
from ggbench.problem import Estimate, Estimator


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
}
HARMLESS = ("lists", "odd info")


def naughty(tmp_path: Path, median: float = 0.0) -> str:
    """The path of an estimator file that does wrong in the way it is asked to."""
    path = tmp_path / "naughty.py"
    kinds = ("good", "raises in some runs", *FAULTS, *HARMLESS)
    path.write_text(
        NAUGHTY.replace("KINDS", ", ".join(map(repr, kinds))).replace("MEDIAN", repr(median))
    )
    return str(path)


def small(tmp_path: Path) -> scenario.Scenario:
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return scenario.load(str(path))


def ran(
    tmp_path: Path, folder: str = "out", labels: tuple[str, ...] = LABELS, **options: Any
) -> Store:
    """The store of a campaign on the small scenario, run to its end."""
    jobs = options.pop("jobs", 0)
    settings = {"runs": 3, "seed": 5, "assumptions": False} | options
    work = Campaign(small(tmp_path), labels, folder=tmp_path / folder, **settings)
    campaign.check(work.scenario, assumptions=False)
    store = work.open()
    work.prepare_cases(store)
    campaign.execute(work.tasks(store), store, jobs, lambda done, total: None)
    campaign.summarize(store, work.scenario)
    return store


def records(store: Store) -> dict[tuple[str, str, int], dict[str, Any]]:
    """Records without what may differ between two equal campaigns: time and memory."""
    found = list(store.records())
    for record in found:
        record.pop("seconds", None)
        record.pop("peak_memory_mb", None)
    return {(r["case"], r["estimator"], r["run"]): r for r in found}


def test_results_do_not_depend_on_the_number_of_processes(tmp_path):
    """The same seed gives the same records and series, in one process or in two."""
    alone, together = ran(tmp_path, "one"), ran(tmp_path, "two", jobs=2)
    expected = records(alone)
    assert len(expected) == 2 * len(LABELS) * 3
    assert {r["status"] for r in expected.values()} == {"ok"}
    assert records(together) == expected
    for case, label in {key[:2] for key in expected}:
        assert np.array_equal(
            alone.series(case, label), together.series(case, label), equal_nan=True
        )
        assert np.array_equal(alone.detail(case, label, 0), together.detail(case, label, 0))


def test_runs_differ_and_cases_are_paired(tmp_path):
    """Another run or another seed is another draw; two cases share what they have in common."""
    first, other = records(ran(tmp_path, "a")), records(ran(tmp_path, "b", seed=6))
    final = "final_position_error_m"
    assert len({r["base", "ins", run][final] for r in (first, other) for run in range(3)}) == 6
    for run in range(3):
        assert first["base", "ins", run][final] == first["noisy", "ins", run][final]
        assert first["base", "ekf", run][final] != first["noisy", "ekf", run][final]


def test_results_do_not_depend_on_the_company(tmp_path):
    """An estimator's records are the same whichever others run beside it, in whatever order."""
    expected = records(ran(tmp_path, "all"))
    mixed = records(ran(tmp_path, "some", labels=("ukf[points=merwe]", "ins")))
    assert mixed == {key: expected[key] for key in mixed}


@pytest.mark.parametrize("kind", FAULTS)
def test_an_estimator_that_fails_becomes_records(kind, tmp_path):
    """What an estimator does wrong is the reason in its record; the others are not touched."""
    label = f"{naughty(tmp_path)}[kind={kind}]"
    store = ran(tmp_path, labels=(label, "ekf"), runs=2)
    found = records(store)
    for key, record in found.items():
        if key[1] == "ekf":
            assert record["status"] == "ok"
        else:
            assert record["status"] == "failed"
            assert record["name"] == "naughty"
            with pytest.raises(ValueError, match=FAULTS[kind]):
                raise ValueError(record["reason"])
    summary, _ = campaign.summarize(store, small(tmp_path))
    counts = summary.groupby("estimator")["failed"].max()
    assert counts.to_dict() == {"naughty": 2, "ekf": 0}


@pytest.mark.parametrize("kind", HARMLESS)
def test_what_is_odd_but_harmless_does_not_stop_a_campaign(kind, tmp_path):
    """Lists for arrays, remarks that no file can hold: accepted or recorded, never a crash."""
    label = f"{naughty(tmp_path)}[kind={kind}]"
    found = records(ran(tmp_path, labels=(label, "ekf"), runs=1))
    assert found["base", "ekf", 0]["status"] == "ok"
    assert found["base", label, 0]["status"] in ("ok", "failed")


def test_an_estimator_that_fails_in_some_runs(tmp_path):
    """Failed runs are counted and left out; the finished ones are judged and reported."""
    case = small(tmp_path).cases[0]
    problems = [runner.simulate(runner.flight_of(case), 5, run)[0] for run in range(4)]
    firsts = sorted(problem.measurements[0, 0] for problem in problems)
    label = f"{naughty(tmp_path, float(np.mean(firsts[1:3])))}[kind=raises in some runs]"
    store = ran(tmp_path, labels=("ins", label), runs=4)
    statuses = [records(store)["base", label, run]["status"] for run in range(4)]
    assert sorted(statuses) == ["failed", "failed", "ok", "ok"]
    assert {r.get("reason") for r in store.records()} == {None, "ArithmeticError: not this one"}
    table, _ = campaign.summarize(store, small(tmp_path))
    row = table[(table["case"] == "base") & (table["estimator"] == "naughty")].iloc[0]
    assert (row["runs"], row["failed"]) == (4, 2)
    assert np.isfinite(row["position_mrse_m"])
    text = report.write(store.folder, tmp_path / "reports").read_text()
    assert "ArithmeticError: not this one" in text


def test_a_campaign_of_nothing_but_failures_is_summed_up(tmp_path):
    """Even if every run of every estimator fails, there is a table, and it counts them."""
    label = f"{naughty(tmp_path)}[kind=nothing]"
    store = ran(tmp_path, labels=(label,), runs=2)
    table, _ = campaign.summarize(store, small(tmp_path))
    assert table["failed"].tolist() == [2] * len(table)


def test_an_estimator_that_cannot_take_the_problem_is_left_out(tmp_path):
    """A reason to skip is told before anything runs; if none is left, nothing runs."""
    bad = "ukf[kappa=-20]"
    work = Campaign(small(tmp_path), ("ins", bad), 1, 5, False, tmp_path / "out")
    store = work.open()
    (reason,) = work.prepare_cases(store)
    assert reason.startswith(f"{bad} is left out: n + kappa must be positive")
    assert work.labels == ("ins",)
    assert all(task.estimators == ("ins",) for task in work.tasks(store))
    work = Campaign(small(tmp_path), (bad,), 1, 5, False, tmp_path / "none")
    with pytest.raises(CampaignError, match=r"no estimator can take this scenario: .*n \+ kappa"):
        work.prepare_cases(work.open())


def test_a_campaign_goes_on_where_it_stopped(tmp_path):
    """What is stored is not run again; more runs and more estimators are added to it."""
    whole = records(ran(tmp_path, "whole"))
    ran(tmp_path, "parts", labels=LABELS[:2], runs=1).close()
    work = Campaign(small(tmp_path), LABELS, 3, 5, False, tmp_path / "parts")
    store = work.open()
    missing = {(t.case.name, label, t.run) for t in work.tasks(store) for label in t.estimators}
    assert missing == {k for k in whole if k[2] > 0 or k[1] == LABELS[2]}
    campaign.execute(work.tasks(store), store, 0, lambda done, total: None)
    assert records(store) == whole
    assert work.tasks(store) == []


@pytest.mark.parametrize("change", ["seed", "scenario", "estimator file"])
def test_results_of_another_campaign_are_not_mixed_in(change, tmp_path):
    """Another seed, scenario or estimator's code in the same folder is refused, not averaged."""
    own = naughty(tmp_path)
    ran(tmp_path, labels=("ins", own), runs=1).close()
    loaded = small(tmp_path)
    seed = 5
    if change == "seed":
        seed = 6
    elif change == "scenario":
        path = tmp_path / "small.toml"
        path.write_text(SMALL.replace("speed_mps = 250.0", "speed_mps = 251.0"))
        loaded = scenario.load(str(path))
    else:
        naughty(tmp_path, median=1.0)
    work = Campaign(loaded, ("ins", own), 1, seed, False, tmp_path / "out")
    with pytest.raises(StoreError, match=r"holds results with another .*choose another -o, or --f"):
        work.open()
    work.fresh = True
    store = work.open()
    assert store.finished() == set()
    assert store.manifest()["seed"] == seed


def test_a_folder_of_other_things_is_left_alone(tmp_path):
    """A folder that holds something else is refused; --fresh removes results and nothing else."""
    folder = tmp_path / "thesis"
    folder.mkdir()
    (folder / "chapter1.txt").write_text("years of work")
    work = Campaign(small(tmp_path), ("ins",), 1, 5, False, folder, fresh=True)
    with pytest.raises(StoreError, match="is not empty and holds no results"):
        work.open()
    store = ran(tmp_path, "out", runs=1)
    store.close()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    ran(tmp_path, "out", runs=1, seed=9, fresh=True).close()
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"


def test_a_folder_that_cannot_be_made_has_its_sentence(tmp_path):
    """A file where the folder should be is an error with a sentence."""
    (tmp_path / "file").write_text("")
    work = Campaign(small(tmp_path), ("ins",), 1, 5, False, tmp_path / "file")
    with pytest.raises(StoreError, match="cannot use results folder"):
        work.open()
    work.folder = tmp_path / "file" / "below"
    with pytest.raises(StoreError, match="cannot use results folder"):
        work.open()


class Trap:
    """A pickle of this creates a file when it is loaded."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple:
        return Path.touch, (self.path,)


QUERIES = {
    "record that is no JSON": "UPDATE records SET record = '{'",
    "record without its content": "UPDATE records SET record = '{}'",
    "series cut": "UPDATE records SET series = x'0011'",
    "database of something else": "ALTER TABLE records RENAME COLUMN record TO something",
}
TEXTS = {
    "manifest cut": ("manifest.json", '{"scenario": '),
    "manifest of something else": ("manifest.json", "[1, 2]"),
    "manifest empty": ("manifest.json", "{}"),
    "scenario spoilt": ("scenario.toml", "[[["),
    "database overwritten": ("records.sqlite", "not a database" * 1000),
    "database empty": ("records.sqlite", ""),
}
GONE = {"manifest gone": "manifest.json", "scenario gone": "scenario.toml"}
GONE["arrays gone"] = "case-base.npz"


def damage(folder: Path, kind: str) -> None:
    """Spoil one thing in a results folder."""
    database, arrays = folder / "records.sqlite", folder / "case-base.npz"
    trap = np.array([Trap(folder / "sprung")], dtype=object)
    if kind in QUERIES:
        with sqlite3.connect(database) as connection:
            connection.execute(QUERIES[kind])
    elif kind in TEXTS:
        name, text = TEXTS[kind]
        (folder / name).write_text(text)
    elif kind in GONE:
        (folder / GONE[kind]).unlink()
    elif kind == "database spoilt inside":
        content = database.read_bytes()
        database.write_bytes(content[:4096] + b"\xa5" * (len(content) - 4096))
    elif kind == "database cut":
        database.write_bytes(database.read_bytes()[: database.stat().st_size // 3])
    elif kind == "arrays cut":
        arrays.write_bytes(arrays.read_bytes()[:300])
    elif kind == "arrays of something else":
        np.savez(arrays, other=np.zeros(3))
    elif kind == "arrays not zipped":
        with arrays.open("wb") as file:
            np.save(file, np.zeros(3))
    elif kind == "arrays pickled":
        np.savez(arrays, times=trap, **{"bound-filter": trap})
    else:
        arrays.write_bytes(pickle.dumps(Trap(folder / "sprung")))


DAMAGES = {
    "database overwritten": "records.sqlite",
    "database spoilt inside": "records.sqlite",
    "database cut": "records.sqlite",
    "database empty": "records.sqlite|no finished run",
    "database of something else": "records.sqlite",
    "record that is no JSON": "records.sqlite",
    "record without its content": "records.sqlite",
    "series cut": "records.sqlite",
    "manifest cut": "manifest.json.* is damaged",
    "manifest of something else": "manifest.json.* is damaged: not a JSON object",
    "manifest empty": "manifest.json",
    "manifest gone": "manifest.json.*No such file",
    "scenario gone": "scenario.toml.*No such file",
    "scenario spoilt": "scenario.toml.* is not valid TOML",
    "arrays gone": "case-base.npz cannot be read",
    "arrays cut": "case-base.npz cannot be read",
    "arrays of something else": "case-base.npz",
    "arrays not zipped": "case-base.npz",
    "arrays pickled": "case-base.npz cannot be read.*allow_pickle=False",
    "arrays a bare pickle": "case-base.npz cannot be read",
}


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Path:
    """A finished results folder, to be copied and spoilt."""
    tmp_path = tmp_path_factory.mktemp("results")
    store = ran(tmp_path, runs=2)
    store.close()
    return store.folder


@pytest.mark.parametrize("kind", DAMAGES)
def test_damaged_results_have_their_sentence(kind, results, tmp_path):
    """Whatever a folder's files have become, reporting it ends with one line that names the file.

    Nothing in a results folder is executed: a pickle planted in it is refused, not loaded.
    """
    folder = tmp_path / "out"
    folder.mkdir()
    for file in results.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    damage(folder, kind)
    with pytest.raises(GGBenchError, match=DAMAGES[kind]) as caught:
        report.write(folder, tmp_path / "reports")
    assert "\n" not in str(caught.value)
    assert not (folder / "sprung").exists()


def test_a_results_folder_says_what_made_it(results):
    """The manifest has scenario, seed, versions, machine and date; the folder the scenario."""
    manifest = json.loads((results / "manifest.json").read_text())
    assert (manifest["scenario"], manifest["seed"], manifest["runs"]) == ("small", 5, 2)
    assert manifest["estimators"] == list(LABELS)
    assert len(manifest["scenario_hash"]) == 64
    assert {"python", "numpy", "gtsam", "filterpy"} <= set(manifest["versions"])
    assert manifest["machine"]["processors"] >= 1
    assert manifest["date"].startswith("20")
    assert (results / "scenario.toml").read_text() == SMALL
    header = (results / "summary.csv").read_text().splitlines()[0]
    assert header == ",".join(metrics.SUMMARY_COLUMNS)
