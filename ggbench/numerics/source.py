"""The version, and hashes of the source: of what compiled code, maps and results are made with.

Whole rooms are hashed, never a list of files that somebody has to remember.
"""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path

VERSION = version("ggbench")
PACKAGE = Path(__file__).parent.parent
COMPILED_ROOMS = ("numerics", "gravity", "ins", "sensors", "trajectory", "engines", "judging")
"""Rooms that hold compiled code, or constants that are compiled into it."""
MAP_ROOMS = ("numerics", "gravity", "maps")
"""Rooms that make a map from data."""
_NOT_OF_RESULTS = {"estimators", "scenarios", "figures", "report", "api.py", "cli"}
"""What no result depends on: parts that results know by their own content, and what shows them."""


@cache
def source_hash(*rooms: str) -> str:
    """Return a hash (16 hexadecimal digits) of the modules of rooms.

    Of all rooms that a result depends on, and of the modules beside the rooms, if none is named.
    """
    digest = hashlib.sha256()
    files = (path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py"))
    for file in sorted(files):
        room = file.parts[0]
        if room in rooms or (not rooms and room not in _NOT_OF_RESULTS):
            content = (PACKAGE / file).read_bytes()
            digest.update(f"{file.as_posix()}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:16]
