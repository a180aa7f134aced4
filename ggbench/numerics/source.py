"""The version, and hashes of the source: of what compiled code, maps and results are made with.

Whole rooms are hashed, or a module with all that it imports; never a list of files that somebody
has to remember.
"""

from __future__ import annotations

import hashlib
import re
from functools import cache
from importlib.metadata import version
from pathlib import Path

VERSION = version("ggbench")
PACKAGE = Path(__file__).parent.parent
COMPILED_ROOMS = ("numerics", "gravity", "ins", "sensors", "trajectory", "engines", "judging")
"""Rooms that hold compiled code, or constants that are compiled into it."""
MAP_ROOMS = ("numerics", "gravity", "maps")
"""Rooms that make a map from data."""
_NOT_OF_RESULTS = {
    "adapters", "estimators", "scenarios", "areas", "contract", "recorded", "figures", "report",
    "api.py", "cli",
}  # fmt: skip
"""What no result depends on: parts that results know by their own content, and what shows them."""


@cache
def source_hash(*rooms: str) -> str:
    """Return a hash (16 hexadecimal digits) of the modules of rooms.

    Of all rooms that a result depends on, and of the modules beside the rooms, if none is named.
    """
    found = set()
    for file in PACKAGE.rglob("*.py"):
        room = file.relative_to(PACKAGE).parts[0]
        if room in rooms or (not rooms and room not in _NOT_OF_RESULTS):
            found.add(file)
    return _hash_of(found)


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


def _hash_of(modules: set[Path]) -> str:
    """Return a hash of modules of the package, with their names."""
    digest = hashlib.sha256()
    for module in sorted(modules):
        content = module.read_bytes()
        name = module.relative_to(PACKAGE).as_posix()
        digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:16]


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
