"""Users' tracks: positions over time, validated, smoothed and resampled at the INS rate."""

from __future__ import annotations

import math
import stat
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.linalg import solveh_banded

from ..gravity.ellipsoid import radii_of_curvature
from ..numerics.kernels import compiled
from .csv_text import rollover, status_of
from .heading import require_heading
from .manoeuvres import BANK_GRAVITY, Array, TrajectoryError
from .track_formats import Place, rows_of

Columns = str | tuple[tuple[str, str], ...] | None
FASTEST = 10000.0
"""Highest speed of a track [m/s]."""
_LARGEST = 1_000_000_000  # file [bytes]
_GAP = 5.0  # the longest step, in medians, unless the scenario says otherwise
_STILL = 1.0  # speed below which the heading of the velocity means nothing [m/s]
_WIDEST = 1000.0  # smoothing, in medians of the step: beyond it rounding shows
_LARGEST_TURN = 90.0  # of an attitude angle from row to row [deg]
_RANGES = {
    "latitude_deg": (-89.0, 89.0, "degrees"),
    "longitude_deg": (-180.0, 360.0, "degrees"),
    "height_m": (-12000.0, 100000.0, "metres"),
    "heading_deg": (-360.0, 360.0, "degrees"),
    "pitch_deg": (-85.0, 85.0, "degrees"),
    "roll_deg": (-180.0, 180.0, "degrees"),
}


@dataclass(frozen=True)
class TrackLimits:
    """Limits for the validation of a track, and smoothing of the track.

    Attributes
    ----------
    gap : longest allowed time between two rows [s]; None for five times the median time
        between rows.
    acceleration : largest allowed acceleration [m/s²].
    smoothing : period of the oscillations whose amplitude is halved by the smoothing [s]; 0 for no
        smoothing.
    """

    gap: float | None = None
    acceleration: float = 50.0
    smoothing: float = 0.0


@dataclass(frozen=True)
class Track:
    """Track: smooth functions of time for the position, and for the attitude if known.

    Attributes
    ----------
    times : (N,) times of the rows, from 0 [s].
    position : cubic splines of latitude, longitude [rad, without jumps at 180°] and height [m].
    angles : functions of time for heading, pitch and roll [rad]; None for an unknown angle.
    remark : remark on the conversion of heights; "" for none.
    """

    times: Array
    position: tuple[CubicSpline, ...]
    angles: tuple[PchipInterpolator | None, ...]
    remark: str = ""


def read_track(file: str, limits: TrackLimits, columns: Columns = None) -> Track:
    """Read a track from a file: CSV, GPX, KML, NMEA 0183, RTKLIB ``.pos`` and others.

    The content determines the format. The first line of a CSV file names the columns: time_s,
    latitude_deg, longitude_deg and height_m, and optionally heading, pitch and roll in degrees.
    Other columns are ignored. If the names in the file differ, ``columns`` states them. It is
    the name of a preset, or contains pairs: a key such as ``height_m``, and the name in the file.

    Raises TrajectoryError with a sentence that states the file, the line, the value and the allowed
    values.
    """
    status = status_of(file, "track")
    if not stat.S_ISREG(status.st_mode):
        raise TrajectoryError(f"cannot read the track {file}: it is not a file")
    if status.st_size > _LARGEST:
        raise TrajectoryError(
            f"track {file}: has {status.st_size / 1e6:.0f} MB; at most "
            f"{_LARGEST / 1e6:g} are allowed"
        )
    return _read_track(file, limits, columns, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=2)
def _read_track(file: str, limits: TrackLimits, columns: Columns, time: int, size: int) -> Track:
    try:
        content = Path(file).read_bytes()
    except OSError as error:
        raise TrajectoryError(f"cannot read the track {file}: {error.strerror}") from None
    try:
        rows = rows_of(content, dict(columns) if isinstance(columns, tuple) else columns)
        return replace(track_of(rows.columns, rows.place, limits), remark=rows.remark)
    except TrajectoryError as error:
        raise TrajectoryError(f"track {file}: {error}") from None


