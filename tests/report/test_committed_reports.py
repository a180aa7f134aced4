"""Committed reports: of this version of results, and of the scenarios as they are."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ggbench.campaign.result_keys import RESULTS_VERSION
from ggbench.spec import scenario

REPORTS = Path(__file__).parents[2] / "reports"
MANIFESTS = sorted(REPORTS.glob("*/data/manifest.json"))
RUN_AGAIN = "'make library' runs anew what has changed"


def test_every_shipped_scenario_has_its_report():
    """And every digest is of a scenario that is shipped."""
    held = {path.parents[1].name for path in MANIFESTS}
    assert held == set(scenario.shipped())


@pytest.mark.parametrize("path", MANIFESTS, ids=lambda path: path.parents[1].name)
def test_a_report_is_of_this_version_of_results_and_of_its_scenario(path):
    """The report carries the version and the scenario's hash; notes are copied."""
    manifest = json.loads(path.read_text(encoding="utf-8"))
    assert manifest["results_version"] == RESULTS_VERSION, RUN_AGAIN
    loaded = scenario.load(manifest["scenario"])
    assert manifest["scenario_hash"] == loaded.content_hash, RUN_AGAIN
    text = (REPORTS / f"{manifest['scenario']}.md").read_text(encoding="utf-8")
    assert f"results version {RESULTS_VERSION}, scenario {manifest['scenario_hash'][:16]}" in text
    assert loaded.notes.strip() in text, RUN_AGAIN
