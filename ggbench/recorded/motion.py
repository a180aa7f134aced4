"""Conversion and plausibility checks of recorded positions, velocities and attitudes."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ..gravity.ellipsoid import metres_along
from ..sensors.aiding import Motion
from ..spec.limits import FASTEST_MPS, HIGHEST_M, LOWEST_M
from ..spec.recordings import Frame
from ..trajectory.truth import attitudes_of
from .columns import Columns

POSITION = ("latitude_deg", "longitude_deg", "height_m")
ATTITUDE = ("heading_deg", "pitch_deg", "roll_deg")
_DIRECTIONS = {"ENU": ("east", "north", "up"), "NED": ("north", "east", "down")}
_LIMITS = {
    "latitude_deg": (-89.0, 89.0),
    "longitude_deg": (-180.0, 360.0),
    "height_m": (LOWEST_M, HIGHEST_M),
    "heading_deg": (-360.0, 360.0),
    "pitch_deg": (-90.0, 90.0),
    "roll_deg": (-180.0, 180.0),
}
_SPAN = 10.0
"""Time span over which displacements and velocities are compared [s]; reduces position noise."""
_SLOW = 0.3
"""Speed below which displacements do not indicate the frame of velocities [m/s]."""
_JUMP = 100.0
"""Constant term of the largest deviation of a position from its prediction [m]."""


def velocity_columns(frame: Frame) -> tuple[str, ...]:
    """Return the column names of a velocity vector, in the order of the frame's axes."""
    return tuple(f"velocity_{direction}_mps" for direction in _DIRECTIONS[frame])


def velocities_of(columns: Columns, frame: Frame) -> np.ndarray:
    """Return the velocities (N, 3) in a file, converted to ENU [m/s].

    Raises FlightError if velocities are impossible.
    """
    names = velocity_columns(frame)
    columns.require_within(dict.fromkeys(names, (-FASTEST_MPS, FASTEST_MPS)))
    velocities = columns.stacked(names)
    if frame == "NED":
        velocities = velocities[:, [1, 0, 2]]
        velocities[:, 2] = 0.0 - velocities[:, 2]
    return velocities


def positions_of(columns: Columns) -> np.ndarray:
    """Return the positions (N, 3) in a file [rad, rad, m], with longitudes without jumps.

    Raises FlightError if positions are impossible.
    """
    columns.require_within({name: _LIMITS[name] for name in POSITION})
    positions = columns.stacked(POSITION)
    positions[:, :2] = np.radians(positions[:, :2])
    there = np.isfinite(positions[:, 1])
    positions[there, 1] = np.unwrap(positions[there, 1])
    return positions


def attitudes_in(columns: Columns) -> np.ndarray:
    """Return the attitudes C_nb (N, 3, 3) from heading, pitch and roll in a file.

    Raises FlightError if angles are impossible.
    """
    columns.require_within({name: _LIMITS[name] for name in ATTITUDE})
    return np.asarray(attitudes_of(np.radians(columns.stacked(ATTITUDE))))


def angles_of(attitudes: np.ndarray) -> np.ndarray:
    """Return heading (0 to 2π), pitch and roll (N, 3) [rad] of attitudes C_nb (N, 3, 3)."""
    up = attitudes[:, 2]
    pitch = np.arctan2(up[:, 1], np.hypot(up[:, 0], up[:, 2]))
    heading = np.arctan2(attitudes[:, 0, 1], attitudes[:, 1, 1]) % (2.0 * math.pi)
    return np.stack([heading, pitch, np.arctan2(-up[:, 0], up[:, 2])], axis=-1)


def track_columns(times: np.ndarray, motion: Motion) -> dict[str, np.ndarray]:
    """Return a track as columns (N,) of a file: times, positions, ENU velocities, angles."""
    places = np.hstack([np.degrees(motion.positions[:, :2]), motion.positions[:, 2:]])
    values = np.hstack([places, motion.velocities, np.degrees(angles_of(motion.attitudes))])
    names = (*POSITION, *velocity_columns("ENU"), *ATTITUDE)
    return {"time_s": times} | dict(zip(names, values.T, strict=True))