def part_of(track: Track, start: float, end: float) -> Track:
    """Return the part of a track between two times [s], with times that begin at 0."""

    def moved(spline: CubicSpline) -> CubicSpline:
        return CubicSpline(track.times - start, spline(track.times))

    angles = [
        None if angle is None else PchipInterpolator(track.times - start, angle(track.times))
        for angle in track.angles
    ]
    inside = (track.times >= start) & (track.times <= end)
    return Track(track.times[inside] - start, tuple(map(moved, track.position)), tuple(angles))


def track_of(columns: dict[str, Array], place: Place, limits: TrackLimits) -> Track:
    """Return the validated and smoothed track from the columns (N,) of a file.

    The keys of ``columns`` are time_s, latitude_deg, longitude_deg and height_m, and optionally
    heading_deg, pitch_deg and roll_deg. ``place`` is a function that returns the place of a row in
    the file, for messages.

    Raises TrajectoryError if a value is invalid; the message states the line, the value and the
    allowed values.
    """
    for key, (low, high, unit) in _RANGES.items():
        if key in columns:
            bad = (columns[key] < low) | (columns[key] > high)
            if bad.any():
                n = int(np.argmax(bad))
                raise TrajectoryError(
                    f"{place(n)}: {key} is {columns[key][n]:g} and must lie between {low:g} "
                    f"and {high:g} {unit}"
                )
    latitude, longitude = columns["latitude_deg"], columns["longitude_deg"]
    times = _times(columns["time_s"], place, limits)
    longitude = np.unwrap(longitude, period=360.0)
    position = [np.radians(latitude), np.radians(longitude), columns["height_m"]]
    _check_speed(times, position, place)
    if limits.smoothing > _WIDEST * float(np.median(np.diff(times))):
        raise TrajectoryError(
            f"smoothing_s is {limits.smoothing:g} and must not exceed {_WIDEST:g} times the median "
            f"step, {_WIDEST * float(np.median(np.diff(times))):g} s"
        )
    splines: list[CubicSpline] = []
    for values in position:
        if limits.smoothing > 0.0:
            values = _smooth(times, values, limits.smoothing)
        splines.append(CubicSpline(times, values))
    velocity = _check_acceleration(times, splines, place, limits)
    angles: list[PchipInterpolator | None] = []
    for key in ("heading_deg", "pitch_deg", "roll_deg"):
        if key not in columns:
            angles.append(None)
            continue
        unwrapped = np.unwrap(columns[key], period=360.0)
        turn = np.abs(np.diff(unwrapped))
        if turn.max() > _LARGEST_TURN:
            n = int(np.argmax(turn > _LARGEST_TURN)) + 1
            raise TrajectoryError(
                f"{place(n)}: {key} turns by {turn[n - 1]:g}° from the row before; at most "
                f"{_LARGEST_TURN:g}° are allowed from row to row"
            )
        angles.append(PchipInterpolator(times, np.radians(unwrapped)))
    if "heading_deg" in columns:
        require_heading(columns["heading_deg"], velocity)
    return Track(times, tuple(splines), tuple(angles))


def _smooth(times: Array, values: Array, period: float) -> Array:
    """Return values (N,) of a cubic smoothing spline that halves the amplitude at a period.

    The spline minimises the integral of the squared deviations plus (period / 2π)⁴ times the
    integral of the squared second derivative. The equations are solved for the second derivatives
    at the inner points (Reinsch 1967).
    """
    steps = np.diff(times)
    inverse = (period / math.tau) ** 4 / np.gradient(times)
    left, right = 1.0 / steps[:-1], 1.0 / steps[1:]
    centre = -left - right
    bands = np.zeros((3, len(times) - 2))
    bands[2] = (steps[:-1] + steps[1:]) / 3.0 + (
        left**2 * inverse[:-2] + centre**2 * inverse[1:-1] + right**2 * inverse[2:]
    )
    bands[1, 1:] = steps[1:-1] / 6.0 + (
        centre[:-1] * left[1:] * inverse[1:-2] + right[:-1] * centre[1:] * inverse[2:-1]
    )
    bands[0, 2:] = right[:-2] * left[2:] * inverse[2:-2]
    bend = left * values[:-2] + centre * values[1:-1] + right * values[2:]
    try:
        second = solveh_banded(bands, bend)
    except np.linalg.LinAlgError:
        raise TrajectoryError(
            f"smoothing_s is {period:g}, too long for steps as short as {steps.min():.3g} s; "
            "reduce it, or remove rows that are close together"
        ) from None
    change = np.zeros(len(times))
    change[:-2] += left * second
    change[1:-1] += centre * second
    change[2:] += right * second
    return np.asarray(values - inverse * change)


