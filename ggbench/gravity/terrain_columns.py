"""Compiled field of a terrain's columns, at points between and above summits.

Each cell of a terrain is a column between a base level and the height of the cell. Columns near a
point are prisms, computed by the kernels of the package choclo. Columns farther away are vertical
line masses with a dipole at each end. Blocks of 2 x 2, 4 x 4, ... cells are also represented by
such line masses. The dipoles represent second moments of a block: the mean square of its width and
length, and the variance and slope of its heights. The difference of width and length is neglected.
choclo has no kernel for a line mass. Its kernel for a prism takes twenty times as long as the
computation of a line mass in this module.

Let (e, n, z) be the offset of a point of the line mass, ρ² = e² + n², r² = ρ² + z² and s = z / r.
The integrals over the line are ∫dz/r³ = [s] / ρ² and ∫dz/r⁵ = [s − s³/3] / ρ⁴, with the brackets
evaluated at both ends (Blakely 1995, sec. 3.2.3). The code avoids cancellation directly above a
column.
"""

from __future__ import annotations

import math

import numpy as np
from choclo.prism import kernel_ee, kernel_en, kernel_eu, kernel_nn, kernel_nu, kernel_uu

from ..numerics.kernels import compiled, inlined
from ..numerics.records import record
from .ellipsoid import radii_of_sine

_DEEPEST = 128
"""Size of the stack of blocks to visit: three blocks per level, at most 30 levels."""


@record
class Columns:
    """Columns of a terrain and blocks of them, on a grid regular in latitude and longitude.

    Attributes
    ----------
    blocks : (M, 4) moments of the blocks of all levels. Blocks of level l have 2^l x 2^l cells;
        level 0 are the cells. Heights h are above the base; e and n are the east and north
        coordinates from the centre of the block, as fractions of its width and length. Each row
        contains the means of h, h e and h n [m], and the variance of h [m²].
    first : (L,) index of the first block of each level.
    shape : (L, 2) number of blocks of each level along latitude and longitude.
    south_west, steps : (2,) first cell, and distances between cells, in latitude and longitude
        [rad].
    base : height of the lower end of all columns [m].
    density : density of the ground, for columns of the land; density deficit of water, for columns
        of the sea [kg/m³]. A column with its top below the base has a negative mass.
    """

    blocks: np.ndarray
    first: np.ndarray
    shape: np.ndarray
    south_west: np.ndarray
    steps: np.ndarray
    base: float
    density: float


