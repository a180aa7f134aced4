"""Package version, and hashes of the source behind compiled code and cached maps.

A hash covers whole subpackages ("rooms"), or a module with all its imports. There is no list of
files to maintain.
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
"""Subpackages with compiled code, or with constants that are compiled into it."""
MAP_ROOMS = ("numerics", "gravity", "maps")
"""Subpackages that build maps from data."""


@cache
def rooms_hash(*rooms: str) -> str:
    """Return a hash (16 hexadecimal digits) of all modules of the given subpackages."""
    return _hash_of({file for room in rooms for file in (PACKAGE / room).rglob("*.py")})


VECTORS = PACKAGE / "numerics" / "vectors.py"
_IMPORT = re.compile(r"^\s*from\s+(\.+)([\w.]*)\s+import\s+(\((?:[^)#]|#.*)*\)|.*)", re.MULTILINE)
"""Pattern of relative imports. A test checks that all imports within the package are relative."""


def module_hash(file: Path) -> str:
    """Return a hash (16 hexadecimal digits) of the source of a module and of all its imports.

    The hash covers direct and indirect imports within the package. A file outside the package, such
    as a user's estimator, may use any compiled function, so its hash covers all
    :data:`COMPILED_ROOMS`.
    """
    if PACKAGE in file.parents:
        # A formula may be compiled for vectors although its module does not import them.
        return _hash_of({file, VECTORS} | _imported(file) | _imported(VECTORS))
    own = rooms_hash(*COMPILED_ROOMS).encode() + file.read_bytes()
    return hashlib.sha256(own).hexdigest()[:16]


def _hash_of(modules: set[Path]) -> str:
    """Return a hash of the names and contents of modules of the package."""
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
        ahead = set().union(*map(directly_imported, ahead)) - found
        found |= ahead
    return found


@cache
def directly_imported(file: Path) -> frozenset[Path]:
    """Return the files of the package's modules that a module imports directly."""
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
