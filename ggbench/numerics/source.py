"""The version, and hashes of the source: of what compiled code, maps and results are made with.

Whole rooms are hashed, or a module with all that it imports; never a list of files that somebody
has to remember. The hash of all that a result depends on is of the statements alone: a sentence
that says something better leaves the results of hours what they are.
"""

from __future__ import annotations

import ast
import hashlib
import re
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TypeGuard

VERSION = version("ggbench")
PACKAGE = Path(__file__).parent.parent
COMPILED_ROOMS = ("numerics", "gravity", "ins", "sensors", "trajectory", "engines", "judging")
"""Rooms that hold compiled code, or constants that are compiled into it."""
MAP_ROOMS = ("numerics", "gravity", "maps")
"""Rooms that make a map from data."""
_RESULTS = ("campaign/runner.py", "block.py", "reduced.py", "engines", *MAP_ROOMS)
"""What makes results, with all that it imports: the runner, what estimators are made of, which
themselves are known by their own content, and maps."""


@cache
def source_hash(*rooms: str) -> str:
    """Return a hash (16 hexadecimal digits) of the modules of rooms.

    If none is named, of all modules on which a result depends, without their comments and
    docstrings: of :mod:`ggbench.campaign.runner`, of what estimators are made of, and of all that
    these import.
    """
    roots = [PACKAGE / name for name in rooms or _RESULTS]
    files = {file for root in roots for file in (root, *root.rglob("*.py")) if file.is_file()}
    return _hash_of(files if rooms else files.union(*map(_imported, files)), whole=bool(rooms))


_VECTORS = PACKAGE / "numerics" / "vectors.py"
_IMPORT = re.compile(r"^\s*from\s+(\.+)([\w.]*)\s+import\s+(\((?:[^)#]|#.*)*\)|.*)", re.MULTILINE)
"""Modules of the package import each other relatively (a test holds them to it)."""


def module_hash(file: Path) -> str:
    """Return a hash (16 hexadecimal digits) of a module's source and of all that it imports.

    Of modules of the package, directly or not. A file elsewhere, an estimator of a user's own, may
    use whatever is compiled here: it is hashed with all :data:`COMPILED_ROOMS`.
    """
    if PACKAGE in file.parents:
        # A formula is compiled for vectors, too, without its module knowing them.
        return _hash_of({file, _VECTORS} | _imported(file) | _imported(_VECTORS))
    own = source_hash(*COMPILED_ROOMS).encode() + file.read_bytes()
    return hashlib.sha256(own).hexdigest()[:16]


def _hash_of(modules: set[Path], whole: bool = True) -> str:
    """Return a hash of modules of the package, with their names; or of their statements alone."""
    digest = hashlib.sha256()
    for module in sorted(modules):
        content = module.read_bytes()
        if not whole:
            content = statements(content.decode()).encode()
        name = module.relative_to(PACKAGE).as_posix()
        digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:16]


@cache
def statements(text: str) -> str:
    """Return a module's text without docstrings, lines of comments and empty lines.

    By lines, so that every version of Python finds the same: what is said at the end of a line of
    code stays, and so does all that is within a text of several lines.
    """
    lines = text.splitlines()
    dropped, kept = set[int](), set[int]()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and _is_text(node.value):
            rows = range(node.lineno - 1, node.end_lineno or node.lineno)
            before = lines[rows[0]].encode()[: node.col_offset]
            behind = lines[rows[-1]].encode()[node.end_col_offset :]
            if not (before + behind).strip():
                dropped.update(rows)
        elif isinstance(node, ast.JoinedStr) or _is_text(node):
            kept.update(range(node.lineno - 1, node.end_lineno or node.lineno))
    return "\n".join(
        line
        for row, line in enumerate(lines)
        if row not in dropped
        and (row in kept or (line.strip() and not line.lstrip().startswith("#")))
    )


def _is_text(node: ast.AST) -> TypeGuard[ast.Constant]:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _imported(file: Path) -> set[Path]:
    """Return the modules of the package that a module imports, directly or not."""
    found: set[Path] = set()
    ahead = {file}
    while ahead:
        ahead = set().union(*map(_imported_directly, ahead)) - found
        found |= ahead
    return found


@cache
def _imported_directly(file: Path) -> frozenset[Path]:
    found = set()
    for dots, path, names in _IMPORT.findall(file.read_text(encoding="utf-8")):
        base = file.parents[len(dots) - 1].joinpath(*filter(None, path.split(".")))
        for name in re.findall(r"\w+", re.sub(r"#.*|\bas\s+\w+", "", names)):
            candidates = (base / f"{name}.py", base / name / "__init__.py", base.with_suffix(".py"))
            for candidate in (*candidates, base / "__init__.py"):
                if candidate.is_file():
                    found.add(candidate)
                    break
    return frozenset(found)
