"""Table ``[draw]``: tracks and map errors drawn for the runs of a case."""

from __future__ import annotations

import hashlib
import math
from typing import Annotated

import numpy as np
from pydantic import Field

from ..gravity.ellipsoid import metres_per_radian
from . import quantities as q
from .tables import Section
from .trajectory import TrajectorySpec

_SEED = 3737
"""Seed of the tracks. All campaigns fly the same tracks of a case."""


class DrawSpec(Section):
    """``[draw]``: starts, headings and map errors that differ between runs."""

    tracks: Annotated[int, Field(ge=1, le=1000)] = 1
    """Number of tracks. Run r flies the track with index r modulo this number."""
    start_km: q.Displacement = 0.0
    """Half the side of the square from which starts are drawn, centred on the start."""
    heading_deg: q.Turns = 0.0
    """Largest rotation of a track, to either side."""
    maps: Annotated[int, Field(ge=1, le=1000)] = 1
    """Number of map errors. Run r has the map error with index r modulo this number."""
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]*$", max_length=60)] = ""
    """Part of the seed. Cases with equal names, or without one, share tracks and random numbers."""


def words_of(name: str) -> tuple[int, ...]:
    """Return four 32-bit numbers derived from a name; ``()`` for an empty name."""
    if not name:
        return ()
    digest = hashlib.sha256(name.encode()).digest()
    return tuple(np.frombuffer(digest, dtype="<u4", count=4).tolist())


def drawn_track(spec: TrajectorySpec, draw: DrawSpec, run: int) -> TrajectorySpec:
    """Return the table ``[trajectory]`` with the track of a run.

    The track is moved and rotated at random, or is one of several survey lines.
    """
    if draw.tracks > 1:
        rng = np.random.default_rng([_SEED, run % draw.tracks, *words_of(draw.name)])
        east, north, turn = rng.uniform(-1.0, 1.0, 3).tolist()
        spec = moved(spec, draw.start_km * east, draw.start_km * north, draw.heading_deg * turn)
    if lines := spec.drawn_lines:
        spec = spec.model_copy(update={"lines": (lines[run % len(lines)],)})
    return spec


def moved(spec: TrajectorySpec, east_km: float, north_km: float, turn_deg: float) -> TrajectorySpec:
    """Return a flight that is moved to a new start and rotated about the new start.

    Parameters
    ----------
    spec : table of a flight that consists of segments or follows a track.
    east_km, north_km : displacement of the start [km].
    turn_deg : clockwise rotation [deg].
    """
    if spec.file is not None:
        return spec.model_copy(
            update={
                "shift_east_km": spec.shift_east_km + east_km,
                "shift_north_km": spec.shift_north_km + north_km,
                "turn_deg": spec.turn_deg + turn_deg,
            }
        )
    start = spec.start()
    metres = metres_per_radian(start.position)
    place = start.position[:2] + 1e3 * np.array([north_km, east_km]) / metres
    latitude, longitude = np.degrees(place).tolist()
    return spec.model_copy(
        update={
            "latitude_deg": latitude,
            "longitude_deg": longitude,
            "heading_deg": math.degrees(start.heading) + turn_deg,
            "segment": tuple(
                s.model_copy(update={"to_heading_deg": s.to_heading_deg + turn_deg})
                if s.to_heading_deg is not None
                else s
                for s in spec.segment
            ),
        }
    )
