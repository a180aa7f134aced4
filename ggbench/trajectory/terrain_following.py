"""Terrain following: height profile at a clearance above known terrain.

The profile h(t) is nearly the lowest profile above a floor f(t). Its slope is limited to s, and its
vertical acceleration to a. First the slope is limited: g(t) = max_τ f(τ) − s |t − τ|.
Then the acceleration is limited by the double envelope of Lasry and Lions (1986), which does not
increase the slope::

    d(t) = max_τ g(τ) − a (t − τ)² / 4          curvature above −a / 2
    h(t) = min_τ d(τ) + a (t − τ)² / 2          curvature between −a and a, h ≥ g

The profile is close to the floor above peaks and rounded in valleys. A moving average with
raised-cosine weights over ±2 s makes the acceleration continuous.
"""

from __future__ import annotations

import importlib.resources
import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from ..errors import GGBenchError
from ..gravity.meridians import Area
from ..numerics.kernels import compiled
from .manoeuvres import Array, State, TrajectoryError, enu, follow, speed_of

_STEP = 0.1  # of the plan [s]
_SHORTEST, _LONGEST = 20.0, 36000.0  # [s]
_NEAR_DEG = 0.02  # to a flight: where voids of its terrain count
_BLUR = 2.0  # half the width of the moving average, a raised cosine [s]


@dataclass(frozen=True)
class TerrainFollowing:
    """Straight terrain-following flight, level at both ends, at constant speed over ground.

    Attributes
    ----------
    terrain : path of an elevation model, or name of a shipped elevation model.
    clearance : smallest height above the terrain [m].
    lowest : smallest height above the ellipsoid [m].
    zero_level : height of the terrain's zero level above the ellipsoid [m].
    duration, distance : duration [s] or distance over ground [m]; the other is None.
    climb_angle : steepest climb and descent [rad].
    vertical_acceleration : largest upward and downward acceleration [m/s²].
    """

    terrain: str
    clearance: float
    lowest: float = -math.inf
    duration: float | None = None
    distance: float | None = None
    climb_angle: float = math.radians(10.0)
    vertical_acceleration: float = 2.0
    zero_level: float = 0.0

    def length(self, start: State) -> float:
        """Return the duration of the flight [s].

        Raises TrajectoryError if the duration is too short or too long.
        """
        duration = self.duration
        if duration is None:
            assert self.distance is not None
            duration = self.distance / speed_of(start)
        if not _SHORTEST <= duration <= _LONGEST:
            raise TrajectoryError(
                f"lasts {duration:g} s and must last {_SHORTEST:g} to {_LONGEST:g} s"
            )
        return duration

    def rates(self, start: State, count: int, dt: float) -> Array:
        """Return rates (count, 3) of heading (zero), speed and climb angle.

        The horizontal speed is constant.

        Raises TrajectoryError if the terrain cannot be followed.
        """
        if start.speed < 1e-3 or abs(start.climb) > 1e-6:
            raise TrajectoryError(
                "must begin in level flight at a speed above 0, but its initial climb angle is "
                f"{math.degrees(start.climb):g}° and its initial speed {start.speed:g} m/s"
            )
        from scipy.interpolate import CubicSpline  # not at the top: it loads slowly

        times = np.arange(count + 1) * dt
        steps = math.ceil(times[-1] / _STEP)
        step = times[-1] / steps
        floor = self._floor(start, steps, step)
        slope = start.speed * math.tan(self.climb_angle)
        profile = _profile(floor, float(start.position[2]), step, slope, self.vertical_acceleration)
        vertical = CubicSpline(step * np.arange(steps + 1), profile, bc_type="clamped")(times, 1)
        climb = np.arctan(vertical / start.speed)
        speed = start.speed / np.cos(climb)
        return np.stack([np.zeros(count), np.diff(speed) / dt, np.diff(climb) / dt], axis=-1)

    def start_height(self, start: State) -> float:
        """Return an initial height for following the terrain, in whole metres [m].

        The result is one to two metres above the smallest possible height. ``start`` is the initial
        state; its height is ignored.
        """
        duration = self.length(start)
        steps = math.ceil(duration / _STEP)
        step = duration / steps
        slope = start.speed * math.tan(self.climb_angle)
        floor = _Floor.over(self._floor(start, steps, step), step, self.vertical_acceleration)
        return 1.0 + math.ceil(_least_start(floor, step, slope, self.vertical_acceleration))

    def _floor(self, start: State, steps: int, step: float) -> Array:
        """Return the lowest allowed height (steps + 1,) along the flight [m]."""
        # The track at constant height: the terrain's height moves it by 1e-4 of its length.
        fine = 4
        count = fine * steps + 1
        velocity = enu(*(np.full(count, x) for x in (start.heading, start.speed, 0.0)))
        track = follow(start.position, velocity, step / fine)
        ground = heights(self.terrain, track[:, 0], track[:, 1]) + self.zero_level
        height = ground + self.clearance
        # Highest of the neighbourhood of each step, so that none between them is missed.
        padded = np.concatenate([height[:1].repeat(fine), height, height[-1:].repeat(fine)])
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * fine + 1)
        return np.maximum(windows.max(axis=-1)[::fine], self.lowest)


