"""A results folder read back: every metric from the runs, epochs and bounds that it is of."""

from __future__ import annotations

import errno
import importlib.util
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from campaigns import failed, finished, ran, small
from problems import SMALL

from ggbench.campaign import running
from ggbench.campaign.campaign import Campaign
from ggbench.judging.run_errors import WINDOWS, window_mask
from ggbench.judging.summary import METRICS
from ggbench.report import render
from ggbench.results.database import Result, StoreError
from ggbench.results.folder import Results, as_argument, write_tables
from ggbench.results.store import MOST_KEPT, Store, kept_epochs

STUDIED = (
    SMALL.replace("last_s = 5.0", "last_s = 5.0\nrequired_m = 6.0").replace(
        "[campaign]", '[campaign]\nassumption_runs = 2\nassumption_estimator = "ekf"'
    )
    + """windows.settled_from_s = 12.0

[[assumption]]
name = "without-effect"
title = "another regularisation, of a filter that there is not"
gradiometer.whitening_regularization = 1e-6

[[assumption]]
name = "louder"
title = "three times the noise"
gradiometer.noise_eotvos = 0.03
"""
)
KINDS = {
    "ins": "filter",
    "ekf": "filter",
    "factor-graph[mode=batch]": "batch",
    "factor-graph[mode=fixed-lag,lag=3]": "fixed-lag-3",
}
"""Estimators, and the bound that each is set beside."""


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Results:
    path = tmp_path_factory.mktemp("folder")
    loaded = small(path, STUDIED)
    return ran(path, labels=tuple(KINDS), runs=3, assumptions=True, scenario=loaded)


@pytest.fixture(scope="module")
def flown(tmp_path_factory) -> Path:
    """The folder of a campaign of two runs, which tests copy and spoil."""
    path = tmp_path_factory.mktemp("flown")
    results = ran(path, labels=("ins", "ekf"), runs=2)
    results.store.close()
    return results.folder


@pytest.fixture
def copied(flown, tmp_path) -> Results:
    """A copy of that folder."""
    return Results(shutil.copytree(flown, tmp_path / "copied"))


def test_bounds_of_a_summary_are_of_their_window_and_causality(results):
    """The root of the mean squared bound over the epochs of each window, of the estimator's kind.

    The four kinds are four bounds: of a filter, three epochs later, of all readings.
    """
    rows = results.metrics().set_index(["case", "estimator", "window"])
    seen = set()
    for case in results.scenario.cases:
        arrays = results.arrays(case.name)
        for label, kind in KINDS.items():
            for window in WINDOWS:
                mask = window_mask(arrays["times"], case.windows, window)
                wanted = np.sqrt(np.sum(arrays[f"bound-{kind}"][mask], axis=0) / mask.sum())
                row = rows.loc[case.name, label, window]
                found = row[["bound_m", "velocity_bound_mps"]].to_numpy(float)
                assert found == pytest.approx(wanted)
                seen.add(round(float(found[0]), 9))
    assert len(seen) == 2 * 3 * 3  # cases, windows, bounds


def test_published_numbers_stand_beside_their_case(results):
    """Position and velocity of the case that has them, nothing of the other."""
    rows = results.metrics().groupby("case")[["published_m", "published_mps"]].first()
    assert tuple(rows.loc["base"]) == (6.0, 0.3)
    assert rows.loc["noisy"].isna().all()


def test_a_study_is_set_beside_the_same_runs_without_it(results):
    """Of three runs two were studied: the declared metrics are of these two alone.

    One that changes nothing is the case itself, which has more results; it has its own two.
    """
    studies = results.studies().set_index(["assumption", "case", "window"])
    runs = results.runs()
    for name in ("", "louder", "without-effect"):
        of_study = (runs["assumption"] == name) & (runs["estimator"] == "ekf")
        assert len(runs[of_study & (runs["case"] == "base")]) == (2 if name else 3)
        own = runs[of_study & (runs["case"] == "base") & (runs["run"] < 2)]
        row = studies.loc[(name, "base", "settled")]
        assert (row["runs"], row["estimator"], row["published_m"]) == (2, "ekf", 6.0)
        wanted = np.sqrt(own["settled_position_ms"].mean())
        assert row["rms_m"] == pytest.approx(wanted)
    assert set(studies.loc["louder"].index.get_level_values("case")) == {"base"}
    declared, same = (studies.loc[name, "base"]["rms_m"] for name in ("", "without-effect"))
    assert declared.tolist() == same.tolist()


