"""The digest of a campaign: written, read again, and refused where it is damaged."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from campaigns import ran, small
from problems import SMALL

from ggbench.judging.field_scale import correlation_m
from ggbench.results import digest
from ggbench.results.database import StoreError
from ggbench.results.folder import Results

LABELS = ("ins", "ekf", "ukf[points=merwe]")
NAMED = SMALL.replace('name = "base"', 'name = "1e3"').replace('name = "noisy"', 'name = "null"')
"""The small scenario with cases whose names look like a number and like none."""


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Results:
    path = tmp_path_factory.mktemp("digest")
    return ran(path, labels=LABELS, scenario=small(path, NAMED))


@pytest.fixture(scope="module")
def folder(results, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("written") / "small" / digest.FOLDER
    digest.write(results, path)
    return path


def assert_alike(found: pd.DataFrame, wanted: pd.DataFrame) -> None:
    """Texts are the same, numbers are to six digits; what is missing is missing in both."""
    assert len(found) == len(wanted) > 0
    assert list(found.columns) == list(wanted.columns)
    for name in wanted:
        if pd.api.types.is_numeric_dtype(wanted[name]):
            held = found[name].to_numpy(dtype=float)
            given = wanted[name].to_numpy(dtype=float)
            assert np.allclose(held, given, rtol=6e-6, atol=0.0, equal_nan=True), name
        else:
            assert found[name].fillna("").tolist() == wanted[name].fillna("").tolist(), name


def test_what_is_read_is_what_was_written(results, folder):
    """The settled metrics, the cases and the pairs, to six digits, and what was run."""
    held, metrics = digest.read(folder), results.metrics()
    assert_alike(held.metrics, metrics[metrics["window"] == "settled"])
    assert_alike(held.cases, results.cases())
    assert_alike(held.pairs, results.pairs())
    assert held.cases["case"].tolist() == ["1e3", "null"]
    assert held.metrics["recommended"].dtype == bool
    assert held.manifest["title"] == results.scenario.title
    assert held.manifest["runs"] == 3 and held.manifest["seed"] == 5
    assert held.manifest["results_version"] == results.manifest["results_version"]
    assert held.cases["correlation_m"].isna().all()  # no map on board


def test_the_length_is_that_of_the_gradients_along_the_track(results, folder, monkeypatch):
    """Of the epochs at which they were read, each at its own place."""
    results = Results(results.folder)  # one that holds no table of cases yet
    real = results.arrays("1e3")
    times = real["times"]
    track = np.column_stack([0.0 * times + 0.5, 1.0 + 1e-5 * times, 0.0 * times + 1e3])
    read = np.arange(2, len(times), 2)
    vertical = np.random.default_rng(3).normal(size=len(read)).cumsum()
    arrays = real | {"track": track, "gradient_times": times[read], "vertical": vertical}
    monkeypatch.setattr(results, "arrays", lambda case: arrays)
    digest.write(results, folder.parent / "other")
    held = digest.read(folder.parent / "other")
    wanted = correlation_m(track[read], vertical)
    assert held.cases["correlation_m"].to_numpy() == pytest.approx(wanted, rel=1e-5)
    assert wanted > 0.0


def without(text: str, key: str) -> str:
    return json.dumps({k: v for k, v in json.loads(text).items() if k != key})


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        ("manifest.json", None, "cannot read .*manifest.json: No such file"),
        ("metrics.csv", None, "cannot read .*metrics.csv: No such file"),
        ("cases.csv", None, "cannot read .*cases.csv: No such file"),
        ("pairs.csv", None, "cannot read .*pairs.csv: No such file"),
        ("manifest.json", lambda text: text[:99], "is damaged: JSONDecodeError"),
        ("manifest.json", lambda text: "[]", "is damaged: TypeError"),
        ("manifest.json", lambda text: without(text, "title"), "is damaged: KeyError.'title'"),
        ("manifest.json", lambda text: without(text, "machine"), "KeyError.'machine'"),
        ("metrics.csv", lambda text: "", "is damaged: EmptyDataError"),
        ("cases.csv", lambda text: text.replace("case,", "x,", 1), "cases.csv has no column case"),
    ],
)
def test_a_damaged_digest_is_told_in_a_sentence(folder, tmp_path, file, change, words):
    """Which folder, what of it, and how it is made anew."""
    shutil.copytree(folder, tmp_path / "data")
    path = tmp_path / "data" / file
    if change is None:
        path.unlink()
    else:
        path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(StoreError, match=words) as told:
        digest.read(tmp_path / "data")
    if change is not None:
        assert str(told.value).endswith("; 'ggbench report' rewrites it")


def test_pairs_are_those_that_a_page_may_need():
    """Each has the INS, the EKF or an estimator that its case names; others are left out."""
    pairs = pd.DataFrame(
        [("a", "ukf", "tercom"), ("a", "ekf", "ukf"), ("b", "ukf", "tercom")],
        columns=["case", "first", "second"],
    )
    names = {"recommended": ["", "ekf"], "best": ["ekf", "tercom"], "best_smoother": ["", ""]}
    cases = pd.DataFrame({"case": ["a", "b"]} | names)
    assert digest.decisive_pairs(pairs, cases).index.tolist() == [1, 2]
    assert digest.decisive_pairs(pairs[:0], cases).empty
