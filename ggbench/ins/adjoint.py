"""Adjoint of the INS error model over one IMU interval, for eight runs at once.

A row y of Φ, written as a column, obeys y' = Fᵀ y backwards in time. A Taylor series solves this
equation, with one sparse product per order, so y is a polynomial within the interval. The
contribution of noise to Q = ∫ Φ G q Gᵀ Φᵀ ds is an integral of products of polynomials, computed as
a sum over the first Legendre coefficients of the polynomials. The last axis of arrays is the run
(lane), see :mod:`ggbench.numerics.lanes`.
"""

from __future__ import annotations

import math

import numpy as np

from ..numerics.kernels import compiled, copied, inlined
from ..numerics.lanes import unfilled
from ..numerics.vectors import load, store
from .known_gravity import COMPONENT
from .local_level import Vector
from .noise import Noise
from .strapdown import keep, three
from .system_matrix import (
    ATTITUDE,
    BODY,
    DAMPING,
    DECAY,
    DISTANCE,
    DRIVEN,
    ENTRIES,
    FORCE,
    LONGITUDE,
    NAVIGATION_STATES,
    SENSED,
    STATES,
    TRANSPORT,
    TURN,
    VELOCITY,
    entries_dot,
)

MOST_FACTORS = 48
"""Largest number of factors of Q in an interval, see :func:`propagate`."""

_LAST = 5
"""Order of the last term of the series. The chain bias → attitude → velocity → position of F ends
after three products. Feedback to the start of the chain is 1e-4 of the error in an interval. The
fifth term is needed for biases that vary. In the longest allowed interval, a tenth of their time
constant, it is 8e-8 of the remaining bias and 3e-8 of its Q. The sixth term is 1e-9. For constant
biases the fifth term of Q is below 1e-12, even in intervals of a second."""
_SLOW = 2e-4
"""Largest rotation or feedback of errors in an interval for which three orders are sufficient.
The neglected terms are the third power of this limit / 24: 3e-13 of Φ and less of Q. Nearly all
feedback is that of the height error, at a rate of 1.8e-3 s⁻¹."""
TIME = ENTRIES
SCALED = ENTRIES + 1
"""Length of F dt, see :func:`scaled_entries`: the entries of F, then dt for δh' = δv_U."""
DISTURBANCE = STATES
"""Index of the first of the three states of the gravity disturbance, if it is a state."""
_HEIGHT = STATES + 3
"""Index of the altimeter component of a term, after the components of y."""


@copied
def is_slow(entries: np.ndarray, dt: float, noise: Noise) -> bool:
    """Return whether :func:`propagate_short_series` is accurate enough for all intervals.

    The result is False if biases vary, if the gravity disturbance is a state, or if an altimeter
    damps the INS. Otherwise the rotation and the feedback of errors in an interval must be below a
    limit. Only the first and the last interval are examined.

    Parameters
    ----------
    entries : (N, ENTRIES, LANES) non-zero entries of the system matrix F in each interval.
    dt : length of an interval [s].
    noise : process noise of the INS.
    """
    if noise.damped or noise.wandering or noise.disturbance.shape[0] > 0:
        return False
    square = 0.0
    for n in (0, entries.shape[0] - 1):
        for r in range(entries.shape[2]):
            for i in range(3):
                square = max(square, 4.0 * entries[n, TURN + i, r] ** 2)
                square = max(square, abs(entries[n, VELOCITY + 5 * i + 1, r]))
    return math.sqrt(square) * dt < _SLOW


@inlined
def _position_of(f: np.ndarray, p: Vector, v: Vector, a: Vector) -> Vector:
    """Return the position components of Fᵀ y, for y = (p, v, a, ...)."""
    latitude = load(f, 0, 0) * p[0] + load(f, 0, 3) * p[1]
    height = load(f, 0, 1) * p[0] + load(f, 0, 4) * p[1] + load(f, 0, DAMPING) * p[2]
    return (
        latitude
        + entries_dot(f=f, n=0, j=VELOCITY, stride=5, x=v[0], y=v[1], z=v[2])
        + entries_dot(f=f, n=0, j=ATTITUDE, stride=3, x=a[0], y=a[1], z=a[2]),
        entries_dot(f=f, n=0, j=LONGITUDE, stride=1, x=v[0], y=v[1], z=v[2]),
        height
        + entries_dot(f=f, n=0, j=VELOCITY + 1, stride=5, x=v[0], y=v[1], z=v[2])
        + entries_dot(f=f, n=0, j=ATTITUDE + 1, stride=3, x=a[0], y=a[1], z=a[2]),
    )


