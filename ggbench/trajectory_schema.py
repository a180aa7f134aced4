"""What ``[trajectory]`` of a scenario file may say."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from .sections import Finite, Latitude, Longitude, Positive, Section


class SegmentSpec(Section):
    """One ``[[trajectory.segment]]``."""

    duration_s: Positive
    turn_rate_deg_per_s: Annotated[float, Field(ge=-30.0, le=30.0)] = 0.0
    acceleration_mps2: Annotated[float, Field(ge=-50.0, le=50.0)] = 0.0
    climb_rate_deg_per_s: Annotated[float, Field(ge=-30.0, le=30.0)] = 0.0


class TrajectorySpec(Section):
    """``[trajectory]``: initial state and segments of the true flight."""

    latitude_deg: Latitude
    longitude_deg: Longitude
    height_m: Annotated[float, Field(ge=-12000.0, le=100000.0, allow_inf_nan=False)]
    speed_mps: Annotated[float, Field(ge=0.0, le=10000.0)]
    heading_deg: Finite
    pitch_deg: Finite = 0.0
    roll_deg: Finite = 0.0
    segment: Annotated[list[SegmentSpec], Field(min_length=1)]

    @property
    def duration_s(self) -> float:
        """Length of the flight [s]."""
        return sum(segment.duration_s for segment in self.segment)
