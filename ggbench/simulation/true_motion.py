"""True motion of a flight and error-free inertial data, from its ``[trajectory]`` table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from ..gravity.field import Field, OutsideMapError
from ..ins import strapdown
from ..spec.limits import FASTEST_MPS, HIGHEST_M, LOWEST_M
from ..spec.trajectory import TrajectorySpec
from ..trajectory.manoeuvres import TrajectoryError
from ..trajectory.truth import Trajectory, along, fly
from .field_source import beside


@lru_cache(maxsize=8)
def error_free_motion(
    spec: TrajectorySpec, dt: float, versions: tuple[object, ...], felt: Field | None
) -> tuple[Trajectory, np.ndarray, np.ndarray]:
    """Return the true trajectory, and error-free IMU angle and velocity increments (N, 3).

    Cases that differ only in sensors and priors share the cached result. ``dt`` is the sampling
    interval [s]. ``versions`` are the versions of the input files. ``felt`` is the field whose
    gravity disturbance the accelerometers measure, or None.
    """
    trajectory = trajectory_of(spec, dt)
    _require_possible(trajectory)
    disturbances = np.zeros((len(trajectory.times) - 1, 3))
    if felt is not None:
        middle = 0.5 * (trajectory.positions[1:] + trajectory.positions[:-1])
        disturbances = beside(felt, float(middle[0, 1])).gravity_disturbance(*middle.T)
    delta_angles, delta_velocities = strapdown.error_free_increments(
        trajectory.positions,
        trajectory.velocities,
        trajectory.attitudes,
        disturbances,
        trajectory.dt,
    )
    return trajectory, delta_angles, delta_velocities


def _require_possible(trajectory: Trajectory) -> None:
    """Raise TrajectoryError if height or speed leave their limits during a flight.

    Long manoeuvres or a track can exceed the limits even if each key of the table is valid.
    """
    heights, speeds = trajectory.positions[:, 2], np.linalg.norm(trajectory.velocities, axis=1)
    for what, values, lowest, highest, unit in (
        ("height", heights, LOWEST_M, HIGHEST_M, "m"),
        ("speed", speeds, 0.0, FASTEST_MPS, "m/s"),
    ):
        outside = ~((lowest <= values) & (values <= highest))  # NaN is outside
        if outside.any():
            first = int(outside.argmax())
            raise TrajectoryError(
                f"the flight's {what} is {values[first]:g} {unit} after "
                f"{trajectory.times[first]:g} s and must lie between {lowest:g} and {highest:g}"
                f" {unit}"
            )


def require_within(fields: Sequence[Field], positions: np.ndarray, spec: TrajectorySpec) -> None:
    """Raise OutsideMapError if positions (K, 3) leave a map; the message states a remedy."""
    for field in fields:
        try:
            field.require_inside(positions)
        except OutsideMapError as error:
            lowest, highest = field.lower[2], field.upper[2]
            heights = field.coordinates(positions)[:, 2]
            below, above = heights < lowest, heights > highest
            where, cure = "above", "fly lower or build the map with higher layers"
            share = above.mean()
            if below.mean() >= share:
                where, share = "below", below.mean()
                follows = any(segment.terrain is not None for segment in spec.segment)
                cure = "fly higher or build the map with lower layers"
                if field.is_draped:
                    missing = math.ceil(lowest - heights.min())
                    cure = f"fly {missing} m higher, or build the map with a lower --clearance-from"
                elif follows:
                    cure = (
                        f"set lowest_m = {math.ceil(lowest)} of the segment, or build the map "
                        "with 'ggbench map build --drape'"
                    )
            if share == 0.0:
                raise
            raise OutsideMapError(
                f"{error}; {share:.0%} of the flight lies {where} the map: {cure}"
            ) from None


def trajectory_of(spec: TrajectorySpec, dt: float) -> Trajectory:
    """Return the true trajectory of a ``[trajectory]`` table.

    Parameters
    ----------
    spec : the table.
    dt : sampling interval [s].

    Raises
    ------
    TrajectoryError
        If the flight is impossible, or a file is invalid.
    """
    pitch, roll = math.radians(spec.pitch_deg), math.radians(spec.roll_deg)
    banks = spec.vehicle == "aircraft"
    if spec.file is None:
        start = spec.start()
        return fly(
            position=start.position,
            speed=start.speed,
            heading=start.heading,
            pitch=pitch,
            roll=roll,
            segments=spec.manoeuvres(),
            dt=dt,
            banks=banks,
            size=len(spec.segment),
        )
    track = spec.track()
    try:
        return along(track, dt, pitch, roll, banks)
    except TrajectoryError as error:
        raise TrajectoryError(f"track {spec.file}: {error}") from None
