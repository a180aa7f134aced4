"""Messages of results folders."""

from __future__ import annotations

import io
import json
import pickle
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import plan, ran
from problems import SMALL
from refusals import refused
from thinning import thinned

from ggbench.errors import GGBenchError
from ggbench.report import render
from ggbench.results.database import StoreError
from ggbench.results.folder import Results
from ggbench.spec.scenario import ScenarioError


class Trap:
    """A pickle of this creates a file when it is loaded."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple:
        return Path.touch, (self.path,)


def archive(**arrays: np.ndarray) -> bytes:
    content = io.BytesIO()
    np.savez(content, **arrays)
    return content.getvalue()


def query(folder: Path, text: str, *values: bytes) -> None:
    with sqlite3.connect(folder / "records.sqlite") as connection:
        connection.execute(text, values)


def arrays(folder: Path, content: bytes) -> None:
    """Replace the arrays that runs share."""
    query(folder, "UPDATE shared SET arrays = ?", content)


def pickled(folder: Path) -> None:
    """Plant an archive of arrays that would run code if it were trusted."""
    array = np.array([Trap(folder / "sprung")], dtype=object)
    arrays(folder, archive(times=array, **{"bound-filter": array}))


def bare_pickle(folder: Path) -> None:
    arrays(folder, pickle.dumps(Trap(folder / "sprung")))


def written(folder: Path, name: str, text: str) -> None:
    (folder / name).write_text(text)


def changed_manifest(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = folder / "manifest.json"
    held = json.loads(path.read_text())
    change(held)
    path.write_text(json.dumps(held))


def removed(folder: Path, name: str) -> None:
    (folder / name).unlink()


def spoilt_inside(folder: Path) -> None:
    path = folder / "records.sqlite"
    content = path.read_bytes()
    path.write_bytes(content[:4096] + b"\xa5" * (len(content) - 4096))


def cut(folder: Path) -> None:
    path = folder / "records.sqlite"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])


def many_estimators(held: dict[str, Any]) -> None:
    held["estimators"].update({f"e{n}": {} for n in range(2000)})


DATABASE, MANIFEST = "records.sqlite", "manifest.json"
ANOTHER_VERSION = "records.sqlite comes from another version"
SHARED = "shared data of case base.* cannot be unpacked"
READS = "but this version of ggbench reads format 6"
SHORT = "UPDATE curves SET series = substr(series, 17) WHERE run = 1"
CUT_ARRAYS = "UPDATE shared SET arrays = substr(arrays, 1, 300)"
RENAMED = "ALTER TABLE records RENAME COLUMN info TO something"
OTHER_SCENARIO = SMALL.replace("250.0", "251.0")
DAMAGES: dict[str, tuple[Callable[..., None], tuple[object, ...], str]] = {
    "database overwritten": (written, (DATABASE, "not a database" * 1000), "records.sqlite"),
    "database spoilt inside": (spoilt_inside, (), "records.sqlite"),
    "database cut": (cut, (), "records.sqlite"),
    "database empty": (written, (DATABASE, ""), ANOTHER_VERSION),
    "database of something else": (query, (RENAMED,), ANOTHER_VERSION),
    "database gone": (removed, (DATABASE,), "holds no results: it has no records.sqlite"),
    "info that is no JSON": (
        query,
        ("UPDATE records SET info = '{'",),
        "the info of a run in .*records.sqlite is damaged",
    ),
    "one series an epoch short": (
        query,
        (SHORT,),
        "a time series in .*records.sqlite is damaged",
    ),
    "manifest cut": (written, (MANIFEST, '{"scenario": '), "manifest.json.* is damaged"),
    "manifest of something else": (written, (MANIFEST, "[1, 2]"), "manifest.json is damaged"),
    "manifest empty": (written, (MANIFEST, "{}"), "manifest.json has format None"),
    "manifest gone": (removed, (MANIFEST,), "manifest.json.*No such file"),
    "arrays gone": (
        query,
        ("DELETE FROM shared",),
        "lacks the shared data of case base.*resumes",
    ),
    "arrays cut": (query, (CUT_ARRAYS,), SHARED),
    "arrays of something else": (
        arrays,
        (archive(other=np.zeros(3)),),
        "shared data of case base.* is damaged: it has no times",
    ),
    "arrays not zipped": (arrays, (b"\x93NUMPY",), SHARED),
    "arrays pickled": (pickled, (), SHARED),
    "arrays a bare pickle": (bare_pickle, (), SHARED),
}
"""Damages of a folder, their arguments, and messages."""
MANIFESTS: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "scenario spoilt": (
        lambda held: held.update(scenario_text="[[["),
        "scenario.* is not valid TOML",
    ),
    "scenario of something else": (
        lambda held: held.update(scenario_text=OTHER_SCENARIO),
        "has changed since the run: its hash differs",
    ),
    "cells spoilt": (
        lambda held: held.update(cells=[{"key": 1}]),
        "manifest.json is damaged: it has no cells.0.assumption",
    ),
    "format of old": (
        lambda held: held.update(format=2),
        f"manifest.json has format 2, {READS}",
    ),
    "format to come": (
        lambda held: held.update(format=7),
        f"manifest.json has format 7, {READS}",
    ),
    "no runs": (
        lambda held: held.update(runs=0),
        "manifest.json is damaged: its runs is invalid",
    ),
    "seed below 0": (
        lambda held: held.update(seed=-1),
        "manifest.json is damaged: its seed is invalid",
    ),
    **{
        f"scenario named {name!r}": (
            lambda held, name=name: held.update(scenario=name),
            r"manifest\.json is damaged: its scenario",
        )
        for name in ("../escaped", "/escaped", "..", ".", "")
    },
    "a cell twice": (
        lambda held: held["cells"].append(held["cells"][0]),
        "contain the same estimator and case twice",
    ),
    "a case twice": (
        lambda held: held["cases"].append(held["cases"][0]),
        "its list of cases contains a name twice",
    ),
    "a cell of an unknown case": (
        lambda held: held["cells"][0].update(case="x"),
        "have an unknown case x",
    ),
    "a cell of an unknown estimator": (
        lambda held: held["cells"][0].update(estimator="x"),
        "have an unknown estimator x",
    ),
    "no families": (
        lambda held: held["families"].clear(),
        "it has no family of the estimator",
    ),
    "2000 estimators": (many_estimators, "its estimators is invalid"),
}
"""Changes of a manifest, and messages."""


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Path:
    """A finished results folder, to be copied and spoilt."""
    made = ran(tmp_path_factory.mktemp("results"), runs=2)
    made.store.close()
    return made.folder


def is_refused(folder: Path, message: str) -> None:
    """Assert that a report of a folder ends with one line, and that nothing in it is executed."""
    with refused(GGBenchError, message):
        render.write(folder, folder.parent / "deep" / "er")
    assert not (folder / "sprung").exists()


@thinned("kind", DAMAGES)
def test_damaged_results_have_their_sentence(kind, results, tmp_path):
    """A pickle planted in them is refused, not loaded."""
    damage, options, message = DAMAGES[kind]
    folder = shutil.copytree(results, tmp_path / "out")
    damage(folder, *options)
    is_refused(folder, message)


@pytest.mark.parametrize("kind", MANIFESTS)
def test_a_bad_manifest_has_its_sentence(kind, results, tmp_path):
    """A scenario named like a path leads no report elsewhere, and many cells cost no minutes."""
    change, message = MANIFESTS[kind]
    folder = shutil.copytree(results, tmp_path / "out")
    changed_manifest(folder, change)
    is_refused(folder, message)
    with pytest.raises(ScenarioError if kind == "scenario spoilt" else StoreError, match=message):
        Results(folder).runs()


def file_in_place(tmp_path: Path) -> str:
    (tmp_path / "file").write_text("")
    return "small.toml"


def own_copy(tmp_path: Path) -> str:
    """A scenario in the folder of its results."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".lock").touch()
    return "out/scenario.toml"


BAD_PLACES = {
    "a file in its place": ("file", file_in_place, "cannot use results folder"),
    "a file above it": ("file/below", file_in_place, "cannot use results folder"),
    "the scenario in it": ("out", own_copy, "is the folder of the scenario, whose"),
}
"""Folders, makers of what is there, and messages."""


@pytest.mark.parametrize("kind", BAD_PLACES)
def test_a_folder_that_cannot_be_used_has_its_sentence(kind, tmp_path, monkeypatch):
    folder, make, message = BAD_PLACES[kind]
    monkeypatch.chdir(tmp_path)
    argument = make(tmp_path)
    work = plan(tmp_path, folder, ("ins",))
    work.argument = argument
    with refused(StoreError, message):
        work.open()