@inlined
def _velocity_of(f: np.ndarray, p: Vector, v: Vector, a: Vector) -> Vector:
    """Return the velocity components of Fᵀ y, for y = (p, v, a, ...)."""
    return (
        load(f, 0, 5) * p[1]
        + entries_dot(f=f, n=0, j=VELOCITY + 2, stride=5, x=v[0], y=v[1], z=v[2])
        + (load(f, 0, ATTITUDE + 5) * a[1] + load(f, 0, ATTITUDE + 8) * a[2]),
        load(f, 0, 2) * p[0]
        + entries_dot(f=f, n=0, j=VELOCITY + 3, stride=5, x=v[0], y=v[1], z=v[2])
        + load(f, 0, ATTITUDE + 2) * a[0],
        load(f, 0, TIME) * p[2]
        + entries_dot(f=f, n=0, j=VELOCITY + 4, stride=5, x=v[0], y=v[1], z=v[2]),
    )


@inlined
def _attitude_of(f: np.ndarray, v: Vector, a: Vector) -> Vector:
    """Return the attitude components of Fᵀ y, for y = (p, v, a, ...)."""
    f_0, f_1, f_2 = three(f, 0, FORCE)
    w_0, w_1, w_2 = three(f, 0, TURN)
    return (
        (f_2 * v[1] - f_1 * v[2]) + (w_1 * a[2] - w_2 * a[1]),
        (f_0 * v[2] - f_2 * v[0]) + (w_2 * a[0] - w_0 * a[2]),
        (f_1 * v[0] - f_0 * v[1]) + (w_0 * a[1] - w_1 * a[0]),
    )


@inlined
def _in_body(f: np.ndarray, n: Vector) -> Vector:
    """Return C_bn n."""
    return (
        entries_dot(f=f, n=0, j=BODY, stride=3, x=n[0], y=n[1], z=n[2]),
        entries_dot(f=f, n=0, j=BODY + 1, stride=3, x=n[0], y=n[1], z=n[2]),
        entries_dot(f=f, n=0, j=BODY + 2, stride=3, x=n[0], y=n[1], z=n[2]),
    )


@copied
def _transpose_biases(f: np.ndarray, terms: np.ndarray, k: int) -> None:
    """Fill the bias components of term k + 1 of a series."""
    pushed, turned = _in_body(f, three(terms, k, 3)), _in_body(f, three(terms, k, 6))
    d_g, d_a = load(f, 0, DECAY), load(f, 0, DECAY + 1)
    for axis in range(3):
        store(terms, k + 1, 9 + axis, d_g * load(terms, k, 9 + axis) - turned[axis])
        store(terms, k + 1, 12 + axis, d_a * load(terms, k, 12 + axis) + pushed[axis])


@copied
def _transpose_disturbance(f: np.ndarray, terms: np.ndarray, k: int) -> None:
    """Fill the gravity-disturbance components of term k + 1 of a series.

    The velocity error has δv' = … − δg, because accelerometers do not sense gravity. With a map
    δg' = −(|v|/D) δg + w. With gradients integrated along the indicated velocity
    δg' = −T δv − ω_en × δg + w; the term in T changes the velocity components of term k + 1.
    """
    decay = load(f, 0, DISTANCE)
    g_0, g_1, g_2 = three(terms, k, DISTURBANCE)
    w_0, w_1, w_2 = three(f, 0, TRANSPORT)
    time = load(f, 0, TIME)
    v_0, v_1, v_2 = time * load(terms, k, 3), time * load(terms, k, 4), time * load(terms, k, 5)
    disturbance = (
        decay * g_0 - v_0 + (w_1 * g_2 - w_2 * g_1),
        decay * g_1 - v_1 + (w_2 * g_0 - w_0 * g_2),
        decay * g_2 - v_2 + (w_0 * g_1 - w_1 * g_0),
    )
    keep(terms, k + 1, DISTURBANCE, disturbance)
    for axis in range(3):
        a, b, c = COMPONENT[axis, 0], COMPONENT[axis, 1], COMPONENT[axis, 2]
        pulled = load(f, 0, SENSED + a) * g_0 + load(f, 0, SENSED + b) * g_1
        pulled = pulled + load(f, 0, SENSED + c) * g_2
        store(terms, k + 1, 3 + axis, load(terms, k + 1, 3 + axis) - pulled)


