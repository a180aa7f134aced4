"""The gravity-gradient tensor at a point: normal field plus a map of the disturbing field.

A :class:`Field` interpolates a :class:`~.gradient_map.GradientMap` by a tensor-product cubic
B-spline in latitude, longitude and height (not-a-knot ends) and adds the exact normal field. The
compiled point kernels below are the only implementation: simulation, h and H all call them.

Tensor components are ordered [EE, EN, EU, NN, NU, UU] (x = east, y = north, z = up), in E;
derivatives are for a displacement of one metre east, north and up, with axes that move along.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_banded

from ..errors import GGBenchError
from ..numerics.frozen import frozen
from ..numerics.kernels import LANES, compiled, copied, inlined
from .ellipsoid import metres_per_radian_of, normal_gradient_at, normal_gradient_of
from .gradient_map import GradientMap


class OutsideMapError(GGBenchError):
    """A position lies outside the gradient map."""


def spline_coefficients(values: np.ndarray, axis: int) -> np.ndarray:
    """Return uniform cubic B-spline coefficients that interpolate ``values`` along ``axis``.

    n nodes (n >= 4) give n + 2 coefficients; the two end conditions are not-a-knot (the third
    derivative is continuous across the second and the last but one node).
    """
    data = np.moveaxis(values, axis, 0)
    n = data.shape[0]
    right = np.zeros((n + 2, *data.shape[1:]))
    right[1:-1] = data
    band = np.zeros((9, n + 2))  # LAPACK's band storage, four diagonals on either side

    def put(row: int, column: int, value: float) -> None:
        band[4 + row - column, column] = value

    for offset, weight in enumerate((1.0, -4.0, 6.0, -4.0, 1.0)):
        put(0, offset, weight)
        put(n + 1, n - 3 + offset, weight)
    for row in range(1, n + 1):
        for column, weight in zip(range(row - 1, row + 2), (1 / 6, 4 / 6, 1 / 6), strict=True):
            put(row, column, weight)
    solved = solve_banded((4, 4), band, right.reshape(n + 2, -1))
    return np.ascontiguousarray(np.moveaxis(solved.reshape(right.shape), 0, axis))


@inlined
def _locate(position: float, origin: float, step: float, nodes: int) -> tuple[int, float, bool]:
    """Return the cell along an axis, the place 0 <= t <= 1 in it, and whether the grid has it.

    A position outside is moved to the border; the cell of NaN is −1.
    """
    u = (position - origin) / step
    if math.isnan(u):  # it must not become an index, nor a number
        return -1, math.nan, False
    cells = nodes - 3
    clamped = min(max(u, 0.0), float(cells))
    cell = min(int(clamped), cells - 1)
    # Half a millionth of a cell: a border node computed in another order is inside.
    return cell, clamped - cell, abs(u - clamped) <= 5e-7


@inlined
def _four_weights(t: float) -> tuple[float, float, float, float]:
    """Return the four cubic B-spline weights at 0 <= t <= 1 of a cell."""
    u = 1.0 - t
    return (
        u * u * u * (1.0 / 6.0),
        (4.0 + t * t * (3.0 * t - 6.0)) * (1.0 / 6.0),
        (4.0 + u * u * (3.0 * u - 6.0)) * (1.0 / 6.0),
        t * t * t * (1.0 / 6.0),
    )


@inlined
def _four_slopes(t: float) -> tuple[float, float, float, float]:
    """Return the derivatives of the four weights."""
    u = 1.0 - t
    return -0.5 * u * u, t * (1.5 * t - 2.0), u * (2.0 - 1.5 * u), 0.5 * t * t


@inlined
def _weights(t: float, weight: np.ndarray) -> None:
    """Fill the four weights."""
    weight[0], weight[1], weight[2], weight[3] = _four_weights(t)


@inlined
def _slopes(t: float, slope: np.ndarray) -> None:
    """Fill the derivatives of the four weights."""
    slope[0], slope[1], slope[2], slope[3] = _four_slopes(t)


_UNSIGNED = np.uint64
"""An index that cannot be negative: one that could be would keep a loop from running on vectors."""


@copied
def _sum_columns(
    flat: np.ndarray,
    size: int,
    start: int,
    row: int,
    column: int,
    first: np.ndarray,
    second: np.ndarray,
    out: np.ndarray,
) -> None:
    """Sum the 16 columns of nodes around a cell with the weights ``first`` ⊗ ``second``.

    The four nodes of a column, with all their components, are contiguous, so that ``out`` is one
    sum of ``size`` numbers. ``start`` is where the first column begins in the flat coefficients,
    ``row`` and ``column`` how far it is to the next one along the first and the second axis.
    """
    for a in range(4):
        c_0 = _UNSIGNED(start + a * row)
        c_1, c_2 = c_0 + _UNSIGNED(column), c_0 + _UNSIGNED(2 * column)
        c_3 = c_0 + _UNSIGNED(3 * column)
        w_0, w_1 = first[a] * second[0], first[a] * second[1]
        w_2, w_3 = first[a] * second[2], first[a] * second[3]
        for c in range(_UNSIGNED(size)):
            total = (
                w_0 * flat[c_0 + c] + w_1 * flat[c_1 + c]
                + w_2 * flat[c_2 + c] + w_3 * flat[c_3 + c]
            )  # fmt: skip
            out[c] = total if a == 0 else out[c] + total


@copied
def _sum_columns_and_slopes(
    flat: np.ndarray,
    size: int,
    start: int,
    row: int,
    column: int,
    weights: np.ndarray,
    out: np.ndarray,
    along_first: np.ndarray,
    along_second: np.ndarray,
) -> None:
    """Do :func:`_sum_columns`, and the same for the derivatives along the first two axes.

    ``weights`` (24,): of each axis the four weights and their four derivatives.
    """
    x_0, x_1, x_2, x_3 = weights[8], weights[9], weights[10], weights[11]
    y_0, y_1, y_2, y_3 = weights[12], weights[13], weights[14], weights[15]
    for a in range(4):
        c_0 = _UNSIGNED(start + a * row)
        c_1, c_2 = c_0 + _UNSIGNED(column), c_0 + _UNSIGNED(2 * column)
        c_3 = c_0 + _UNSIGNED(3 * column)
        weight, slope = weights[a], weights[4 + a]
        for c in range(_UNSIGNED(size)):
            f_0, f_1, f_2, f_3 = flat[c_0 + c], flat[c_1 + c], flat[c_2 + c], flat[c_3 + c]
            across = x_0 * f_0 + x_1 * f_1 + x_2 * f_2 + x_3 * f_3
            slope_across = y_0 * f_0 + y_1 * f_1 + y_2 * f_2 + y_3 * f_3
            if a == 0:
                out[c] = weight * across
                along_first[c] = slope * across
                along_second[c] = weight * slope_across
            else:
                out[c] += weight * across
                along_first[c] += slope * across
                along_second[c] += weight * slope_across


@inlined
def _along(columns: np.ndarray, weight: np.ndarray, m: int, count: int) -> float:
    """Return the sum along a column of component ``m`` of ``count``."""
    return (
        weight[0] * columns[m]
        + weight[1] * columns[count + m]
        + weight[2] * columns[2 * count + m]
        + weight[3] * columns[3 * count + m]
    )


@copied
def _spline(
    position: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    out: np.ndarray,
    count: int,
) -> bool:
    """Fill ``out`` (4 count,): the values, then the three derivatives of each; see spline_at."""
    # One piece of memory: to ask for it costs as much as to fill it.
    work = np.empty(24 + 12 * count)
    weights = work[:24]
    start = 0
    inside = True
    for axis in range(3):
        nodes = coefficients.shape[axis]
        cell, t, within = _locate(position[axis], origin[axis], step[axis], nodes)
        if cell < 0:
            out[:] = math.nan
            return False
        start = start * nodes + cell
        _weights(t, weights[8 * axis :])
        slopes = weights[8 * axis + 4 : 8 * axis + 8]
        _slopes(t, slopes)
        scale = 1.0 / step[axis] if within else 0.0
        inside &= within
        for i in range(4):
            slopes[i] *= scale
    column = coefficients.shape[2] * count
    row = coefficients.shape[1] * column
    size = 4 * count
    sums = work[24 : 24 + size]
    along_first, along_second = work[24 + size : 24 + 2 * size], work[24 + 2 * size :]
    _sum_columns_and_slopes(
        coefficients.reshape(-1), size, start * count, row, column,
        weights, sums, along_first, along_second,
    )  # fmt: skip
    vertical, slopes = weights[16:20], weights[20:24]
    for m in range(count):
        out[m] = _along(sums, vertical, m, count)
        out[count + 3 * m] = _along(along_first, vertical, m, count)
        out[count + 3 * m + 1] = _along(along_second, vertical, m, count)
        out[count + 3 * m + 2] = _along(sums, slopes, m, count)
    return inside


@compiled
def spline_tensor_at(
    position: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    out: np.ndarray,
) -> bool:
    """Fill ``out`` (24,): a tensor and the three derivatives of each component; see spline_at."""
    return _spline(position, origin, step, coefficients, out, 6)  # loops of known length


@compiled
def spline_at(
    position: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    value: np.ndarray,
    derivative: np.ndarray,
) -> bool:
    """Evaluate the spline and its derivatives at one (latitude, longitude, height).

    Outside the grid the value at its border is kept and the derivative across it is zero: an
    estimator's trial point must have a number, and this one is continuous.

    Parameters
    ----------
    position, origin, step : (3,) in the units of the grid's three axes.
    coefficients : (n0 + 2, n1 + 2, n2 + 2, m).
    value : (m,) output. derivative : (m, 3) output, per unit of each axis.

    Returns
    -------
    Whether the position lies inside the grid.
    """
    count = coefficients.shape[3]
    out = np.empty(4 * count)
    if count == 6:
        inside = spline_tensor_at(position, origin, step, coefficients, out)
    else:
        inside = _spline(position, origin, step, coefficients, out, count)
    for m in range(count):
        value[m] = out[m]
        for axis in range(3):
            derivative[m, axis] = out[count + 3 * m + axis]
    return inside


@compiled
def spline_lanes(
    places: np.ndarray,
    count: int,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    work: np.ndarray,
    out: np.ndarray,
) -> None:
    """Do :func:`spline_tensor_at` at the places of several runs at once.

    Parameters
    ----------
    places : (3 * LANES,) the run is the last index, as in ``out``. count : how many there are.
    origin, step, coefficients : the map.
    work : (27 * LANES + 96,) scratch.
    out : (24 * LANES,) output: a tensor, and the three derivatives of each component.
    """
    for axis in range(3):
        start, inverse = origin[axis], 1.0 / step[axis]
        cells = float(coefficients.shape[axis] - 3)
        place = places[axis * LANES : (axis + 1) * LANES]
        weights = work[8 * axis * LANES : 8 * (axis + 1) * LANES]
        first = work[(24 + axis) * LANES : (25 + axis) * LANES]
        for r in range(LANES):
            u = (place[r] - start) * inverse
            clamped = min(max(u, 0.0), cells)
            cell = min(math.floor(clamped), cells - 1.0)
            first[r] = cell if cell >= 0.0 else 0.0  # NaN must not become an index
            t = clamped - cell if u == u else u
            within = 1.0 if abs(u - clamped) <= 5e-7 else 0.0
            w, s = _four_weights(t), _four_slopes(t)
            scale = inverse * within
            weights[r], weights[LANES + r] = w[0], w[1]
            weights[2 * LANES + r], weights[3 * LANES + r] = w[2], w[3]
            weights[4 * LANES + r], weights[5 * LANES + r] = scale * s[0], scale * s[1]
            weights[6 * LANES + r], weights[7 * LANES + r] = scale * s[2], scale * s[3]
    flat = coefficients.reshape(-1)
    column = coefficients.shape[2] * 6
    row = coefficients.shape[1] * column
    own = work[27 * LANES : 27 * LANES + 24]
    sums = work[27 * LANES + 24 : 27 * LANES + 48]
    along_first = work[27 * LANES + 48 : 27 * LANES + 72]
    along_second = work[27 * LANES + 72 : 27 * LANES + 96]
    for r in range(count):
        for i in range(24):
            own[i] = work[i * LANES + r]
        i, j = int(work[24 * LANES + r]), int(work[25 * LANES + r])
        k = int(work[26 * LANES + r])
        _sum_columns_and_slopes(
            flat, 24, i * row + j * column + 6 * k, row, column, own,
            sums, along_first, along_second,
        )  # fmt: skip
        w_0, w_1, w_2, w_3 = own[16], own[17], own[18], own[19]
        s_0, s_1, s_2, s_3 = own[20], own[21], own[22], own[23]
        for m in range(6):
            a, b, c, d = sums[m], sums[6 + m], sums[12 + m], sums[18 + m]
            out[m * LANES + r] = w_0 * a + w_1 * b + w_2 * c + w_3 * d
            out[(8 + 3 * m) * LANES + r] = s_0 * a + s_1 * b + s_2 * c + s_3 * d
            out[(6 + 3 * m) * LANES + r] = (
                w_0 * along_first[m] + w_1 * along_first[6 + m]
                + w_2 * along_first[12 + m] + w_3 * along_first[18 + m]
            )  # fmt: skip
            out[(7 + 3 * m) * LANES + r] = (
                w_0 * along_second[m] + w_1 * along_second[6 + m]
                + w_2 * along_second[12 + m] + w_3 * along_second[18 + m]
            )  # fmt: skip


@compiled
def gradient_at(
    position: np.ndarray,
    sine: float,
    cosine: float,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    value: np.ndarray,
    derivative: np.ndarray,
) -> bool:
    """Fill the full tensor (6,) [E] and its derivative (6, 3) [E/m east, north, up] at a point.

    ``sine`` and ``cosine`` are those of its latitude. ``coefficients`` of size zero mean the normal
    field alone. Returns whether the point lies inside the map (always true without one).
    """
    if coefficients.size == 0:
        normal_gradient_at(sine, cosine, position[2], value, derivative)
        return True
    disturbing = np.empty(24)
    inside = spline_tensor_at(position, origin, step, coefficients, disturbing)
    normal_gradient_at(sine, cosine, position[2], value, derivative)
    north, east = metres_per_radian_of(sine, cosine, position[2])
    per_north, per_east = 1.0 / north, 1.0 / east
    for m in range(6):
        value[m] += disturbing[m]
        derivative[m, 0] += disturbing[7 + 3 * m] * per_east
        derivative[m, 1] += disturbing[6 + 3 * m] * per_north
        derivative[m, 2] += disturbing[8 + 3 * m]
    return inside


@compiled
def gradients(
    positions: np.ndarray,
    sines: np.ndarray,
    cosines: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill the full tensors (6, N) [E] at N points: the values of :func:`gradient_at`, faster.

    Parameters
    ----------
    positions : (3, N) latitudes, longitudes [rad], heights [m].
    sines, cosines : (N,) of the latitudes.
    origin, step, coefficients : the map, as in :func:`spline_at`; of size zero for none.
    out : (6, N) output; NaN where a position is.
    """
    ee, en, eu, nn, nu, uu = out[0], out[1], out[2], out[3], out[4], out[5]
    heights = positions[2]
    for p in range(sines.shape[0]):
        ee[p], nn[p], nu[p], uu[p] = normal_gradient_of(sines[p], cosines[p], heights[p])
    en[:] = 0.0
    eu[:] = 0.0
    if coefficients.size == 0:
        return
    flat = coefficients.reshape(-1)
    weights = np.empty((3, 4))
    columns = np.empty(24)
    shape = coefficients.shape
    column = shape[2] * 6
    row = shape[1] * column
    for p in range(sines.shape[0]):
        i, t_0, _ = _locate(positions[0, p], origin[0], step[0], shape[0])
        j, t_1, _ = _locate(positions[1, p], origin[1], step[1], shape[1])
        k, t_2, _ = _locate(positions[2, p], origin[2], step[2], shape[2])
        if i < 0 or j < 0 or k < 0:
            out[:, p] = math.nan
            continue
        _weights(t_0, weights[0])
        _weights(t_1, weights[1])
        _weights(t_2, weights[2])
        start = i * row + j * column + k * 6
        _sum_columns(flat, 24, start, row, column, weights[0], weights[1], columns)
        for m in range(6):
            out[m, p] += _along(columns, weights[2], m, 6)


