"""Compiled evaluation of the measurement function at the sigma points of eight runs."""

from __future__ import annotations

import numpy as np

from ..numerics.kernels import compiled, inlined
from ..numerics.lanes import lanes
from ..numerics.records import record
from ..numerics.vectors import load, splat, store
from ..sensors.gravity_kernels import bend_gravity_pairs
from ..sensors.model_arrays import ModelArrays, PointScratch, point_scratch
from ..sensors.model_kernels import Expansion, read

_NEAR, _STRAIGHT = 0.01, 1e-7
"""Displacement [m] and rotation [rad] of the instrument below which h is linearised."""


@record
class SigmaPoints:
    """Sigma points x ± d_q of eight runs and h at these points.

    The instrument errors B_k x are the errors of the gradiometer's position and attitude.

    Attributes
    ----------
    shift : (moving, n, lanes) instrument errors B_k d_q [m; rad] of the deviations d_q. ``moving``
        is the number of instrument errors.
    odd, even : (m, n, lanes) half the difference, and half the sum, of h(x + d_q) − h(x) and h(x −
        d_q) − h(x) [units of the channels].
    far : (lanes, n) indices q of the pairs at which h is evaluated instead of linearised.
    counts : (lanes,) number of these pairs.
    errors : (6, 2n, lanes) instrument errors B_k x of the evaluated points.
    found : (g, 2n, lanes) h of the g gradient channels at these points.
    chosen, points : scratch.
    """

    shift: np.ndarray
    odd: np.ndarray
    even: np.ndarray
    far: np.ndarray
    counts: np.ndarray
    errors: np.ndarray
    found: np.ndarray
    chosen: np.ndarray
    points: PointScratch


@compiled
def sigma_points_of(moving: int, n: int, m: int, g: int) -> SigmaPoints:
    """Return unfilled arrays for sigma points.

    Parameters
    ----------
    moving : number of instrument errors, from :func:`.moving_errors`.
    n, m, g : number of states, of channels, and of gradient channels.
    """
    chosen = lanes(1, 2)
    size = chosen.shape[2]
    return SigmaPoints(
        shift=lanes(moving, n),
        odd=lanes(m, n),
        even=lanes(m, n),
        far=np.zeros((size, n), dtype=np.int64),
        counts=np.zeros(size, dtype=np.int64),
        errors=lanes(6, 2 * n),
        found=lanes(g, 2 * n),
        chosen=chosen,
        points=point_scratch(2 * n),
    )


@compiled
def read_sigma_points(
    model: ModelArrays,
    group: np.ndarray,
    count: int,
    k: int,
    x: np.ndarray,
    lower: np.ndarray,
    spread: float,
    at: Expansion,
    out: SigmaPoints,
) -> None:
    """Fill ``odd`` and ``even`` of the sigma points x ± spread · L_q; L_q is column q of L.

    Parameters
    ----------
    model : arrays of h.
    group : (lanes,) index of the run in each lane; unused lanes repeat a run.
    count : number of different runs in the group.
    k : epoch.
    x : (1, n, lanes) mean states.
    lower : (n, n, lanes) Cholesky factor L of P.
    spread : factor on the columns of L.
    at : h and its derivative at x, already filled.
    out : output, including ``counts``.
    """
    shift, odd, even, counts = out.shift, out.odd, out.even, out.counts
    b, slope, gain = at.b, at.slope, at.context.gain
    moving, n, g = shift.shape[0], shift.shape[1], slope.shape[0]
    columns = b.shape[1]
    factor, zero = splat(spread), splat(0.0)
    for i in range(moving):
        for q in range(n):
            total = zero
            for j in range(q, columns):
                total += load(b, i, j) * load(lower, j, q)
            store(shift, i, q, factor * total)
    for c in range(odd.shape[0]):
        for q in range(n):
            total = zero
            if c < g:
                for i in range(moving):
                    total += load(slope, c, i) * load(shift, i, q)
            store(odd, c, q, total)
            store(even, c, q, zero)
    most = 0
    for r in range(counts.shape[0]):
        counts[r] = 0
        if r < count and g > 0 and gain[0, 0, r] != 0.0:
            counts[r] = _far(out, r)
            most = max(most, counts[r])
    if most > 0:
        _evaluate(model, k, most, _alike(count, out), at, out)
    _add_linear_pairs(model, lower, factor, at, odd)
    bend_gravity_pairs(
        model=model,
        group=group,
        count=count,
        k=k,
        x=x,
        lower=lower,
        spread=spread,
        odd=odd,
        even=even,
    )