@compiled
def scaled_entries(f: np.ndarray, n: int, time: float, out: np.ndarray) -> None:
    """Fill ``out`` (1, SCALED, LANES) with the entries of F in interval ``n``, scaled by a time.

    ``f`` (N, ENTRIES, LANES) contains the non-zero entries of the system matrix F in each interval.
    They are multiplied by ``time`` [s], except the entry ``DRIVEN``. This entry scales the noise of
    the gravity disturbance, and is copied unchanged. The last element of ``out`` is the time.
    """
    for i in range(ENTRIES):
        store(out, 0, i, time * load(f, n, i))
    store(out, 0, DRIVEN, load(f, n, DRIVEN))
    store(out, 0, TIME, time)


@inlined
def _series(f: np.ndarray, columns: np.ndarray, i: int, terms: np.ndarray) -> None:
    """Fill the terms (Fᵀ)^k y of the series of column ``i``, from y (k = 0) on."""
    for j in range(columns.shape[1]):
        store(terms, 0, j, load(columns, i, j))
    for k in range(_LAST):
        p, v, a = three(terms, k, 0), three(terms, k, 3), three(terms, k, 6)
        keep(terms, k + 1, 0, _position_of(f, p, v, a))
        keep(terms, k + 1, 3, _velocity_of(f, p, v, a))
        keep(terms, k + 1, 6, _attitude_of(f, v, a))
        _transpose_biases(f, terms, k)
        if columns.shape[1] > STATES:
            _transpose_disturbance(f, terms, k)


@compiled
def series_terms() -> np.ndarray:
    """Return an unfilled array (6, 19, LANES) for the terms of a Taylor series, one per order.

    The orders are 0 to 5. The 19 components of a term are 15 INS states, three states of the
    gravity disturbance, and the noise of the altimeter.
    """
    return unfilled(_LAST + 1, STATES + 4)


def _legendre_weights(degree: int) -> tuple[float, ...]:
    """Return √(2l + 1) ∫ s^k / k! P_l(2s − 1) ds over 0..1, for l = ``degree`` and all k.

    The Legendre coefficient b_l of a column y(s) is the sum over k of these weights times the terms
    (Fᵀ)^k y. Then ∫ y yᵀ ds = Σ_l b_l b_lᵀ.
    """
    return tuple(
        math.sqrt(2 * degree + 1)
        * math.factorial(k)
        / (math.factorial(k - degree) * math.factorial(k + degree + 1))
        if k >= degree
        else 0.0
        for k in range(_LAST + 1)
    )


_END = tuple(1.0 / math.factorial(k) for k in range(_LAST + 1))
_MEAN, _SLOPE, _CURVE = (_legendre_weights(degree) for degree in range(3))


@inlined
def _weighted(weights: tuple[float, ...], first: int, terms: np.ndarray, j: int) -> float:
    """Return the weighted sum of component ``j`` of the terms from ``first`` on.

    The term of highest order is added first, because it is the smallest.
    """
    total = weights[_LAST] * load(terms, _LAST, j)
    for k in range(_LAST - 1, first - 1, -1):
        total = weights[k] * load(terms, k, j) + total
    return total


@inlined
def _add_up(terms: np.ndarray, columns: np.ndarray, i: int) -> None:
    """Put the sum of a series into column ``i``."""
    for j in range(columns.shape[1]):
        store(columns, i, j, _weighted(_END, 0, terms, j))


