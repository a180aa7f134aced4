"""Aiding sensors other than the gradiometer, with measurements as functions of INS errors.

A sensor class has two methods that define its measurements:

* :meth:`AidingSensor.exact` returns the measurements without sensor errors, from the true motion
  and the INS solution.
* :meth:`AidingSensor.about` returns the same measurements as a linear function of the INS errors.

The errors of a sensor are white noise, channel biases, outliers and dropouts.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from ..gravity.ellipsoid import metres_along
from ..gravity.field import Field
from ..numerics.rotations import rotation_matrix
from ..problem import Channel
from .gradiometer.faults import Faults
from .processes import gauss_markov, remaining

MOVED = 9
"""Number of INS errors on which measurements depend: position, velocity and attitude."""
MGAL = 1e5
"""Conversion factor from m/s² to mGal."""
AXES = "xyz"
_NO_FAULTS = Faults()
_GRAVITY = ("east", "north", "scalar")


class _Track(Protocol):
    @property
    def positions(self) -> np.ndarray: ...
    @property
    def velocities(self) -> np.ndarray: ...
    @property
    def attitudes(self) -> np.ndarray: ...


class Motion(NamedTuple):
    """Positions, velocities and attitudes of a body at K epochs.

    Attributes
    ----------
    positions : (..., K, 3) latitude, longitude [rad] and height [m].
    velocities : (..., K, 3) velocities ENU [m/s].
    attitudes : (..., K, 3, 3) attitude matrices C_nb, from body axes to ENU.
    """

    positions: np.ndarray
    velocities: np.ndarray
    attitudes: np.ndarray

    @classmethod
    def of(cls, track: _Track) -> Motion:
        """Return the motion of an INS track or of a true track."""
        return cls(track.positions, track.velocities, track.attitudes)

    @classmethod
    def of_states(cls, states: np.ndarray) -> Motion:
        """Return the motion of navigation states (..., 15); the inverse of :attr:`states`."""
        c_nb = states[..., 6:].reshape(*states.shape[:-1], 3, 3)
        return cls(states[..., :3], states[..., 3:6], c_nb)

    @property
    def states(self) -> np.ndarray:
        """Navigation states (..., 15): position, velocity and C_nb (row by row)."""
        c_nb = self.attitudes.reshape(*self.positions.shape[:-1], 9)
        return np.concatenate([self.positions, self.velocities, c_nb], axis=-1)

    def at(self, epochs: Any) -> Motion:
        """Return the motion at the epochs with indices ``epochs``."""
        return Motion(
            self.positions[..., epochs, :],
            self.velocities[..., epochs, :],
            self.attitudes[..., epochs, :, :],
        )


@dataclass(frozen=True)
class AidingSensor(ABC):
    """Base class of the aiding sensors.

    Attributes
    ----------
    period : time between two measurements [s].
    noise : (e,) RMS of the white noise of each of e channels [unit of the channel].
    bias : standard deviation of the bias of each channel [unit of the channel]; zero for no bias.
    bias_time : correlation time of the bias, a Gauss–Markov process [s]; ∞ for a constant bias.
    faults : outliers and dropouts, which no estimator assumes.
    arm_sigma : standard deviation of the constant error of each lever-arm component [m]; zero for
        no error.
    label : name of the sensor, needed if there are several sensors of the same kind; "" for none.
    """

    period: float
    noise: tuple[float, ...]
    bias: float = 0.0
    bias_time: float = np.inf
    faults: Faults = _NO_FAULTS
    arm_sigma: float = field(default=0.0, kw_only=True)
    label: str = field(default="", kw_only=True)

    kind: ClassVar[str]

    @property
    def name(self) -> str:
        """Name of the sensor: the label, or the kind of the sensor if there is no label."""
        return self.label or self.kind

    @property
    @abstractmethod
    def channels(self) -> tuple[Channel, ...]:
        """The e channels of the sensor."""

    @abstractmethod
    def exact(self, truth: Motion, ins: Motion, gravity: Field) -> np.ndarray:
        """Return the measurements (..., K, e) without sensor errors.

        ``gravity`` is the true gravity field.
        """

    @abstractmethod
    def about(self, ins: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Return the measurements as linear functions of the INS errors.

        The result is the offset (..., K, e) and an array (..., K, e, 9), the first nine columns of
        C_k. :class:`.ModelArrays` defines both. The contribution of the map's gravity is excluded.
        """

    def seen_from(self, readings: np.ndarray, old: Motion, new: Motion) -> np.ndarray:
        """Return measurements (..., K, e), converted from an old to a new INS solution.

        The base class returns them unchanged, because most measurements do not depend on the INS.
        """
        return readings

    @property
    def weights(self) -> np.ndarray:
        """Jacobian W (e, 3) of the channels with respect to the gravity disturbance, ENU.

        The unit is that of the channel per m/s².
        """
        return np.zeros((len(self.channels), 3))

    @property
    def biased(self) -> int:
        """Number of channels with a bias; these channels come first."""
        return len(self.channels) if self.bias > 0.0 else 0

    @property
    def armed(self) -> int:
        """Number of lever-arm states: three or zero."""
        return 3 if self.arm_sigma > 0.0 else 0

    def by_arm(self, motion: Motion, turning: np.ndarray) -> np.ndarray:
        """Return the Jacobian (..., K, e, 3) of the channels with respect to the lever arm.

        The unit is that of the channel per m.

        Parameters
        ----------
        motion : indicated or true motion of the body.
        turning : (..., K, 3) angular rate of the body about the body axes [rad/s].
        """
        return np.zeros((*motion.positions.shape[:-1], len(self.channels), 3))

    def decay(self, times: np.ndarray) -> np.ndarray:
        """Return the decay factor (K,) of a bias from the previous epoch to each epoch.

        The factor is e^(−Δt/T), with the interval Δt and the correlation time T. The first interval
        is that from time zero to the first epoch.
        """
        return remaining(times, self.bias_time)

    def biases(self, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return random biases (K, b) of a run at the epochs, for the b channels with a bias."""
        return self.bias * gauss_markov(times, self.bias_time, self.biased, rng)


@dataclass(frozen=True)
class VelocityLog(AidingSensor):
    """Velocity log: components of the velocity in body axes (right, forward, up) or in ENU.

    In body axes the velocity depends on the attitude error φ: C_bn v ≈ Ĉ_bn (v̂ − δv + v̂ × φ). A
    hat marks INS values, and δv is the velocity error. The terms φ × δv and φ² v / 2 are neglected.
    For φ = 3′ the first is 1 mm/s at δv = 1 m/s, and the second is 0.04 mm/s at v = 100 m/s.
    """

    components: tuple[str, ...] = ("x", "y")
    body: bool = True

    kind = "velocity_log"

    @property
    def _axes(self) -> list[int]:
        return [AXES.index(component) for component in self.components]

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels: the measured velocity components [m/s]."""
        names = ("right", "forward", "up") if self.body else ("E", "N", "U")
        return tuple(Channel(f"velocity {names[i]}", "m/s", self.name) for i in self._axes)

    def exact(self, truth: Motion, ins: Motion, gravity: Field) -> np.ndarray:
        """Return the true velocity components (..., K, e) [m/s]."""
        found = truth.velocities
        if self.body:
            found = np.einsum("...ji,...j->...i", truth.attitudes, found)
        return np.broadcast_to(found, ins.velocities.shape)[..., self._axes]

    def about(self, ins: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Return offset (..., K, e) [m/s] and Jacobian C_k (..., K, e, 9) of the velocity.

        C_k is the derivative with respect to the INS errors. The measurement is
        Ĉ_bn (v̂ − δv + v̂ × φ) in body axes, or v̂ − δv in ENU.
        """
        rows = np.zeros((*ins.positions.shape[:-1], 3, MOVED))
        offset = ins.velocities
        if self.body:
            c_bn = np.swapaxes(ins.attitudes, -1, -2)
            offset = np.einsum("...ij,...j->...i", c_bn, offset)
            rows[..., 3:6] = -c_bn
            rows[..., 6:9] = c_bn @ cross_matrix(ins.velocities)
        else:
            rows[..., np.arange(3), np.arange(3, 6)] = -1.0
        return offset[..., self._axes], rows[..., self._axes, :]


@dataclass(frozen=True)
class Barometer(AidingSensor):
    """Barometric altimeter or known sea level, as a measurement of the height.

    The height is ĥ − δh [m], with the INS height ĥ and its error δh.
    """

    kind = "barometer"

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channel: the height [m]."""
        return (Channel("height", "m", self.name),)

    def exact(self, truth: Motion, ins: Motion, gravity: Field) -> np.ndarray:
        """Return the true height (..., K, 1) [m]."""
        return np.broadcast_to(truth.positions, ins.positions.shape)[..., 2:]

    def about(self, ins: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Return the offset ĥ (..., K, 1) [m] and the Jacobian C_k (..., K, 1, 9) of ĥ − δh."""
        rows = np.zeros((*ins.positions.shape[:-1], 1, MOVED))
        rows[..., 0, 2] = -1.0
        return ins.positions[..., 2:], rows


@dataclass(frozen=True)
class Gravimeter(AidingSensor):
    """Gravimeter; measurements are gravity disturbances, reduced with the INS solution [mGal].

    In steady flight an accelerometer measures the specific force f = c(v, p) + γ(p) − δg. In this
    equation c = (2ω_ie + ω_en) × v is the Eötvös acceleration, and −γ is normal gravity. The
    reduced measurement is c(v̂, p̂) + γ(p̂) − Ĉ_nb C_bn f. This is the disturbance δg at the true
    position plus the effects of the INS errors on c, γ and f (Li 2011). The component ``scalar``
    is −δg_U, the excess of downward gravity.

    Vehicle accelerations are assumed known; residual accelerations are part of the noise. Terms of
    second order in the INS errors are neglected. They are 0.02 mGal for an error of 1 m/s or 10 km,
    and 0.04 mGal for a tilt of 1′.
    """

    components: tuple[str, ...] = ("scalar",)
    steady_force: Callable[[np.ndarray, np.ndarray], np.ndarray] = field(kw_only=True)
    """Function of positions and velocities: c + γ (..., 3), ENU [m/s²], as computed in the INS."""

    kind = "gravimeter"

    @property
    def _axes(self) -> list[int]:
        return [_GRAVITY.index(component) for component in self.components]

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels: the measured components of the disturbance [mGal]."""
        return tuple(Channel(f"gravity {_GRAVITY[i]}", "mGal", self.name) for i in self._axes)

    @property
    def weights(self) -> np.ndarray:
        """Jacobian W (e, 3) of the channels with respect to the disturbance ENU.

        The unit is mGal / (m/s²). The channel ``scalar`` is the negative of the up component.
        """
        return np.asarray((MGAL * _SIGNS[:, np.newaxis] * np.eye(3))[self._axes])

    def exact(self, truth: Motion, ins: Motion, gravity: Field) -> np.ndarray:
        """Return the reduced measurements (..., K, e) [mGal] without sensor errors.

        The specific force is that of the true motion; the reduction uses the INS solution.
        """
        disturbance = gravity.gravity_disturbance(*np.moveaxis(truth.positions, -1, 0))
        felt = self.steady_force(truth.positions, truth.velocities) - disturbance
        turn = ins.attitudes @ np.swapaxes(truth.attitudes, -1, -2)
        reduced = self.steady_force(ins.positions, ins.velocities)
        reduced = reduced - np.einsum("...ij,...j->...i", turn, felt)
        return np.asarray((MGAL * _SIGNS * reduced)[..., self._axes])

    def seen_from(self, readings: np.ndarray, old: Motion, new: Motion) -> np.ndarray:
        """Return the measurements (..., K, e) [mGal], reduced with the new INS solution.

        The measured specific force is rotated from the old to the new attitude. The rotation needs
        three components: those without a measurement are taken from the specific force of steady
        flight.
        """
        turn = new.attitudes @ np.swapaxes(old.attitudes, -1, -2)
        reduced = self.steady_force(new.positions, new.velocities)
        felt = np.einsum("...ji,...j->...i", turn, reduced)
        measured = readings / (MGAL * _SIGNS[self._axes])
        before = self.steady_force(old.positions, old.velocities)
        felt[..., self._axes] = before[..., self._axes] - measured
        again = reduced - np.einsum("...ij,...j->...i", turn, felt)
        return np.asarray((MGAL * _SIGNS * again)[..., self._axes])

    def about(self, ins: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Return the offset (..., K, e) [mGal], which is zero, and C_k (..., K, e, 9).

        C_k is the derivative of the reduced measurements with respect to the INS errors, in mGal
        per m, m/s and rad. The derivative of the map's gravity is excluded.
        """
        rows = np.zeros((*ins.positions.shape[:-1], 3, MOVED))
        for j, step in ((1, 100.0), (2, 100.0), (3, 1.0), (4, 1.0), (5, 1.0)):
            # c and γ are smooth: the fourth digit of a central difference is beyond any reading.
            error = np.zeros(6)
            error[j] = 0.5 * step
            moved = (error[:3] / metres_of(ins.positions))[..., _ENU]
            ahead, behind = (
                self.steady_force(ins.positions + sign * moved, ins.velocities + sign * error[3:])
                for sign in (1.0, -1.0)
            )
            rows[..., j] = (ahead - behind) / step
        rows[..., 6:9] = -cross_matrix(self.steady_force(ins.positions, ins.velocities))
        rows *= MGAL * _SIGNS[:, np.newaxis]
        return np.zeros((*ins.positions.shape[:-1], len(self._axes))), rows[..., self._axes, :]


_SIGNS = np.array([1.0, 1.0, -1.0])
"""Signs of the disturbance components E, N, U in the channels east, north, scalar."""


_ENU = [1, 0, 2]
"""Indices of longitude, latitude and height in a position, in the order ENU."""


def position_error(indicated: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return indicated − true positions (..., 3), in metres ENU at the indicated positions."""
    return np.asarray((indicated - true)[..., _ENU] * metres_of(indicated))


def corrected_positions(indicated: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Return indicated positions (..., 3), corrected for position errors ENU (..., 3) [m].

    This is the inverse of :func:`position_error`.
    """
    return np.asarray(indicated - (error / metres_of(indicated))[..., _ENU])


def corrected_motion(indicated: Motion, errors: np.ndarray) -> Motion:
    """Return the motion of an INS, corrected for estimated errors.

    Parameters
    ----------
    indicated : motion of the INS at K epochs.
    errors : (K, n) estimated states; the first nine are errors of position [m], velocity [m/s] and
        attitude [rad].
    """
    attitudes, turn = np.empty((len(errors), 3, 3)), np.empty((3, 3))
    for k, c_nb in enumerate(indicated.attitudes):
        rotation_matrix(np.ascontiguousarray(errors[k, 6:9]), turn)
        attitudes[k] = turn @ c_nb
    return Motion(
        corrected_positions(indicated.positions, errors[:, :3]),
        indicated.velocities - errors[:, 3:6],
        attitudes,
    )


def cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """Return the cross-product matrices [v×] (..., 3, 3) of vectors v (..., 3)."""
    return np.cross(np.eye(3), vectors[..., np.newaxis, :])


def metres_of(positions: np.ndarray) -> np.ndarray:
    """Return the factors (..., 3) that convert position differences to metres ENU.

    They are metres per radian of longitude, metres per radian of latitude, and 1. Note the other
    order of ``positions`` (..., 3): latitude, longitude [rad] and height [m].
    """
    flat = np.ascontiguousarray(positions).reshape(-1, 3)
    metres = np.hstack([metres_along(flat), np.ones((len(flat), 1))])
    return metres.reshape(positions.shape)