def _times(times: Array, place: Place, limits: TrackLimits) -> Array:
    """Return times from zero; raise TrajectoryError if they do not increase or have a gap."""
    steps = np.diff(times)
    if (steps <= 0.0).any():
        n = int(np.argmax(steps <= 0.0)) + 1
        raise TrajectoryError(
            f"{place(n)}: time_s is {times[n]:.10g} after {times[n - 1]:.10g} in the row "
            f"before; times must increase from row to row{rollover(times[n - 1], times[n])}"
        )
    median = float(np.median(steps))
    allowed = _GAP * median if limits.gap is None else limits.gap
    if steps.max() > allowed * (1.0 + 1e-9):
        n = int(np.argmax(steps > allowed * (1.0 + 1e-9))) + 1
        rule = f"{_GAP:g} times the median" if limits.gap is None else "max_gap_s"
        raise TrajectoryError(
            f"{place(n)}: comes {steps[n - 1]:g} s after the row before; at most "
            f"{allowed:g} s ({rule}) are allowed"
            + ("; set max_gap_s to allow more" if limits.gap is None else "")
        )
    return np.asarray(times - times[0])


def _check_speed(times: Array, position: list[Array], place: Place) -> None:
    """Raise TrajectoryError if the speed between two rows is impossible."""
    middle = [0.5 * (p[1:] + p[:-1]) for p in position]
    meridian, prime_vertical = _radii(middle[0])
    north = (meridian + middle[2]) * np.diff(position[0])
    east = (prime_vertical + middle[2]) * np.cos(middle[0]) * np.diff(position[1])
    speed = np.sqrt(north**2 + east**2 + np.diff(position[2]) ** 2) / np.diff(times)
    if speed.max() > FASTEST:
        n = int(np.argmax(speed > FASTEST)) + 1
        raise TrajectoryError(
            f"{place(n)}: lies {speed[n - 1] * (times[n] - times[n - 1]):.4g} m from the row "
            f"before, a speed of {speed[n - 1]:.4g} m/s; at most {FASTEST:g} m/s are allowed"
        )


def _check_acceleration(
    times: Array, splines: list[CubicSpline], place: Place, limits: TrackLimits
) -> Array:
    """Return velocities (N, 3) ENU [m/s] at the knots.

    Raises TrajectoryError if the acceleration of the splines is too large. It is largest at the
    knots.
    """
    velocity, acceleration = _motion(splines, times)
    size = np.sqrt((acceleration**2).sum(axis=-1))
    if size.max() > limits.acceleration:
        n = int(np.argmax(size))
        raise TrajectoryError(
            f"{place(n)}: the positions imply an acceleration of {size[n]:.4g} m/s²; at most "
            f"{limits.acceleration:g} m/s² (max_acceleration_mps2) are allowed: check for a "
            "jump, or remove noise with smoothing_s"
        )
    return velocity


def _motion(splines: list[CubicSpline], times: Array) -> tuple[Array, Array]:
    """Return velocities and accelerations (N, 3) ENU, without terms of the Earth's rotation."""
    latitude, height = (np.asarray(splines[i](times)) for i in (0, 2))
    meridian, prime_vertical = _radii(latitude)
    scale = np.stack(
        [
            (prime_vertical + height) * np.cos(latitude),
            meridian + height,
            np.ones_like(height),
        ],
        axis=-1,
    )
    order = [splines[1], splines[0], splines[2]]
    velocity = scale * np.stack([s.derivative(1)(times) for s in order], axis=-1)
    acceleration = scale * np.stack([s.derivative(2)(times) for s in order], axis=-1)
    # Meridians converge: the scale of longitude changes on the way north.
    acceleration[:, 0] -= velocity[:, 0] * velocity[:, 1] * np.tan(latitude) / scale[:, 1]
    return velocity, acceleration


