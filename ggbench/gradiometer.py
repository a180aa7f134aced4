"""The gravity gradiometer: what it reads in the axes of its mount, and which of it it delivers.

A gradiometer reads the gravitational gradient tensor Γ in the axes of its mount s, C_sn Γ^n C_snᵀ:

``platform``
    inertially stabilised, C_sn = C_in(L, λ + ω_ie t): a position error shows because the field
    changes and because the local level turns against inertial space. Inertial axes coincide with
    ECEF axes at t = 0.
``local-level``
    held level and to the north without error, C_sn = I: only the field's change shows.
``strapdown``
    fixed to the body, C_sn = C_bn: the reading depends on the attitude, too. Its rotation is taken
    as compensated: no centrifugal term of ω_ib is left in the reading.

Tensors are vectors [xx, xy, xz, yy, yz, zz], in E. A *channel* is a linear combination of the six:
a component, half the difference of two diagonal ones (``xx-yy`` = (xx − yy)/2), or what a disk of
rotating accelerometers measures (:mod:`ggbench.rotating_gradiometer`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from .earth import ROTATION_RATE
from .field import Field, gradient_at
from .ins_error import metres_per_radian
from .lowpass import LowPass

COMPONENTS = ("xx", "xy", "xz", "yy", "yz", "zz")
DIFFERENCES = ("xx-yy", "yy-zz", "zz-xx")
INSTRUMENTS = ("platform", "local-level", "strapdown")
PLATFORM, LOCAL_LEVEL, STRAPDOWN = range(3)
"""Kinds of instruments, as the compiled code knows them: indices of :data:`INSTRUMENTS`."""


@njit(cache=True)
def inertial_from_local(latitude: float, longitude: float, time: float, out: np.ndarray) -> None:
    """Fill C_in (3, 3): ENU at a geodetic position to inertial axes at ``time`` [s] (eq. 10)."""
    angle = longitude + ROTATION_RATE * time
    sin_l, cos_l = math.sin(latitude), math.cos(latitude)
    sin_a, cos_a = math.sin(angle), math.cos(angle)
    out[0, 0], out[0, 1], out[0, 2] = -sin_a, -sin_l * cos_a, cos_l * cos_a
    out[1, 0], out[1, 1], out[1, 2] = cos_a, -sin_l * sin_a, cos_l * sin_a
    out[2, 0], out[2, 1], out[2, 2] = 0.0, cos_l, sin_l


@njit(cache=True)
def rotate_tensor(rotation: np.ndarray, tensor: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` with vec6(C M Cᵀ) of the symmetric tensor vec6(M) (the paper's D6(C) vec6)."""
    half = np.empty((3, 3))
    xx, xy, xz, yy, yz, zz = tensor[0], tensor[1], tensor[2], tensor[3], tensor[4], tensor[5]
    for i in range(3):
        a, b, c = rotation[i, 0], rotation[i, 1], rotation[i, 2]
        half[i, 0] = a * xx + b * xy + c * xz
        half[i, 1] = a * xy + b * yy + c * yz
        half[i, 2] = a * xz + b * yz + c * zz
    m = 0
    for i in range(3):
        for j in range(i, 3):
            out[m] = (
                half[i, 0] * rotation[j, 0]
                + half[i, 1] * rotation[j, 1]
                + half[i, 2] * rotation[j, 2]
            )
            m += 1


@njit(cache=True)
def reading_at(
    instrument: int,
    position: np.ndarray,
    time: float,
    c_nb: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    out: np.ndarray,
) -> bool:
    """Fill the noise-free tensor (6,) [E] in the axes of the mount; return: inside the map.

    ``instrument`` is an index of :data:`INSTRUMENTS`; only a platform depends on ``time`` [s], only
    a strapdown instrument on ``c_nb``.
    """
    tensor = np.empty(6)
    derivative = np.empty((6, 3))
    rotation = np.empty((3, 3))
    inside = gradient_at(position, origin, step, coefficients, tensor, derivative)
    if instrument == LOCAL_LEVEL:
        out[:] = tensor
        return inside
    if instrument == PLATFORM:
        inertial_from_local(position[0], position[1], time, rotation)
    else:
        rotation[:, :] = c_nb.T
    rotate_tensor(rotation, tensor, out)
    return inside


@njit(cache=True)
def _add_turn(tensor: np.ndarray, x: float, y: float, z: float, out: np.ndarray) -> None:
    """Add [φ×] M − M [φ×] for φ = (x, y, z) to ``out`` (6,): eq. 12's ∂L_φ/∂φ times φ."""
    xx, xy, xz, yy, yz, zz = tensor[0], tensor[1], tensor[2], tensor[3], tensor[4], tensor[5]
    out[0] = out[0] + 2.0 * xz * y - 2.0 * xy * z
    out[1] = out[1] - xz * x + yz * y + (xx - yy) * z
    out[2] = out[2] + xy * x + (zz - xx) * y - yz * z
    out[3] = out[3] - 2.0 * yz * x + 2.0 * xy * z
    out[4] = out[4] + (yy - zz) * x - xy * y + xz * z
    out[5] = out[5] + 2.0 * yz * x - 2.0 * xz * y