@compiled
def _gradient_at_all(
    positions: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    values: np.ndarray,
    derivatives: np.ndarray,
) -> int:
    """Evaluate :func:`gradient_at` at (n, 3) positions; return the first outside index or -1."""
    outside = -1
    for n in range(positions.shape[0]):
        sine, cosine = math.sin(positions[n, 0]), math.cos(positions[n, 0])
        inside = gradient_at(
            positions[n], sine, cosine, origin, step, coefficients, values[n], derivatives[n]
        )
        if not inside and outside < 0:
            outside = n
    return outside


@compiled
def _spline_at_all(
    positions: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    values: np.ndarray,
) -> int:
    """Evaluate the value of the spline at (n, 3) positions; return the first outside or -1."""
    outside = -1
    derivative = np.empty((coefficients.shape[3], 3))
    for n in range(positions.shape[0]):
        inside = spline_at(positions[n], origin, step, coefficients, values[n], derivative)
        if not inside and outside < 0:
            outside = n
    return outside


@dataclass(frozen=True, eq=False)
class Field:
    """The Earth's gravity-gradient field in the area of a scenario.

    Attributes
    ----------
    origin, step : (3,) first node and spacing of the map in latitude, longitude [rad], height [m].
    tensor_coefficients : (n0, n1, n2, 6) B-spline coefficients [E]; size 0 for no map.
    disturbance_coefficients : (n0, n1, n2, 3) of the gravity disturbance vector, ENU [m/s²].
    """

    origin: np.ndarray
    step: np.ndarray
    tensor_coefficients: np.ndarray
    disturbance_coefficients: np.ndarray

    def __post_init__(self) -> None:
        for item in fields(self):
            object.__setattr__(self, item.name, frozen(getattr(self, item.name)))

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
        return cls(
            np.array([gradient_map.latitude0, gradient_map.longitude0, gradient_map.height0]),
            np.array(
                [gradient_map.latitude_step, gradient_map.longitude_step, gradient_map.height_step]
            ),
            tensor,
            disturbance,
        )

    @property
    def has_map(self) -> bool:
        """Whether a disturbing field is added to the normal field."""
        return self.tensor_coefficients.size > 0

    @property
    def upper(self) -> np.ndarray:
        """Last node of the map in latitude, longitude [rad] and height [m]."""
        cells = np.array(self.tensor_coefficients.shape[:3]) - 3
        return self.origin + cells * self.step

    def tensor(self, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike) -> np.ndarray:
        """Return the gradient tensor (..., 6) [E] at positions of any (broadcast) shape.

        Raises
        ------
        OutsideMapError
            If a position lies outside the map; the message names it and the map's bounds.
        """
        return self.tensor_and_derivative(latitude, longitude, height)[0]

    def tensor_and_derivative(
        self, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the tensor (..., 6) [E] and its derivative (..., 6, 3) [E/m east, north, up].

        Raises
        ------
        OutsideMapError
            If a position lies outside the map; the message names it and the map's bounds.
        """
        positions, shape = self._positions(latitude, longitude, height)
        values = np.empty((len(positions), 6))
        derivatives = np.empty((len(positions), 6, 3))
        outside = _gradient_at_all(
            positions, self.origin, self.step, self.tensor_coefficients, values, derivatives
        )
        self._require_inside(positions, outside)
        return values.reshape(*shape, 6), derivatives.reshape(*shape, 6, 3)

    def gravity_disturbance(
        self, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike
    ) -> np.ndarray:
        """Return the gravity disturbance vector (..., 3), ENU [m/s²]; zero without a map.

        Raises
        ------
        OutsideMapError
            If a position lies outside the map.
        """
        positions, shape = self._positions(latitude, longitude, height)
        values = np.zeros((len(positions), 3))
        if self.has_map:
            outside = _spline_at_all(
                positions, self.origin, self.step, self.disturbance_coefficients, values
            )
            self._require_inside(positions, outside)
        return values.reshape(*shape, 3)

    @staticmethod
    def _positions(
        latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike
    ) -> tuple[np.ndarray, tuple[int, ...]]:
        axes = np.broadcast_arrays(*(np.asarray(a, float) for a in (latitude, longitude, height)))
        return np.stack([axis.ravel() for axis in axes], axis=-1), axes[0].shape

    def _require_inside(self, positions: np.ndarray, outside: int) -> None:
        if outside < 0:
            return
        lower, upper = self.origin.copy(), self.upper
        point = positions[outside].copy()
        for corner in (lower, upper, point):
            corner[:2] = np.degrees(corner[:2])
        raise OutsideMapError(
            f"position {point[0]:.5f}° N, {point[1]:.5f}° E, {point[2]:.0f} m is outside the "
            f"gradient map, which covers {lower[0]:.3f}° to {upper[0]:.3f}° N, "
            f"{lower[1]:.3f}° to {upper[1]:.3f}° E, {lower[2]:.0f} to {upper[2]:.0f} m"
        )