def heights(name: str, latitude: Array, longitude: Array) -> Array:
    """Return terrain heights (N,) [m] at positions (N,) [rad], interpolated bilinearly.

    ``name`` is the path of an elevation model or the name of a shipped elevation model.

    Raises TrajectoryError if the file cannot be read, or if a position is outside the model or in a
    void.
    """
    version = version_of(name)
    try:
        grid_of = terrain_of(name, version, None)
    except TrajectoryError:  # voids far from the flight do not matter to it
        flown = np.degrees([latitude.min(), latitude.max(), longitude.min(), longitude.max()])
        grid_of = terrain_of(name, version, Area(*flown.tolist()).widened(_NEAR_DEG, _NEAR_DEG))
    south, west, latitude_step, longitude_step, grid = grid_of
    row = (np.degrees(latitude) - south) / latitude_step
    rounding = 1e-9
    column = (np.mod(np.degrees(longitude) - west + rounding, 360.0) - rounding) / longitude_step
    rows, columns = grid.shape
    outside = (row < -rounding) | (row > rows - 1 + rounding) | (column > columns - 1 + rounding)
    if outside.any():
        n = int(np.argmax(outside))
        raise TrajectoryError(
            f"leaves the terrain {name} at {math.degrees(latitude[n]):.5f}° N, "
            f"{math.degrees(longitude[n]):.5f}° E; it covers {south:.3f}° to "
            f"{south + (rows - 1) * latitude_step:.3f}° N, {west:.3f}° to "
            f"{west + (columns - 1) * longitude_step:.3f}° E"
        )
    i = np.clip(row.astype(int), 0, rows - 2)
    j = np.clip(column.astype(int), 0, columns - 2)
    u, v = row - i, column - j
    height = (1.0 - u) * ((1.0 - v) * grid[i, j] + v * grid[i, j + 1]) + u * (
        (1.0 - v) * grid[i + 1, j] + v * grid[i + 1, j + 1]
    )
    if not np.isfinite(height).all():
        n = int(np.argmin(np.isfinite(height)))
        raise TrajectoryError(
            f"the terrain {name} has no height at {math.degrees(latitude[n]):.5f}° N, "
            f"{math.degrees(longitude[n]):.5f}° E on the flight path; fill its gaps first"
        )
    return np.asarray(height)


def terrain_path(name: str) -> Path:
    """Return the path of the shipped model ``name`` if there is one, else ``name`` as a path."""
    if not Path(name).is_absolute() and ".." not in Path(name).parts:
        shipped = importlib.resources.files("ggbench.scenarios") / "data" / name
        if isinstance(shipped, Path) and shipped.is_file():
            return shipped
    return Path(name)


def version_of(name: str) -> tuple[int, int]:
    """Return the version of a file, two numbers that change when the file is written.

    Raises TrajectoryError if the file cannot be read.
    """
    try:
        status = terrain_path(name).stat()
    except OSError as error:
        raise TrajectoryError(f"cannot read the terrain {name}: {error.strerror}") from None
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=2)
def terrain_of(
    name: str, version: tuple[int, int], area: Area | None
) -> tuple[float, float, float, float, Array]:
    """Return bounds [deg], steps [deg] and heights (n_lat, n_lon) [m] of a terrain.

    The bounds are the southern and the western limit. The steps are in latitude and in longitude.
    ``area`` is the area in which heights are needed; None: everywhere. ``version`` is from
    :func:`version_of`.

    Raises TrajectoryError if the file contains no terrain, or too many voids in the area.
    """
    from ..gravity.terrain_files import read_terrain

    try:
        terrain = read_terrain(terrain_path(name), area)
    except GGBenchError as error:
        raise TrajectoryError(str(error)) from None
    return (
        terrain.south_deg,
        terrain.west_deg,
        terrain.latitude_step_deg,
        terrain.longitude_step_deg,
        np.asarray(terrain.height_m, dtype=float),
    )


@dataclass(frozen=True)
class _Floor:
    """Floor of a profile, raised by the height that the moving average removes.

    Attributes
    ----------
    raised : (N,) raised floor [m].
    blur : weights of the moving average.
    flat : number of steps at each end over which the profile is level.
    edge : number of level steps added beyond each end.
    """

    raised: Array
    blur: Array
    flat: int
    edge: int

    @classmethod
    def over(cls, floor: Array, step: float, acceleration: float) -> _Floor:
        """Return the raised floor for steps [s] and a limit of the vertical acceleration [m/s²]."""
        # Level flight beyond both ends, within them for as long as the moving average sees.
        flat = round(_BLUR / step) + 2
        blur = 0.5 * (1.0 + np.cos(math.pi * np.linspace(-1.0, 1.0, 2 * flat - 1)))
        blur /= blur.sum()
        # A mean of a curve lies below it by half its curvature times the variance of the weights.
        offsets = step * np.arange(-(flat - 1), flat)
        margin = 0.5 * acceleration * float(blur @ offsets**2)
        return cls(floor + margin, blur, flat, flat + 2)


