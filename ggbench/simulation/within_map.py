"""Whether a flight stays within its maps, and what to do if it does not."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..gravity.field import Field, OutsideMapError
from ..spec.trajectory import TrajectorySpec


def require_within(fields: Sequence[Field], positions: np.ndarray, spec: TrajectorySpec) -> None:
    """Raise OutsideMapError if positions (K, 3) leave a map; it says how many, and what to do."""
    for field in fields:
        try:
            field.require_inside(positions)
        except OutsideMapError as error:
            lowest, highest = field.lower[2], field.upper[2]
            below, above = positions[:, 2] < lowest, positions[:, 2] > highest
            where, cure, share = "above", "fly lower or build it higher", above.mean()
            if below.mean() >= share:
                where, share = "below", below.mean()
                follows = any(segment.terrain is not None for segment in spec.segment)
                cure = (
                    f"lowest_m = {math.ceil(lowest)} of the segment keeps a flight that follows "
                    "the terrain inside"
                    if follows
                    else "fly higher or build it lower"
                )
            if share == 0.0:
                raise
            raise OutsideMapError(
                f"{error}; {share:.0%} of the flight lies {where} the map: {cure}"
            ) from None
