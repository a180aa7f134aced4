"""The adjoint of the INS error model over one IMU interval, for several runs at once.

A row y of Φ, as a column, obeys y' = Fᵀ y backwards in time: one sparse product per order of a
Taylor series. Over the interval y is a polynomial, and what noise adds to Q = ∫ Φ G q Gᵀ Φᵀ ds, the
integral of products of polynomials, is a sum over their first Legendre coefficients. Arrays are
laid out as :mod:`ggbench.ins.system_matrix` says.
"""

from __future__ import annotations

import math

import numpy as np

from ..numerics.kernels import LANES, compiled, inlined
from .system_matrix import ATTITUDE, BODY, DAMPING, DECAY, ENTRIES, FORCE, TURN, VELOCITY

Column = tuple[
    float, float, float, float, float, float, float, float,
    float, float, float, float, float, float, float,
]  # fmt: skip
"""A column y of 15 numbers."""


@inlined
def _transposed(f: np.ndarray, r: int, scale: float, y: Column) -> Column:
    """Return scale · Fᵀ y of the entries f (ENTRIES * LANES,) of F of run ``r``."""
    p_0, p_1, p_2 = scale * y[0], scale * y[1], scale * y[2]
    v_0, v_1, v_2 = scale * y[3], scale * y[4], scale * y[5]
    a_0, a_1, a_2 = scale * y[6], scale * y[7], scale * y[8]
    f_0, f_1 = f[FORCE * LANES + r], f[(FORCE + 1) * LANES + r]
    f_2 = f[(FORCE + 2) * LANES + r]
    w_0, w_1 = f[TURN * LANES + r], f[(TURN + 1) * LANES + r]
    w_2 = f[(TURN + 2) * LANES + r]
    c_0, c_1 = f[BODY * LANES + r], f[(BODY + 1) * LANES + r]
    c_2, c_3 = f[(BODY + 2) * LANES + r], f[(BODY + 3) * LANES + r]
    c_4, c_5 = f[(BODY + 4) * LANES + r], f[(BODY + 5) * LANES + r]
    c_6, c_7 = f[(BODY + 6) * LANES + r], f[(BODY + 7) * LANES + r]
    c_8 = f[(BODY + 8) * LANES + r]
    d_g, d_a = scale * f[DECAY * LANES + r], scale * f[(DECAY + 1) * LANES + r]
    return (
        (f[r] * p_0 + f[3 * LANES + r] * p_1)
        + (
            f[VELOCITY * LANES + r] * v_0
            + f[(VELOCITY + 5) * LANES + r] * v_1
            + f[(VELOCITY + 10) * LANES + r] * v_2
        )
        + (
            f[ATTITUDE * LANES + r] * a_0
            + f[(ATTITUDE + 3) * LANES + r] * a_1
            + f[(ATTITUDE + 6) * LANES + r] * a_2
        ),
        0.0,
        (f[LANES + r] * p_0 + f[4 * LANES + r] * p_1 + f[DAMPING * LANES + r] * p_2)
        + (
            f[(VELOCITY + 1) * LANES + r] * v_0
            + f[(VELOCITY + 6) * LANES + r] * v_1
            + f[(VELOCITY + 11) * LANES + r] * v_2
        )
        + (
            f[(ATTITUDE + 1) * LANES + r] * a_0
            + f[(ATTITUDE + 4) * LANES + r] * a_1
            + f[(ATTITUDE + 7) * LANES + r] * a_2
        ),
        (f[5 * LANES + r] * p_1 + f[(VELOCITY + 2) * LANES + r] * v_0)
        + (f[(VELOCITY + 7) * LANES + r] * v_1 + f[(VELOCITY + 12) * LANES + r] * v_2)
        + (f[(ATTITUDE + 5) * LANES + r] * a_1 + f[(ATTITUDE + 8) * LANES + r] * a_2),
        (f[2 * LANES + r] * p_0 + f[(VELOCITY + 3) * LANES + r] * v_0)
        + (f[(VELOCITY + 8) * LANES + r] * v_1 + f[(VELOCITY + 13) * LANES + r] * v_2)
        + f[(ATTITUDE + 2) * LANES + r] * a_0,
        (p_2 + f[(VELOCITY + 4) * LANES + r] * v_0)
        + (f[(VELOCITY + 9) * LANES + r] * v_1 + f[(VELOCITY + 14) * LANES + r] * v_2),
        (f_2 * v_1 - f_1 * v_2) + (w_1 * a_2 - w_2 * a_1),
        (f_0 * v_2 - f_2 * v_0) + (w_2 * a_0 - w_0 * a_2),
        (f_1 * v_0 - f_0 * v_1) + (w_0 * a_1 - w_1 * a_0),
        d_g * y[9] - (c_0 * a_0 + c_3 * a_1 + c_6 * a_2),
        d_g * y[10] - (c_1 * a_0 + c_4 * a_1 + c_7 * a_2),
        d_g * y[11] - (c_2 * a_0 + c_5 * a_1 + c_8 * a_2),
        d_a * y[12] + (c_0 * v_0 + c_3 * v_1 + c_6 * v_2),
        d_a * y[13] + (c_1 * v_0 + c_4 * v_1 + c_7 * v_2),
        d_a * y[14] + (c_2 * v_0 + c_5 * v_1 + c_8 * v_2),
    )


