"""Compiled iterated, robust update of an extended Kalman filter for eight runs.

The update minimises J(x) = ½ (x − x⁻)ᵀ P⁻¹ (x − x⁻) + Σ ρ(r(x)), where r are the whitened residuals
of a measurement and ρ is a loss. Gauss–Newton steps (Bell & Cathey 1993) are halved until J
decreases. Every x is written as x⁻ + P λ, so P is not inverted. A run that has converged stays
unchanged while other runs of the group iterate, so its result does not depend on them.
"""

from __future__ import annotations

import numpy as np

from ..numerics import lane_algebra
from ..numerics.kernels import compiled, inlined
from ..numerics.lanes import each, flags, lanes, numbers
from ..numerics.records import record
from ..numerics.vectors import load, splat, store
from .robust_weights import NONE, ROUNDS, loss_of, reweigh, weight_of
from .whitened_measurements import Batch, LinearisedMeasurement, linearise

_CONVERGED = 1e-6
"""Decrease of the cost below which an update has converged: a thousandth of a deviation."""


@record
class Rules:
    """Options of an iterated update.

    Attributes
    ----------
    iterations : largest number of linearisations; 1 is a linear update.
    halvings : largest number of trial steps. The first is the full step; each further one is half
        of the previous one.
    loss, threshold : robust loss, see :mod:`.robust_weights`. With a loss,
        ``whole`` of :class:`.LinearisedMeasurement` must be true.
    settled : whether the weights of a loss are iterated to convergence at each linearisation,
        instead of following from the residuals at the linearisation point.
    """

    iterations: int
    halvings: int
    loss: int
    threshold: float
    settled: bool


@record
class Search:
    """Iterated updates of eight runs at an epoch, one run per lane.

    Attributes
    ----------
    batch, rules : arrays and update rules of all runs.
    reading : measurement, linearised at x.
    start : (1, n, lanes) predicted state x⁻.
    dual : (1, n, lanes) λ with x = x⁻ + P λ.
    step : (1, n, lanes) Gauss–Newton step of λ.
    tried : (1, n, lanes) λ of the latest shortened step.
    rows, innovation : (equations, n, lanes), (1, equations, lanes) whitened H and innovation
        relative to x⁻, from the last linearisation; a loss multiplies both by the roots of its
        weights.
    hp, s, white, half, gain : scratch. After :func:`update`, s is the Cholesky factor of H P Hᵀ + I
        in the form of :func:`.lane_algebra.factorise`.
    cost : (lanes,) J(x).
    seeking, trying : (lanes,) whether a run has not converged; whether a step of the run is being
        halved.
    weights : (1, equations, lanes) weights that the loss gives to the equations; ones without a
        loss.
    weight : (equations,) scratch.
    counts : (lanes, 2) number of linearisations, and of evaluations of h, so far.
    """

    batch: Batch
    rules: Rules
    reading: LinearisedMeasurement
    start: np.ndarray
    dual: np.ndarray
    step: np.ndarray
    tried: np.ndarray
    rows: np.ndarray
    innovation: np.ndarray
    hp: np.ndarray
    s: np.ndarray
    white: np.ndarray
    half: np.ndarray
    gain: np.ndarray
    cost: np.ndarray
    seeking: np.ndarray
    trying: np.ndarray
    weights: np.ndarray
    weight: np.ndarray
    counts: np.ndarray


@compiled
def search_of(batch: Batch, rules: Rules, reading: LinearisedMeasurement) -> Search:
    """Return unfilled arrays for iterated updates, in the shapes of :class:`Search`."""
    n, equations = batch.prior_cov.shape[0], reading.rows.shape[0]
    weights = lanes(1, equations)
    weights[:] = 1.0
    seeking = flags()
    return Search(
        batch=batch,
        rules=rules,
        reading=reading,
        start=lanes(1, n),
        dual=lanes(1, n),
        step=lanes(1, n),
        tried=lanes(1, n),
        rows=lanes(equations, n),
        innovation=lanes(1, equations),
        hp=lanes(equations, n),
        s=lanes(equations, equations),
        white=lanes(1, equations),
        half=lanes(equations, n),
        gain=lanes(equations, n),
        cost=numbers(0.0),
        seeking=seeking,
        trying=flags(),
        weights=weights,
        weight=np.zeros(equations),
        counts=np.zeros((len(seeking), 2), dtype=np.int64),
    )


@compiled
def minimise(
    out: Search, group: np.ndarray, count: int, k: int, x: np.ndarray, p: np.ndarray
) -> None:
    """Move x from the prediction to the most probable state.

    The linearised equations of the update are written to ``out.rows`` and ``out.innovation``.

    Parameters
    ----------
    out : the search; ``out.reading`` must be linearised at x, and is overwritten.
    group : (lanes,) index of the run in each lane; unused lanes repeat a run.
    count : number of different runs in the group.
    k : epoch.
    x, p : (1, n, lanes), (n, n, lanes) predicted mean and covariance; x is overwritten.
    """
    rules, m = out.rules, out.rows.shape[0]
    lane_algebra.copy(x, out.start)
    for j in range(x.shape[1]):
        store(out.dual, 0, j, splat(0.0))
    for r in each():
        out.seeking[r] = r < count
        out.trying[r] = False
        out.cost[r] = _left(out, r)
        out.counts[r, 1] += 1
    for iteration in range(rules.iterations):
        _take(out, x, p, iteration == 0)
        for r in each():
            out.counts[r, 0] += out.seeking[r]
        if rules.iterations == 1:
            return
        lane_algebra.project(out.rows, p, m, out.hp, out.s)
        lane_algebra.factorise(out.s, m, out.s)
        lane_algebra.whiten(out.s, m, out.innovation, out.white)
        lane_algebra.solve_lower(out.s, m, out.rows, out.half)
        for j in range(x.shape[1]):
            store(out.step, 0, j, splat(0.0) - load(out.dual, 0, j))
        lane_algebra.correct(out.half, out.white, m, out.step)
        _descend(out, group, count, k, x, p)
        if not out.seeking.any():
            return


