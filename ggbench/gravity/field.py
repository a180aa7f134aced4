"""Gravity-gradient tensor at a point: normal field plus disturbing field of a map.

A :class:`Field` interpolates a :class:`~.gradient_map.GradientMap` by a tensor-product cubic
B-spline in latitude, longitude and height (:mod:`.spline`) and adds the exact normal field.

Tensor components are ordered [EE, EN, EU, NN, NU, UU] (east, north, up), in E. Derivatives are per
metre to the east, to the north and upwards, in axes that move with the point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GGBenchError
from ..numerics.frozen import freeze_arrays
from ..numerics.kernels import compiled, inlined
from ..numerics.records import record
from .ellipsoid import (
    metres_per_radian_of,
    normal_gradient_of,
    normal_gradient_slopes_of,
)
from .gradient_map import GradientMap, unknown
from .spline import (
    TENSOR_WORK,
    spline_coefficients,
    spline_tensor_slopes,
    spline_tensors,
    surface_heights,
    vector_at,
)


class OutsideMapError(GGBenchError):
    """A position lies outside the gradient map."""


@record
class DisturbanceMap:
    """Gravity disturbance of a map as arrays for compiled kernels.

    :class:`Field` describes the arrays. ``coefficients`` are its ``disturbance_coefficients``, and
    ``base`` are its ``base_coefficients``.
    """

    origin: np.ndarray
    step: np.ndarray
    coefficients: np.ndarray
    base: np.ndarray


Tensor = tuple[float, float, float, float, float, float]
"""The six tensor components; each is a number, or a vector with the values of eight runs."""


@inlined
def gradient_of(
    sine: float,
    cosine: float,
    height: float,
    values: Tensor,
    along: tuple[Tensor, Tensor, Tensor],
) -> tuple[Tensor, tuple[Tensor, Tensor, Tensor], float, float]:
    """Return the full tensor [E], its derivatives [E/m], and metres per radian of L and λ.

    The full tensor is normal field plus disturbing field. The derivatives are to the east, to the
    north and upwards. Metres per radian are those of :func:`.metres_per_radian_of`.

    Parameters
    ----------
    sine, cosine : sine and cosine of the latitude.
    height : height above the ellipsoid [m].
    values : disturbing tensor [E].
    along : derivatives of ``values`` with respect to latitude, longitude [E/rad] and height [E/m].
    """
    ee, nn, nu, uu = normal_gradient_of(sine, cosine, height)
    slopes = normal_gradient_slopes_of(sine, cosine, height)
    north, east = metres_per_radian_of(sine, cosine, height)
    per_north, per_east = 1.0 / north, 1.0 / east
    a, o, h = along
    return (
        (values[0] + ee, values[1], values[2], values[3] + nn, values[4] + nu, values[5] + uu),
        (
            (
                per_east * o[0], per_east * o[1], per_east * o[2],
                per_east * o[3], per_east * o[4], per_east * o[5],
            ),
            (
                per_north * a[0] + slopes[0], per_north * a[1], per_north * a[2],
                per_north * a[3] + slopes[1], per_north * a[4] + slopes[2],
                per_north * a[5] + slopes[3],
            ),
            (
                h[0] + slopes[4], h[1], h[2],
                h[3] + slopes[5], h[4] + slopes[6], h[5] + slopes[7],
            ),
        ),
        north,
        east,
    )  # fmt: skip


@compiled
def gradients_and_slopes(
    positions: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    base: np.ndarray,
    values: np.ndarray,
    derivatives: np.ndarray,
) -> None:
    """Fill ``values`` (N, 6) with tensors [E] and ``derivatives`` (N, 6, 3) with slopes [E/m].

    The tensors are the normal plus the disturbing field. The last axis of the derivatives is east,
    north, up. ``positions`` (N, 3) are latitude, longitude [rad] and height [m]. ``origin``,
    ``step``, ``coefficients`` and ``base`` are the map, as in :func:`.vector_at`, but with six
    components. ``coefficients`` of size zero mean the normal field alone.
    """
    s, work = np.zeros(24), np.empty(TENSOR_WORK)
    for n in range(positions.shape[0]):
        if coefficients.size > 0:
            spline_tensor_slopes(
                positions=positions[n].reshape((3, 1)),
                count=1,
                origin=origin,
                step=step,
                coefficients=coefficients,
                base=base,
                work=work,
                out=s.reshape((24, 1)),
            )
        full, slopes, _, _ = gradient_of(
            math.sin(positions[n, 0]), math.cos(positions[n, 0]), positions[n, 2],
            (s[0], s[1], s[2], s[3], s[4], s[5]),
            (
                (s[6], s[9], s[12], s[15], s[18], s[21]),
                (s[7], s[10], s[13], s[16], s[19], s[22]),
                (s[8], s[11], s[14], s[17], s[20], s[23]),
            ),
        )  # fmt: skip
        for m in range(6):
            values[n, m] = full[m]
            for axis in range(3):
                derivatives[n, m, axis] = slopes[axis][m]


@compiled
def gradients(
    positions: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    base: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill ``out`` (6, N) with the full tensors [E] at N points, without derivatives.

    Parameters
    ----------
    positions : (3, N) latitudes, longitudes [rad], heights [m].
    origin, step, coefficients, base : the map, as in :func:`.vector_at`; ``coefficients`` of size
        zero mean the normal field alone.
    out : (6, N) output; NaN at NaN positions.
    """
    count = positions.shape[1]
    if coefficients.size == 0:
        out[:, :] = 0.0
    else:
        spline_tensors(
            positions=positions,
            count=count,
            origin=origin,
            step=step,
            coefficients=coefficients,
            base=base,
            out=out,
        )
    for p in range(count):
        sine, cosine = math.sin(positions[0, p]), math.cos(positions[0, p])
        ee, nn, nu, uu = normal_gradient_of(sine, cosine, positions[2, p])
        out[0, p] += ee
        out[3, p] += nn
        out[4, p] += nu
        out[5, p] += uu


