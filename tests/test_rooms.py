"""The rooms of the package, and which of them may know which others."""

from __future__ import annotations

import ast
import functools
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from thinning import thinned

ROOT = Path(__file__).parents[1]
FLOORS = (
    ("errors", "estimator_spec", "parameters"),
    ("files", "numerics"),
    ("gravity", "problem"),
    ("ins", "maps", "sensors"),
    ("adapters", "trajectory", "block", "reduced"),
    ("spec", "engines"),
    ("estimation", "simulation"),
    ("judging",),
    ("contract", "exchange", "recorded", "results"),
    ("figures",),
    ("campaign", "matchability", "report"),
    ("display",),
    ("score",),
    ("api",),
    ("cli",),
)
"""A room imports what stands above it in this list, and nothing beside it or below."""
APART = {("api", "report")}
"""Nor these: a notebook draws the figures that a report draws, and writes no report."""
ESTIMATORS_MAY = {"problem", "block", "parameters", "engines", "numerics", "reduced", "estimators"}


def room_of(name: str) -> str:
    """The room of a dotted name within the package: its first part."""
    return name.split(".")[0]


def imported(file: Path, package: tuple[str, ...]) -> tuple[tuple[int, str], ...]:
    """(line, dotted name within the package) of what a file imports from it, wherever it does."""
    return imports_in(file.read_text(encoding="utf-8"), package)


@functools.cache
def imports_in(text: str, package: tuple[str, ...]) -> tuple[tuple[int, str], ...]:
    return tuple(_imports_in(ast.parse(text), package))


def _imports_in(tree: ast.Module, package: tuple[str, ...]) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            if node.level:
                base = (*package[: len(package) - node.level + 1], *(node.module or "").split("."))
            elif node.module and node.module.split(".")[0] == "ggbench":
                base = tuple(node.module.split(".")[1:])
            else:
                continue
            base = tuple(part for part in base if part)
            for alias in node.names:
                yield node.lineno, ".".join((*base, alias.name))
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "ggbench":
                    yield node.lineno, ".".join(alias.name.split(".")[1:]) or "ggbench"


def violations(root: Path) -> list[str]:
    """Imports that the table does not allow, as sentences."""
    floor = {room: n for n, rooms in enumerate(FLOORS) for room in rooms}
    found = []
    for file in sorted((root / "ggbench").rglob("*.py")):
        place = file.relative_to(root / "ggbench")
        mine = place.parts[0].removesuffix(".py")
        if mine == "__init__":
            continue
        if mine not in floor:
            found.append(f"{place} stands in no room of the table")
            continue
        for line, name in imported(file, place.parent.parts):
            other = room_of(name)
            if other not in floor or (
                other != mine and (floor[other] >= floor[mine] or (mine, other) in APART)
            ):
                found.append(f"{place}:{line} imports {name}: {mine} may not know {other}")
    for file in sorted((root / "estimators").glob("*.py")):
        for line, name in imported(file, ("estimators",)):
            if room_of(name) not in ESTIMATORS_MAY:
                found.append(f"estimators/{file.name}:{line} imports {name}")
    return found


def test_rooms_know_only_what_stands_above_them():
    assert violations(ROOT) == []


@thinned(
    ("place", "line"),
    [
        ("ggbench/gravity/field.py", "from ..simulation.runs import simulate\n"),
        ("ggbench/sensors/gradiometer/lowpass.py", "from ...ins import strapdown\n"),
        ("ggbench/campaign/runner.py", "from ..report import tables\n"),
        ("ggbench/api.py", "from .report import tables\n"),
        ("ggbench/report/tables.py", "from ..campaign.records import judged\n"),
        ("ggbench/problem.py", "import ggbench.engines.filters\n"),
        ("ggbench/judging/ranking.py", "def later():\n    from ggbench.cli import main\n"),
        ("ggbench/engines/filters.py", "from ..estimators import ekf\n"),
        ("ggbench/numerics/lanes.py", "from .. import block\n"),
        ("ggbench/attic.py", "import numpy\n"),
        ("ggbench/judging/field_scale.py", "from ..matchability import statistics\n"),
        ("ggbench/matchability/score.py", "from ..cli import maps\n"),
        ("estimators/ekf.py", "from ..simulation.runs import simulate\n"),
        ("estimators/ins.py", "from ggbench.results import store\n"),
    ],
)
def test_an_import_that_climbs_is_seen(tmp_path, place, line):
    """The guard fails where it should: one planted line is one violation."""
    for folder in ("ggbench", "estimators"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("*.pyc"))
    file = tmp_path / place
    before = file.read_text(encoding="utf-8") if file.exists() else ""
    file.write_text(f"{before}\n{line}", encoding="utf-8")
    assert len(violations(tmp_path)) == 1


def lane_counts(package: Path, estimators: Path) -> list[str]:
    """Places outside ``numerics`` where code knows how many lanes there are."""
    found = []
    files = [*package.rglob("*.py"), *estimators.glob("*.py")]
    for file in sorted(file for file in files if file.parent != package / "numerics"):
        text = file.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if "LANES" in text else ():
            names = {getattr(node, field, None) for field in ("id", "attr", "name")}
            if "LANES" in names:
                found.append(f"{file.name}:{node.lineno}")
    return found


def test_numerics_alone_knows_how_many_lanes_there_are():
    assert lane_counts(ROOT / "ggbench", ROOT / "estimators") == []


@pytest.mark.parametrize(
    "line",
    [
        "from ..numerics.kernels import LANES\n",
        "from ..numerics.kernels import LANES as WIDTH\n",
        "from ..numerics import kernels\n\nSIZE = kernels.LANES\n",
        "def zeros():\n    return [0] * LANES\n",
    ],
)
@pytest.mark.parametrize("place", ["ggbench/engines/filters.py", "estimators/ekf.py"])
def test_a_count_of_lanes_elsewhere_is_seen(tmp_path, place, line):
    """The guard fails where it should, and not at files of numerics."""
    for folder in ("ggbench/numerics", "ggbench/engines", "estimators"):
        (tmp_path / folder).mkdir(parents=True)
    for name in ("ggbench/numerics/lanes.py", place):
        shutil.copy(ROOT / name, tmp_path / name)
    file = tmp_path / place
    file.write_text(f"{file.read_text(encoding='utf-8')}\n{line}", encoding="utf-8")
    assert len(lane_counts(tmp_path / "ggbench", tmp_path / "estimators")) == 1


def test_rooms_are_entered_by_their_modules():
    """The ``__init__`` of a room loads nothing: --help stays quick, and no circle hides.

    What it names for type checkers alone is not loaded.
    """
    for file in (ROOT / "ggbench").glob("*/**/__init__.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        assert ast.get_docstring(tree), file
        loaded = [node for node in tree.body if isinstance(node, ast.ImportFrom | ast.Import)]
        modules = {getattr(node, "module", None) for node in loaded}
        assert modules <= {"__future__", "importlib", "typing"}, file


def test_every_room_is_installed():
    """What ``packages`` of pyproject.toml lists is what there is."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    rooms = {
        ".".join(file.parent.relative_to(ROOT).parts)
        for file in (ROOT / "ggbench").rglob("__init__.py")
    }
    listed = project["tool"]["setuptools"]["packages"]
    apart = {"ggbench.estimators", "ggbench.scenarios"}
    assert sorted(listed) == sorted(rooms | apart)
