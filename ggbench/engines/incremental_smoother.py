"""Compiled incremental smoothing of many runs by Kalman smoothers, equal to iSAM2.

Each node has a linearisation point. Every epoch adds a node, linearised at the predicted state.
Nodes whose estimate has moved from this point by a threshold or more are relinearised at the
estimate. Then the linear problem is solved exactly. GTSAM's ISAM2 (Kaess et al. 2012) has the same
rules if its wildfire threshold is zero; tests compare with it. ISAM2 eliminates the affected part
of a Bayes tree. Here a Kalman filter restarts from the oldest relinearised node, and the
multipliers of :mod:`.smoother_passes` are propagated back through all nodes.

In a sliding window (GTSAM's IncrementalFixedLagSmoother) a node leaves the window when it is older
than the newest measurement by more than the lag. The linearisation of this node is then final. The
oldest node in the window is coupled to the node that left, so its linearisation is also final.

Eight runs are processed in parallel: the filter restarts at the oldest node that is relinearised in
any of the eight runs.
"""

from __future__ import annotations

import numpy as np

from ..block import ProblemBlock
from ..numerics import lane_algebra, lanes
from ..numerics.kernels import compiled
from .linear_problems import (
    BatchProblem,
    Linearisation,
    gather_motion,
    relinearise_epoch,
    smoother_of,
)
from .robust_weights import number_of
from .smoother_passes import covariances, filter_epoch, restore_filter_state, smooth_back
from .whitened_measurements import batch_of, linearise


@compiled
def _smooth(
    problems: BatchProblem,
    limits: np.ndarray,
    leaving: np.ndarray,
    mean: np.ndarray,
    cov: np.ndarray,
    relinearized: np.ndarray,
) -> None:
    """Solve the problems of a block.

    Parameters
    ----------
    limits, leaving : see :func:`smoother`; empty without a window.
    mean, cov, relinearized : (R, K, n), (R, K, n, n), (R,) output.
    """
    runs, epochs = problems.batch.measurements.shape[:2]
    solver = smoother_of(problems)
    path, work = solver.path, solver.work
    windowed = leaving.shape[0] > 0
    for first in lanes.group_starts(runs):
        count, group = lanes.count_from(first, runs), lanes.group_members(first, runs)
        oldest = 0
        for k in range(epochs):
            if windowed and leaving[k] > oldest:
                covariances(
                    path,
                    path.trial,
                    newest=k - 1,
                    oldest=oldest,
                    final=leaving[k] - 1,
                    first=first,
                    count=count,
                    mean=mean,
                    cov=cov,
                )
            gather_motion(solver, group, k)
            if k == 0:
                lanes.broadcast(problems.batch.prior_mean, work.x)
            else:
                lane_algebra.copy(path.trial[k - 1], work.x)
            lane_algebra.move(path.phi[k], path.moving[k], work.x, work.scratch)
            lane_algebra.copy(work.x, path.trial[k])
            lane_algebra.copy(work.x, path.states[k])
            begin = k
            for j in range(k, oldest - 1, -1):
                fixed = j == oldest and oldest > 0
                if j == k or (not fixed and _moved(path, j, limits, group, count, relinearized)):
                    linearise(problems.batch, group, count, j, path.trial[j], solver.reading)
                    relinearise_epoch(solver, j)
                    begin = j
            restore_filter_state(solver, begin - 1)
            for j in range(begin, k + 1):
                filter_epoch(solver, j)
            if windowed:
                oldest = leaving[k]
            else:
                lanes.scatter(x=work.x, p=work.p, first=first, count=count, k=k, mean=mean, cov=cov)
            smooth_back(solver, k, oldest)
        if windowed:
            covariances(
                path,
                path.trial,
                newest=epochs - 1,
                oldest=oldest,
                final=epochs - 1,
                first=first,
                count=count,
                mean=mean,
                cov=cov,
            )


@compiled
def _moved(
    path: Linearisation,
    j: int,
    limits: np.ndarray,
    group: np.ndarray,
    count: int,
    relinearized: np.ndarray,
) -> bool:
    """Update the linearisation points of node ``j``; return whether any point has changed.

    If any state of a run has moved from its point by the limit or more, the estimate becomes the
    point. Otherwise the trial state is reset to the point, so the linearisation does not change.
    """
    states, trial = path.states[j], path.trial[j]
    n = limits.shape[1]
    some = False
    for r in lanes.each():
        moved = False
        for i in range(n):
            moved |= abs(trial[0, i, r] - states[0, i, r]) >= limits[group[r], i]
        for i in range(n):
            if moved:
                states[0, i, r] = trial[0, i, r]
            else:
                trial[0, i, r] = states[0, i, r]
        if moved and r < count:
            relinearized[group[r]] += 1
        some |= moved
    return some


def smoother(
    block: ProblemBlock,
    limits: np.ndarray,
    leaving: np.ndarray | None = None,
    loss: str = "none",
    threshold: float = np.inf,
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Smooth every run incrementally, measurement by measurement.

    Parameters
    ----------
    block : block of R runs.
    limits : (R, n) smallest change of each state that causes relinearisation of its node.
    leaving : (K,) index of the oldest node in the window at each epoch. Earlier nodes are final.
        None means no window: the output at each epoch is the newest node at that epoch.
    loss, threshold : robust loss on each whitened component of a measurement, see
        :mod:`.robust_weights`.

    Returns
    -------
    mean (R, K, n) and covariance (R, K, n, n) of each final node, and counters by name.
    """
    runs, epochs, n = block.runs, block.epochs, block.dimension
    mean, cov = np.empty((runs, epochs, n)), np.empty((runs, epochs, n, n))
    relinearized = np.zeros(runs, dtype=np.int64)
    if leaving is None:
        leaving = np.empty(0, dtype=np.int64)
    problems = BatchProblem(batch_of(block), number_of(loss, threshold), threshold)
    _smooth(problems, limits, leaving, mean, cov, relinearized)
    evaluations = relinearized + epochs
    return mean, cov, {"relinearized": relinearized, "map_evaluations": evaluations}