@inlined
def _column(columns: np.ndarray, i: int, r: int) -> Column:
    """Return column ``i`` of run ``r`` of columns (C, 15 * LANES)."""
    return (
        columns[i, r], columns[i, LANES + r], columns[i, 2 * LANES + r],
        columns[i, 3 * LANES + r], columns[i, 4 * LANES + r], columns[i, 5 * LANES + r],
        columns[i, 6 * LANES + r], columns[i, 7 * LANES + r], columns[i, 8 * LANES + r],
        columns[i, 9 * LANES + r], columns[i, 10 * LANES + r], columns[i, 11 * LANES + r],
        columns[i, 12 * LANES + r], columns[i, 13 * LANES + r], columns[i, 14 * LANES + r],
    )  # fmt: skip


@inlined
def _series(
    f: np.ndarray, r: int, dt: float, y: Column
) -> tuple[Column, Column, Column, Column, Column]:
    """Return the terms of the Taylor series of exp(Fᵀ dt) y, from the first to the fifth order.

    F's chain bias → attitude → velocity → position ends after three products, and what comes back
    is 1e-4 of it in an interval: terms beyond are below rounding.
    """
    t_1 = _transposed(f, r, dt, y)
    t_2 = _transposed(f, r, dt / 2.0, t_1)
    t_3 = _transposed(f, r, dt / 3.0, t_2)
    t_4 = _transposed(f, r, dt / 4.0, t_3)
    return t_1, t_2, t_3, t_4, _transposed(f, r, dt / 5.0, t_4)


@inlined
def _sum(y: float, t_1: float, t_2: float, t_3: float, t_4: float, t_5: float) -> float:
    """Return the sum of a series, its small terms first."""
    return y + (t_1 + (t_2 + (t_3 + (t_4 + t_5))))


@inlined
def _add_up(
    y: Column,
    terms: tuple[Column, Column, Column, Column, Column],
    columns: np.ndarray,
    i: int,
    r: int,
) -> None:
    """Put the sum of a series into column ``i`` of run ``r``."""
    a, b, c, d, e = terms
    columns[i, r] = _sum(y[0], a[0], b[0], c[0], d[0], e[0])
    columns[i, 2 * LANES + r] = _sum(y[2], a[2], b[2], c[2], d[2], e[2])
    columns[i, 3 * LANES + r] = _sum(y[3], a[3], b[3], c[3], d[3], e[3])
    columns[i, 4 * LANES + r] = _sum(y[4], a[4], b[4], c[4], d[4], e[4])
    columns[i, 5 * LANES + r] = _sum(y[5], a[5], b[5], c[5], d[5], e[5])
    columns[i, 6 * LANES + r] = _sum(y[6], a[6], b[6], c[6], d[6], e[6])
    columns[i, 7 * LANES + r] = _sum(y[7], a[7], b[7], c[7], d[7], e[7])
    columns[i, 8 * LANES + r] = _sum(y[8], a[8], b[8], c[8], d[8], e[8])
    columns[i, 9 * LANES + r] = _sum(y[9], a[9], b[9], c[9], d[9], e[9])
    columns[i, 10 * LANES + r] = _sum(y[10], a[10], b[10], c[10], d[10], e[10])
    columns[i, 11 * LANES + r] = _sum(y[11], a[11], b[11], c[11], d[11], e[11])
    columns[i, 12 * LANES + r] = _sum(y[12], a[12], b[12], c[12], d[12], e[12])
    columns[i, 13 * LANES + r] = _sum(y[13], a[13], b[13], c[13], d[13], e[13])
    columns[i, 14 * LANES + r] = _sum(y[14], a[14], b[14], c[14], d[14], e[14])


