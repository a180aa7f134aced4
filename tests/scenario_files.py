"""Files with the small scenario."""

from __future__ import annotations

from pathlib import Path

from problems import SMALL

from ggbench.simulation.error_free_flight import prepare
from ggbench.spec import scenario


def small(tmp_path: Path, old: str = "", new: str = "") -> str:
    """The path of a file with the small scenario, one text in it replaced."""
    assert old in SMALL
    path = tmp_path / "small.toml"
    path.write_text(SMALL.replace(old, new, 1) if old else SMALL)
    return str(path)


def load_and_fly(path: str) -> scenario.Scenario:
    """What `ggbench validate` does with a file."""
    loaded = scenario.load(path)
    for case in loaded.cases:
        prepare(case)
    return loaded
