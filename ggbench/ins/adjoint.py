"""The adjoint of the INS error model over one IMU interval, for a group of runs at once.

A row y of Φ, as a column, obeys y' = Fᵀ y backwards in time: one sparse product per order of a
Taylor series. Over the interval y is a polynomial, and what noise adds to Q = ∫ Φ G q Gᵀ Φᵀ ds, the
integral of products of polynomials, is a sum over their first Legendre coefficients. Arrays have
the runs last, see :mod:`ggbench.numerics.lanes`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..numerics.kernels import compiled, inlined
from ..numerics.lanes import lanes
from ..numerics.vectors import load, store
from .known_gravity import COMPONENT
from .system_matrix import (
    ATTITUDE,
    BODY,
    DAMPING,
    DECAY,
    DISTANCE,
    DRIVEN,
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
"""How many factors of Q an interval has at most, see :func:`back`."""

_LAST = 5
"""Order of the last term: F's chain bias → attitude → velocity → position ends after three
products, and what comes back is 1e-4 of it in an interval. The fifth is for biases that wander:
over a tenth of their time constant, the longest interval allowed, it is 8e-8 of what remains of
them and 3e-8 of their Q, and the sixth is 1e-9. (Of Q without them the fifth is below 1e-12 even in
intervals of a second.)"""
DISTURBANCE = STATES
"""The first of three states that come after the others where the gravity disturbance is one."""
_HEIGHT = STATES + 3
"""Where a term has what an altimeter's noise enters by, after its numbers."""


class Noise(NamedTuple):
    """What drives the error model: G q Gᵀ by its square roots.

    Attributes
    ----------
    roots : (15,) of the diagonal, without the altimeter's part.
    altimeter : (2,) in δh and δv_U, of what couples them.
    damped : whether there is an altimeter. wandering : whether biases decay or are driven.
    disturbance : (3,) what drives the gravity disturbance ENU, of no elements where it is no state:
        √2 σ [m/s²], whose PSD is 2 σ² |v|/D; or what the speed multiplies [s⁻¹˙⁵] where gradients
        are integrated, whose noise has the PSD of a walk.
    """

    roots: np.ndarray
    altimeter: np.ndarray
    damped: bool
    wandering: bool
    disturbance: np.ndarray


def noise_roots(noise: np.ndarray, decaying: bool, disturbance: tuple[float, ...] = ()) -> Noise:
    """Return the square roots of G q Gᵀ (15, 15): diagonal but for what an altimeter couples.

    ``decaying`` says that F makes biases decay; ``disturbance`` is :attr:`Noise.disturbance`.
    """
    altimeter, diagonal = np.zeros(2), np.diag(noise).copy()
    if noise[2, 2] > 0.0:
        altimeter = noise[2, [2, 5]] / math.sqrt(noise[2, 2])
        diagonal[[2, 5]] -= altimeter**2
    roots = np.sqrt(np.maximum(diagonal, 0.0))
    wandering = decaying or bool(roots[NAVIGATION_STATES:].any())
    driven = np.array(disturbance, dtype=float)
    return Noise(roots, altimeter, bool(altimeter.any()), wandering, driven)


