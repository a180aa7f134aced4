"""A results folder: other things in it, and other processes."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from campaigns import LABELS, failed, plan, ran, small
from problems import SMALL

from ggbench.judging import statistics
from ggbench.judging.summary import METRICS
from ggbench.report import render
from ggbench.results.database import Result, StoreError
from ggbench.results.folder import Results
from ggbench.results.store import RESULT_FILES, Store, require_ours


def test_a_folder_of_other_things_is_left_alone(tmp_path):
    """A folder that holds something else is refused; --fresh removes results and nothing else."""
    folder = tmp_path / "thesis"
    folder.mkdir()
    (folder / "chapter1.txt").write_text("years of work")
    with pytest.raises(StoreError, match="is not empty and holds no results"):
        plan(tmp_path, "thesis", ("ins",), fresh=True).open()
    ran(tmp_path, runs=1).store.close()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    (tmp_path / "out" / ".notes.part").write_text("mine too")
    results = ran(tmp_path, runs=1, seed=9, fresh=True)
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"
    assert (tmp_path / "out" / ".notes.part").read_text() == "mine too"
    assert sum(map(len, results.store.finished().values())) == 2 * len(LABELS)


def test_a_lost_run_is_worth_another_attempt_only_with_more_time(tmp_path):
    """What was lost at a limit stays lost at that limit; a higher one leaves it to be run again."""
    store = Store(tmp_path / "out", create=True)
    store.add(
        [
            Result("k", failed(0)),
            Result("k", failed(1), retry_above=60.0),
            Result("k", failed(2), retry_above=60.0),
            Result("lost", failed(0), retry_above=0.0),
        ]
    )
    kept = {
        limit: {key: runs.tolist() for key, runs in store.finished(limit).items()}
        for limit in (1.0, 60.0, 60.5, np.inf)
    }
    assert kept == {
        1.0: {"k": [0, 1, 2]},
        60.0: {"k": [0, 1, 2]},
        60.5: {"k": [0]},
        np.inf: {"k": [0]},
    }
    store.add([Result("k", failed(1), series=np.ones((3, 4)))])  # it takes the lost one's place
    assert store.finished()["k"].tolist() == [0, 1]
    np.testing.assert_array_equal(store.series_of("k", 1), 1.0)
    store.close()


def test_a_fresh_start_removes_all_that_a_campaign_leaves(tmp_path):
    """The manifest, too, and what was half written; a file of one's own stays."""
    folder = tmp_path / "out"
    folder.mkdir()
    for name in (*RESULT_FILES, ".metrics.csv.123.part", "notes.txt"):
        (folder / name).touch()
    Store(folder, create=True, fresh=True).close()
    assert {path.name for path in folder.iterdir()} == {".lock", "records.sqlite", "notes.txt"}


def test_what_a_campaign_leaves_at_once_is_its_own(tmp_path):
    """A lock, an empty database and a file half written: one that was stopped may be run again."""
    folder = tmp_path / "out"
    folder.mkdir()
    for name in (".lock", ".manifest.json.123.part", "records.sqlite", "records.sqlite-wal"):
        (folder / name).touch()
    require_ours(folder)
    (folder / ".thesis.tex.123.part").touch()
    with pytest.raises(StoreError, match="is not empty and holds no results"):
        require_ours(folder)


FOREIGN = {
    "scenario.toml": "mine",
    "metrics.csv": "a,b",
    "manifest.json": '{"name": "my web app", "format": 2}',
    "records.sqlite": "SQLite format 3",
}


@pytest.mark.parametrize("name", FOREIGN)
@pytest.mark.parametrize("fresh", [False, True])
def test_files_of_others_with_our_names_are_left_alone(name, fresh, tmp_path):
    """A folder that has only names in common with a results folder is not one."""
    folder = tmp_path / "thesis"
    folder.mkdir()
    (folder / name).write_text(FOREIGN[name])
    with pytest.raises(StoreError, match="is not empty and holds no results"):
        plan(tmp_path, "thesis", ("ins",), fresh=fresh).open()
    assert [path.name for path in folder.iterdir()] == [name]
    assert (folder / name).read_text() == FOREIGN[name]


def test_a_folder_that_may_only_be_read(results, tmp_path, monkeypatch):
    """Someone else's folder is read as it is, or, with an unmerged log, refused with a sentence."""
    folder = tmp_path / "out"
    shutil.copytree(results, folder)
    monkeypatch.setattr("os.access", lambda path, mode: mode != os.W_OK)
    whole = len(Results(folder).runs())
    assert whole == len(Results(results).runs()) > 0
    (folder / "records.sqlite-wal").write_bytes(b"not merged")
    with pytest.raises(StoreError, match="is read-only and its campaign was interrupted"):
        Results(folder)


