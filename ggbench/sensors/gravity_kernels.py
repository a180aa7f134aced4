"""Compiled gravity-disturbance term of the measurement equation."""

from __future__ import annotations

import numpy as np

from ..gravity.ellipsoid import metres_per_radian_of
from ..gravity.spline import vector_at
from ..numerics.kernels import compiled, inlined
from ..numerics.rotations import sine_cosine
from .model_arrays import ModelArrays


@compiled
def disturbance_at(
    model: ModelArrays, run: int, k: int, error: np.ndarray, value: np.ndarray, slope: np.ndarray
) -> None:
    """Fill ``value`` with the gravity disturbance δg at a corrected INS position.

    The corrected position is the INS position minus ``error``.

    Parameters
    ----------
    model : arrays of a block.
    run : index of the run.
    k : epoch.
    error : (3,) position error ENU [m].
    value : (3,) output, δg, ENU [m/s²].
    slope : (3, 3) output, derivatives of δg with respect to the error to the east, to the north and
        upwards [s⁻²].
    """
    place = model.places[run, k]
    sine, cosine = sine_cosine(place[0])
    per_north, per_east = metres_per_radian_of(sine, cosine, place[2])
    at = np.empty(3)
    at[0] = place[0] - error[1] / per_north
    at[1] = place[1] - error[0] / per_east
    at[2] = place[2] - error[2]
    along = np.empty((3, 3))
    gravity = model.gravity
    vector_at(
        at, gravity.origin, gravity.step, gravity.coefficients, gravity.base,
        value, along,
    )  # fmt: skip
    for i in range(3):
        slope[i, 0] = -along[i, 1] / per_east
        slope[i, 1] = -along[i, 0] / per_north
        slope[i, 2] = -along[i, 2]


@inlined
def _weighs(weights: np.ndarray) -> bool:
    """Return whether any element of W_k (m, 3) of a run is non-zero."""
    for c in range(weights.shape[0]):
        for i in range(3):
            if weights[c, i] != 0.0:
                return True
    return False


@compiled
def add_gravity(
    model: ModelArrays,
    group: np.ndarray,
    count: int,
    k: int,
    x: np.ndarray,
    predicted: np.ndarray,
    slope: np.ndarray,
) -> None:
    """Add the gravity term W_k δg(p̂_k − x) of each run to h, and its derivative to H.

    :class:`.ModelArrays` defines the symbols.

    Parameters
    ----------
    model : arrays of a block.
    group : (lanes,) runs; unused lanes repeat a run.
    count : number of different runs in the group.
    k : epoch.
    x : (1, n, lanes) states, one run per lane.
    predicted : (1, m, lanes) h, to which the term is added.
    slope : (m, n, lanes) H, to which the derivative is added; (0, n, lanes) if H is not needed.
    """
    if model.gravity.coefficients.size == 0:
        return
    error, value, along = np.empty(3), np.empty(3), np.empty((3, 3))
    for r in range(count):
        weights = model.weights[group[r], k]
        if not _weighs(weights):
            continue
        for i in range(3):
            error[i] = x[0, i, r]
        disturbance_at(model, group[r], k, error, value, along)
        for c in range(weights.shape[0]):
            for i in range(3):
                predicted[0, c, r] += weights[c, i] * value[i]
                if slope.shape[0] > 0:
                    for j in range(3):
                        slope[c, j, r] += weights[c, i] * along[i, j]


@compiled
def bend_gravity_pairs(
    model: ModelArrays,
    group: np.ndarray,
    count: int,
    k: int,
    x: np.ndarray,
    lower: np.ndarray,
    spread: float,
    odd: np.ndarray,
    even: np.ndarray,
) -> None:
    """Add the nonlinear part of W_k δg to measurements predicted at pairs of sigma points.

    The sigma points are x ± d_q, with d_q = spread · L_q. ``odd`` and ``even`` are modified.
    :class:`.ModelArrays` defines W_k and δg.

    Parameters
    ----------
    model, group, count, k, x : as in :func:`add_gravity`.
    lower : (n, n, lanes) Cholesky factor L of P; L_q is column q.
    spread : factor on the columns of L.
    odd : (m, n, lanes) column q is [h(x + d_q) − h(x − d_q)] / 2.
    even : (m, n, lanes) column q is [h(x + d_q) + h(x − d_q)] / 2 − h(x).
    """
    if model.gravity.coefficients.size == 0:
        return
    error, centre, plus, minus = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    along, unused = np.empty((3, 3)), np.empty((3, 3))
    for r in range(count):
        run, weights = group[r], model.weights[group[r], k]
        if not _weighs(weights):
            continue
        for i in range(3):
            error[i] = x[0, i, r]
        disturbance_at(model, run, k, error, centre, along)
        for q in range(3):  # the others do not move the place
            for i in range(3):
                error[i] = x[0, i, r] + (spread * lower[i, q, r] if i >= q else 0.0)
            disturbance_at(model, run, k, error, plus, unused)
            for i in range(3):
                error[i] = x[0, i, r] - (spread * lower[i, q, r] if i >= q else 0.0)
            disturbance_at(model, run, k, error, minus, unused)
            for i in range(3):
                straight = 0.0
                for j in range(q, 3):
                    straight += along[i, j] * lower[j, q, r]
                bent = 0.5 * (plus[i] - minus[i]) - spread * straight
                mean = 0.5 * (plus[i] + minus[i]) - centre[i]
                for c in range(weights.shape[0]):
                    odd[c, q, r] += weights[c, i] * bent
                    even[c, q, r] += weights[c, i] * mean
