"""Table of the trajectory: initial state and segments, or the file of a track."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ..files.writing import sha256_of
from ..trajectory.manoeuvres import Manoeuvre, State, TrajectoryError, plan
from ..trajectory.terrain_following import TerrainFollowing, terrain_path
from . import quantities as q
from .columns import ColumnNames
from .segments import SegmentSpec, keys_given
from .tables import Listed, Section, distinct

if TYPE_CHECKING:
    from ..trajectory.survey_lines import SurveyLine
    from ..trajectory.track import Track, TrackLimits

LineName = Annotated[str, Field(min_length=1)]
_PLAN_STEP = 0.5  # of the plan whose duration counts before the IMU's rate is known [s]


_START = ("latitude_deg", "longitude_deg", "height_m", "speed_mps", "heading_deg")
_MOVES = ("shift_east_km", "shift_north_km", "turn_deg")
_TRACK = (
    "max_gap_s",
    "max_acceleration_mps2",
    "smoothing_s",
    "columns",
    "lines",
    "middle_s",
    "made_up_turns",
    *_MOVES,
)


class TrajectorySpec(Section):
    """``[trajectory]``: initial state and segments of the true flight, or the file of a track."""

    latitude_deg: q.Latitude | None = None
    """Latitude at the start; must be given with segments."""
    longitude_deg: q.Longitude | None = None
    """Longitude at the start; must be given with segments."""
    height_m: q.Height | None = None
    """Height at the start, above the ellipsoid. With segments it may be omitted only if
    `terrain-following` comes first: the default is then the lowest height that clears the terrain.
    """
    speed_mps: q.Speed | None = None
    """Speed at the start, along the path; must be given with segments."""
    heading_deg: q.Angle | None = None
    """Heading at the start, clockwise from north; must be given with segments."""
    pitch_deg: q.Pitch = 0.0
    """Added to the pitch throughout; with a track only if its file has no attitude."""
    roll_deg: q.Roll = 0.0
    """Added to the roll throughout; with a track only if its file has no attitude."""
    segment: Listed[SegmentSpec] = ()
    repeat: Annotated[int, Field(ge=1, le=1000)] = 1
    """Number of repetitions of all segments."""
    vehicle: Literal["aircraft", "ship"] = "aircraft"
    """An aircraft banks in turns and pitches with the climb angle; a ship stays level."""
    file: Annotated[str, Field(min_length=1)] | None = None
    """Name of a shipped track, or path of a track (CSV), in place of start and segments.

    With `lines` the file contains survey lines and their measurements (CSV, also compressed by
    gzip).
    """
    columns: ColumnNames | None = None
    """Track (CSV): names of the columns by key, `{ height_m = "alt [ft]" }`; or name of a preset.

    Units in brackets are converted. Presets with positions: `px4`, `ros`.
    """
    lines: Annotated[Listed[LineName], distinct("a line")] = ()
    """Survey lines of the file. Run r flies the line with index r modulo the number of lines."""
    made_up_turns: bool = False
    """Survey lines: whether each run flies all lines in the order of time, joined by artificial
    turns.
    """
    middle_s: q.Duration | None = None
    """Survey lines: duration of the flown middle part of each line. Without it: the whole line."""
    max_gap_s: q.Duration | None = None
    """Track: longest time between two rows. Without it: five median steps."""
    max_acceleration_mps2: q.TrackAcceleration = 50.0
    """Track: largest allowed acceleration between positions."""
    smoothing_s: q.Smoothing = 0.0
    """Track: period at which a smoothing spline halves the amplitude; 0: no smoothing."""
    shift_east_km: q.Shift = 0.0
    """Track: shift of the start to the east."""
    shift_north_km: q.Shift = 0.0
    """Track: shift of the start to the north."""
    turn_deg: q.Angle = 0.0
    """Track: clockwise rotation about the start."""

    @model_validator(mode="after")
    def _check(self) -> TrajectorySpec:
        keys = keys_given(self)
        if self.file is not None:
            for key in (*_START, "segment", "repeat"):
                if key in keys:
                    raise ValueError(
                        f"'{key}' excludes 'file', which defines the whole flight; remove one of "
                        "them"
                    )
            if self.lines:
                for key in _MOVES:
                    if key in keys:
                        raise ValueError(
                            f"'{key}' applies to tracks only; survey lines are flown where they "
                            "were measured; remove it"
                        )
                if self.columns is not None:
                    raise ValueError("'columns' applies to tracks, not to survey lines; remove it")
                if len(self.drawn_lines) > 1 and self.middle_s is None:
                    raise ValueError(
                        "middle_s is missing: all lines must be flown for the same time"
                    )
                if self.made_up_turns and self.middle_s is not None:
                    raise ValueError("made_up_turns uses whole lines; remove middle_s")
            elif self.middle_s is not None or self.made_up_turns:
                key = "made_up_turns" if self.made_up_turns else "middle_s"
                raise ValueError(f"'{key}' applies to survey lines and needs 'lines'")
            return self
        for key in _TRACK:
            if key in keys:
                raise ValueError(f"'{key}' applies to tracks and needs 'file'")
        if not self.segment:
            raise ValueError(
                "needs [[trajectory.segment]] tables, or file = the path of a track (CSV)"
            )
        for key in _START:
            if key == "height_m" and self.segment[0].kind == "terrain-following":
                continue
            if getattr(self, key) is None:
                raise ValueError(f"'{key}' is missing")
        if self.vehicle == "ship" and any(s.bank_deg is not None for s in self.segment):
            raise ValueError(
                "a ship does not bank; give its turns a turn_rate_deg_per_s or a radius_m instead "
                "of bank_deg"
            )
        return self

    @property
    def drawn_lines(self) -> tuple[str, ...]:
        """Survey lines, if each run flies only one of them; otherwise empty."""
        return () if self.made_up_turns else self.lines

    @property
    def duration_s(self) -> float:
        """Duration of the flight [s].

        Raises
        ------
        TrajectoryError
            If a segment cannot be flown, or a file cannot be used. The class derives from
            ValueError.
        """
        if self.file is not None:
            return float(self.track().times[-1])
        if all(segment.kind == "rates" for segment in self.segment):
            return sum(s.duration_s for s in self.segment if s.duration_s) * self.repeat
        return _duration(self, file_versions(self))

    def start(self) -> State:
        """Return the initial state of the segments."""
        assert self.latitude_deg is not None and self.longitude_deg is not None
        assert self.speed_mps is not None and self.heading_deg is not None
        height = self.height_m
        if height is None:
            height = _start_height(self, file_versions(self))
        place = math.radians(self.latitude_deg), math.radians(self.longitude_deg), height
        return State(np.array(place), math.radians(self.heading_deg), self.speed_mps, 0.0)

    def manoeuvres(self) -> list[Manoeuvre]:
        """Return the manoeuvres of all segments, including repetitions."""
        return [segment.manoeuvre() for segment in self.segment] * self.repeat

    def track_limits(self) -> TrackLimits:
        """Return the limits for the validation of the track, and the smoothing period [s]."""
        from ..trajectory.track import TrackLimits

        return TrackLimits(self.max_gap_s, self.max_acceleration_mps2, self.smoothing_s)

    def track(self) -> Track:
        """Return the track of the file; if ``lines`` are given, the track of :meth:`survey_line`.

        Raises
        ------
        TrajectoryError
            If the file is invalid.
        """
        from ..trajectory.track import (
            read_track,  # not at the top: it loads slowly, few flights have one
        )

        assert self.file is not None
        if not self.lines:
            track = read_track(self.file, self.track_limits(), self.columns)
            return self._moved(track)
        line = self.survey_line()
        try:
            return line.track(self.track_limits(), self.middle_s)
        except TrajectoryError as error:
            raise TrajectoryError(f"survey lines {self.file}: {error}") from None

    def _moved(self, track: Track) -> Track:
        """Return a track, shifted and rotated as the keys ``shift_...`` and ``turn_deg`` state."""
        if not any(getattr(self, key) for key in _MOVES):
            return track
        from ..trajectory.moved_track import moved_track  # not at the top: it loads slowly

        east, north = 1e3 * self.shift_east_km, 1e3 * self.shift_north_km
        try:
            return moved_track(track, east, north, math.radians(self.turn_deg))
        except TrajectoryError as error:
            raise TrajectoryError(f"track {self.file}: {error}") from None

    def survey_line(self) -> SurveyLine:
        """Return the first survey line; if ``made_up_turns`` is set, all lines joined to one.

        Raises
        ------
        TrajectoryError
            If the file is invalid or lacks the line.
        """
        from ..trajectory.made_up_turns import all_lines
        from ..trajectory.survey_lines import line_named

        assert self.file is not None
        if not self.made_up_turns:
            return line_named(self.file, self.lines[0])
        try:
            return all_lines([line_named(self.file, name) for name in self.lines])
        except TrajectoryError as error:
            raise TrajectoryError(f"survey lines {self.file}: {error}") from None

    def files(self) -> list[Path]:
        """Return the paths of the input files of the flight."""
        names = sorted({s.terrain for s in self.segment if s.terrain is not None})
        return [terrain_path(name) for name in names] + ([Path(self.file)] if self.file else [])

    def file_hashes(self) -> list[str]:
        """Return the SHA-256 of each input file.

        Raises
        ------
        TrajectoryError
            If a file cannot be read.
        """
        versions = file_versions(self)
        return [_hash(path, v) for path, v in zip(self.files(), versions, strict=True)]

    def placeless(self) -> TrajectorySpec:
        """Return the table with fixed names in place of file paths, for hashes of the content."""
        terrains = sorted({s.terrain for s in self.segment if s.terrain is not None})
        segments = tuple(
            s.model_copy(update={"terrain": f"terrain {terrains.index(s.terrain)}"})
            if s.terrain is not None
            else s
            for s in self.segment
        )
        return self.model_copy(
            update={"segment": segments, "file": None if self.file is None else "track"}
        )


def file_versions(spec: TrajectorySpec) -> tuple[tuple[int, int], ...]:
    """Return modification time [ns] and size [bytes] of each input file of the flight.

    Raises
    ------
    TrajectoryError
        If a file does not exist.
    """
    versions = []
    for path in spec.files():
        try:
            status = path.stat()
        except OSError as error:
            raise TrajectoryError(f"cannot read {path}: {error.strerror}") from None
        versions.append((status.st_mtime_ns, status.st_size))
    return tuple(versions)


@lru_cache(maxsize=64)
def _hash(path: Path, version: tuple[int, int]) -> str:
    return sha256_of(path, TrajectoryError)


@lru_cache(maxsize=64)
def _start_height(spec: TrajectorySpec, versions: tuple[tuple[int, int], ...]) -> float:
    """Return the lowest start height from which the first segment can follow the terrain [m]."""
    first = spec.segment[0].manoeuvre()
    assert isinstance(first, TerrainFollowing)
    return first.start_height(spec.model_copy(update={"height_m": 0.0}).start())


@lru_cache(maxsize=64)
def _duration(spec: TrajectorySpec, versions: tuple[tuple[int, int], ...]) -> float:
    return plan(spec.start(), spec.manoeuvres(), _PLAN_STEP, len(spec.segment))[1]