@njit(cache=True)
def reading_jacobian_at(
    instrument: int,
    position: np.ndarray,
    time: float,
    c_nb: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill ∂(reading)/∂(east, north, up; ψ) (6, 6) [E/m; E/rad] at a point (eqs. 11, 12).

    For a platform D6(C_in) { ∂Γ/∂r + [∂L_φ/∂φ][∂φ_in/∂r] }: the field's change and the local
    level's turn. ψ turns the body, C_nb → exp([ψ×]) C_nb, which only a strapdown instrument sees.
    """
    tensor = np.empty(6)
    derivative = np.empty((6, 3))
    rotation = np.empty((3, 3))
    column = np.empty(6)
    gradient_at(position, origin, step, coefficients, tensor, derivative)
    out[:, 3:] = 0.0
    if instrument == LOCAL_LEVEL:
        out[:, :3] = derivative
        return
    if instrument == STRAPDOWN:
        rotation[:, :] = c_nb.T
        against = np.empty(3)
        for axis in range(3):
            column[:] = derivative[:, axis]
            rotate_tensor(rotation, column, out[:, axis])
            # The mount turns with the body, so the tensor turns against it.
            against[:] = 0.0
            against[axis] = -1.0
            column[:] = 0.0
            _add_turn(tensor, against[0], against[1], against[2], column)
            rotate_tensor(rotation, column, out[:, 3 + axis])
        return
    inertial_from_local(position[0], position[1], time, rotation)
    per_north, per_east = metres_per_radian(position)
    for axis in range(3):
        # φ_in: the rotation of the local level for one metre along the axis.
        phi_x = phi_y = phi_z = 0.0
        if axis == 0:
            phi_y = math.cos(position[0]) / per_east
            phi_z = math.sin(position[0]) / per_east
        elif axis == 1:
            phi_x = -1.0 / per_north
        column[:] = derivative[:, axis]
        _add_turn(tensor, phi_x, phi_y, phi_z, column)
        rotate_tensor(rotation, column, out[:, axis])


@njit(cache=True)
def readings_along(
    instrument: int,
    positions: np.ndarray,
    times: np.ndarray,
    attitudes: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
) -> np.ndarray:
    """Return the noise-free tensors (K, 6) in the mount at (K, 3), (K,) and (K, 3, 3)."""
    out = np.empty((positions.shape[0], 6))
    for k in range(positions.shape[0]):
        reading_at(
            instrument, positions[k], times[k], attitudes[k], origin, step, coefficients, out[k]
        )
    return out


def readings(
    field: Field,
    positions: np.ndarray,
    times: np.ndarray,
    attitudes: np.ndarray | None = None,
    instrument: str = "platform",
) -> np.ndarray:
    """Return noise-free tensors (K, 6) [E] in the mount of an instrument along a track.

    Parameters
    ----------
    field : the gradient field.
    positions : (K, 3) geodetic latitude, longitude [rad], height [m].
    times : (K,) [s] since the inertial frame coincided with ECEF.
    attitudes : (K, 3, 3) C_nb, which only a strapdown instrument needs.
    instrument : one of :data:`INSTRUMENTS`.

    Raises
    ------
    OutsideMapError
        If a position lies outside the map; the message names it and the map's bounds.
    """
    field.tensor(*positions.T)  # raises outside the map, which the kernel below would extend
    if attitudes is None:
        attitudes = np.tile(np.eye(3), (len(positions), 1, 1))
    return readings_along(
        INSTRUMENTS.index(instrument), positions, times, np.ascontiguousarray(attitudes),
        field.origin, field.step, field.tensor_coefficients,
    )  # fmt: skip


@dataclass(frozen=True)
class Gradiometer:
    """A gradiometer as the estimators know it.

    Attributes
    ----------
    noise_eotvos : RMS of the white noise of each channel, before the filter [E].
    lowpass : the instrument's filter, or None.
    components : names of its channels.
    instrument : how it is mounted, one of :data:`INSTRUMENTS`.
    bias_eotvos : σ of each channel's bias at the start [E].
    drift : root PSD of the bias's random walk [E/√s].
    """

    noise_eotvos: float
    lowpass: LowPass | None
    components: tuple[str, ...] = COMPONENTS
    instrument: str = "platform"
    bias_eotvos: float = 0.0
    drift: float = 0.0

    @property
    def channels(self) -> np.ndarray:
        """Rows (m, 6) that take the tensor in the mount to the channels."""
        return np.stack([channel(name) for name in self.components])

    def noise(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Return white noise (count, m) of its channels [E].

        All that any instrument could deliver is drawn, so that a subset sees the same noise.
        """
        groups = (COMPONENTS, DIFFERENCES)
        draws = np.hstack([rng.standard_normal((count, len(group))) for group in groups])
        names = [name for group in groups for name in group]
        chosen = [names.index(name) for name in self.components]
        return np.asarray(self.noise_eotvos * draws[:, chosen])

    @property
    def biased(self) -> bool:
        """Whether its channels have biases, which are states of the estimation problem then."""
        return self.bias_eotvos > 0.0 or self.drift > 0.0


def channel(name: str) -> np.ndarray:
    """Return the row (6,) that takes a tensor to a component or to half a difference of two."""
    row = np.zeros(6)
    plus, _, minus = name.partition("-")
    row[COMPONENTS.index(plus)] = 0.5 if minus else 1.0
    if minus:
        row[COMPONENTS.index(minus)] = -0.5
    return row


def noise_rms(root_psd: float, rate_hz: float) -> float:
    """Return N_RMS = √(D_NSD² f / 2) of a noise density [E/√Hz] at an update rate [Hz] (eq. 1)."""
    return math.sqrt(root_psd**2 * rate_hz / 2.0)


def parse_components(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of channels in the standard order."""
    return tuple(name for name in (*COMPONENTS, *DIFFERENCES) if name in names)
