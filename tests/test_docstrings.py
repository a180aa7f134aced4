"""Docstrings of the package: parameters that exist, errors that are raised, shapes of arrays."""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path

from findings_by_file import findings_by_file

ROOT = Path(__file__).parent.parent
FILES = [path for room in ("ggbench", "estimators") for path in sorted((ROOT / room).rglob("*.py"))]
COMMANDS = ROOT / "ggbench" / "cli"
"""Their docstrings are help texts; errors are printed."""
DEMANDS = ROOT / "ggbench" / "contract" / "demands.py"
"""Its functions all raise the same two errors, which the module names."""
_SECTION = re.compile(r"^Parameters\n-+\n(.*?)(?=^\w[\w ]*\n-+\n|\Z)", re.MULTILINE | re.DOTALL)
_ENTRY = re.compile(r"^(\S.*?) :", re.MULTILINE)


def flaws(source: str, raises: bool = True) -> Iterator[str]:
    """Yield a sentence for each public class or function whose docstring is incomplete."""
    for node in _public(ast.parse(source)):
        text = ast.get_docstring(node)
        if not text:
            yield f"{node.name} has no docstring"
        elif isinstance(node, ast.FunctionDef):
            yield from _flaws_of(node, text, raises)


def _public(tree: ast.Module | ast.ClassDef) -> Iterator[ast.ClassDef | ast.FunctionDef]:
    """Yield public classes and functions, and those within the classes."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef):
                yield from _public(node)


def _flaws_of(node: ast.FunctionDef, text: str, raises: bool) -> Iterator[str]:
    rest = node.args
    given = [*rest.posonlyargs, *rest.args, *rest.kwonlyargs, rest.vararg, rest.kwarg]
    names = {argument.arg for argument in given if argument is not None}
    section = _SECTION.search(text)
    for entry in _ENTRY.findall(section[1]) if section else ():
        for name in entry.split(","):
            if name.strip().lstrip("*") not in names:
                yield f"{node.name} has no parameter {name.strip()}"
    thrown = any(isinstance(part, ast.Raise) and part.exc is not None for part in ast.walk(node))
    if raises and thrown and not re.search(r"[Rr]aise|[Rr]efuse", text):
        yield f"{node.name} raises an error that its docstring does not state"


def test_docstrings_state_parameters_and_errors():
    silent = {path for path in FILES if COMMANDS in path.parents or path == DEMANDS}
    assert silent
    assert findings_by_file(set(FILES) - silent, flaws) == {}
    assert findings_by_file(silent, functools.partial(flaws, raises=False)) == {}


def test_an_incomplete_docstring_is_found():
    bare = "def f(x):\n    return x\n"
    other = (
        'def f(x):\n    """Do.\n\n    Parameters\n    ----------\n    x, y : numbers.\n    """\n'
    )
    silent = 'def f(x):\n    """Do."""\n    raise ValueError(x)\n'
    assert list(flaws(bare)) == ["f has no docstring"]
    assert list(flaws(other)) == ["f has no parameter y"]
    assert list(flaws(silent)) == ["f raises an error that its docstring does not state"]
    assert list(flaws(silent, raises=False)) == []
    assert (
        list(flaws('def f(x):\n    """Return x.\n\n    Raise ValueError."""\n    raise x(1)')) == []
    )


_ARRAY = re.compile(r"\b(?:Array|ComplexArray|ndarray|NDArray)\b")
_LENGTH = r"(?:\.\.\.|len\(\w+\)|(?![A-Z][a-z])[\w']+(?: ?[×·+−*/-] ?[\w']+)*)"
_SHAPE = re.compile(rf"\((?:\.\.\.|{_LENGTH}(?:, {_LENGTH})+|{_LENGTH},)\)")
"""A shape in parentheses: ``(K, n)``, ``(N,)``, ``(...)``."""


def shapeless(source: str) -> Iterator[str]:
    """Yield the name of each public function of arrays whose docstring states no shape."""
    for node in _public(ast.parse(source)):
        if isinstance(node, ast.FunctionDef):
            rest = node.args
            given = [*rest.posonlyargs, *rest.args, *rest.kwonlyargs]
            types = [argument.annotation for argument in given] + [node.returns]
            arrays = any(_ARRAY.search(ast.unparse(each)) for each in types if each is not None)
            if arrays and not _SHAPE.search(ast.get_docstring(node) or ""):
                yield node.name


def test_docstrings_state_the_shapes_of_arrays():
    assert findings_by_file(FILES, shapeless) == {}


def test_a_docstring_without_shapes_is_found():
    """Negative controls: of a parameter and of a result; numbers, texts and shapes are let pass."""
    head = 'def f(x: np.ndarray) -> float:\n    """Return the sum'
    assert list(shapeless(f'{head}."""\n')) == ["f"]
    assert list(shapeless(f'{head} (see Groves, or below)."""\n')) == ["f"]
    assert list(shapeless(f'{head} (Groves, 2013)."""\n')) == ["f"]
    assert list(shapeless(f'{head} [m] (in time)."""\n')) == ["f"]
    assert list(shapeless('def f() -> dict[str, Array]:\n    """Return all."""\n')) == ["f"]
    for shape in ("(N,)", "(K, n, n)", "(...)", "(..., 3)", "(runs, K', 4)", "(N, len(names))"):
        assert list(shapeless(f'{head} of x {shape}."""\n')) == []
    assert list(shapeless('def f(x: float) -> str:\n    """Return a text."""\n')) == []
    assert list(shapeless('def _f(x: Array) -> Array:\n    """Return it."""\n')) == []
