"""Versions of a case's input files, used as keys of caches in a process."""

from __future__ import annotations

from ..spec.case import CaseSpec
from ..spec.trajectory import file_versions
from ..trajectory.terrain_following import terrain_path as shipped_or_own
from .field_source import map_version, version_of
from .instruments import noise_names

Versions = tuple[tuple[int, int], ...]


def input_versions(case: CaseSpec) -> Versions:
    """Return modification time [ns] and size [bytes] of each input file.

    The two numbers are zero for a map without a file.

    Raises
    ------
    TrajectoryError
        If a file of the trajectory is missing. Any other missing file has the version zero.
    """
    maps = tuple(map_version(case.side(name).field) for name in ("truth", "model"))
    noises = tuple(version_of(shipped_or_own(name)) for name in noise_names(case))
    return (*file_versions(case.trajectory), *maps, *noises)