def test_a_study_is_read_without_the_run_of_its_case(tmp_path):
    """Assumptions are studied on the cases with published numbers, whichever cases are run."""
    loaded = small(tmp_path, STUDIED)
    found = ran(
        tmp_path, labels=("ins",), runs=1, cases=("noisy",), assumptions=True, scenario=loaded
    )
    runs = found.runs()
    assert set(zip(runs["assumption"], runs["case"], strict=True)) == {
        ("", "noisy"),
        ("louder", "base"),
        ("without-effect", "base"),
    }


def test_records_are_of_the_cases_or_of_one_study(results):
    """The cases' runs are not mixed with a study's of the same case."""
    assert sum(1 for _ in results.records()) == 2 * len(KINDS) * 3
    for name in ("louder", "without-effect"):
        studied = list(results.records(name))
        assert [(r["case"], r["estimator"], r["run"]) for r in studied] == [
            ("base", "ekf", 0),
            ("base", "ekf", 1),
        ]
    assert list(results.records("other")) == []


def test_the_files_of_a_folder_are_its_tables(results, flown):
    """Row by row and column by column; what was not studied or judged has no file."""
    tables = {
        "pairs": results.pairs(),
        "failures": results.failures(),
        "cases": results.cases(),
        "assumptions": results.studies(),
        "metrics": results.metrics(),
    }
    assert tuple(tables["metrics"].columns) == METRICS
    for name, table in tables.items():
        file = pd.read_csv(results.folder / f"{name}.csv")
        assert (list(file.columns), len(file)) == (list(table.columns), len(table))
    runs = pd.read_parquet(results.folder / "runs.parquet")
    pd.testing.assert_frame_equal(runs, results.runs())
    assert not {"assumptions.csv", "fixes.csv"} & {path.name for path in flown.iterdir()}


def test_without_pyarrow_the_table_of_runs_is_csv(copied, monkeypatch):
    """The same table, to the last bit; what the other format held is gone, and comes back."""
    results = copied
    assert (results.folder / "runs.parquet").exists()
    found = importlib.util.find_spec
    with monkeypatch.context() as patch:
        patch.setattr(importlib.util, "find_spec", lambda n: None if n == "pyarrow" else found(n))
        write_tables(results)
    file = pd.read_csv(results.folder / "runs.csv")
    assert not (results.folder / "runs.parquet").exists()
    table = results.runs()
    assert list(file.columns) == list(table.columns)
    for name in ("settled_position_ms", "settled_nees", "whole_velocity_ms"):
        assert (file[name] == table[name]).all()
    write_tables(results)
    names = {path.name for path in results.folder.iterdir()}
    assert "runs.parquet" in names and "runs.csv" not in names


def test_tables_are_the_callers_own(results):
    """What is done to one does not come back with the next."""
    for read in (results.runs, results.metrics, results.pairs, results.cases):
        table = read()
        table["case"] = "spoilt"
        assert set(read()["case"]) == {"base", "noisy"}, read


def test_a_command_takes_any_path_as_its_scenario():
    """Neither a space divides it, nor a dash makes it an option."""
    assert as_argument("my flights/a.toml") == "'my flights/a.toml'"
    assert as_argument("-a.toml") == "./-a.toml"


def test_a_command_repeats_its_own_run(results):
    """The case, the study's if there is one, the estimator, the seed and the run."""
    runs = results.runs().set_index(["assumption", "case", "estimator", "run"])
    command = "ggbench run small.toml --case {} -e {} --seed 5 --run {}".format
    assert runs.loc[("louder", "base", "ekf", 1), "command"] == command("louder/base", "ekf", 1)
    assert runs.loc[("", "noisy", "ekf", 2), "command"] == command("noisy", "ekf", 2)
    label = "factor-graph[mode=batch]"
    quoted = command("base", f"'{label}'", 0)
    assert runs.loc[("", "base", label, 0), "command"] == quoted


def test_counters_are_medians_over_an_estimators_own_runs(results, monkeypatch):
    """Of numbers alone, of runs that finished and that count; who counts nothing has no row."""
    fresh = Results(results.folder, results.store)
    (cell, *_) = (c for c in fresh.cells if (c.assumption, c.estimator) == ("", "ekf"))

    def infos(key, runs):
        if key != cell.key:
            return [{"remark": "none"}]
        return [{"rounds": n, "remark": "text"} if n else {} for n in (3, 9, 4, None, 7)]

    monkeypatch.setattr(results.store, "infos", infos)
    assert fresh.counters().to_dict("records") == [
        {"case": cell.case, "estimator": "ekf", "rounds": 5.5}
    ]


def test_remarks_are_of_finished_runs(tmp_path):
    store = Store(tmp_path / "out", create=True)
    store.add([Result("k", failed(3)), Result("k", finished(4, info={"rounds": 2}))])
    assert store.infos("k", 5) == [{"rounds": 2}] and store.infos("k", 4) == []


