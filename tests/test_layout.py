"""Layout of code: few exceptions from the formatter, and long calls by name."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from findings_by_file import findings_by_file

ROOT = Path(__file__).parents[1]
ROOMS = ("ggbench", "estimators", "tests", "benchmarks", "studies", "docs")
FILES = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]
MOST_SKIPPED = 60
"""Statements that the formatter leaves alone: matrices, tables and unrolled kernels."""
MOST_POSITIONAL = 6
COMPILED = {"compiled", "copied", "inlined", "intrinsic"}
WORDS = {"add_row", "command", "pack", "run", "start"}
"""Functions of any number of words or cells, which have no names."""


def skipped(source: str) -> int:
    """Return the number of statements that the formatter leaves alone."""
    return sum(line.endswith("# fmt: skip") for line in source.splitlines())


def is_compiled(node: ast.AST) -> bool:
    """Return whether a node is a compiled function, which may pass on arrays by position."""
    decorators = getattr(node, "decorator_list", [])
    return any(ast.unparse(decorator) in COMPILED for decorator in decorators)


def long_calls(node: ast.AST) -> list[str]:
    """Return the calls below a node with too many arguments by position, kernels left out."""
    if is_compiled(node):
        return []
    found = [call for child in ast.iter_child_nodes(node) for call in long_calls(child)]
    if isinstance(node, ast.Call) and len(node.args) > MOST_POSITIONAL:
        name = ast.unparse(node.func).rpartition(".")[2]
        if name not in WORDS:
            found.append(f"{name}, line {node.lineno}")
    return found


def test_the_formatter_has_few_exceptions():
    counts = {str(path): skipped(path.read_text(encoding="utf-8")) for path in FILES}
    assert sum(counts.values()) <= MOST_SKIPPED, {k: v for k, v in counts.items() if v}


@pytest.mark.long
def test_calls_with_many_arguments_pass_them_by_name():
    assert findings_by_file(FILES, lambda source: long_calls(ast.parse(source))) == {}


def test_exceptions_and_long_calls_are_found():
    """Negative controls: counted at the end of a line; kernels and lists of words are left out."""
    found = findings_by_file([Path(__file__)], lambda source: [source[:9]])
    assert found == {"tests/test_layout.py": ['"""Layout']}
    assert skipped("a = [1]  # fmt: skip\nb = '# fmt: skip'\n") == 1
    long = "f(1, 2, 3, 4, 5, 6, 7)"
    assert long_calls(ast.parse(f"x.{long}")) == ["f, line 1"]
    assert long_calls(ast.parse(f"@compiled\ndef k():\n    {long}")) == []
    assert long_calls(ast.parse("f(1, 2, 3, 4, 5, 6, g=7)\nrun(1, 2, 3, 4, 5, 6, 7)")) == []