@pytest.mark.long
def test_what_a_folder_names_is_not_loaded(tmp_path, monkeypatch):
    """Neither reading nor resuming a folder runs a file that its manifest or scenario names."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "trap.py").write_text(f"open({str(tmp_path / 'sprung')!r}, 'w')")
    loaded = small(tmp_path, SMALL.replace('["ins", "ekf"]', '["ins", "trap.py"]'))
    results = ran(tmp_path, labels=("ins",), runs=2, scenario=loaded)
    results.store.close()
    path = tmp_path / "out" / "manifest.json"
    manifest = json.loads(path.read_text())
    for key in ("estimators", "families"):
        manifest[key]["trap.py"] = manifest[key]["ins"]
    path.write_text(json.dumps(manifest))
    (tmp_path / "sprung").unlink(missing_ok=True)
    render.write(tmp_path / "out", tmp_path / "reports")
    assert not (tmp_path / "sprung").exists()


def test_results_of_another_scenario_are_not_overwritten(tmp_path):
    """Another scenario in the same folder is refused, unless it is to be discarded."""
    ran(tmp_path, runs=1).store.close()
    (tmp_path / "small.toml").rename(tmp_path / "other.toml")
    from ggbench.spec import scenario

    loaded = scenario.load(str(tmp_path / "other.toml"))
    with pytest.raises(StoreError, match="contains results of the scenario small, not of other"):
        plan(tmp_path, "out", ("ins",), scenario=loaded).open()
    assert ran(tmp_path, scenario=loaded, labels=("ins",), runs=1, fresh=True).runs().shape[0] == 2


def test_two_processes_do_not_share_a_folder(tmp_path):
    """While one campaign has a folder, another is refused; reading it is allowed."""
    results = ran(tmp_path, runs=1)
    with pytest.raises(StoreError, match="another ggbench is running in"):
        plan(tmp_path, "out", ("ins",)).open()
    assert len(Results(results.folder).runs()) == 2 * len(LABELS)
    results.store.close()
    plan(tmp_path, "out", ("ins",)).open()


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Path:
    """A finished results folder, to be copied and spoilt."""
    tmp_path = tmp_path_factory.mktemp("results")
    made = ran(tmp_path, runs=2)
    made.store.close()
    return made.folder


def test_a_folder_is_known_by_its_database_alone(results, tmp_path):
    """One that has lost its manifest and has other files in it is still a campaign's."""
    (tmp_path / "notes.txt").touch()
    shutil.copy(results / "records.sqlite", tmp_path)
    require_ours(tmp_path)


def test_the_band_of_innovations_is_of_the_readings_that_are_expected(tmp_path):
    """A folder alone tells how many readings a run has: the share that does not drop out.

    Of the 20 readings (11 of them settled, from 10 s on), four lie in a gap, and of the others half
    are expected.
    """
    faults = "[truth.gradiometer]\ndropout_share = 0.5\ndropouts_s = [[12.0, 15.0]]\n\n[windows]"
    loaded = small(tmp_path, SMALL.replace("[windows]", faults, 1))
    results = ran(tmp_path, labels=("ekf",), runs=3, scenario=loaded)
    rows = results.metrics().set_index(["case", "window"]).loc["base"]
    for window, readings in (("whole", 8), ("settled", 4)):
        band = tuple(rows.loc[window, ["nis_lo", "nis_hi"]])
        assert band == statistics.mean_band(3 * readings, 6)


def test_a_results_folder_says_what_made_it(results):
    """The manifest has scenario, seed, versions, machine and date; the folder the scenario."""
    manifest = json.loads((results / "manifest.json").read_text())
    assert (manifest["scenario"], manifest["seed"], manifest["runs"]) == ("small", 5, 2)
    assert list(manifest["estimators"]) == list(LABELS)
    assert len(manifest["scenario_hash"]) == 64
    assert {"python", "numpy", "gtsam", "filterpy"} <= set(manifest["versions"])
    assert manifest["machine"]["processors"] >= 1
    assert manifest["date"].startswith("20")
    assert (results / "scenario.toml").read_text() == SMALL
    header = (results / "metrics.csv").read_text().splitlines()[0]
    assert header == ",".join(METRICS)
