"""Gravity gradiometer: gradient tensor in mount axes, and channels.

A gradiometer measures the gravitational gradient tensor Γ^n (ENU) in mount axes s, C_sn Γ^n C_snᵀ:

``platform``
    inertially stabilised mount, C_sn = C_in(L, λ + ω_ie t). A position error is observable from
    changes of the field and from the rotation of the local level in inertial space. Inertial axes
    coincide with ECEF axes at t = 0.
``local-level``
    mount that is levelled and aligned to north without error, C_sn = I. A position error is
    observable only from changes of the field.
``strapdown``
    mount that is fixed to the body, C_sn = C_bn. Measurements also depend on the attitude. The
    centrifugal term of the angular rate ω_ib is assumed to be compensated.

Tensors are vectors [xx, xy, xz, yy, yz, zz], in E. A *channel* is a linear combination of the six
components: a single component, half the difference of two diagonal components (``xx-yy`` = (xx −
yy)/2), or a channel of rotating accelerometers (:mod:`ggbench.sensors.gradiometer.rotating`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...gravity.coloured_noise import VectorAutoregression
from ...gravity.ellipsoid import ROTATION_RATE
from ...gravity.field import Field
from ...numerics.kernels import compiled, inlined
from ...numerics.vectors import like
from .lowpass import LowPass, Treatment

COMPONENTS = ("xx", "xy", "xz", "yy", "yz", "zz")
DIFFERENCES = ("xx-yy", "yy-zz", "zz-xx")
INSTRUMENTS = ("platform", "local-level", "strapdown")
_TRACELESS = np.vstack([np.eye(5), [-1.0, 0.0, 0.0, -1.0, 0.0]])
"""Matrix (6, 5) from the first five components to the six components of a trace-free tensor."""
PLATFORM, LOCAL_LEVEL, STRAPDOWN = range(3)
"""Indices of :data:`INSTRUMENTS`, for compiled code."""


@inlined
def inertial_matrix(
    sin_l: float, cos_l: float, sin_a: float, cos_a: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Return the rotation matrix C_in from ENU to inertial axes, row by row.

    The arguments are sine and cosine of the latitude L and of the angle λ + ω_ie t, with the
    longitude λ (Wang et al. 2013, eq. 10).
    """
    return (
        -sin_a, -sin_l * cos_a, cos_l * cos_a,
        cos_a, -sin_l * sin_a, cos_l * sin_a,
        like(sin_l, 0.0), cos_l, sin_l,
    )  # fmt: skip


