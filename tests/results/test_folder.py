"""A results folder read back: every figure from the runs, epochs and bounds that it is of."""

from __future__ import annotations

import errno
import os

import numpy as np
import pytest
from campaigns import ran, small
from problems import SMALL

from ggbench.judging.summary import WINDOWS, window_mask
from ggbench.results.folder import Results
from ggbench.results.store import MOST_KEPT, Result, Store, StoreError, kept_epochs

STUDIED = (
    SMALL.replace("last_s = 5.0", "last_s = 5.0\nlock_m = 6.0").replace(
        "[campaign]", '[campaign]\nassumption_runs = 2\nassumption_estimator = "ekf"'
    )
    + """
[[assumption]]
name = "louder"
title = "three times the noise"
gradiometer.noise_eotvos = 0.03

[[assumption]]
name = "without-effect"
title = "another regularisation, of a filter that there is not"
gradiometer.whitening_regularization = 1e-6
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


def test_bounds_of_a_summary_are_of_their_window_and_causality(results):
    """The root of the mean squared bound over the epochs of each window, of the estimator's kind.

    The four kinds are four bounds: of a filter, three epochs later, of all readings.
    """
    rows = results.summary().set_index(["case", "label", "window"])
    seen = set()
    for case in results.scenario.cases:
        arrays = results.arrays(case.name)
        for label, kind in KINDS.items():
            for window in WINDOWS:
                mask = window_mask(arrays["times"], case.windows, window)
                wanted = np.sqrt(np.sum(arrays[f"bound-{kind}"][mask], axis=0) / mask.sum())
                row = rows.loc[case.name, label, window]
                found = row[["position_bound_m", "velocity_bound_mps"]].to_numpy(float)
                assert found == pytest.approx(wanted)
                seen.add(round(float(found[0]), 9))
    assert len(seen) == 2 * 3 * 3  # cases, windows, bounds


def test_published_numbers_stand_beside_their_case(results):
    """Position and velocity of the case that has them, nothing of the other."""
    rows = results.summary().groupby("case")[["paper_position_m", "paper_velocity_mps"]].first()
    assert tuple(rows.loc["base"]) == (6.0, 0.3)
    assert rows.loc["noisy"].isna().all()


def test_a_study_is_set_beside_the_same_runs_without_it(results):
    """Of three runs two were studied: the declared figures are of these two alone.

    One that changes nothing is the case itself, which has more results; it has its own two.
    """
    studies = results.studies().set_index(["assumption", "case", "window"])
    runs = results.runs()
    for name in ("", "louder", "without-effect"):
        of_study = (runs["assumption"] == name) & (runs["estimator"] == "ekf")
        assert len(runs[of_study & (runs["case"] == "base")]) == (2 if name else 3)
        own = runs[of_study & (runs["case"] == "base") & (runs["run"] < 2)]
        row = studies.loc[(name, "base", "settled")]
        assert (row["runs"], row["label"]) == (2, "ekf")
        wanted = np.sqrt(own["settled_position_ms"].mean())
        assert row["position_mrse_m"] == pytest.approx(wanted)
    assert set(studies.loc["louder"].index.get_level_values("case")) == {"base"}
    declared, same = (
        studies.loc[name, "base"]["position_mrse_m"] for name in ("", "without-effect")
    )
    assert declared.tolist() == same.tolist()


def test_records_are_of_the_cases_or_of_one_study(results):
    """The cases' runs are not mixed with a study's of the same case."""
    assert sum(1 for _ in results.records()) == 2 * len(KINDS) * 3
    for name in ("louder", "without-effect"):
        studied = list(results.records(name))
        assert [(r["case"], r["estimator"], r["run"]) for r in studied] == [
            ("base", "ekf", 0), ("base", "ekf", 1),
        ]  # fmt: skip
    assert list(results.records("other")) == []


def test_a_command_repeats_its_own_run(results):
    """The case, the study's if there is one, the estimator, the seed and the run."""
    runs = results.runs().set_index(["assumption", "case", "estimator", "run"])
    command = "ggbench run small.toml --case {} -e {} --seed 5 --run {}".format
    assert runs.loc[("louder", "base", "ekf", 1), "command"] == command("louder/base", "ekf", 1)
    assert runs.loc[("", "noisy", "ekf", 2), "command"] == command("noisy", "ekf", 2)
    label = "factor-graph[mode=batch]"
    quoted = command("base", f"'{label}'", 0)
    assert runs.loc[("", "base", label, 0), "command"] == quoted


def test_times_to_lock_are_the_estimators_own(results):
    """Those of the records of one case and estimator, run by run; NaN of what never locked."""
    different = set()
    for case in results.scenario.cases:
        for label in KINDS:
            wanted = [
                np.nan if record["lock_time_s"] is None else record["lock_time_s"]
                for record in results.records()
                if (record["case"], record["estimator"]) == (case.name, label)
            ]
            found = results.lock_times(case.name, label)
            assert np.array_equal(found, wanted, equal_nan=True)
            different.add(found.tobytes())
    assert len(different) > 3


@pytest.mark.parametrize("epochs", [1, 2, 399, 400, 401, 5000])
def test_the_epochs_of_a_series_are_spread_over_the_flight(epochs):
    """All, or an even choice of many: first and last always, none twice."""
    kept = kept_epochs(epochs)
    assert (kept[0], kept[-1]) == (0, epochs - 1)
    assert len(set(kept.tolist())) == len(kept) == min(epochs, MOST_KEPT)
    assert np.ptp(np.diff(kept)) <= 1 if epochs > 1 else True


def test_as_many_runs_are_read_as_are_asked_for(tmp_path):
    """In order, none left out between two pieces that are read, and none beyond those asked for."""
    store = Store(tmp_path / "out", create=True)
    head = {"name": "a", "parameters": "", "causality": "filter", "seed": 1, "status": "failed",
            "reason": "none"}  # fmt: skip
    held = 2600
    store.add(
        Result("k", head | {"run": run}, np.full((2, 4), float(run))) for run in range(held)[::-1]
    )
    for runs, first in ((held + 9, 0), (2000, 0), (2300, 7), (1, 0)):
        found = [record["run"] for record in store.records("k", runs, first)]
        assert found == list(range(first, min(runs, held)))
    assert store.series("k", 2000)[:, 0, 0].tolist() == list(range(2000))
    store.close()


def test_runs_beyond_those_asked_for_are_not_shown(results):
    """Of three runs that a folder holds, two are read where its manifest asks for two."""
    fewer = Results(results.folder, results.store)
    fewer.manifest["runs"] = 2
    assert fewer.run_count == 2
    assert sorted(set(fewer.runs()["run"])) == [0, 1]
    assert len(fewer.series("base", "ekf")) == len(fewer.lock_times("base", "ekf")) == 2


def test_a_file_that_cannot_be_written_leaves_the_one_before(tmp_path, monkeypatch):
    """A full disk: a sentence, the old content, and nothing half written beside it."""
    store = Store(tmp_path / "out", create=True)
    store.write("summary.csv", b"before")
    before = sorted(path.name for path in (tmp_path / "out").iterdir())

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StoreError, match=r"cannot write .*summary\.csv: No space left on device"):
        store.write("summary.csv", b"after")
    monkeypatch.undo()
    assert (tmp_path / "out" / "summary.csv").read_bytes() == b"before"
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == before
    store.close()
