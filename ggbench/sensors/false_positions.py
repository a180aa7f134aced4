"""Positions that a receiver reports wrongly: as if jammed, spoofed or misled by its corrections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_TIMING = 1e-9
"""Within which times are equal [s]."""


@dataclass(frozen=True)
class FalsePositions:
    """Errors of a receiver's positions that follow the clock, the same in all runs.

    Attributes
    ----------
    ramp : ENU [m/s], by which the error grows from ``ramp_from`` [s] on.
    jump : ENU [m], between the two times of ``jump_within`` [s].
    """

    ramp: tuple[float, ...] = (0.0, 0.0, 0.0)
    ramp_from: float = 0.0
    jump: tuple[float, ...] = (0.0, 0.0, 0.0)
    jump_within: tuple[float, float] = (0.0, np.inf)

    def at(self, times: np.ndarray) -> np.ndarray:
        """Return the errors (K, 3) ENU [m] of positions at some times (K,) [s]."""
        first, last = self.jump_within
        jumped = (times > first - _TIMING) & (times < last + _TIMING)
        grown = np.maximum(times - self.ramp_from, 0.0)
        return grown[:, np.newaxis] * np.array(self.ramp) + np.outer(jumped, self.jump)