@compiled
def _radii(latitude: Array) -> Array:
    """Return the radii of curvature (2, N) [m] at latitudes (N,) [rad]."""
    radii = np.empty((2, latitude.shape[0]))
    for n in range(latitude.shape[0]):
        radii[0, n], radii[1, n] = radii_of_curvature(latitude[n])
    return radii


def resample(
    track: Track, dt: float, pitch: float, roll: float, banks: bool
) -> tuple[Array, Array, Array]:
    """Return the initial position of a track, and its velocities and angles at the INS rate.

    The velocities are derivatives of cubic splines with a knot at every sample. The mechanization
    integrates them with the midpoint rule. The acceleration of the splines at sample n is a_n. The
    position error of the step from sample n to n + 1 is dt² (a_{n+1} - a_n) / 12. The errors of the
    first n steps add up to only dt² (a_n - a_0) / 12, so the positions stay near the track.

    Parameters
    ----------
    track : track from :func:`read_track`.
    dt : sampling interval [s].
    pitch, roll : attitude in straight and level flight [rad]. Each angle is used only if the track
        does not contain it. If ``banks`` is true, the angle of coordinated flight is added.
    banks : whether the vehicle banks in turns and pitches with its climb angle.

    Returns
    -------
    Initial position (3,) [rad, rad, m], velocities (N, 3) ENU [m/s], and heading, pitch and roll
    (N, 3) [rad].

    Raises
    ------
    TrajectoryError
        If the track is shorter than a sampling interval, or turns too fast within an interval.
        Also if the track has no heading and is too slow to define a heading.
    """
    times = np.arange(math.floor(track.times[-1] / dt + 1e-9) + 1) * dt
    if len(times) < 2:
        raise TrajectoryError(
            f"lasts {track.times[-1]:g} s, less than one IMU interval of {dt:g} s"
        )
    # New splines through the values at the samples: those of rows denser than the samples would
    # leave a random walk.
    positions = [np.asarray(s(np.minimum(times, track.times[-1]))) for s in track.position]
    velocity, acceleration = _motion([CubicSpline(times, p) for p in positions], times)
    angles_given = [None if angle is None else np.asarray(angle(times)) for angle in track.angles]
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    if angles_given[0] is None:
        moving = speed > _STILL
        if not moving.any():
            raise TrajectoryError(
                f"never exceeds {_STILL:g} m/s and has no heading; add a column heading_deg, and "
                "check that times are in seconds"
            )
        heading = np.unwrap(np.arctan2(velocity[moving, 0], velocity[moving, 1]))
        angles_given[0] = np.interp(times, times[moving], heading)
    sideways = (velocity[:, 1] * acceleration[:, 0] - velocity[:, 0] * acceleration[:, 1]) / (
        np.maximum(speed, _STILL)
    )
    if angles_given[1] is None:
        climb = np.arctan2(velocity[:, 2], np.maximum(speed, _STILL))
        angles_given[1] = pitch + climb if banks else np.full(len(times), pitch)
    if angles_given[2] is None:
        bank = np.arctan(sideways / BANK_GRAVITY)
        angles_given[2] = roll + bank if banks else np.full(len(times), roll)
    angles = np.stack([np.asarray(angle) for angle in angles_given], axis=-1)
    turn = np.abs(np.diff(angles, axis=0)).max(axis=-1)
    if turn.max() > 0.5:
        n = int(np.argmax(turn))
        raise TrajectoryError(
            f"turns by {math.degrees(turn[n]):.3g}° within one IMU interval at {times[n]:g} s; "
            "at most 28° are allowed: add columns of attitude, or smooth it (smoothing_s)"
        )
    start = np.array([p[0] for p in positions])
    return start, velocity, angles