@inlined
def _transpose(f: np.ndarray, n: int, scale: float, terms: np.ndarray, k: int) -> None:
    """Fill term k + 1 with scale · Fᵀ y of term k, y; the entries of F are ``f[n]``."""
    p_0, p_1 = scale * load(terms, k, 0), scale * load(terms, k, 1)
    p_2 = scale * load(terms, k, 2)
    v_0, v_1 = scale * load(terms, k, 3), scale * load(terms, k, 4)
    v_2 = scale * load(terms, k, 5)
    a_0, a_1 = scale * load(terms, k, 6), scale * load(terms, k, 7)
    a_2 = scale * load(terms, k, 8)
    position = load(f, n, 0) * p_0 + load(f, n, 3) * p_1
    velocity = entries_dot(f, n, VELOCITY, 5, v_0, v_1, v_2)
    store(terms, k + 1, 0, position + velocity + entries_dot(f, n, ATTITUDE, 3, a_0, a_1, a_2))
    store(terms, k + 1, 1, entries_dot(f, n, LONGITUDE, 1, v_0, v_1, v_2))
    position = load(f, n, 1) * p_0 + load(f, n, 4) * p_1 + load(f, n, DAMPING) * p_2
    velocity = entries_dot(f, n, VELOCITY + 1, 5, v_0, v_1, v_2)
    store(terms, k + 1, 2, position + velocity + entries_dot(f, n, ATTITUDE + 1, 3, a_0, a_1, a_2))
    attitude = load(f, n, ATTITUDE + 5) * a_1 + load(f, n, ATTITUDE + 8) * a_2
    velocity = load(f, n, 5) * p_1 + entries_dot(f, n, VELOCITY + 2, 5, v_0, v_1, v_2)
    store(terms, k + 1, 3, velocity + attitude)
    velocity = load(f, n, 2) * p_0 + entries_dot(f, n, VELOCITY + 3, 5, v_0, v_1, v_2)
    store(terms, k + 1, 4, velocity + load(f, n, ATTITUDE + 2) * a_0)
    store(terms, k + 1, 5, p_2 + entries_dot(f, n, VELOCITY + 4, 5, v_0, v_1, v_2))
    f_0, f_1, f_2 = load(f, n, FORCE), load(f, n, FORCE + 1), load(f, n, FORCE + 2)
    w_0, w_1, w_2 = load(f, n, TURN), load(f, n, TURN + 1), load(f, n, TURN + 2)
    store(terms, k + 1, 6, (f_2 * v_1 - f_1 * v_2) + (w_1 * a_2 - w_2 * a_1))
    store(terms, k + 1, 7, (f_0 * v_2 - f_2 * v_0) + (w_2 * a_0 - w_0 * a_2))
    store(terms, k + 1, 8, (f_1 * v_0 - f_0 * v_1) + (w_0 * a_1 - w_1 * a_0))
    d_g, d_a = scale * load(f, n, DECAY), scale * load(f, n, DECAY + 1)
    for axis in range(3):
        turned = entries_dot(f, n, BODY + axis, 3, a_0, a_1, a_2)
        store(terms, k + 1, 9 + axis, d_g * load(terms, k, 9 + axis) - turned)
        pushed = entries_dot(f, n, BODY + axis, 3, v_0, v_1, v_2)
        store(terms, k + 1, 12 + axis, d_a * load(terms, k, 12 + axis) + pushed)


@inlined
def _transpose_disturbance(f: np.ndarray, n: int, scale: float, terms: np.ndarray, k: int) -> None:
    """Fill the numbers of term k + 1 that belong to the gravity disturbance.

    δv' = … − δg, as the accelerometers do not feel gravity; δg' = −(|v|/D) δg + w, or, where
    gradients are integrated along the indicated velocity, δg' = −T δv − ω_en × δg + w.
    """
    decay = load(f, n, DISTANCE)
    g_0, g_1 = scale * load(terms, k, DISTURBANCE), scale * load(terms, k, DISTURBANCE + 1)
    g_2 = scale * load(terms, k, DISTURBANCE + 2)
    w_0, w_1 = load(f, n, TRANSPORT), load(f, n, TRANSPORT + 1)
    w_2 = load(f, n, TRANSPORT + 2)
    v_0, v_1 = scale * load(terms, k, 3), scale * load(terms, k, 4)
    v_2 = scale * load(terms, k, 5)
    store(terms, k + 1, DISTURBANCE, decay * g_0 - v_0 + (w_1 * g_2 - w_2 * g_1))
    store(terms, k + 1, DISTURBANCE + 1, decay * g_1 - v_1 + (w_2 * g_0 - w_0 * g_2))
    store(terms, k + 1, DISTURBANCE + 2, decay * g_2 - v_2 + (w_0 * g_1 - w_1 * g_0))
    for axis in range(3):
        a, b, c = COMPONENT[axis, 0], COMPONENT[axis, 1], COMPONENT[axis, 2]
        pulled = load(f, n, SENSED + a) * g_0 + load(f, n, SENSED + b) * g_1
        pulled = pulled + load(f, n, SENSED + c) * g_2
        store(terms, k + 1, 3 + axis, load(terms, k + 1, 3 + axis) - pulled)


@inlined
def _series(
    f: np.ndarray, n: int, dt: float, columns: np.ndarray, i: int, terms: np.ndarray
) -> None:
    """Fill the terms of the Taylor series of exp(Fᵀ dt) y of column ``i``, y itself the first."""
    for j in range(columns.shape[1]):
        store(terms, 0, j, load(columns, i, j))
    for k in range(_LAST):
        _transpose(f, n, dt / (k + 1), terms, k)
        if columns.shape[1] > STATES:
            _transpose_disturbance(f, n, dt / (k + 1), terms, k)


@compiled
def series_terms() -> np.ndarray:
    """Return an array for the terms of a series: (6, 19, LANES), order by order."""
    return lanes(_LAST + 1, STATES + 4)


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
        for k in range(_LAST + 1)
    )


_ONES = (1.0,) * (_LAST + 1)
_MEAN, _SLOPE, _CURVE = (_legendre_weights(degree) for degree in range(3))


