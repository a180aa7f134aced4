"""Content-based keys of stored runs, and input files of runs.

The key of a run is a hash of all inputs of the result. These are the contents of case and map, the
estimator's parameters and source, the seed, and the versions of results and libraries. Names, paths
and the order of cases and estimators do not change the key. Key and run index together identify a
run.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import platform
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

from ..numerics.source import VERSION
from ..simulation.field_source import map_content, map_files, map_version
from ..simulation.instruments import noise_files
from ..spec.case import CaseSpec
from ..spec.sensors import FieldSpec

RESULTS_VERSION = 2
"""Version of the numerical results of runs.

Raise it with every change that moves a result beyond rounding: `tests/test_golden.py` finds such a
change. Stored runs of another version count as missing, and ``make library`` flies them again.
"""
_PACKAGES = ("numpy", "scipy", "filterpy", "gtsam", "numba")
"""Packages whose version may change a result."""


@cache
def environment() -> dict[str, Any]:
    """Return the versions on which a result depends: package, results and libraries."""
    return {
        "ggbench": VERSION,
        "results_version": RESULTS_VERSION,
        "versions": {
            "python": platform.python_version(),
            **{name: importlib.metadata.version(name) for name in _PACKAGES},
        },
    }


def problem_key(case: CaseSpec, seed: int) -> str:
    """Return the key of the simulated problems of a case.

    The key does not depend on the versions of package, results and libraries.

    Raise MapError if the case's map file cannot be read.
    """
    # A file is its content: where it lies, and how that is spelt, is no part of the problem.
    placeless: dict[str, Any] = {
        "field": case.field.model_copy(update={"source": "map"}),
        "trajectory": case.trajectory.placeless(),
        "gradiometer": _placeless(case.gradiometer),
    }
    for name in ("truth", "model"):
        side = getattr(case, name)
        field = side.field.model_copy(update={"source": None})
        change = {"field": field, "gradiometer": _placeless(side.gradiometer)}
        placeless[name] = side.model_copy(update=change)
    fields = [case.side(name).field for name in ("truth", "model")]
    maps = [_map_content(field, map_version(field)) for field in fields]
    content = case.model_copy(update=placeless).content_hash
    noises = [key for _, key in noise_files(case)]
    return _hash([content, *maps, *case.trajectory.file_hashes(), *noises, seed])


def _placeless(gradiometer: Any) -> Any:
    """Return the gradiometer table without the path of its model of coloured noise."""
    if gradiometer is None or gradiometer.coloured_noise is None:
        return gradiometer
    return gradiometer.model_copy(update={"coloured_noise": "noise"})


def case_key(case: CaseSpec, seed: int) -> str:
    """Return the key of the arrays that all runs of a case share.

    The key does not depend on estimators.
    """
    return _hash([environment(), problem_key(case, seed)])


def run_key(case: CaseSpec, estimator: Mapping[str, Any], seed: int) -> str:
    """Return the key of an estimator's runs on a case.

    ``estimator`` is the content of the estimator
    (:attr:`ggbench.campaign.registry.Choice.content`). Key and run index together identify a run.
    """
    return _hash([case_key(case, seed), estimator])


def _hash(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def input_files(cases: Iterable[CaseSpec]) -> list[dict[str, str]]:
    """Return role, name and SHA-256 of each input file of cases, without duplicates.

    The role states the use of the file, for example ``track``. Names have no folders, because only
    the content counts. Raise MapError, TrajectoryError or
    ColouredNoiseError if a file cannot be read.
    """
    files: dict[tuple[str, str, str], None] = {}
    for case in cases:
        for side in ("truth", "model"):
            files |= dict.fromkeys(map_files(case.side(side).field))
        flown = zip(case.trajectory.files(), case.trajectory.file_hashes(), strict=True)
        for path, key in flown:
            role = "track" if not case.trajectory.lines else "survey lines"
            role = role if str(path) == case.trajectory.file else "terrain of the flight"
            files[role, path.name, key] = None
        for path, key in noise_files(case):
            files["model of coloured noise", path.name, key] = None
    return [{"role": role, "name": name, "sha256": key} for role, name, key in files]


@cache
def _map_content(spec: FieldSpec, version: tuple[int, int]) -> str | None:
    """Return a hash of the map of a field; each version of its file is read once per process."""
    return map_content(spec)
