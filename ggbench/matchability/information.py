"""Position information in measurements of a field: Fisher information and ambiguity.

The instrument has local-level axes and white noise. The vector h contains the noise-free
measurements in units of the noise standard deviation. H contains the derivatives of h with respect
to displacements in metres to the east and to the north.
Height, velocity and attitude are assumed known, so the results depend only on position and track.
The error bound of a simulated flight does not make this assumption.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter
from scipy.special import ndtr

from ..gravity.ellipsoid import metres_along, normal_gravity_along
from ..gravity.field import Field
from ..gravity.gradient_map import MapError

Array = NDArray[np.float64]
Kind = Literal["tensor", "uu", "gravity"]
KINDS: tuple[Kind, ...] = ("tensor", "uu", "gravity")
MGAL = 1e5
"""Number of mGal in 1 m/s²."""
_ROUNDING = 1e-9
_DIRECTIONS = 720
"""Number of directions over half a turn in an average."""
_APART_M = 20.0
"""Half the step [m] of central differences of gravity; a map's spline is smooth over it."""


@dataclass(frozen=True)
class Instrument:
    """Instrument that measures the field.

    Attributes
    ----------
    kind : ``tensor`` for all six tensor components, ``uu`` for the vertical gradient, ``gravity``
        for a gravimeter.
    noise : noise standard deviation of each channel [E; for a gravimeter mGal].
    """

    kind: Kind = "tensor"
    noise: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise MapError(f"an instrument is one of {', '.join(KINDS)}, and not {self.kind!r}")
        if not 0.0 < self.noise < np.inf:
            raise MapError(f"a noise must be positive and finite, and is {self.noise:g}")

    @property
    def unit(self) -> str:
        """Unit of the measurements: E or mGal."""
        return "mGal" if self.kind == "gravity" else "E"

    def readings(self, field: Field, positions: Array) -> Array:
        """Return the noise-free measurements h (N, c) at positions (N, 3) [rad, rad, m].

        They are in units of the noise standard deviation. c is the number of channels. The
        measurement of a gravimeter is normal gravity minus the upward component of the gravity
        disturbance.

        Raises
        ------
        OutsideMapError
            If a position of a gravimeter is outside the map. For a gradiometer, values at the
            border are used outside the map.
        """
        if self.kind == "gravity":
            disturbance = field.gravity_disturbance(*positions.T)[:, 2:]
            gravity = normal_gravity_along(positions)[:, np.newaxis] - disturbance
            return np.asarray(gravity * (MGAL / self.noise))
        tensors = field.continued_tensor(positions) / self.noise
        return tensors[:, 5:] if self.kind == "uu" else tensors

    def jacobians(self, field: Field, positions: Array) -> Array:
        """Return the derivatives H (N, c, 2) [1/m] of h at positions (N, 3) [rad, rad, m].

        They are derivatives with respect to displacements to the east and to the north. The
        measurements h of c channels are those of :meth:`readings`.

        Raises
        ------
        OutsideMapError
            If a position is outside the map.
        """
        if self.kind == "gravity":
            sides = [
                self.readings(field, moved(positions, _APART_M * axis))
                - self.readings(field, moved(positions, -_APART_M * axis))
                for axis in np.eye(2)
            ]
            return np.stack(sides, axis=-1) / (2.0 * _APART_M)
        slopes = field.tensor_and_derivative(*positions.T)[1][:, :, :2] / self.noise
        return slopes[:, 5:] if self.kind == "uu" else slopes


def moved(positions: Array, offset: Array) -> Array:
    """Return positions (..., 3), displaced by offsets (..., 2) [m] to the east and to the north."""
    metres = metres_along(positions.reshape(-1, 3)).reshape(*positions.shape[:-1], 2)
    angles = offset / metres
    out = np.empty((*np.broadcast_shapes(angles.shape[:-1], positions.shape[:-1]), 3))
    out[...] = positions
    out[..., 1::-1] += angles
    return out


def information(jacobians: Array) -> Array:
    """Return the Fisher information J = Σ HᵀH (2, 2) [1/m²] on the horizontal position.

    The sum is over N positions. ``jacobians`` contains H (N, c, 2) of c channels, see
    :meth:`Instrument.jacobians`.
    """
    rows = jacobians.reshape(-1, 2)
    return np.asarray(rows.T @ rows)


def accuracy(info: Array) -> float:
    """Return the Cramér–Rao bound √tr J⁻¹ [m] of the position; ∞ for a singular J (2, 2).

    J is the Fisher information on the horizontal position.
    """
    determinant = float(np.linalg.det(info))
    return float(np.sqrt(np.trace(info) / determinant)) if determinant > 0.0 else np.inf


def isotropy(info: Array) -> float:
    """Return the ratio λ_min / λ_max of the eigenvalues of the Fisher information J (2, 2).

    The ratio is 1 for isotropic information, 0 if one direction is unobservable, and NaN for J = 0.
    """
    low, high = np.linalg.eigvalsh(info)
    return float(low / high) if high > 0.0 else np.nan


