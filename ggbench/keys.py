"""What a stored run is the result of: its key.

A run's key is a hash of everything that its result depends on (the content of its case and map,
the estimator with its parameters and source, the seed, the package and the libraries below it) and
never of a name, a place or an order. Its number completes it.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.resources
import json
import platform
from functools import cache
from pathlib import Path
from typing import Any

from . import __version__
from .disturbing_field import MapError
from .registry import Choice
from .schema import CaseSpec

_PACKAGES = ("numpy", "scipy", "filterpy", "gtsam", "numba")
"""Packages whose version may change a result."""


@cache
def environment() -> dict[str, Any]:
    """Return the versions that a result depends on: of the package, its source, its libraries."""
    return {
        "ggbench": __version__,
        "source_hash": _source_hash(),
        "versions": {
            "python": platform.python_version(),
            **{name: importlib.metadata.version(name) for name in _PACKAGES},
        },
    }


def case_key(case: CaseSpec, seed: int) -> str:
    """Return the key of what all runs of a case share, whatever the estimator.

    Raises
    ------
    MapError
        If the case's map file cannot be read.
    """
    source = case.field.source
    map_file = _file_hash(Path(source)) if source.endswith(".npz") else None
    return _hash([environment(), case.content_hash, map_file, seed])


def run_key(case: CaseSpec, choice: Choice, seed: int) -> str:
    """Return the key of the runs of an estimator on a case; a run's number completes it."""
    return _hash([case_key(case, seed), choice.content])


def _hash(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


@cache
def _file_hash(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise MapError(f"cannot read the map {path}: {error.strerror}") from None


def _source_hash() -> str:
    """Return a hash of the package's source."""
    digest = hashlib.sha256()
    for package in ("ggbench", "ggbench.estimators"):
        folder = importlib.resources.files(package)
        for file in sorted(folder.iterdir(), key=lambda f: f.name):
            if file.name.endswith(".py"):
                digest.update(file.name.encode() + file.read_bytes())
    return digest.hexdigest()[:16]
