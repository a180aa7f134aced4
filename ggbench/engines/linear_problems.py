"""Linearised problems of eight runs about their trajectories, and the arrays of a smoother."""

from __future__ import annotations

import math

import numpy as np

from ..numerics import lane_algebra, lanes
from ..numerics.kernels import compiled
from ..numerics.records import record
from ..numerics.vectors import load, store
from .robust_weights import NONE, loss_of, weight_of
from .whitened_measurements import Batch, LinearisedMeasurement, linearise, readings_of


@record
class BatchProblem:
    """A block of runs, and the loss of whitened residuals, see :mod:`.robust_weights`."""

    batch: Batch
    loss: int
    threshold: float


@record
class Updates:
    """Data of the updates of all epochs for the backward pass.

    Attributes
    ----------
    gains, lower, pulls : (K, m, n, lanes), (K, m, m, lanes), (K, m, 1, lanes): Kᵀ, the root of S
        (see :func:`.lane_algebra.factorise`) and S⁻¹ y.
    """

    gains: np.ndarray
    lower: np.ndarray
    pulls: np.ndarray


@record
class Linearisation:
    """Linearised problems of a group about its trajectories, and results of the filter.

    Attributes
    ----------
    moving : (K,) number of states that Φ changes.
    phi, q : (K, n, n, lanes) rows of Φ and Q of these states.
    rows, target : (K, m, n, lanes), (K, 1, m, lanes): H x = target + noise of unit variance.
    states, trial : (K, 1, n, lanes) the trajectory and the trial trajectory.
    filtered, half_cov : (K, 1, n, lanes), (K, 1, n (n + 1) / 2, lanes): x_f and P_f, half of it.
    updates : data of the measurement updates.
    """

    moving: np.ndarray
    phi: np.ndarray
    q: np.ndarray
    rows: np.ndarray
    target: np.ndarray
    states: np.ndarray
    trial: np.ndarray
    filtered: np.ndarray
    half_cov: np.ndarray
    updates: Updates


@record
class Scratch:
    """Scratch for one epoch and measurements of m equations, named by its content."""

    x: np.ndarray
    p: np.ndarray
    scratch: np.ndarray
    other: np.ndarray
    hp: np.ndarray
    half: np.ndarray
    change: np.ndarray
    s: np.ndarray
    innovation: np.ndarray
    white: np.ndarray
    back: np.ndarray


@record
class CostTerms:
    """Sums along the trial trajectories, (1, 1, lanes) each.

    Attributes
    ----------
    unexplained : squares of the part that does not depend on the states.
    explained : squares of the other residuals, or twice their losses.
    weighted : their squares with the weights of a loss; without a loss equal to ``explained``.
    promised : predicted value of these from the linear problem.
    motion : the cost of the motion, twice.
    """

    unexplained: np.ndarray
    explained: np.ndarray
    weighted: np.ndarray
    promised: np.ndarray
    motion: np.ndarray


@record
class Smoother:
    """Arrays for smoothing one group of runs after the other.

    Attributes
    ----------
    problems : of all runs.
    expected : expected number of states that change, see :func:`.lanes.gather`.
    reading : latest linearised measurement.
    path, costs : of the group.
    work : scratch for the equations of readings.
    """

    problems: BatchProblem
    expected: int
    reading: LinearisedMeasurement
    path: Linearisation
    costs: CostTerms
    work: Scratch


@compiled
def scratch_of(n: int, m: int) -> Scratch:
    """Return the scratch for n states and m equations."""
    new = lanes.lanes
    return Scratch(
        x=new(1, n),
        p=new(n, n),
        scratch=new(n, n),
        other=new(n, n),
        hp=new(m, n),
        half=new(m, n),
        change=new(m, n),
        s=new(m, m),
        innovation=new(1, m),
        white=new(1, m),
        back=new(1, n),
    )