@compiled
def update(out: Search, x: np.ndarray, p: np.ndarray, scratch: np.ndarray) -> None:
    """Update the covariance P (n, n, lanes) with the linearised equations of a search.

    The equations are in ``out.rows`` and ``out.innovation``. If ``out.rules.iterations`` is 1, x
    (1, n, lanes) is updated too.

    ``scratch`` (n, n, lanes) is overwritten.
    """
    m = out.rows.shape[0]
    lane_algebra.kalman_gain(
        rows=out.rows, p=p, m=m, hp=out.hp, lower=out.s, half=out.half, gain=out.gain
    )
    if out.rules.iterations == 1:
        lane_algebra.whiten(out.s, m, out.innovation, out.white)
        lane_algebra.correct(out.half, out.white, m, x)
    lane_algebra.joseph(
        gain=out.gain, hp=out.hp, rows=out.rows, m=m, p=p, scratch=scratch, change=out.half
    )


@compiled
def _left(out: Search, r: int) -> float:
    """Return the sum Σ ρ of a run's residuals at its linearisation point."""
    reading, rules = out.reading, out.rules
    total = 0.5 * reading.squared[0, 0, r]
    for c in range(reading.innovation.shape[1]):
        total += loss_of(reading.innovation[0, c, r], rules.loss, rules.threshold)
    return total


@compiled
def _take(out: Search, x: np.ndarray, p: np.ndarray, first: bool) -> None:
    """Fill the equations of unconverged runs, linearised at x and relative to x⁻.

    A loss multiplies the equations by the square roots of its weights. ``first`` states whether
    this is the first linearisation of the update.
    """
    reading, rules = out.reading, out.rules
    m, n = out.rows.shape[0], out.rows.shape[1]
    for r in each():
        if out.seeking[r]:
            for c in range(m):
                total = reading.innovation[0, c, r]
                for j in range(n):
                    out.rows[c, j, r] = reading.rows[c, j, r]
                    total += reading.rows[c, j, r] * (x[0, j, r] - out.start[0, j, r])
                out.innovation[0, c, r] = total
    if rules.loss == NONE:
        return
    lane_algebra.project(out.rows, p, m, out.hp, out.s)
    rounds = ROUNDS if rules.settled else 0
    for r in each():
        if out.seeking[r]:
            if rules.settled or first:
                reweigh(
                    out.s,
                    out.innovation,
                    m,
                    r,
                    loss=rules.loss,
                    threshold=rules.threshold,
                    rounds=rounds,
                    weight=out.weight,
                )
            for c in range(m):
                if not (rules.settled or first):
                    left = reading.innovation[0, c, r]
                    out.weight[c] = weight_of(left, rules.loss, rules.threshold)
                out.weights[0, c, r] = out.weight[c]
                root = np.sqrt(out.weight[c])
                out.innovation[0, c, r] *= root
                for j in range(n):
                    out.rows[c, j, r] *= root


@compiled
def _descend(
    out: Search, group: np.ndarray, count: int, k: int, x: np.ndarray, p: np.ndarray
) -> None:
    """Halve the step of each run until its cost decreases, and mark the converged runs.

    A run has converged if the decrease is negligible. On return the measurement is linearised at x
    for all runs that have not converged.
    """
    n = x.shape[1]
    before = out.cost.copy()
    out.trying[:] = out.seeking
    part = 1.0
    for _ in range(out.rules.halvings):
        for j in range(n):
            for r in each():
                # One that has found its x is evaluated there again.
                moved = part * out.step[0, j, r] if out.trying[r] else 0.0
                out.tried[0, j, r] = out.dual[0, j, r] + moved
        _place(out.start, p, out.tried, x)
        linearise(out.batch, group, count, k, x, out.reading)
        for r in each():
            if out.trying[r]:
                out.counts[r, 1] += 1
                total = 0.0
                for j in range(n):
                    total += out.tried[0, j, r] * (x[0, j, r] - out.start[0, j, r])
                cost = 0.5 * total + _left(out, r)
                if cost < out.cost[r]:
                    out.cost[r] = cost
                    out.trying[r] = False
                    for j in range(n):
                        out.dual[0, j, r] = out.tried[0, j, r]
        if not out.trying.any():
            break
        part *= 0.5
    _place(out.start, p, out.dual, x)
    for r in each():
        if before[r] - out.cost[r] < _CONVERGED:
            out.seeking[r] = False


@inlined
def _place(start: np.ndarray, p: np.ndarray, dual: np.ndarray, x: np.ndarray) -> None:
    """Fill x (1, n) with x⁻ + P λ."""
    for i in range(p.shape[0]):
        total = splat(0.0)
        for j in range(p.shape[0]):
            total += load(p, i, j) * load(dual, 0, j)
        store(x, 0, i, load(start, 0, i) + total)