@pytest.mark.parametrize("epochs", [1, 2, 399, 400, 401, 5000])
def test_the_epochs_of_a_series_are_spread_over_the_flight(epochs):
    """All, or an even choice of many: first and last always, none twice."""
    kept = kept_epochs(epochs)
    assert (kept[0], kept[-1]) == (0, epochs - 1)
    assert len(set(kept.tolist())) == len(kept) == min(epochs, MOST_KEPT)
    assert np.ptp(np.diff(kept)) <= 1 if epochs > 1 else True


def test_a_run_that_is_missing_has_no_series(tmp_path):
    """Nor that of the next one that is there."""
    store = Store(tmp_path / "out", create=True)
    store.add([Result("k", failed(3), np.ones((2, 4)), np.ones((2, 18)))])
    assert store.series_of("k", 3).shape == (2, 4) and store.detail("k", 3).shape == (2, 18)
    assert store.series_of("k", 2) is None and store.detail("k", 2) is None
    store.close()


def test_what_runs_share_is_not_their_records(tmp_path):
    """What is stored of a case's runs does not tell that its arrays are."""
    store = Store(tmp_path / "out", create=True)
    store.add([Result("k", failed())])
    store.write_arrays("other", {"times": np.ones(2)})
    assert store.has_arrays("other") and not store.has_arrays("k")
    store.close()


def test_results_are_added_together_or_not_at_all(tmp_path):
    """Where one of them cannot be stored, none is."""
    store = Store(tmp_path / "out", create=True)
    with pytest.raises(StoreError, match=r"cannot write to .* the same command resumes"):
        store.add([Result("k", failed()), Result("k", failed(-1))])
    assert store.finished() == {}
    store.close()


def test_as_many_runs_are_read_as_are_asked_for(tmp_path):
    """In order, and none beyond those asked for, one by one and as a table."""
    store = Store(tmp_path / "out", create=True)
    held = 5100
    store.add(Result("k", failed(run), np.full((2, 4), float(run))) for run in range(held)[::-1])
    for runs, first in ((held + 9, 0), (2000, 0), (2300, 7), (1, 0)):
        found = [record["run"] for record in store.records("k", runs, first)]
        assert found == list(range(first, min(runs, held)))
        assert store.runs({"k"}, runs)["run"].tolist() == list(range(min(runs, held)))
    assert store.series("k", 2000)[:, 0, 0].tolist() == list(range(2000))
    store.close()


def test_rows_are_in_the_order_in_which_they_were_asked_for(results):
    """Case by case as in the scenario, and in each the estimators as on the command line."""
    rows = results.metrics()[["case", "estimator", "window"]].itertuples(index=False, name=None)
    cases = [case.name for case in results.scenario.cases]
    assert list(rows) == [(c, label, w) for c in cases for label in KINDS for w in WINDOWS]
    assert set(results.metrics()["runs"]) == {3}  # a study's are not among them


def test_series_are_of_the_cases_and_not_of_a_study(results):
    """All at once or alone, they end with the error that the run's own record tells."""
    for record in results.records():
        case, label, run = record["case"], record["estimator"], record["run"]
        alone = results.series_of(case, label, run)
        assert np.array_equal(results.series(case, label)[run], alone, equal_nan=True)
        assert alone[-1, 0] == pytest.approx(record["final_position_error_m"], rel=1e-6)


def test_cases_that_were_not_run_are_not_shown(tmp_path):
    """Of two cases one was asked for: the other is in the scenario's copy and nowhere else."""
    results = ran(tmp_path, labels=("ins",), runs=1, scenario=small(tmp_path).select(["noisy"]))
    assert [case.name for case in results.scenario.cases] == ["noisy"]
    assert [case.name for case in results.whole_scenario.cases] == ["base", "noisy"]
    assert set(results.metrics()["case"]) == set(results.runs()["case"]) == {"noisy"}


def test_estimators_that_look_for_truth_are_told_with_what_they_use(results):
    """Those that use nothing are not; nor is anything made of what is no list."""
    held = {"a": {}, "b": {"seeks": []}, "c": {"seeks": ["gc", "inspect"]}, "d": {"seeks": "gc"}}
    told = Results(results.folder, results.store)
    told.manifest["estimators"] = held
    assert told.seeking == {"c": "gc, inspect"}
    assert told.labels == list(held)


def key_of(results: Results, case: str) -> str:
    """The key of the EKF's runs of a case."""
    (key,) = {c.key for c in results.cells if (c.case, c.estimator) == (case, "ekf")}
    return key