@inlined
def _put(factors: np.ndarray, row: int, i: int, root: float, terms: np.ndarray, j: int) -> None:
    """Fill rows ``row`` to ``row + 2`` of column ``i`` with b_0, b_1, b_2 of component ``j``.

    Each coefficient is multiplied by the noise ``root``.
    """
    store(factors, row, i, root * _weighted(_MEAN, 0, terms, j))
    store(factors, row + 1, i, root * _weighted(_SLOPE, 1, terms, j))
    store(factors, row + 2, i, root * _weighted(_CURVE, 2, terms, j))


@compiled
def propagate(
    f: np.ndarray, noise: Noise, columns: np.ndarray, terms: np.ndarray, factors: np.ndarray
) -> int:
    """Propagate C columns y backwards over an interval, y ← exp(Fᵀ dt) y.

    A column y is a row of the transition matrix Φ, written as a column. F is the system matrix.

    Parameters
    ----------
    f : (1, SCALED, LANES) F dt from :func:`scaled_entries`.
    noise : process noise accumulated over the interval.
    columns : (C, 15 or 18, LANES) columns y, changed in place.
    terms : scratch from :func:`series_terms`.
    factors : (MOST_FACTORS, C, LANES) output. The rows up to the returned number form a matrix W,
        and the noise of the interval adds WᵀW to Q. Each row is a noise root (see :class:`.Noise`)
        times a Legendre coefficient b_0, b_1 or b_2 of a component of y:

        - b_0 and b_1 of the velocity; with an altimeter also b_2,
        - b_0 to b_2 of the attitude,
        - b_0 to b_2 of the altimeter noise, with an altimeter,
        - b_0 to b_2 of the biases, if they vary,
        - b_0 to b_2 of the gravity disturbance, if it is a state.

        Higher coefficients are negligible, because the chain from noise to position has no more
        integrations.

    Returns
    -------
    Number of filled rows of ``factors``.
    """
    count = 0
    for i in range(columns.shape[0]):
        _series(f, columns, i, terms)
        for axis in range(3):
            v, a = 3 + axis, 6 + axis
            store(factors, axis, i, noise.roots[v] * _weighted(_MEAN, 0, terms, v))
            store(factors, 3 + axis, i, noise.roots[v] * _weighted(_SLOPE, 1, terms, v))
            store(factors, 6 + axis, i, noise.roots[a] * _weighted(_MEAN, 0, terms, a))
            store(factors, 9 + axis, i, noise.roots[a] * _weighted(_SLOPE, 1, terms, a))
            store(factors, 12 + axis, i, noise.roots[a] * _weighted(_CURVE, 2, terms, a))
        count = 15
        if noise.damped:
            k_1, k_2 = noise.altimeter[0], noise.altimeter[1]
            for k in range(_LAST + 1):
                store(terms, k, _HEIGHT, k_1 * load(terms, k, 2) + k_2 * load(terms, k, 5))
            _put(factors, count, i, 1.0, terms, _HEIGHT)
            for v in range(3, 6):
                store(factors, count + v, i, noise.roots[v] * _weighted(_CURVE, 2, terms, v))
            count += 6
        if noise.wandering:
            for j in range(NAVIGATION_STATES, STATES):
                _put(factors, count, i, noise.roots[j], terms, j)
                count += 3
        if columns.shape[1] > STATES:
            for axis in range(3):
                root = noise.disturbance[axis] * load(f, 0, DRIVEN)
                _put(factors, count, i, root, terms, DISTURBANCE + axis)
                count += 3
        _add_up(terms, columns, i)
    return count


@compiled
def forward(f: np.ndarray, columns: np.ndarray, terms: np.ndarray) -> None:
    """Propagate C columns (C, 15, LANES) over an interval, y ← exp(Fᵀ dt) y, without noise.

    ``f`` is F dt from :func:`scaled_entries`. A column y is a row of the transition
    matrix. A positive dt propagates y from the end of the interval to its start, a negative dt from
    the start to the end. ``terms`` is scratch from :func:`series_terms`.
    """
    for i in range(columns.shape[0]):
        _series(f, columns, i, terms)
        _add_up(terms, columns, i)


@inlined
def _sum(one: Vector, weight: float, two: Vector) -> Vector:
    """Return one + weight · two."""
    return one[0] + weight * two[0], one[1] + weight * two[1], one[2] + weight * two[2]