def _legendre_weights(degree: int) -> tuple[float, ...]:
    """Return ∫ s^k P_l(2s − 1) ds over 0..1, times √(2l + 1), for k = 0..5 and l = ``degree``.

    With b_l = Σ_k of them times the coefficients of polynomials y(s), ∫ y yᵀ ds = Σ_l b_l b_lᵀ.
    """
    return tuple(
        math.sqrt(2 * degree + 1)
        * math.factorial(k) ** 2
        / (math.factorial(k - degree) * math.factorial(k + degree + 1))
        if k >= degree
        else 0.0
        for k in range(6)
    )


_MEAN, _SLOPE, _CURVE = (_legendre_weights(degree) for degree in range(3))


@inlined
def _mean(y: float, t_1: float, t_2: float, t_3: float, t_4: float, t_5: float) -> float:
    """Return b_0 of an element of y in an interval, from its series."""
    return y + (
        _MEAN[1] * t_1 + (_MEAN[2] * t_2 + (_MEAN[3] * t_3 + (_MEAN[4] * t_4 + _MEAN[5] * t_5)))
    )


@inlined
def _slope(t_1: float, t_2: float, t_3: float, t_4: float, t_5: float) -> float:
    """Return b_1."""
    return _SLOPE[1] * t_1 + (
        _SLOPE[2] * t_2 + (_SLOPE[3] * t_3 + (_SLOPE[4] * t_4 + _SLOPE[5] * t_5))
    )


@inlined
def _curve(t_2: float, t_3: float, t_4: float, t_5: float) -> float:
    """Return b_2, the last that matters: the chain noise → position ends with it."""
    return _CURVE[2] * t_2 + (_CURVE[3] * t_3 + (_CURVE[4] * t_4 + _CURVE[5] * t_5))


