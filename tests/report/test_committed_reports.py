"""The reports of this repository are of the code and of the scenarios beside them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ggbench.numerics.source import source_hash
from ggbench.spec import scenario

REPORTS = Path(__file__).parents[2] / "reports"
MANIFESTS = sorted(REPORTS.glob("*/data/manifest.json"))
RUN_AGAIN = "'make library' runs anew what has changed"


def test_every_shipped_scenario_has_its_report():
    """And every digest is of a scenario that is shipped."""
    held = {path.parents[1].name for path in MANIFESTS}
    assert held == set(scenario.shipped())


@pytest.mark.parametrize("path", MANIFESTS, ids=lambda path: path.parents[1].name)
def test_a_report_is_of_the_code_and_the_scenario_beside_it(path):
    """By the hashes that it carries; comments and docstrings are no part of the code's."""
    manifest = json.loads(path.read_text(encoding="utf-8"))
    assert manifest["source_hash"] == source_hash(), RUN_AGAIN
    loaded = scenario.load(manifest["scenario"])
    assert manifest["scenario_hash"] == loaded.content_hash, RUN_AGAIN
    text = (REPORTS / f"{manifest['scenario']}.md").read_text(encoding="utf-8")
    assert f"source {manifest['source_hash']}, scenario {manifest['scenario_hash'][:16]}" in text
    assert loaded.notes.strip() in text, RUN_AGAIN