@inlined
def _weighted(weights: tuple[float, ...], first: int, terms: np.ndarray, j: int) -> float:
    """Return the sum of number ``j`` of weighted terms from ``first`` on, small terms first."""
    total = weights[_LAST] * load(terms, _LAST, j)
    for k in range(_LAST - 1, first - 1, -1):
        total = weights[k] * load(terms, k, j) + total
    return total


@inlined
def _add_up(terms: np.ndarray, columns: np.ndarray, i: int) -> None:
    """Put the sum of a series into column ``i``."""
    for j in range(columns.shape[1]):
        store(columns, i, j, _weighted(_ONES, 0, terms, j))


@inlined
def _mean(terms: np.ndarray, j: int) -> float:
    """Return b_0 of number ``j`` of y in an interval, from its series."""
    return _weighted(_MEAN, 0, terms, j)


@inlined
def _slope(terms: np.ndarray, j: int) -> float:
    """Return b_1."""
    return _weighted(_SLOPE, 1, terms, j)


@inlined
def _curve(terms: np.ndarray, j: int) -> float:
    """Return b_2, the last that matters: the chain noise → position ends with it."""
    return _weighted(_CURVE, 2, terms, j)


@compiled
def back(
    f: np.ndarray,
    n: int,
    dt: float,
    noise: Noise,
    columns: np.ndarray,
    terms: np.ndarray,
    factors: np.ndarray,
) -> int:
    """Take columns (C, 15 or 18, LANES) back over an interval, y ← exp(Fᵀ dt) y.

    Parameters
    ----------
    f, n : (., ENTRIES, LANES) of F, and which of them is the interval's. dt : the interval [s].
    noise : over the interval.
    columns : changed in place. terms : of :func:`series_terms`, overwritten.
    factors : (MOST_FACTORS, C, LANES) output: with W the first of them, the interval's noise adds
        WᵀW to Q. b_0 and b_1 of the velocity's elements, b_0 to b_2 of the attitude's; with an
        altimeter b_0 to b_2 of its own and b_2 of the velocity's; of biases that wander, and of the
        gravity disturbance, b_0 to b_2.

    Returns
    -------
    How many factors there are.
    """
    count = 0
    for i in range(columns.shape[0]):
        _series(f, n, dt, columns, i, terms)
        for axis in range(3):
            v, a = 3 + axis, 6 + axis
            store(factors, axis, i, noise.roots[v] * _mean(terms, v))
            store(factors, 3 + axis, i, noise.roots[v] * _slope(terms, v))
            store(factors, 6 + axis, i, noise.roots[a] * _mean(terms, a))
            store(factors, 9 + axis, i, noise.roots[a] * _slope(terms, a))
            store(factors, 12 + axis, i, noise.roots[a] * _curve(terms, a))
        count = 15
        if noise.damped:
            k_1, k_2 = noise.altimeter[0], noise.altimeter[1]
            for k in range(_LAST + 1):
                store(terms, k, _HEIGHT, k_1 * load(terms, k, 2) + k_2 * load(terms, k, 5))
            store(factors, count, i, _mean(terms, _HEIGHT))
            store(factors, count + 1, i, _slope(terms, _HEIGHT))
            store(factors, count + 2, i, _curve(terms, _HEIGHT))
            for v in range(3, 6):
                store(factors, count + v, i, noise.roots[v] * _curve(terms, v))
            count += 6
        if noise.wandering:
            for j in range(NAVIGATION_STATES, STATES):
                store(factors, count, i, noise.roots[j] * _mean(terms, j))
                store(factors, count + 1, i, noise.roots[j] * _slope(terms, j))
                store(factors, count + 2, i, noise.roots[j] * _curve(terms, j))
                count += 3
        if columns.shape[1] > STATES:
            driven = load(f, n, DRIVEN)
            for axis in range(3):
                root, j = noise.disturbance[axis] * driven, DISTURBANCE + axis
                store(factors, count, i, root * _mean(terms, j))
                store(factors, count + 1, i, root * _slope(terms, j))
                store(factors, count + 2, i, root * _curve(terms, j))
                count += 3
        _add_up(terms, columns, i)
    return count


@compiled
def forward(f: np.ndarray, n: int, dt: float, columns: np.ndarray, terms: np.ndarray) -> None:
    """Take columns (C, 15, LANES) forward over an interval, y ← exp(−Fᵀ dt) y; see :func:`back`."""
    for i in range(columns.shape[0]):
        _series(f, n, -dt, columns, i, terms)
        _add_up(terms, columns, i)