def _profile(floor: Array, height: float, step: float, slope: float, acceleration: float) -> Array:
    """Return a profile (N,) [m] above a floor (N,), from a given height, level at both ends.

    Raises TrajectoryError if the initial height is too low.
    """
    over = _Floor.over(floor, step, acceleration)
    raised, flat, edge = over.raised, over.flat, over.edge

    def envelope(end: float) -> Array:
        padded = np.concatenate([np.full(edge, height), raised, np.full(edge, end)])
        padded[edge : edge + flat] = np.maximum(padded[edge : edge + flat], height)
        padded[-edge - flat : -edge] = np.maximum(padded[-edge - flat : -edge], end)
        return _limited(padded, step, slope, acceleration)

    # The lowest level at which the end can be reached level.
    low, high = float(raised[-flat:].max()), max(float(raised.max()), height) + 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if envelope(middle)[-edge - flat] <= middle + 1e-9:
            high = middle
        else:
            low = middle
    whole = envelope(high)
    if whole[edge + flat - 1] > height + 1e-3:
        # Where it begins, the terrain ahead asks for more.
        raise TrajectoryError(
            f"begins at {height:.1f} m, too low for the terrain ahead: the initial height must be "
            f"at least {math.ceil(_least_start(over, step, slope, acceleration))} m. Remove "
            "height_m if this is the first segment, climb first, increase max_climb_angle_deg or "
            "reduce clearance_m"
        )
    smooth = np.convolve(whole, over.blur, mode="same")
    return np.asarray(smooth[edge:-edge])


def _least_start(over: _Floor, step: float, slope: float, acceleration: float) -> float:
    """Return the lowest initial height for a profile that is level at both ends [m].

    The profile is level over the length of the moving average, to avoid a jerk at the start. The
    level end may require additional height.
    """
    raised = over.raised
    end = _least_end(over, raised[::-1], float(raised[0]), step, slope, acceleration)
    return _least_end(over, raised, end, step, slope, acceleration)


def _least_end(
    over: _Floor, raised: Array, other: float, step: float, slope: float, acceleration: float
) -> float:
    """Return the lowest initial level [m] above a floor (N,), for the final level ``other`` [m]."""
    flat, edge = over.flat, over.edge
    low, high = float(raised[0]), max(float(raised.max()), other) + 1.0
    for _ in range(40):
        height = 0.5 * (low + high)
        padded = np.concatenate([np.full(edge, height), raised, np.full(edge, other)])
        padded[edge : edge + flat] = np.maximum(padded[edge : edge + flat], height)
        padded[-edge - flat : -edge] = np.maximum(padded[-edge - flat : -edge], other)
        if _limited(padded, step, slope, acceleration)[edge + flat - 1] <= height + 1e-6:
            high = height
        else:
            low = height
    return high


@compiled
def _limited(floor: Array, step: float, slope: float, acceleration: float) -> Array:
    """Return the envelope (N,) above a floor (N,) within limits of slope and acceleration."""
    count = floor.shape[0]
    lifted = floor.copy()
    fall = slope * step
    for n in range(1, count):
        lifted[n] = max(lifted[n], lifted[n - 1] - fall)
    for n in range(count - 2, -1, -1):
        lifted[n] = max(lifted[n], lifted[n + 1] - fall)
    curvature = 0.5 * acceleration * step * step
    dilated = -_envelope(-lifted, 0.5 * curvature)
    return _envelope(dilated, curvature)


@compiled
def _envelope(values: Array, curvature: float) -> Array:
    """Return min over m of values[m] + curvature (n − m)² for every n (N,), in linear time.

    The method is that of Felzenszwalb and Huttenlocher (2012). It lists the parabolas of the lower
    envelope from left to right, with the position where each becomes the lowest.
    """
    count = values.shape[0]
    lowest = np.zeros(count, dtype=np.int64)
    begins = np.empty(count)
    last = 0
    begins[0] = -np.inf
    for n in range(1, count):
        while True:
            m = lowest[last]
            crossing = 0.5 * ((values[n] - values[m]) / (curvature * (n - m)) + (n + m))
            if crossing > begins[last]:
                break
            last -= 1
        last += 1
        lowest[last] = n
        begins[last] = crossing
    out = np.empty(count)
    at = 0
    for n in range(count):
        while at < last and begins[at + 1] < n:
            at += 1
        m = lowest[at]
        out[n] = values[m] + curvature * (n - m) ** 2
    return out