@inlined
def _times(roots: np.ndarray, first: int, numbers: Vector) -> Vector:
    """Return the products of three numbers with three roots, from root ``first`` on."""
    return (
        roots[first] * numbers[0], roots[first + 1] * numbers[1], roots[first + 2] * numbers[2],
    )  # fmt: skip


@inlined
def _put_sums(
    weights: tuple[float, ...],
    first: int,
    noise: Noise,
    j: int,
    terms: tuple[Vector, ...],
    factors: np.ndarray,
    row: int,
    i: int,
) -> Vector:
    """Return a weighted sum of terms, and fill three factors with the sum times noise roots."""
    last = len(terms) - 1
    w = weights[last]
    total = (w * terms[last][0], w * terms[last][1], w * terms[last][2])
    for k in range(last - 1, first - 1, -1):
        total = _sum(total, weights[k], terms[k])
    by_roots = _times(noise.roots, j, total)
    for axis in range(3):
        store(factors, row + axis, i, by_roots[axis])
    return total


# Kept next to `propagate`: without it the simulation of a run takes 15 to 18 % longer.
@copied
def propagate_short_series(
    f: np.ndarray, noise: Noise, columns: np.ndarray, factors: np.ndarray
) -> int:
    """Propagate as :func:`propagate` does, with a series of lower order.

    This requires that :func:`is_slow` is true. The series has fourth order in the attitude, and
    third order in position and velocity. Biases are constant, so the bias components of y change
    by the averages of its attitude and velocity components: y_ε' = −C_bn y_φ for the gyros, and
    y_∇' = C_bn y_v for the accelerometers.

    Parameters
    ----------
    f : (1, SCALED, LANES) F dt from :func:`scaled_entries`.
    noise : process noise accumulated over the interval.
    columns : (C, 15, LANES) columns y, changed in place.
    factors : (MOST_FACTORS, C, LANES) output, as in :func:`propagate`.

    Returns
    -------
    Number of filled rows of ``factors``.
    """
    for i in range(columns.shape[0]):
        p_0, v_0, a_0 = three(columns, i, 0), three(columns, i, 3), three(columns, i, 6)
        p_1, v_1 = _position_of(f, p_0, v_0, a_0), _velocity_of(f, p_0, v_0, a_0)
        a_1 = _attitude_of(f, v_0, a_0)
        p_2, v_2 = _position_of(f, p_1, v_1, a_1), _velocity_of(f, p_1, v_1, a_1)
        a_2 = _attitude_of(f, v_1, a_1)
        p_3, v_3 = _position_of(f, p_2, v_2, a_2), _velocity_of(f, p_2, v_2, a_2)
        a_3 = _attitude_of(f, v_2, a_2)
        a_4 = _attitude_of(f, v_3, a_3)
        v, a = (v_0, v_1, v_2, v_3), (a_0, a_1, a_2, a_3, a_4)
        mean_v = _put_sums(
            weights=_MEAN, first=0, noise=noise, j=3, terms=v, factors=factors, row=0, i=i
        )
        _put_sums(weights=_SLOPE, first=1, noise=noise, j=3, terms=v, factors=factors, row=3, i=i)
        mean_a = _put_sums(
            weights=_MEAN, first=0, noise=noise, j=6, terms=a, factors=factors, row=6, i=i
        )
        _put_sums(weights=_SLOPE, first=1, noise=noise, j=6, terms=a, factors=factors, row=9, i=i)
        _put_sums(weights=_CURVE, first=2, noise=noise, j=6, terms=a, factors=factors, row=12, i=i)
        keep(columns, i, 0, _sum(_sum(_sum(p_0, 1.0, p_1), _END[2], p_2), _END[3], p_3))
        keep(columns, i, 3, _sum(_sum(_sum(v_0, 1.0, v_1), _END[2], v_2), _END[3], v_3))
        total = _sum(_sum(_sum(a_0, 1.0, a_1), _END[2], a_2), _END[3], a_3)
        keep(columns, i, 6, _sum(total, _END[4], a_4))
        keep(columns, i, 9, _sum(three(columns, i, 9), -1.0, _in_body(f, mean_a)))
        keep(columns, i, 12, _sum(three(columns, i, 12), 1.0, _in_body(f, mean_v)))
    return 15