@compiled
def fill_parents(children: np.ndarray, rows: int, columns: int, parents: np.ndarray) -> None:
    """Fill ``parents`` (rows / 2 · columns / 2, 4) with moments of blocks of 2 x 2 children.

    The finer level has even numbers ``rows`` and ``columns`` of blocks. Its blocks are ``children``
    (rows · columns, 4), see :class:`Columns`.
    """
    for j in range(rows // 2):
        for i in range(columns // 2):
            at = j * (columns // 2) + i
            mean = east = north = square = 0.0
            for a in range(2):
                for b in range(2):
                    child = children[(2 * j + a) * columns + 2 * i + b]
                    mean += 0.25 * child[0]
                    # Places are halved, as the block is twice as wide.
                    east += 0.25 * (0.5 * child[1] + (0.5 * b - 0.25) * child[0])
                    north += 0.25 * (0.5 * child[2] + (0.5 * a - 0.25) * child[0])
                    square += 0.25 * (child[3] + child[0] * child[0])
            parents[at, 0], parents[at, 1], parents[at, 2] = mean, east, north
            parents[at, 3] = max(square - mean * mean, 0.0)


@inlined
def _add_line(
    e: float, n: float, low: float, high: float, factor: float, out: np.ndarray, p: int
) -> None:
    """Add the field of a vertical line mass to ``out`` (N, 9), row p.

    The line lies at an offset ``e``, ``n`` [m] and has the mass ``factor`` per metre [kg/m]. If
    ``high`` is below ``low``, the mass is negative.
    """
    across = e * e + n * n
    square_b, square_t = across + low * low, across + high * high
    r_b, r_t = math.sqrt(square_b), math.sqrt(square_t)
    s_b, s_t = low / r_b, high / r_t
    over_b, over_t = 1.0 / square_b, 1.0 / square_t
    if low * high > 0.0:
        third = (high - low) * (high + low) * over_b * over_t / (s_t + s_b)
    else:
        third = (s_t - s_b) / across
    rest = (over_t + over_b - across * over_t * over_b) / (1.0 + s_t * s_b)
    fifth = third * (over_t + over_b + rest)  # three times the integral
    third, fifth = factor * third, factor * fifth
    up = factor * (over_b / r_b - over_t / r_t)
    out[p, 0] += e * e * fifth - third
    out[p, 1] += e * n * fifth
    out[p, 2] += e * up
    out[p, 3] += n * n * fifth - third
    out[p, 4] += n * up
    out[p, 5] += 2.0 * third - across * fifth
    out[p, 6] += e * third
    out[p, 7] += n * third
    out[p, 8] += factor * (1.0 / r_b - 1.0 / r_t)


@inlined
def _add_dipole(
    e: float, n: float, u: float, d_e: float, d_n: float, d_u: float, out: np.ndarray, p: int
) -> None:
    """Add the field of a mass dipole (d_e, d_n, d_u) [kg m] to ``out`` (N, 9), row p.

    The dipole lies at an offset (e, n, u) [m] from the point.
    """
    square = e * e + n * n + u * u
    third = 1.0 / (square * math.sqrt(square))
    fifth = 3.0 * third / square
    along = d_e * e + d_n * n + d_u * u
    seventh = 5.0 * fifth / square * along
    same = fifth * along
    ee = fifth * 2.0 * d_e * e + same - seventh * e * e
    nn = fifth * 2.0 * d_n * n + same - seventh * n * n
    out[p, 0] += ee
    out[p, 1] += fifth * (d_e * n + d_n * e) - seventh * e * n
    out[p, 2] += fifth * (d_e * u + d_u * e) - seventh * e * u
    out[p, 3] += nn
    out[p, 4] += fifth * (d_n * u + d_u * n) - seventh * n * u
    out[p, 5] -= ee + nn
    out[p, 6] += third * d_e - same * e
    out[p, 7] += third * d_n - same * n
    out[p, 8] += third * d_u - same * u


@compiled
def add_prism(bounds: np.ndarray, factor: float, out: np.ndarray, p: int) -> None:
    """Add ``factor`` times the field of a prism at one point to row p of ``out`` (N, 9).

    ``bounds`` (west, east, south, north, bottom, top) are offsets from the point [m]. The gradient
    is the sum of choclo's kernels over the corners. The attraction follows from the gradient by
    Euler's theorem on homogeneous functions.
    """
    for i in range(2):
        e = bounds[i]
        for j in range(2):
            n = bounds[2 + j]
            for k in range(2):
                u = bounds[4 + k]
                r = math.sqrt(e * e + n * n + u * u)
                sign = factor if (i + j + k) % 2 else -factor
                ee, nn, uu = kernel_ee(e, n, u, r), kernel_nn(e, n, u, r), kernel_uu(e, n, u, r)
                en, eu, nu = kernel_en(e, n, u, r), kernel_eu(e, n, u, r), kernel_nu(e, n, u, r)
                out[p, 0] += sign * ee
                out[p, 1] += sign * en
                out[p, 2] += sign * eu
                out[p, 3] += sign * nn
                out[p, 4] += sign * nu
                out[p, 5] += sign * uu
                out[p, 6] -= sign * (e * ee + n * en + u * eu)
                out[p, 7] -= sign * (e * en + n * nn + u * nu)
                out[p, 8] -= sign * (e * eu + n * nu + u * uu)


@compiled
def add_columns(columns: Columns, points: np.ndarray, ratio: float, out: np.ndarray) -> None:
    """Add the field of columns, divided by the gravitational constant, to ``out`` (N, 9).

    The components are EE, EN, EU, NN, NU, UU [kg/m³] and E, N, U [kg/m²] in the axes of each point.
    Around each point the Earth is flat.

    Parameters
    ----------
    points : (N, 3) latitude, longitude [rad], height above the zero level [m].
    ratio : a block is a line mass if the ratio of its distance to its size is at least this number.
        The size is √((w² + l²)/2 + 12 v) for the width w, the length l and the variance v of the
        heights.
    """
    top_level = columns.first.shape[0] - 1
    levels, rows, places = np.empty((3, _DEEPEST), np.int64)
    bounds = np.empty(6)
    for p in range(points.shape[0]):
        sine, cosine = math.sin(points[p, 0]), math.cos(points[p, 0])
        meridian, prime_vertical = radii_of_sine(sine)
        bottom = columns.base - points[p, 2]
        last = 0
        for j in range(columns.shape[top_level, 0]):
            for i in range(columns.shape[top_level, 1]):
                levels[last], rows[last], places[last] = top_level, j, i
                last += 1
        while last > 0:
            last -= 1
            level, j, i = levels[last], rows[last], places[last]
            block = columns.blocks[columns.first[level] + j * columns.shape[level, 1] + i]
            if block[0] == 0.0 and block[3] == 0.0:
                continue
            wide = float(1 << level)
            d_lat = (
                columns.south_west[0] - points[p, 0]
                + ((j + 0.5) * wide - 0.5) * columns.steps[0]
            )  # fmt: skip
            d_lon = (
                columns.south_west[1] - points[p, 1]
                + ((i + 0.5) * wide - 0.5) * columns.steps[1]
            )  # fmt: skip
            parallel = prime_vertical * (cosine - d_lat * (sine + 0.5 * d_lat * cosine))
            e = d_lon * parallel
            n = meridian * d_lat + 0.5 * d_lon * d_lon * prime_vertical * sine * cosine
            width = wide * columns.steps[1] * parallel
            length = wide * columns.steps[0] * meridian
            top = bottom + block[0]
            gap = max(min(bottom, top), -max(bottom, top), 0.0)
            square = 0.5 * (width * width + length * length)
            size = square + 12.0 * block[3]
            if e * e + n * n + gap * gap >= ratio * ratio * size:
                area = columns.density * width * length
                _add_line(e, n, bottom, top, area, out, p)
                edge = square / 24.0
                _add_dipole(e, n, bottom, 0.0, 0.0, area * edge, out, p)
                _add_dipole(
                    e, n, top, area * width * block[1], area * length * block[2],
                    area * (0.5 * block[3] - edge), out, p,
                )  # fmt: skip
            elif level > 0:
                for a in range(2):
                    for b in range(2):
                        levels[last] = level - 1
                        rows[last], places[last] = 2 * j + a, 2 * i + b
                        last += 1
            else:
                bounds[0], bounds[1] = e - 0.5 * width, e + 0.5 * width
                bounds[2], bounds[3] = n - 0.5 * length, n + 0.5 * length
                bounds[4], bounds[5] = bottom, top
                add_prism(bounds, columns.density, out, p)