def require_consistent(
    columns: Columns,
    times: np.ndarray,
    positions: np.ndarray,
    velocities: np.ndarray,
    frame: Frame,
    noise: float = 0.0,
) -> None:
    """Raise FlightError if velocities contradict the displacements between positions.

    The message states the likely cause: sign, frame, unit or order of the axes. ``times`` (N,) are
    the times of the rows [s]. ``frame`` is the frame stated by the user. ``noise`` is the RMS noise
    of a position [m].
    """
    there = np.isfinite(positions).all(axis=1) & np.isfinite(velocities).all(axis=1)
    if np.count_nonzero(there) < 3:
        return
    at, velocities = times[there], velocities[there]
    moved = _displacements(positions[there])
    led = 0.5 * (velocities[1:] + velocities[:-1]) * np.diff(at)[:, np.newaxis]
    _require_smooth(columns, np.flatnonzero(there), moved, led, noise)
    spans = np.floor((at[1:] - at[0]) / _SPAN).astype(int)
    starts = np.flatnonzero(np.diff(spans, prepend=-1))
    moved, led = (np.add.reduceat(steps, starts) for steps in (moved, led))
    long = np.add.reduceat(np.diff(at), starts)
    slack = 5.0 * noise + _SLOW * float(np.sqrt(np.mean(long**2)))
    for axes, what in (([0, 1], "horizontally"), ([2], "vertically")):
        size = max(_rms(moved[:, axes]), _rms(led[:, axes]))
        if _rms((moved - led)[:, axes]) <= 0.3 * size + slack:
            continue
        hint = ""
        if what == "vertically" and _rms(moved[:, 2] + led[:, 2]) <= 0.15 * size + slack:
            other = "down" if frame == "ENU" else "up"
            hint = f"; they agree if the vertical velocity is positive {other}wards"
        elif what == "horizontally":
            for hypothesis, alternative, of in _alternatives(positions[there], starts, moved, led):
                if _rms(alternative - of) <= 0.15 * _rms(of) + slack:
                    hint = f"; they agree if {hypothesis}"
                    break
        seconds = float(np.sqrt(np.mean(long**2)))
        raise columns.error(
            f"positions and velocities contradict each other {what}: in {seconds:.3g} s the "
            f"positions move by {_rms(moved[:, axes]):.3g} m (RMS), the integrated velocities "
            f'(frame = "{frame}") by {_rms(led[:, axes]):.3g} m; the difference is '
            f"{_rms((moved - led)[:, axes]):.3g} m{hint}"
        )


def _alternatives(
    positions: np.ndarray, starts: np.ndarray, moved: np.ndarray, led: np.ndarray
) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield likely causes of a contradiction, with displacements under each hypothesis.

    Each item has the cause in words, displacements (S, 2) from positions, and displacements (S, 2)
    from velocities [m].

    Parameters
    ----------
    positions : (N, 3) positions [rad, rad, m].
    starts : (S,) index of the first step of each time span.
    moved, led : (S, 3) displacements over the spans, from positions and from velocities [m].
    """
    moved, led = moved[:, :2], led[:, :2]
    yield "the east and north velocities are exchanged (NED read as ENU)", moved, led[:, ::-1]
    yield "both horizontal velocities have the opposite sign", moved, -led
    for hypothesis, others in (
        ("latitude and longitude are radians", np.degrees(positions)),
        ("latitude and longitude are exchanged", positions[:, [1, 0, 2]]),
    ):
        if np.abs(others[:, 0]).max() < 0.5 * math.pi:
            yield hypothesis, np.add.reduceat(_displacements(others), starts)[:, :2], led
    yield "the velocities are in km/h", moved, led / 3.6
    yield "the velocities are in knots", moved, led * 0.5144


def _require_smooth(
    columns: Columns, rows: np.ndarray, moved: np.ndarray, led: np.ndarray, noise: float
) -> None:
    """Raise FlightError if a position is far from its prediction from the row before."""
    free = _JUMP + 10.0 * noise + 3.0 * np.linalg.norm(led, axis=1)
    for axes, what in (([2], "height"), ([0, 1], "position")):
        jump = np.linalg.norm((moved - led)[:, axes], axis=1)
        if (jump > free).any():
            n = int(jump.argmax())
            raise columns.error(
                f"the {what} jumps by {np.linalg.norm(moved[n, axes]):.4g} m from the row "
                f"before, where the velocity gives {np.linalg.norm(led[n, axes]):.3g} m",
                int(rows[n + 1]),
            )


def _displacements(positions: np.ndarray) -> np.ndarray:
    """Return the steps (N − 1, 3) between positions (N, 3), ENU [m]."""
    middle = 0.5 * (positions[1:] + positions[:-1])
    steps = np.diff(positions, axis=0)[:, [1, 0, 2]]
    steps[:, :2] *= metres_along(np.ascontiguousarray(middle))
    return np.asarray(steps)


def _rms(steps: np.ndarray) -> float:
    """Return the RMS length of displacements (N, d), or the RMS of values (N,)."""
    squares = steps**2 if steps.ndim == 1 else np.sum(steps**2, axis=1)
    return float(np.sqrt(np.mean(squares)))
