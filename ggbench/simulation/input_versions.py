"""Versions of the files that a case is made of: a cache within a process is keyed by them."""

from __future__ import annotations

from ..spec.case import CaseSpec
from ..spec.trajectory import file_versions
from ..trajectory.terrain_following import terrain_path as shipped_or_own
from .field_source import map_version, version_of
from .instruments import noise_names

Versions = tuple[tuple[int, int], ...]


def input_versions(case: CaseSpec) -> Versions:
    """Return time of change [ns] and size [bytes] of each file of a case; zeros of a built map.

    Raises
    ------
    TrajectoryError
        If a file of the flight is missing. Other missing files have zeros.
    """
    maps = tuple(map_version(case.side(name).field) for name in ("truth", "model"))
    noises = tuple(version_of(shipped_or_own(name)) for name in noise_names(case))
    return (*file_versions(case.trajectory), *maps, *noises)
