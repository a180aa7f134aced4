"""Few tests use private names of the package: a change of its inside should not break them."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MOST = 20
NAMED_TUPLE = {"_asdict", "_fields", "_make", "_replace"}
"""Public methods of named tuples."""


def private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def defined(folders: tuple[Path, ...]) -> set[str]:
    """Private names that the code of some folders binds: functions, variables and attributes."""
    names = set()
    for node in nodes(*folders):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            names.add(node.id if isinstance(node, ast.Name) else node.attr)
    return {name for name in names - NAMED_TUPLE if private(name) and not name.endswith("_")}


def uses(node: ast.AST, names: set[str]) -> list[str]:
    """Private names of the package that a node of a test's code uses of another object."""
    if isinstance(node, ast.ImportFrom):
        inside = (node.module or "").startswith("ggbench")
        return [alias.name for alias in node.names if inside and alias.name in names]
    if isinstance(node, ast.Attribute):
        own = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
        return [node.attr] if node.attr in names and not own else []
    called = getattr(node, "func", None)
    if getattr(called, "attr", getattr(called, "id", "")) == "setattr":
        texts = [getattr(argument, "value", None) for argument in node.args]
        return [t for t in texts if isinstance(t, str) and t.rpartition(".")[2] in names]
    return []


def nodes(*folders: Path):
    for folder in folders:
        for file in sorted(folder.rglob("*.py")):
            yield from ast.walk(ast.parse(file.read_text(encoding="utf-8")))


@pytest.mark.long
def test_tests_use_few_private_names_of_the_package():
    names = defined((ROOT / "ggbench", ROOT / "estimators"))
    found = [use for node in nodes(ROOT / "tests") for use in uses(node, names)]
    assert len(found) <= MOST, sorted(found)


def test_each_way_to_use_a_private_name_is_counted():
    code = (
        "from ggbench.engines import _one\nmodule._one\nself._one\n"
        "monkeypatch.setattr(module, '_one', 2)\npatch.setattr('ggbench.room._one', 2)\n"
        "from other import _one\nmodule._two"
    )
    found = [use for node in ast.walk(ast.parse(code)) for use in uses(node, {"_one"})]
    assert len(found) == 4