@compiled
def smoother_of(problems: BatchProblem) -> Smoother:
    """Return unfilled arrays for a group of runs, in the shapes of :class:`Linearisation`."""
    batch, new = problems.batch, lanes.series
    epochs, n = batch.transition.shape[1:3]
    reading = readings_of(batch, problems.loss != NONE)
    m = reading.rows.shape[0]
    path = Linearisation(
        moving=np.zeros(epochs, dtype=np.int64),
        phi=new(epochs, n, n),
        q=new(epochs, n, n),
        rows=new(epochs, m, n),
        target=new(epochs, 1, m),
        states=new(epochs, 1, n),
        trial=new(epochs, 1, n),
        filtered=new(epochs, 1, n),
        half_cov=new(epochs, 1, n * (n + 1) // 2),
        updates=Updates(new(epochs, m, n), new(epochs, m, m), new(epochs, m, 1)),
    )
    one = lanes.lanes
    return Smoother(
        problems=problems,
        expected=lanes.moving_states(batch.transition, batch.process_cov),
        reading=reading,
        path=path,
        costs=CostTerms(one(1, 1), one(1, 1), one(1, 1), one(1, 1), one(1, 1)),
        work=scratch_of(n, m),
    )


@compiled
def gather_motion(smoother: Smoother, group: np.ndarray, k: int) -> None:
    """Fill Φ and Q of a group of runs (lanes,) at an epoch."""
    batch, path = smoother.problems.batch, smoother.path
    path.moving[k] = lanes.gather(
        transition=batch.transition,
        process_cov=batch.process_cov,
        group=group,
        k=k,
        expected=smoother.expected,
        phi=path.phi[k],
        q=path.q[k],
    )


@compiled
def gather_motions(smoother: Smoother, group: np.ndarray) -> None:
    """Fill Φ and Q of a group of runs (lanes,) at all epochs."""
    for k in range(smoother.path.moving.shape[0]):
        gather_motion(smoother, group, k)


@compiled
def linearise_track(smoother: Smoother, group: np.ndarray, count: int) -> None:
    """Linearise about the trial trajectories of a group.

    Parameters
    ----------
    smoother : ``path.trial`` is read; ``path.rows``, ``path.target`` and ``costs`` are filled.
    group : (lanes,) runs, of which ``count`` differ.
    """
    path, costs = smoother.path, smoother.costs
    costs.unexplained[:] = 0.0
    costs.explained[:] = 0.0
    costs.weighted[:] = 0.0
    for k in range(path.moving.shape[0]):
        linearise(smoother.problems.batch, group, count, k, path.trial[k], smoother.reading)
        relinearise_epoch(smoother, k)


@compiled
def relinearise_epoch(smoother: Smoother, k: int) -> None:
    """Replace H (m, n) and its target (1, m) of epoch ``k`` by those about the trial trajectory.

    Costs are added up. With a loss, each equation is multiplied by the root of its weight.
    """
    problems, reading = smoother.problems, smoother.reading
    path, costs = smoother.path, smoother.costs
    rows, target, trial = path.rows[k], path.target[k], path.trial[k]
    m, n = rows.shape[0], rows.shape[1]
    if problems.loss != NONE:
        _weigh(smoother)
    weighted = load(costs.weighted, 0, 0)
    for c in range(m):
        new = load(reading.innovation, 0, c)
        weighted += new * new
        for j in range(n):
            new += load(reading.rows, c, j) * load(trial, 0, j)
        store(target, 0, c, new)
    store(costs.weighted, 0, 0, weighted)
    if problems.loss == NONE:
        store(costs.explained, 0, 0, weighted)
    total = load(costs.unexplained, 0, 0) + load(reading.squared, 0, 0)
    store(costs.unexplained, 0, 0, total)
    lane_algebra.copy(reading.rows, rows)


@compiled
def _weigh(smoother: Smoother) -> None:
    """Multiply equations with the roots of their weights; add up twice their losses."""
    problems, reading, costs = smoother.problems, smoother.reading, smoother.costs
    loss, threshold = problems.loss, problems.threshold
    m, n = reading.rows.shape[0], reading.rows.shape[1]
    for r in lanes.each():
        for c in range(m):
            residual = reading.innovation[0, c, r]
            costs.explained[0, 0, r] += 2.0 * loss_of(residual, loss, threshold)
            root = math.sqrt(weight_of(residual, loss, threshold))
            reading.innovation[0, c, r] *= root
            for j in range(n):
                reading.rows[c, j, r] *= root