@compiled
def back(
    f: np.ndarray,
    dt: float,
    roots: np.ndarray,
    altimeter: np.ndarray,
    columns: np.ndarray,
    white: np.ndarray,
) -> None:
    """Take columns (C, 15 * LANES) back over an interval, y ← exp(Fᵀ dt) y.

    Parameters
    ----------
    f : (ENTRIES * LANES,) of F. dt : the interval [s].
    roots, altimeter : (15,), (2,) of :class:`Noise`, over the interval.
    columns : changed in place.
    white : (C, 21 * LANES) output, what the interval's noise adds to Q, as factors of a product:
        b_0 and b_1 of the velocity's elements, b_0 to b_2 of the attitude's; and what matters with
        an altimeter alone, b_0 to b_2 of its own and b_2 of the velocity's.
    """
    lanes = f.shape[0] // ENTRIES
    root_v, root_a = roots[3], roots[6]
    k_1, k_2 = altimeter[0], altimeter[1]
    for i in range(columns.shape[0]):
        for r in range(lanes):
            y = _column(columns, i, r)
            terms = _series(f, r, dt, y)
            a, b, c, d, e = terms
            white[i, r] = root_v * _mean(y[3], a[3], b[3], c[3], d[3], e[3])
            white[i, LANES + r] = root_v * _mean(y[4], a[4], b[4], c[4], d[4], e[4])
            white[i, 2 * LANES + r] = root_v * _mean(y[5], a[5], b[5], c[5], d[5], e[5])
            white[i, 3 * LANES + r] = root_v * _slope(a[3], b[3], c[3], d[3], e[3])
            white[i, 4 * LANES + r] = root_v * _slope(a[4], b[4], c[4], d[4], e[4])
            white[i, 5 * LANES + r] = root_v * _slope(a[5], b[5], c[5], d[5], e[5])
            white[i, 6 * LANES + r] = root_a * _mean(y[6], a[6], b[6], c[6], d[6], e[6])
            white[i, 7 * LANES + r] = root_a * _mean(y[7], a[7], b[7], c[7], d[7], e[7])
            white[i, 8 * LANES + r] = root_a * _mean(y[8], a[8], b[8], c[8], d[8], e[8])
            white[i, 9 * LANES + r] = root_a * _slope(a[6], b[6], c[6], d[6], e[6])
            white[i, 10 * LANES + r] = root_a * _slope(a[7], b[7], c[7], d[7], e[7])
            white[i, 11 * LANES + r] = root_a * _slope(a[8], b[8], c[8], d[8], e[8])
            white[i, 12 * LANES + r] = root_a * _curve(b[6], c[6], d[6], e[6])
            white[i, 13 * LANES + r] = root_a * _curve(b[7], c[7], d[7], e[7])
            white[i, 14 * LANES + r] = root_a * _curve(b[8], c[8], d[8], e[8])
            h_1, h_2 = k_1 * a[2] + k_2 * a[5], k_1 * b[2] + k_2 * b[5]
            h_3, h_4 = k_1 * c[2] + k_2 * c[5], k_1 * d[2] + k_2 * d[5]
            h_5 = k_1 * e[2] + k_2 * e[5]
            white[i, 15 * LANES + r] = _mean(k_1 * y[2] + k_2 * y[5], h_1, h_2, h_3, h_4, h_5)
            white[i, 16 * LANES + r] = _slope(h_1, h_2, h_3, h_4, h_5)
            white[i, 17 * LANES + r] = _curve(h_2, h_3, h_4, h_5)
            white[i, 18 * LANES + r] = root_v * _curve(b[3], c[3], d[3], e[3])
            white[i, 19 * LANES + r] = root_v * _curve(b[4], c[4], d[4], e[4])
            white[i, 20 * LANES + r] = root_v * _curve(b[5], c[5], d[5], e[5])
            _add_up(y, terms, columns, i, r)


@compiled
def add_products(white: np.ndarray, covariance: np.ndarray) -> None:
    """Add to the covariance (C, C, LANES) the products of the first 15 factors."""
    lanes = covariance.shape[2]
    for i in range(covariance.shape[0]):
        for j in range(i + 1):
            for r in range(lanes):
                covariance[i, j, r] += (
                    (
                        (
                            white[i, r] * white[j, r]
                            + white[i, LANES + r] * white[j, LANES + r]
                            + white[i, 2 * LANES + r] * white[j, 2 * LANES + r]
                        )
                        + (
                            white[i, 3 * LANES + r] * white[j, 3 * LANES + r]
                            + white[i, 4 * LANES + r] * white[j, 4 * LANES + r]
                            + white[i, 5 * LANES + r] * white[j, 5 * LANES + r]
                        )
                    )
                    + (
                        (
                            white[i, 6 * LANES + r] * white[j, 6 * LANES + r]
                            + white[i, 7 * LANES + r] * white[j, 7 * LANES + r]
                            + white[i, 8 * LANES + r] * white[j, 8 * LANES + r]
                        )
                        + (
                            white[i, 9 * LANES + r] * white[j, 9 * LANES + r]
                            + white[i, 10 * LANES + r] * white[j, 10 * LANES + r]
                            + white[i, 11 * LANES + r] * white[j, 11 * LANES + r]
                        )
                    )
                    + (
                        white[i, 12 * LANES + r] * white[j, 12 * LANES + r]
                        + white[i, 13 * LANES + r] * white[j, 13 * LANES + r]
                        + white[i, 14 * LANES + r] * white[j, 14 * LANES + r]
                    )
                )