def inertial_from_local(positions: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the rotation matrices C_in (..., 3, 3) from ENU to inertial axes.

    The formula is eq. 10 of Wang et al. 2013.

    Parameters
    ----------
    positions : (..., 3) latitude, longitude [rad], height [m].
    times : (...) time since the inertial frame coincided with ECEF [s].
    """
    found = np.empty((*positions.shape[:-1], 3, 3))
    angles = positions[..., 1] + ROTATION_RATE * times
    _fill_inertial(positions[..., 0].ravel(), angles.ravel(), found.reshape(-1, 9))
    return found


@compiled
def _fill_inertial(latitudes: np.ndarray, angles: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (N, 9) with C_in for latitudes L (N,) and angles λ + ω_ie t (N,)."""
    for k in range(latitudes.shape[0]):
        sine, cosine = math.sin(latitudes[k]), math.cos(latitudes[k])
        c = inertial_matrix(sine, cosine, math.sin(angles[k]), math.cos(angles[k]))
        for i in range(9):
            out[k, i] = c[i]


@inlined
def rotated(
    c: tuple[float, ...], t: tuple[float, ...]
) -> tuple[float, float, float, float, float, float]:
    """Return vec6(C M Cᵀ) of the symmetric tensor t = vec6(M).

    vec6 is [xx, xy, xz, yy, yz, zz], and ``c`` contains the nine elements of C, row by row. In Wang
    et al. 2013 the function is D6(C) vec6(M).
    """
    x_0 = c[0] * t[0] + c[1] * t[1] + c[2] * t[2]
    x_1 = c[0] * t[1] + c[1] * t[3] + c[2] * t[4]
    x_2 = c[0] * t[2] + c[1] * t[4] + c[2] * t[5]
    y_0 = c[3] * t[0] + c[4] * t[1] + c[5] * t[2]
    y_1 = c[3] * t[1] + c[4] * t[3] + c[5] * t[4]
    y_2 = c[3] * t[2] + c[4] * t[4] + c[5] * t[5]
    z_0 = c[6] * t[0] + c[7] * t[1] + c[8] * t[2]
    z_1 = c[6] * t[1] + c[7] * t[3] + c[8] * t[4]
    z_2 = c[6] * t[2] + c[7] * t[4] + c[8] * t[5]
    return (
        x_0 * c[0] + x_1 * c[1] + x_2 * c[2],
        x_0 * c[3] + x_1 * c[4] + x_2 * c[5],
        x_0 * c[6] + x_1 * c[7] + x_2 * c[8],
        y_0 * c[3] + y_1 * c[4] + y_2 * c[5],
        y_0 * c[6] + y_1 * c[7] + y_2 * c[8],
        z_0 * c[6] + z_1 * c[7] + z_2 * c[8],
    )


def rotate_tensors(rotations: np.ndarray, tensors: np.ndarray) -> np.ndarray:
    """Return tensors (..., 6), rotated by matrices C (..., 3, 3): vec6(C M Cᵀ)."""
    every = np.ascontiguousarray(np.broadcast_to(rotations, (*tensors.shape[:-1], 3, 3)))
    found = np.empty(tensors.shape)
    _rotate(every.reshape(-1, 9), tensors.reshape(-1, 6), found.reshape(-1, 6))
    return found


@compiled
def _rotate(rotations: np.ndarray, tensors: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (N, 6) with tensors (N, 6), rotated by matrices C (N, 9)."""
    for k in range(tensors.shape[0]):
        r, t = rotations[k], tensors[k]
        c = (r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8])
        turned = rotated(c, (t[0], t[1], t[2], t[3], t[4], t[5]))
        for i in range(6):
            out[k, i] = turned[i]


@inlined
def turn_of(
    t: tuple[float, ...], x: float, y: float, z: float
) -> tuple[float, float, float, float, float, float]:
    """Return vec6([φ×] M − M [φ×]) for t = vec6(M) and the small rotation φ = (x, y, z) [rad].

    Eq. 12 of Wang et al. 2013 denotes the result by (∂L_φ/∂φ) φ. vec6 is [xx, xy, xz, yy, yz, zz].
    """
    return (
        2.0 * (t[2] * y - t[1] * z),
        t[4] * y - t[2] * x + (t[0] - t[3]) * z,
        t[1] * x + (t[5] - t[0]) * y - t[4] * z,
        2.0 * (t[1] * z - t[4] * x),
        (t[3] - t[5]) * x - t[1] * y + t[2] * z,
        2.0 * (t[4] * x - t[2] * y),
    )


@inlined
def sum_of(
    one: tuple[float, ...], two: tuple[float, ...]
) -> tuple[float, float, float, float, float, float]:
    """Return the sum of two symmetric tensors [xx, xy, xz, yy, yz, zz]."""
    return (
        one[0] + two[0], one[1] + two[1], one[2] + two[2],
        one[3] + two[3], one[4] + two[4], one[5] + two[5],
    )  # fmt: skip


def readings_along(
    instrument: int,
    positions: np.ndarray,
    times: np.ndarray,
    attitudes: np.ndarray,
    field: Field,
) -> np.ndarray:
    """Return the noise-free tensors (..., 6) [E] in mount axes along tracks.

    Outside the map the field at the border is used.

    Parameters
    ----------
    instrument : index of :data:`INSTRUMENTS`.
    positions, times : (..., 3), (...) positions and times, as in :func:`readings`.
    attitudes : (..., 3, 3) C_nb, needed only for a strapdown instrument.
    field : the gradient field.
    """
    tensors = field.continued_tensor(positions)
    if instrument == PLATFORM:
        return rotate_tensors(inertial_from_local(positions, times), tensors)
    if instrument == STRAPDOWN:
        return rotate_tensors(np.swapaxes(attitudes, -1, -2), tensors)
    return tensors


def readings(
    field: Field,
    positions: np.ndarray,
    times: np.ndarray,
    attitudes: np.ndarray | None = None,
    instrument: str = "platform",
) -> np.ndarray:
    """Return noise-free tensors (K, 6) [E] in mount axes along a track.

    Parameters
    ----------
    field : the gradient field.
    positions : (K, 3) geodetic latitude, longitude [rad], height [m].
    times : (K,) time since the inertial frame coincided with ECEF [s].
    attitudes : (K, 3, 3) C_nb, needed only for a strapdown instrument.
    instrument : one of :data:`INSTRUMENTS`.

    Raises
    ------
    OutsideMapError
        If a position lies outside the map; the message states the position and the bounds of the
        map.
    """
    field.require_inside(positions)
    attitudes = np.eye(3) if attitudes is None else attitudes
    return readings_along(INSTRUMENTS.index(instrument), positions, times, attitudes, field)


@dataclass(frozen=True)
class Gradiometer:
    """Gradiometer as assumed by estimators; σ denotes a standard deviation.

    Attributes
    ----------
    noise_eotvos : RMS noise of each channel, before the low-pass filter [E].
    lowpass : low-pass filter of the instrument; None without a filter.
    components : names of the channels.
    instrument : kind of mount, one of :data:`INSTRUMENTS`.
    bias_eotvos : σ of the initial bias of each channel [E].
    drift : root PSD of the random walk of each bias [E/√s].
    noise_behind_filter : RMS white noise of each channel after the filter [E].
    latency : time from a measurement to its time stamp [s].
    period : time between two measurements [s].
    treatment : compensation of the filter in the measurement model, see :mod:`.lowpass`.
    regularisation : smallest noise after the filter that the compensation assumes, in units of the
        noise before the filter.
    colour : model of coloured noise, or None; with a model, ``noise_eotvos`` is the RMS of the
        coloured noise over the channels.
    mounting_sigma : σ of the constant rotation error of the mount about each axis [rad].
    """

    noise_eotvos: float
    lowpass: LowPass | None
    components: tuple[str, ...] = COMPONENTS
    instrument: str = "platform"
    bias_eotvos: float = 0.0
    drift: float = 0.0
    noise_behind_filter: float = 0.0
    latency: float = 0.0
    period: float = 1.0
    treatment: Treatment = "whitened"
    regularisation: float = 1e-2
    colour: VectorAutoregression | None = None
    mounting_sigma: float = 0.0

    @property
    def channels(self) -> np.ndarray:
        """Rows (m, 6) that map the tensor in mount axes to the channels."""
        return np.array([channel(name) for name in self.components]).reshape(-1, 6)

    @property
    def whole(self) -> bool:
        """Whether the channels determine all five independent components of the tensor."""
        return int(np.linalg.matrix_rank(self.channels @ _TRACELESS)) == 5

    def tensors(self, readings: np.ndarray) -> np.ndarray:
        """Return trace-free tensors (..., 6) [E] from measurements (..., m) by least squares.

        Tensors are in mount axes. The channels must determine the whole tensor, see :attr:`whole`.
        """
        return np.asarray(readings @ (_TRACELESS @ np.linalg.pinv(self.channels @ _TRACELESS)).T)

    def noise(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Return random noise (count, m) of the channels before the filter [E]."""
        if self.colour is not None:
            return self.colour.simulate(self._white(count, rng))
        return self.noise_eotvos * self._white(count, rng)

    def noise_behind(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Return random white noise (count, m) of the channels after the filter [E]."""
        return self.noise_behind_filter * self._white(count, rng)

    def _white(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Return standard normal numbers (count, m) for the channels.

        Numbers are drawn for all possible channels. Therefore a channel has the same noise in every
        selection of channels.
        """
        groups = (COMPONENTS, DIFFERENCES)
        draws = np.hstack([rng.standard_normal((count, len(group))) for group in groups])
        names = [name for group in groups for name in group]
        chosen = [names.index(name) for name in self.components]
        return np.asarray(draws[:, chosen])

    @property
    def biased(self) -> bool:
        """Whether the channels have biases as states."""
        return self.bias_eotvos > 0.0 or self.drift > 0.0


def channel(name: str) -> np.ndarray:
    """Return the row (6,) that maps a tensor to the channel ``name``."""
    row = np.zeros(6)
    plus, _, minus = name.partition("-")
    row[COMPONENTS.index(plus)] = 0.5 if minus else 1.0
    if minus:
        row[COMPONENTS.index(minus)] = -0.5
    return row


def noise_rms(root_psd: float, rate_hz: float) -> float:
    """Return the RMS noise √(D² f / 2) [E] of a noise density D [E/√Hz] at an update rate f [Hz].

    The formula is eq. 1 of Wang et al. 2013.
    """
    return math.sqrt(root_psd**2 * rate_hz / 2.0)


def parse_components(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of channels in the standard order."""
    return tuple(name for name in (*COMPONENTS, *DIFFERENCES) if name in names)