@compiled
def _vectors_at(
    positions: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    base: np.ndarray,
    values: np.ndarray,
) -> None:
    """Fill ``values`` (n, 3) with a spline of three components at positions (n, 3)."""
    derivative = np.empty((coefficients.shape[3], 3))
    for n in range(positions.shape[0]):
        vector_at(
            position=positions[n],
            origin=origin,
            step=step,
            coefficients=coefficients,
            base=base,
            value=values[n],
            derivative=derivative,
        )


_ROUNDING = 5e-7
"""Tolerance for rounding of positions at the border of a map [node spacings]."""


@dataclass(frozen=True, eq=False)
class Field:
    """The Earth's gravity-gradient field in the area of a scenario.

    Attributes
    ----------
    origin, step : (3,) first node and spacing of the map in latitude, longitude [rad], height [m];
        of a draped map the third coordinate is the height above its base surface.
    tensor_coefficients : (n_lat + 2, n_lon + 2, n_h + 2, 6) B-spline coefficients [E] of a map with
        n_lat x n_lon x n_h nodes; size 0 for no map.
    disturbance_coefficients : (n_lat + 2, n_lon + 2, n_h + 2, 3) B-spline coefficients of the
        gravity disturbance vector, ENU [m/s²].
    constant_disturbance : (3,) vector added to the gravity disturbance everywhere, ENU [m/s²].
    standard_error : (9,) standard errors of tensor [E] and gravity disturbance [m/s²], as stated by
        the map; NaN: unknown.
    base_coefficients : (n_lat + 2, n_lon + 2) B-spline coefficients of the base surface of a draped
        map [m]; size 0 for level layers.
    """

    origin: np.ndarray
    step: np.ndarray
    tensor_coefficients: np.ndarray
    disturbance_coefficients: np.ndarray
    constant_disturbance: np.ndarray = field(default_factory=lambda: np.zeros(3))
    standard_error: np.ndarray = field(default_factory=unknown)
    base_coefficients: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @classmethod
    def normal(cls) -> Field:
        """Return the normal field of WGS84 alone (no map, valid everywhere)."""
        nothing = np.zeros((0, 0, 0, 6))
        return cls(np.zeros(3), np.ones(3), nothing, nothing[..., :3])

    @classmethod
    def from_map(cls, gradient_map: GradientMap) -> Field:
        """Return the normal field plus the disturbing field of a map."""
        tensor, disturbance = gradient_map.tensor, gradient_map.gravity_disturbance
        for axis in range(3):
            tensor = spline_coefficients(tensor, axis)
            disturbance = spline_coefficients(disturbance, axis)
        base = np.zeros((0, 0))
        if gradient_map.base is not None:
            base = spline_coefficients(spline_coefficients(gradient_map.base, 0), 1)
        return cls(
            np.array([gradient_map.latitude0, gradient_map.longitude0, gradient_map.height0]),
            np.array(
                [gradient_map.latitude_step, gradient_map.longitude_step, gradient_map.height_step]
            ),
            tensor,
            disturbance,
            standard_error=gradient_map.standard_error,
            base_coefficients=base,
        )

    @property
    def has_map(self) -> bool:
        """Whether a disturbing field is added to the normal field."""
        return self.tensor_coefficients.size > 0

    @property
    def disturbance_map(self) -> DisturbanceMap:
        """Gravity disturbance of the map as arrays for kernels; of size zero without a map."""
        return DisturbanceMap(
            self.origin, self.step, self.disturbance_coefficients, self.base_coefficients
        )

    @property
    def lower(self) -> np.ndarray:
        """First node (3,) of the map [rad, rad, m]; −∞ without a map.

        The node is in map coordinates, see :meth:`coordinates`.
        """
        return self.origin if self.has_map else np.full(3, -np.inf)

    @property
    def upper(self) -> np.ndarray:
        """Last node (3,) of the map [rad, rad, m]; ∞ without a map.

        The node is in map coordinates, see :meth:`coordinates`.
        """
        if not self.has_map:
            return np.full(3, np.inf)
        cells = np.array(self.tensor_coefficients.shape[:3]) - 3
        return self.origin + cells * self.step

    @property
    def is_draped(self) -> bool:
        """Whether the third map coordinate is the height above a base surface (draped map)."""
        return self.base_coefficients.size > 0

    def base(self, positions: np.ndarray) -> np.ndarray:
        """Return the height (...) [m] of the base surface at positions (..., 3); 0 for level maps.

        Positions are latitude, longitude [rad], height [m]. Outside the map the height at the
        border is used.
        """
        heights = np.zeros(positions.shape[:-1])
        if self.is_draped:
            points = np.ascontiguousarray(positions.reshape(-1, 3))
            surface_heights(
                points, self.origin, self.step, self.base_coefficients, heights.reshape(-1)
            )
        return heights

    def coordinates(self, positions: np.ndarray) -> np.ndarray:
        """Return positions (..., 3) [rad, rad, m] in map coordinates.

        The third map coordinate is the height above the base surface for a draped map, and above
        the ellipsoid for other maps.
        """
        if not self.is_draped:
            return positions
        coordinates = np.array(positions, dtype=float)
        coordinates[..., 2] -= self.base(coordinates)
        return coordinates

    def over_nodes(
        self, latitude: ArrayLike, longitude: ArrayLike, third: ArrayLike
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Convert map coordinates to latitude, longitude [rad] and ellipsoidal height [m].

        The shapes of the arguments broadcast to (...), which is the shape of each result.

        Parameters
        ----------
        latitude, longitude : latitudes and longitudes [rad].
        third : height [m] above the base surface, or above the ellipsoid if the map has no base.
        """
        axes = np.broadcast_arrays(*(np.asarray(a, float) for a in (latitude, longitude, third)))
        positions = np.stack(axes, axis=-1)
        return positions[..., 0], positions[..., 1], positions[..., 2] + self.base(positions)

    def flattened(self) -> Field:
        """Return the field of the same map data, with level layers.

        Numbers that were heights above the base surface are then heights above the ellipsoid.
        """
        return replace(self, base_coefficients=np.zeros((0, 0)))

    def covers(self, positions: np.ndarray, slack: float) -> np.ndarray:
        """Return a mask (...) of the positions (..., 3) within the map; True without a map.

        ``slack`` is a tolerance outside the border, in units of the distance between nodes.
        """
        if not self.has_map:
            return np.ones(positions.shape[:-1], dtype=bool)
        room = slack * self.step
        positions = self.coordinates(positions)
        inside = (self.origin - room <= positions) & (positions <= self.upper + room)
        return np.asarray(inside.all(axis=-1))

    def tensor(self, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike) -> np.ndarray:
        """Return the gradient tensor (..., 6) [E] at geodetic positions [rad, rad, m].

        The shapes of the arguments broadcast to (...).

        Raises OutsideMapError if a position lies outside the map; the message states the position
        and the bounds of the map.
        """
        positions, shape = self._positions(latitude, longitude, height)
        self.require_inside(positions)
        return self.continued_tensor(positions).reshape(*shape, 6)

    def continued_tensor(self, positions: np.ndarray) -> np.ndarray:
        """Return the tensor (..., 6) [E] at positions (..., 3) [rad, rad, m], also outside the map.

        Outside the map the disturbing field at the border is used.
        """
        tensor = np.empty((6, math.prod(positions.shape[:-1])))
        gradients(
            np.ascontiguousarray(positions.reshape(-1, 3).T), self.origin, self.step,
            self.tensor_coefficients, self.base_coefficients, tensor,
        )  # fmt: skip
        return np.ascontiguousarray(tensor.T).reshape(*positions.shape[:-1], 6)

    def tensor_and_derivative(
        self, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the tensor (..., 6) [E] and its derivative (..., 6, 3) [E/m east, north, up].

        Raises OutsideMapError if a position lies outside the map; the message states the position
        and the bounds of the map.
        """
        positions, shape = self._positions(latitude, longitude, height)
        values = np.empty((len(positions), 6))
        derivatives = np.empty((len(positions), 6, 3))
        self.require_inside(positions)
        gradients_and_slopes(
            positions=positions,
            origin=self.origin,
            step=self.step,
            coefficients=self.tensor_coefficients,
            base=self.base_coefficients,
            values=values,
            derivatives=derivatives,
        )
        return values.reshape(*shape, 6), derivatives.reshape(*shape, 6, 3)

    def vertical_disturbance(
        self, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike
    ) -> np.ndarray:
        """Return Γ_UU (...) [E] of the map's disturbing field, without the normal field.

        Parameters
        ----------
        latitude, longitude, height : [rad, rad, m], of shapes that broadcast to (...).

        Raises OutsideMapError if a position lies outside the map.
        """
        normal = Field.normal().tensor(latitude, longitude, height)
        return np.asarray((self.tensor(latitude, longitude, height) - normal)[..., 5])

    def gravity_disturbance(
        self, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike
    ) -> np.ndarray:
        """Return the gravity disturbance vector (..., 3), ENU [m/s²].

        It is the sum of the map's disturbance and ``constant_disturbance``. Latitude, longitude
        [rad] and height [m] have shapes that broadcast to (...).

        Raises OutsideMapError if a position lies outside the map.
        """
        positions, shape = self._positions(latitude, longitude, height)
        values = np.zeros((len(positions), 3))
        if self.has_map:
            self.require_inside(positions)
            _vectors_at(
                positions, self.origin, self.step, self.disturbance_coefficients,
                self.base_coefficients, values,
            )  # fmt: skip
        return (values + self.constant_disturbance).reshape(*shape, 3)

    @staticmethod
    def _positions(
        latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike
    ) -> tuple[np.ndarray, tuple[int, ...]]:
        axes = np.broadcast_arrays(*(np.asarray(a, float) for a in (latitude, longitude, height)))
        return np.stack([axis.ravel() for axis in axes], axis=-1), axes[0].shape

    def require_inside(self, positions: np.ndarray) -> None:
        """Raise OutsideMapError if a position (n, 3) [rad, rad, m] lies outside the map."""
        inside = self.covers(positions, _ROUNDING)
        if inside.all():
            return
        lower, upper = self.origin.copy(), self.upper
        at = int(np.argmin(inside))
        point = positions[at].copy()
        for corner in (lower, upper, point):
            corner[:2] = np.degrees(corner[:2])
        above = ""
        if self.is_draped:
            base = float(self.base(positions[at]))
            above = f" above its base surface, which lies at {base:.0f} m there"
        raise OutsideMapError(
            f"position {point[0]:.5f}° N, {point[1]:.5f}° E, {point[2]:.0f} m is outside the "
            f"gradient map, which covers {lower[0]:.3f}° to {upper[0]:.3f}° N, "
            f"{lower[1]:.3f}° to {upper[1]:.3f}° E, {lower[2]:.0f} to {upper[2]:.0f} m{above}"
        )