def offsets(reach_m: float, step_m: float) -> Array:
    """Return a square grid (s, s, 2) of offsets to the east and north [m], centred at zero.

    Neighbours are ``step_m`` apart. The largest offset along an axis is ``reach_m``, rounded up to
    a multiple of ``step_m``.
    """
    side = np.arange(-np.ceil(reach_m / step_m), np.ceil(reach_m / step_m) + 1) * step_m
    return np.stack(np.meshgrid(side, side), axis=-1)


def ambiguity(field: Field, instrument: Instrument, track: Array, grid: Array) -> Array:
    """Return the ambiguity A(d) = ½ Σ ‖h(p) − h(p + d)‖² of a track, for each offset d.

    The sum is over the positions p of ``track`` (N, 3) [rad, rad, m]. h(p) contains the noise-free
    measurements at p, in units of the noise. ``grid`` (s, s, 2) contains the offsets d [m]. The
    shape of the result is (s, s).

    A(d) is the expected difference of the log likelihoods of the true track and the track displaced
    by d. It is NaN where |d| exceeds the largest offset along an axis (the corners of the grid) and
    where the displaced track leaves the map.
    """
    flat = grid.reshape(-1, 2)
    distances = np.full(len(flat), np.nan)
    near = np.flatnonzero(np.hypot(*flat.T) <= grid.max() * (1.0 + _ROUNDING))
    places = moved(track[np.newaxis], flat[near, np.newaxis])
    inside = field.covers(places, _ROUNDING).all(axis=1)
    at_track = instrument.readings(field, track)
    there = instrument.readings(field, places[inside].reshape(-1, 3))
    apart = there.reshape(-1, *at_track.shape) - at_track
    distances[near[inside]] = 0.5 * np.sum(apart**2, axis=(1, 2))
    return distances.reshape(grid.shape[:2])


def least(ambiguities: Array, grid: Array, right_m: float, reach_m: float) -> float:
    """Return A_min, the smallest ambiguity A(d) of the offsets d with r₀ < |d| ≤ ``reach_m``.

    The result is NaN if A is NaN at all these offsets, or if there are none.

    Parameters
    ----------
    ambiguities : (s, s) ambiguity A at each offset, see :func:`ambiguity`.
    grid : (s, s, 2) offsets d [m].
    right_m : r₀, largest error of a correct fix [m].
    reach_m : largest offset [m].
    """
    beyond = ambiguities[_ring(grid, right_m, reach_m) & ~np.isnan(ambiguities)]
    return float(beyond.min()) if beyond.size else np.nan


def false_fix_bound(
    ambiguities: Array, grid: Array, right_m: float, reach_m: float, sigma_m: float = np.inf
) -> float:
    """Return the union bound Σ Q(√(A(d)/2)) on the probability of a false fix, at most 1.

    A(d) is the ambiguity of the offset d, see :func:`ambiguity`. Q is the tail probability of the
    standard normal distribution. The measurements of the true and the displaced track differ by
    √(2A) standard deviations. The wrong track is more likely if the noise exceeds half this
    distance. The sum is over the local minima of A with r₀ < |d| ≤ ``reach_m``.

    Parameters
    ----------
    ambiguities : (s, s) ambiguity A at each offset.
    grid : (s, s, 2) offsets d [m].
    right_m : r₀, largest error of a correct fix [m].
    reach_m : largest offset [m].
    sigma_m : standard deviation σ of the position prior, per axis; it adds |d|²/2σ² to A. ∞: no
        prior.
    """
    total = ambiguities + np.sum(grid**2, axis=-1) / (2.0 * sigma_m**2)
    total = np.where(np.isnan(total), np.inf, total)
    basins = (total == minimum_filter(total, size=3, mode="constant", cval=np.inf)) & (
        _ring(grid, right_m, reach_m) & np.isfinite(total)
    )
    return float(min(1.0, np.sum(ndtr(-np.sqrt(0.5 * total[basins])))))


def spill(info: Array, right_m: float, sigma_m: float = np.inf) -> float:
    """Return the probability that a fix near the correct minimum has an error above r₀.

    The result is P(|e| > r₀) for an error e ~ N(0, (J + I/σ²)⁻¹). r₀ is ``right_m``, the largest
    error of a correct fix [m]. J is the Fisher information ``info`` (2, 2), and σ is the standard
    deviation ``sigma_m`` of the prior, per axis [m].
    :func:`false_fix_bound` does not include these fixes, which are frequent if J is small.
    """
    inverse = info + np.eye(2) / sigma_m**2
    if np.linalg.det(inverse) <= 0.0:
        return 1.0
    angle = np.arange(_DIRECTIONS) * (np.pi / _DIRECTIONS)
    along = np.stack([np.cos(angle), np.sin(angle)])
    q = np.einsum("in,ij,jn->n", along, inverse, along)
    return float(np.sqrt(np.linalg.det(inverse)) * np.mean(np.exp(-0.5 * right_m**2 * q) / q))


def _ring(grid: Array, right_m: float, reach_m: float) -> NDArray[np.bool_]:
    distance = np.hypot(grid[..., 0], grid[..., 1])
    return np.asarray((right_m < distance) & (distance <= reach_m))