def test_only_the_first_run_is_kept_in_detail(results):
    """Its errors and deviations at every epoch; of another run there are none, nor another's."""
    assert results.detail("base", "ekf", 0).shape == (20, 18)
    assert results.detail("base", "ekf", 1) is None
    assert results.detail("base", "other", 0) is None


WITHOUT_VELOCITY = np.ones((20, 4)) * [1.0, np.nan, 1.0, 1.0]


@pytest.mark.parametrize("spoilt", [np.ones((19, 4)), WITHOUT_VELOCITY])
def test_series_that_are_not_of_the_flight_are_refused(copied, spoilt):
    """One epoch too few, or errors that are no numbers: of all runs, of one, and in detail."""
    copied.manifest["runs"] = 1
    key = key_of(copied, "base")
    (record,) = copied.store.records(key, 1)
    detail = np.tile(spoilt, 5)[:, :18]
    copied.store.add([Result(key, record, spoilt, detail)])
    readers = (
        lambda: copied.series("base", "ekf"),
        lambda: copied.series_of("base", "ekf", 0),
        lambda: copied.detail("base", "ekf", 0),
    )
    for reader in readers:
        with pytest.raises(StoreError, match=r"a time series of case base in .* is damaged"):
            reader()


def test_failures_are_listed_with_reason_and_command(copied):
    """The run that failed and no other, the first in the table."""
    key = key_of(copied, "noisy")
    copied.store.add([Result(key, failed(1, name="ekf", reason="it was tired"))])
    failures = Results(copied.folder, copied.store).failures()
    assert failures.to_dict("index") == {
        0: {
            "assumption": "",
            "case": "noisy",
            "estimator": "ekf",
            "run": 1,
            "reason": "it was tired",
            "command": "ggbench run small.toml --case noisy -e ekf --seed 5 --run 1",
        }
    }


def test_runs_beyond_those_asked_for_are_not_shown(results):
    """Of three runs that a folder holds, two are read where its manifest asks for two."""
    fewer = Results(results.folder, results.store)
    fewer.manifest["runs"] = 2
    assert fewer.run_count == 2
    assert sorted(set(fewer.runs()["run"])) == [0, 1]
    assert len(fewer.series("base", "ekf")) == 2


def test_a_file_is_replaced_and_not_overwritten(tmp_path):
    """Who has begun to read the one before reads it to its end."""
    store = Store(tmp_path / "out", create=True)
    store.write("metrics.csv", b"before")
    with (tmp_path / "out" / "metrics.csv").open("rb") as reader:
        store.write("metrics.csv", b"after")
        assert reader.read() == b"before"
    assert (tmp_path / "out" / "metrics.csv").read_bytes() == b"after"
    store.close()


def test_a_file_that_cannot_be_written_leaves_the_one_before(tmp_path, monkeypatch):
    """A full disk: a sentence, the old content, and nothing half written beside it."""
    store = Store(tmp_path / "out", create=True)
    store.write("metrics.csv", b"before")
    before = sorted(path.name for path in (tmp_path / "out").iterdir())

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StoreError, match=r"cannot write .*metrics\.csv: no space left on the disk"):
        store.write("metrics.csv", b"after")
    monkeypatch.undo()
    assert (tmp_path / "out" / "metrics.csv").read_bytes() == b"before"
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == before
    store.close()


def test_a_path_that_is_no_utf8_is_quoted_for_a_shell():
    """Bash reads it back; control: other paths as they were quoted before."""
    name = os.fsdecode(b"r\xe9s'ul ts")
    quoted = as_argument(name)
    quoted.encode()
    done = subprocess.run(
        ["bash", "-c", f"printf %s {quoted}"], capture_output=True, check=True, env={"LC_ALL": "C"}
    )
    assert done.stdout == os.fsencode(name)
    assert (as_argument("a b"), as_argument("-x")) == ("'a b'", "./-x")


@pytest.mark.long
def test_a_scenario_in_a_folder_that_is_no_utf8_is_run_and_reported(tmp_path):
    """All tables are written, with the command that repeats a run."""
    folder = tmp_path / os.fsdecode(b"r\xe9s")
    folder.mkdir()
    loaded = small(folder)
    work = Campaign(
        scenario=loaded,
        argument=str(folder / "small.toml"),
        labels=("ins",),
        runs=2,
        seed=1,
        assumptions=False,
        folder=folder / "out",
    )
    running.fly(work, jobs=0).store.close()
    found = Results(folder / "out")
    assert "$'" in found.runs()["command"].iloc[0]
    render.write(folder / "out", folder / "report")
    found.store.close()
