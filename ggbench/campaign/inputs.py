"""Which files a campaign's results depend on: maps, terrains, tracks, with their hashes."""

from __future__ import annotations

from collections.abc import Iterable

from ..simulation.field_source import map_files
from ..simulation.instruments import noise_files
from ..spec.case import CaseSpec


def input_files(cases: Iterable[CaseSpec]) -> list[dict[str, str]]:
    """Return what cases are made of: the role, the name and the SHA-256 of each file, once.

    Names are without folders: what counts is the content.

    Raises
    ------
    MapError, TrajectoryError, ColouredNoiseError
        If one cannot be read.
    """
    found: dict[tuple[str, str, str], None] = {}
    for case in cases:
        for side in ("truth", "model"):
            found |= dict.fromkeys(map_files(case.side(side).field))
        flown = zip(case.trajectory.files(), case.trajectory.file_hashes(), strict=True)
        for path, key in flown:
            role = "track" if not case.trajectory.lines else "survey lines"
            role = role if str(path) == case.trajectory.file else "terrain of the flight"
            found[role, path.name, key] = None
        for path, key in noise_files(case):
            found["model of coloured noise", path.name, key] = None
    return [{"role": role, "name": name, "sha256": key} for role, name, key in found]
