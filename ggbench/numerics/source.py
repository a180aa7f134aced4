"""Hashes of the package's own source: of what compiled code, maps and results are made with.

Whole folders are hashed, never a list of files that somebody has to remember.
"""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parent.parent
_APART = {"estimators", "scenarios"}
"""Parts of the package that results know by their own content."""


@cache
def source_hash() -> str:
    """Return a hash (16 hexadecimal digits) of the package's modules."""
    digest = hashlib.sha256()
    files = (path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py"))
    for file in sorted(file for file in files if file.parts[0] not in _APART):
        content = (PACKAGE / file).read_bytes()
        digest.update(f"{file.as_posix()}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:16]
