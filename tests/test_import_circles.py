"""No circle of imports among the modules of a room.

Imports within functions count, and those for type checkers alone: they hide a circle, and a reader
meets it all the same.
"""

from __future__ import annotations

import ast
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
Imports = Mapping[str, set[str]]


def module_files(root: Path) -> dict[str, Path]:
    """The files of the package's modules by their dotted names, with the estimators beside it."""
    files = {}
    for folder, above in (("ggbench", root / "ggbench"), ("estimators", root)):
        for file in (root / folder).rglob("*.py"):
            parts = file.relative_to(above).with_suffix("").parts
            files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return files


def imports_of(root: Path) -> dict[str, set[str]]:
    """The modules of the same room that each module imports."""
    files = module_files(root)
    found = {}
    for module, file in files.items():
        package = module.split(".") if file.name == "__init__.py" else module.split(".")[:-1]
        names = _imported(ast.parse(file.read_text(encoding="utf-8")), package)
        room = module.partition(".")[0]
        among = {_module_of(name, files) for name in names} - {module, ""}
        found[module] = {other for other in among if other.partition(".")[0] == room}
    return found


def _module_of(name: str, files: Mapping[str, Path]) -> str:
    """The module that a dotted name is, or is in; "" for none of the package."""
    return name if name in files else name.rpartition(".")[0]


def _imported(node: ast.AST, package: list[str]) -> Iterator[str]:
    """Dotted names within ggbench that code imports, wherever it does."""
    if isinstance(node, ast.ImportFrom):
        base = (node.module or "").split(".") if node.module else []
        if node.level:
            base = [*package[: len(package) - node.level + 1], *base]
        elif base[:1] == ["ggbench"]:
            base = base[1:]
        else:
            return
        yield from (".".join([*base, alias.name]) for alias in node.names)
    elif isinstance(node, ast.Import):
        for alias in node.names:
            head, _, name = alias.name.partition(".")
            if head == "ggbench":
                yield name
    else:
        for inner in ast.iter_child_nodes(node):
            yield from _imported(inner, package)


def circles(imports: Imports) -> list[list[str]]:
    """The groups of modules that import one another, each sorted: strongly connected ones."""
    reached = {module: _reached(module, imports) for module in imports}
    groups = {
        tuple(sorted(other for other in reached[module] if module in reached[other]))
        for module in imports
        if module in reached[module]
    }
    return sorted(map(list, groups))


def _reached(module: str, imports: Imports) -> set[str]:
    """All modules that a module imports, by itself or by others."""
    found: set[str] = set()
    waiting = set(imports[module])
    while waiting:
        found |= waiting
        waiting = {other for each in waiting for other in imports.get(each, ())} - found
    return found


@pytest.mark.long
def test_no_modules_of_a_room_import_one_another():
    assert circles(imports_of(ROOT)) == []


@pytest.mark.parametrize(
    ("room", "source", "target"),
    [
        ("simulation", "from .runs import simulate\n", "simulation/sensor_suite.py"),
        ("simulation", "def later():\n    from .runs import simulate\n", "simulation/aiding.py"),
        ("spec", "import ggbench.spec.scenario\n", "spec/tables.py"),
        ("spec", "from ggbench.spec import case\n", "spec/presets.py"),
        (
            "spec",
            "if TYPE_CHECKING:\n    from .scenario import Scenario\n",
            "spec/sweep.py",
        ),
        ("sensors", "from ..model import SensorModel\n", "sensors/gradiometer/instrument.py"),
    ],
)
def test_a_circle_is_seen(tmp_path, room, source, target):
    """The guard fails where it should, at the top of a module, in functions and for types alone."""
    shutil.copytree(ROOT / "ggbench" / room, tmp_path / "ggbench" / room)
    assert circles(imports_of(tmp_path)) == []
    file = tmp_path / "ggbench" / target
    file.write_text(f"{file.read_text(encoding='utf-8')}\n{source}", encoding="utf-8")
    (found,) = circles(imports_of(tmp_path))
    assert target.removesuffix(".py").replace("/", ".") in found
