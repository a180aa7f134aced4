"""The digest of a campaign: written, read again, and refused where it is damaged."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest
from campaigns import ran, small
from problems import SMALL

from ggbench.results import digest
from ggbench.results.folder import Results
from ggbench.results.store import StoreError

LABELS = ("ins", "ekf", "ukf[points=merwe]", "ukf[points=cubature]")
NAMED = SMALL.replace('name = "base"', 'name = "1e3"').replace('name = "noisy"', 'name = "null"')
"""The small scenario with cases whose names look like a number and like none."""


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Results:
    path = tmp_path_factory.mktemp("digest")
    return ran(path, labels=LABELS, scenario=small(path, NAMED))


@pytest.fixture
def folder(results, tmp_path) -> Path:
    path = tmp_path / "small" / digest.FOLDER
    digest.write(results, path)
    return path


def test_what_is_read_is_what_was_written(results, folder):
    """Figures of the settled window and cases, to six digits, and what was run."""
    held = digest.read(folder)
    figures = results.figures()
    settled = figures[figures["window"] == "settled"].reset_index(drop=True)
    for found, given in ((held.figures, settled), (held.cases, results.cases())):
        pd.testing.assert_frame_equal(found, given, rtol=6e-6, check_dtype=False)
    assert held.cases["case"].tolist() == ["1e3", "null"]
    assert held.manifest["scenario_hash"] == results.manifest["scenario_hash"]
    assert held.manifest["title"] == results.scenario.title


def test_pairs_are_those_that_a_page_may_need(results):
    """Each has the INS, the EKF or an estimator that the case names; others are left out."""
    named = {"recommended": "ekf", "best": "ekf", "best_smoother": ""}
    cases = results.cases().assign(**named)
    pairs = digest._telling(results.pairs(), cases)
    lost = results.pairs().drop(pairs.index)
    assert {*lost["first"], *lost["second"]} == {"ukf[points=merwe]", "ukf[points=cubature]"}
    cases["best"] = "ukf[points=merwe]"
    assert len(digest._telling(results.pairs(), cases)) == len(results.pairs())


@pytest.mark.parametrize(
    ("file", "content", "said"),
    [
        ("manifest.json", "{", "is damaged"),
        ("manifest.json", "{}", "is damaged: KeyError"),
        ("cases.csv", "a,b\n1,2\n", "no column case"),
        ("figures.csv", None, "cannot read .*figures.csv"),
    ],
)
def test_a_damaged_digest_has_its_sentence(folder, file, content, said):
    (folder / file).unlink()
    if content is not None:
        (folder / file).write_text(content)
    with pytest.raises(StoreError, match=said):
        digest.read(folder)


def test_the_digest_is_small_text(folder):
    """Six digits, one line for each row, and a manifest without the scenario's text."""
    assert "scenario_text" not in json.loads((folder / "manifest.json").read_text())
    assert max(map(len, (folder / "figures.csv").read_text().splitlines())) < 800
