"""Problems of eight runs, linearised about trajectories, and the arrays of a smoother."""

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
    """A block of runs, and the robust loss of whitened residuals, see :mod:`.robust_weights`."""

    batch: Batch
    loss: int
    threshold: float


@record
class Updates:
    """Data of the measurement updates of all epochs, for the backward pass.

    Attributes
    ----------
    gains : (K, m, n, lanes) transposed Kalman gains.
    lower : (K, m, m, lanes) Cholesky factors of S, see :func:`.lane_algebra.factorise`.
    pulls : (K, m, 1, lanes) S⁻¹ y with the innovation y.
    """

    gains: np.ndarray
    lower: np.ndarray
    pulls: np.ndarray


@record
class Linearisation:
    """Linearised problems of a group of runs, and results of the Kalman filter.

    Attributes
    ----------
    moving : (K,) number of states that Φ changes. They precede all other states.
    phi, q : (K, n, n, lanes) rows of Φ and Q of these states.
    rows, target : (K, m, n, lanes), (K, 1, m, lanes) H and y of the linearised measurement
        equations H x = y + noise of unit variance.
    states, trial : (K, 1, n, lanes) the current trajectory and the trial trajectory.
    filtered, half_cov : (K, 1, n, lanes), (K, 1, n (n + 1) / 2, lanes) filtered state x_f and lower
        half of its covariance P_f.
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
    """Scratch arrays for one epoch with m measurement equations."""

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
    """Terms of the cost of trial trajectories; shape (1, 1, lanes) each.

    Attributes
    ----------
    unexplained : sum of squares of the part of the measurements that does not depend on the states.
    explained : sum of squares of the residuals of the part that depends on the states; with a loss,
        twice the sum of the losses of these residuals.
    weighted : sum of squares of these residuals with the weights of the loss; equal to
        ``explained`` without a loss.
    promised : value that the linear problem predicts for ``weighted``.
    motion : twice the motion cost, which is the cost of prior and process noise.
    """

    unexplained: np.ndarray
    explained: np.ndarray
    weighted: np.ndarray
    promised: np.ndarray
    motion: np.ndarray


@record
class Smoother:
    """Arrays of a smoother that processes groups of eight runs one after the other.

    Attributes
    ----------
    problems : problems of all runs.
    expected : expected number of states that Φ changes, see :func:`.lanes.gather`.
    reading : the latest linearised measurement.
    path, costs : linearised problems and cost terms of the current group.
    work : scratch for measurement updates.
    """

    problems: BatchProblem
    expected: int
    reading: LinearisedMeasurement
    path: Linearisation
    costs: CostTerms
    work: Scratch


@compiled
def scratch_of(n: int, m: int) -> Scratch:
    """Return scratch arrays for n states and m measurement equations."""
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
    """Return the unfilled arrays of a smoother, in the shapes of :class:`Linearisation`."""
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
    """Fill Φ and Q of a group of runs (lanes,) at epoch ``k``."""
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
    """Fill Φ and Q of ``smoother`` at all epochs, for a group (lanes,) of runs."""
    for k in range(smoother.path.moving.shape[0]):
        gather_motion(smoother, group, k)


@compiled
def linearise_track(smoother: Smoother, group: np.ndarray, count: int) -> None:
    """Linearise about the trial trajectories of a group.

    Parameters
    ----------
    smoother : ``path.trial`` is the input; ``path.rows``, ``path.target`` and ``costs`` are filled.
    group : (lanes,) index of the run in each lane; unused lanes repeat a run.
    count : number of different runs in the group.
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
    """Store the linearised equations H x = y of epoch ``k``: H (m, n) and y (1, m).

    ``smoother.reading`` must be linearised at the trial trajectory before the call. The cost terms
    of the epoch are added to ``costs``. With a loss, each equation is multiplied by the square root
    of its weight.
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
    """Multiply each equation by the square root of its weight; add twice its loss to the cost."""
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
