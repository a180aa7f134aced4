"""What the league needs of a campaign: written, read again, and refused where it is damaged."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from campaigns import ran, small
from problems import SMALL

from ggbench.judging import success
from ggbench.judging.field_scale import correlation_m
from ggbench.results import digest
from ggbench.results.folder import Results
from ggbench.results.store import StoreError
from ggbench.spec.scenario import ScenarioError

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
    """The settled window of summary and pairs, to six digits, and what was run."""
    held = digest.read(folder)
    summary, pairs = results.summary(), results.paired()
    assert_alike(held.summary, summary[summary["window"] == "settled"])
    columns = ["case", "window", "first", "second", "runs", *success.PAIRED_COLUMNS]
    assert_alike(held.pairs, pairs.loc[pairs["window"] == "settled", columns])
    assert [case.name for case in held.scenario.cases] == ["1e3", "null"]
    assert held.scenario.cases == results.scenario.cases
    assert held.manifest["done"] == dict.fromkeys(LABELS, 3)
    assert held.manifest["runs"] == 3 and held.manifest["left_out"] == {}
    assert held.manifest["results_version"] == results.manifest["results_version"]
    assert all(math.isnan(length) for length in held.correlation_m.values())  # no map on board
    assert set(held.correlation_m) == {"1e3", "null"}


def test_the_length_is_that_of_the_gradients_along_the_track(results, folder, monkeypatch):
    """Of the epochs at which they were read, each at its own place."""
    times = np.arange(0.0, 40.0, 0.5)
    track = np.column_stack([np.full(80, 0.5), 1.0 + 1e-5 * times, np.full(80, 1e3)])
    read = np.arange(2, 80, 4)
    vertical = np.random.default_rng(3).normal(size=len(read)).cumsum()
    arrays = {"times": times, "track": track, "gradient_times": times[read], "vertical": vertical}
    monkeypatch.setattr(results, "arrays", lambda case: arrays)
    digest.write(results, folder.parent / "other")
    held = digest.read(folder.parent / "other")
    wanted = correlation_m(track[read], vertical)
    assert held.correlation_m == pytest.approx(dict.fromkeys(("1e3", "null"), wanted), rel=1e-5)
    assert wanted > 0.0


def test_a_study_of_its_own_has_no_pairs(tmp_path):
    """Nobody compares its estimators over scenarios; its summary is there."""
    text = SMALL.replace("[campaign]", "[campaign]\nleague = false")
    digest.write(ran(tmp_path, labels=("ins", "ekf"), scenario=small(tmp_path, text)), tmp_path)
    held = digest.read(tmp_path)
    assert (len(held.summary), len(held.pairs)) == (4, 0)


SKIPS = """
from dataclasses import dataclass
import numpy as np
from ggbench.problem import Estimate, Estimator


@dataclass(frozen=True)
class Choosy(Estimator):
    name = "choosy"
    causality = "filter"

    def skip(self, problem):
        return "it wants a map: without one it is lost"

    def estimate(self, problem, rng):
        raise AssertionError
"""


def test_what_was_left_out_is_told_with_its_reason(tmp_path):
    """As the campaign found it, so that the league can say why there is a gap."""
    (tmp_path / "choosy.py").write_text(SKIPS)
    digest.write(ran(tmp_path, labels=("ekf", f"{tmp_path}/choosy.py"), runs=1), tmp_path / "data")
    held = digest.read(tmp_path / "data")
    assert held.manifest["done"] == {"ekf": 1}
    ((name, reason),) = held.manifest["left_out"].items()
    assert name.endswith("choosy.py") and reason == "it wants a map: without one it is lost"


def test_who_did_fewer_runs_is_told(results, folder, monkeypatch):
    """The fewest over all cases: none where a case has not been begun."""
    summary = results.summary()
    short = summary["label"].eq("ekf") & summary["case"].eq("null")
    gone = summary["label"].eq("ukf[points=merwe]") & summary["case"].eq("1e3")
    changed = summary.assign(runs=summary["runs"].where(~short, 2))[~gone]
    monkeypatch.setattr(results, "summary", lambda: changed)
    digest.write(results, folder.parent / "fewer")
    done = digest.read(folder.parent / "fewer").manifest["done"]
    assert done == {"ins": 3, "ekf": 2, "ukf[points=merwe]": 0}


def without(text: str, key: str) -> str:
    return json.dumps({k: v for k, v in json.loads(text).items() if k != key})


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        ("manifest.json", None, "cannot read .*manifest.json: No such file"),
        ("settled.csv", None, "cannot read .*settled.csv: No such file"),
        ("pairs.csv", None, "cannot read .*pairs.csv: No such file"),
        ("manifest.json", lambda text: text[:99], "is damaged: JSONDecodeError"),
        ("manifest.json", lambda text: "[]", "is damaged: TypeError"),
        ("manifest.json", lambda text: without(text, "scenario_text"), "'scenario_text'"),
        ("manifest.json", lambda text: without(text, "done"), "is damaged: KeyError.'done'"),
        ("manifest.json", lambda text: without(text, "left_out"), "KeyError.'left_out'"),
        ("manifest.json", lambda text: without(text, "machine"), "KeyError.'machine'"),
        ("settled.csv", lambda text: "", "is damaged: EmptyDataError"),
        ("settled.csv", lambda text: text.replace("ratio_median,", "x,"), "column ratio_median"),
        ("pairs.csv", lambda text: text.replace("verdict", "x"), "pairs.csv has no column verdict"),
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
        assert str(told.value).endswith("; the report's command writes it anew")


def test_a_scenario_that_cannot_be_read_any_more_is_told(folder, tmp_path):
    """In the words of the scenario's own errors."""
    shutil.copytree(folder, tmp_path / "data")
    path = tmp_path / "data" / "manifest.json"
    manifest = json.loads(path.read_text(encoding="utf-8"))
    manifest["scenario_text"] = manifest["scenario_text"].replace("speed_mps", "haste")
    path.write_text(json.dumps(manifest), encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"scenario.toml of small: .*haste"):
        digest.read(tmp_path / "data")
