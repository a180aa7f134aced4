"""Tracks and map errors that are drawn for the runs of a case."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from ..gravity.ellipsoid import metres_per_radian
from . import quantities as q
from .tables import Section
from .trajectory import TrajectorySpec

if TYPE_CHECKING:
    from .case import CaseSpec

_SEED = 3737
"""Seed of the tracks: those of a case are the same in all campaigns."""


class DrawSpec(Section):
    """``[draw]``: start, heading and map errors that are drawn instead of shared by all runs."""

    tracks: Annotated[int, Field(ge=1, le=1000)] = 1
    """Number of tracks; run r flies track r modulo this number."""
    start_km: q.Displacement = 0.0
    """Half the side of the square, about the start, in which tracks start."""
    heading_deg: q.Turns = 0.0
    """Largest angle by which a track is turned, to either side."""
    maps: Annotated[int, Field(ge=1, le=1000)] = 1
    """Number of map errors; run r has map error r modulo this number."""


@lru_cache(maxsize=4096)
def of_run(case: CaseSpec, run: int) -> CaseSpec:
    """Return a case with the track and the map errors of a run."""
    draw = case.draw
    change: dict[str, Any] = {"draw": DrawSpec()}
    if draw.tracks > 1:
        rng = np.random.default_rng([_SEED, run % draw.tracks])
        east, north, turn = rng.uniform(-1.0, 1.0, 3).tolist()
        change["trajectory"] = moved(
            case.trajectory, draw.start_km * east, draw.start_km * north, draw.heading_deg * turn
        )
    if lines := case.trajectory.drawn_lines:
        line = lines[run % len(lines)]
        change["trajectory"] = case.trajectory.model_copy(update={"lines": (line,)})
    for side, error in case.map_errors().items() if draw.maps > 1 else ():
        seeded = error.model_copy(update={"seed": error.seed + run % draw.maps})
        tables = getattr(case, side) if side else case
        field = tables.field.model_copy(update={"error": seeded})
        change[side or "field"] = tables.model_copy(update={"field": field}) if side else field
    return case.model_copy(update=change)


def moved(spec: TrajectorySpec, east_km: float, north_km: float, turn_deg: float) -> TrajectorySpec:
    """Return a flight of segments with another start, turned about it.

    Parameters
    ----------
    spec : the flight.
    east_km, north_km : from its start to the new one [km].
    turn_deg : by which all headings grow [deg].
    """
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