@compiled
def wander(
    f: np.ndarray, dt: float, roots: np.ndarray, columns: np.ndarray, biases: np.ndarray
) -> None:
    """Fill what the noise of wandering biases adds to Q in an interval, as factors.

    Parameters
    ----------
    f, dt, roots, columns : as in :func:`back`, before it changes them.
    biases : (C, 18 * LANES) output: b_0, b_1 and b_2 of the biases' elements.
    """
    lanes = f.shape[0] // ENTRIES
    root_g, root_a = roots[9], roots[12]
    for i in range(columns.shape[0]):
        for r in range(lanes):
            y = _column(columns, i, r)
            a, b, c, d, e = _series(f, r, dt, y)
            biases[i, r] = root_g * _mean(y[9], a[9], b[9], c[9], d[9], e[9])
            biases[i, LANES + r] = root_g * _mean(y[10], a[10], b[10], c[10], d[10], e[10])
            biases[i, 2 * LANES + r] = root_g * _mean(y[11], a[11], b[11], c[11], d[11], e[11])
            biases[i, 3 * LANES + r] = root_a * _mean(y[12], a[12], b[12], c[12], d[12], e[12])
            biases[i, 4 * LANES + r] = root_a * _mean(y[13], a[13], b[13], c[13], d[13], e[13])
            biases[i, 5 * LANES + r] = root_a * _mean(y[14], a[14], b[14], c[14], d[14], e[14])
            biases[i, 6 * LANES + r] = root_g * _slope(a[9], b[9], c[9], d[9], e[9])
            biases[i, 7 * LANES + r] = root_g * _slope(a[10], b[10], c[10], d[10], e[10])
            biases[i, 8 * LANES + r] = root_g * _slope(a[11], b[11], c[11], d[11], e[11])
            biases[i, 9 * LANES + r] = root_a * _slope(a[12], b[12], c[12], d[12], e[12])
            biases[i, 10 * LANES + r] = root_a * _slope(a[13], b[13], c[13], d[13], e[13])
            biases[i, 11 * LANES + r] = root_a * _slope(a[14], b[14], c[14], d[14], e[14])
            biases[i, 12 * LANES + r] = root_g * _curve(b[9], c[9], d[9], e[9])
            biases[i, 13 * LANES + r] = root_g * _curve(b[10], c[10], d[10], e[10])
            biases[i, 14 * LANES + r] = root_g * _curve(b[11], c[11], d[11], e[11])
            biases[i, 15 * LANES + r] = root_a * _curve(b[12], c[12], d[12], e[12])
            biases[i, 16 * LANES + r] = root_a * _curve(b[13], c[13], d[13], e[13])
            biases[i, 17 * LANES + r] = root_a * _curve(b[14], c[14], d[14], e[14])


@compiled
def add_six(factors: np.ndarray, first: int, covariance: np.ndarray) -> None:
    """Add to the covariance (C, C, LANES) the products of six rows of factors, from ``first`` on.

    ``first`` counts numbers, LANES a row; factors are (C, rows * LANES).
    """
    lanes = covariance.shape[2]
    for i in range(covariance.shape[0]):
        a = factors[i, first : first + 6 * LANES]
        for j in range(i + 1):
            b = factors[j, first : first + 6 * LANES]
            for r in range(lanes):
                covariance[i, j, r] += (
                    (a[r] * b[r] + a[LANES + r] * b[LANES + r])
                    + (a[2 * LANES + r] * b[2 * LANES + r] + a[3 * LANES + r] * b[3 * LANES + r])
                    + (a[4 * LANES + r] * b[4 * LANES + r] + a[5 * LANES + r] * b[5 * LANES + r])
                )


@compiled
def forward(f: np.ndarray, dt: float, columns: np.ndarray) -> None:
    """Take columns (C, 15 * LANES) forward over an interval, y ← exp(−Fᵀ dt) y."""
    lanes = f.shape[0] // ENTRIES
    for i in range(columns.shape[0]):
        for r in range(lanes):
            y = _column(columns, i, r)
            _add_up(y, _series(f, r, -dt, y), columns, i, r)