@inlined
def _add_linear_pairs(
    model: ModelArrays, lower: np.ndarray, factor: float, at: Expansion, odd: np.ndarray
) -> None:
    """Add D d_q to ``odd``: the exact contribution of the linear part of h."""
    columns, n = model.columns, lower.shape[0]
    for c in range(model.first_linear, odd.shape[0]):
        first = 0
        for q in range(n):
            while first < columns.shape[0] and columns[first] < q:
                first += 1
            total = splat(0.0)
            for s in range(first, columns.shape[0]):
                total += load(at.linear, c, columns[s]) * load(lower, columns[s], q)
            store(odd, c, q, load(odd, c, q) + factor * total)


@compiled
def _far(out: SigmaPoints, r: int) -> int:
    """List the pairs of a run at which h is to be evaluated; return their number."""
    shift, far = out.shift, out.far
    moving, n = shift.shape[0], shift.shape[1]
    count = 0
    for q in range(n):
        size = turn = 0.0
        for i in range(3):
            size += shift[i, q, r] * shift[i, q, r]
        for i in range(3, moving):
            turn += shift[i, q, r] * shift[i, q, r]
        if not (size < _NEAR * _NEAR and turn < _STRAIGHT * _STRAIGHT):
            far[r, count] = q
            count += 1
    return count


@compiled
def _alike(count: int, points: SigmaPoints) -> int:
    """Return the number of leading pairs that are equal in the lists of ``count`` runs."""
    fewest = points.counts[0]
    for r in range(1, count):
        fewest = min(fewest, points.counts[r])
    for s in range(fewest):
        for r in range(1, count):
            if points.far[r, s] != points.far[0, s]:
                return s
    return fewest


@compiled
def _evaluate(
    model: ModelArrays, k: int, pairs: int, alike: int, at: Expansion, out: SigmaPoints
) -> None:
    """Evaluate h at the listed pairs of all runs, up to ``pairs`` pairs for each run.

    A run with fewer pairs is filled up with x. The first ``alike`` pairs are the same in all runs.
    """
    shift, odd, even, far, counts = out.shift, out.odd, out.even, out.far, out.counts
    errors, found, chosen = out.errors, out.found, out.chosen
    size = counts.shape[0]
    for i in range(shift.shape[0]):
        centre = load(at.errors, i, 0)
        for s in range(pairs):
            if s < alike:
                moved = load(shift, i, far[0, s])
            else:
                for r in range(size):
                    chosen[0, 0, r] = shift[i, far[r, s], r] if s < counts[r] else 0.0
                moved = load(chosen, 0, 0)
            # A point and its mirror image are neighbours.
            store(errors, i, 2 * s, centre + moved)
            store(errors, i, 2 * s + 1, centre - moved)
    read(
        model=model,
        k=k,
        context=at.context,
        errors=errors,
        vectors=2 * pairs,
        count=2 * pairs * size,
        points=out.points,
        out=found,
    )
    for c in range(found.shape[0]):
        centre = load(at.by_tensor, 0, c)
        for s in range(pairs):
            plus, minus = load(found, c, 2 * s) - centre, load(found, c, 2 * s + 1) - centre
            if s < alike:
                store(odd, c, far[0, s], 0.5 * (plus - minus))
                store(even, c, far[0, s], 0.5 * (plus + minus))
                continue
            store(chosen, 0, 0, 0.5 * (plus - minus))
            store(chosen, 0, 1, 0.5 * (plus + minus))
            for r in range(size):
                if s < counts[r]:
                    q = far[r, s]
                    odd[c, q, r], even[c, q, r] = chosen[0, 0, r], chosen[0, 1, r]
