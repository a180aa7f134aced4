"""GNSS receivers: position and velocity of an antenna."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..gravity.field import Field
from ..problem import Channel
from .aiding import MOVED, AidingSensor, Motion, cross_matrix, metres_of, position_error

_TIMING = 1e-9
"""Tolerance for equal times [s]."""


@dataclass(frozen=True)
class FalsePositions:
    """Position errors of a GNSS receiver at fixed times, equal in all runs.

    They represent jamming, spoofing or wrong corrections.

    Attributes
    ----------
    ramp : rate of the error, ENU [m/s], from the time ``ramp_from`` [s] on.
    jump : error, ENU [m], between the two times of ``jump_within`` [s].
    """

    ramp: tuple[float, ...] = (0.0, 0.0, 0.0)
    ramp_from: float = 0.0
    jump: tuple[float, ...] = (0.0, 0.0, 0.0)
    jump_within: tuple[float, float] = (0.0, np.inf)

    def at(self, times: np.ndarray) -> np.ndarray:
        """Return the position errors (K, 3), ENU [m], at times (K,) [s]."""
        first, last = self.jump_within
        jumped = (times > first - _TIMING) & (times < last + _TIMING)
        grown = np.maximum(times - self.ramp_from, 0.0)
        return grown[:, np.newaxis] * np.array(self.ramp) + np.outer(jumped, self.jump)


_TRUE_POSITIONS = FalsePositions()


@dataclass(frozen=True)
class Gnss(AidingSensor):
    """GNSS receiver: position relative to the INS, and velocity.

    Position and velocity are linear in the INS errors: p − p̂ = −δr and v = v̂ − δv. An antenna at
    the lever arm l adds C_nb l ≈ (I + [φ×]) Ĉ_nb l to the position. Only positions have biases and
    errors at fixed times.

    Velocities are corrected for the assumed lever arm with error-free angular rates ω. A lever-arm
    error δl adds C_nb δl to positions and C_nb (ω × δl) to velocities. If δl is a state, the
    measurement model uses Ĉ_nb instead of C_nb, so h is linear. This neglects φ × Ĉ_nb δl, which is
    2 mm for δl = 2 m and φ = 3′.

    Attributes
    ----------
    position, velocity : whether the receiver provides positions; whether it provides velocities.
    errors : position errors at fixed times.
    lever : lever arm from the INS to the antenna in body axes (right, forward, up) [m].
    """

    position: bool = True
    velocity: bool = True
    errors: FalsePositions = _TRUE_POSITIONS
    lever: tuple[float, ...] = (0.0, 0.0, 0.0)

    kind = "gnss"

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels that the receiver provides: position and velocity, ENU.

        Positions are relative to the INS [m]; velocities are in m/s.
        """
        kinds = [("position", "m")] * self.position + [("velocity", "m/s")] * self.velocity
        return tuple(
            Channel(f"{what} {axis}", unit, self.name) for what, unit in kinds for axis in "ENU"
        )

    @property
    def biased(self) -> int:
        """Number of axes with a position bias: three or zero."""
        return 3 if self.position and self.bias > 0.0 else 0

    def by_arm(self, motion: Motion, turning: np.ndarray) -> np.ndarray:
        """Return the Jacobian (..., K, e, 3) of the channels with respect to the lever arm.

        It is C_nb for positions [m/m] and C_nb [ω×] for velocities [m/s per m].
        """
        c_nb = motion.attitudes
        parts = [c_nb] * self.position + [c_nb @ cross_matrix(turning)] * self.velocity
        return np.concatenate(parts, axis=-2)

    def exact(self, truth: Motion, ins: Motion, gravity: Field) -> np.ndarray:
        """Return the measurements (..., K, e) without sensor errors.

        They are the true antenna position minus the INS position [m], and the true velocity [m/s].
        """
        parts = []
        if self.position:
            antenna = truth.attitudes @ np.array(self.lever)
            parts.append(antenna - position_error(ins.positions, truth.positions))
        if self.velocity:
            parts.append(np.broadcast_to(truth.velocities, ins.velocities.shape))
        return np.concatenate(parts, axis=-1)

    def about(self, ins: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Return offset (..., K, e) and Jacobian C_k (..., K, e, 9) of the measurements.

        C_k is the derivative with respect to the INS errors. The position is
        −δr + Ĉ_nb l + φ × Ĉ_nb l, and the velocity is v̂ − δv.
        """
        selected = self._selected
        rows = np.zeros((*ins.positions.shape[:-1], len(selected), MOVED))
        rows[..., np.arange(len(selected)), selected] = -1.0
        antenna = ins.attitudes @ np.array(self.lever)
        if self.position:
            rows[..., :3, 6:9] = -cross_matrix(antenna)
        offset = np.concatenate([antenna, ins.velocities], axis=-1)
        return offset[..., selected], rows

    @property
    def _selected(self) -> np.ndarray:
        return np.flatnonzero([self.position] * 3 + [self.velocity] * 3)

    def seen_from(self, readings: np.ndarray, old: Motion, new: Motion) -> np.ndarray:
        """Return measurements (..., K, e) [m] relative to the new INS track, not the old one."""
        if not self.position:
            return readings
        # Metres of the new track: a radian of longitude is worth another length there.
        scaled = readings[..., :3] * (metres_of(new.positions) / metres_of(old.positions))
        off = -position_error(new.positions, old.positions)
        return np.concatenate([scaled + off, readings[..., 3:]], axis=-1)
