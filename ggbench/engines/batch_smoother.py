"""The batch solution of many runs at once, compiled: the factor graph's problem by smoothers.

Each step linearises h about the whole trajectory and solves the linear problem exactly
(:mod:`.smoother_passes`). Steps are those of GTSAM's Levenberg–Marquardt optimizer, which remains
the reference: the same damping, the same rules by which steps are taken and the search ends
(:mod:`.step_rules`), so that it ends at the same minimum where there are several.

Eight runs take their steps together, each by its own decisions and with its own damping; one that
has ended stays where it is.
"""

from __future__ import annotations

import numpy as np

from ..block import ProblemBlock
from ..numerics import lane_algebra, lanes
from ..numerics.kernels import compiled
from .robust_weights import NONE, number_of
from .smoother_passes import (
    Costs,
    Path,
    Work,
    costs_of,
    covariances,
    filter_epoch,
    gather_motion,
    go_back,
    judge,
    path_of,
    put_back,
    set_damping,
    take_trial,
    with_damping,
    work_of,
)
from .step_rules import FIRST_DAMPING, LEAST_FELT, arrived, decide, is_last_step
from .whitened_measurements import Batch, batch_of, linearise, readings_of


@compiled
def _smooth(
    batch: Batch,
    most: int,
    loss: int,
    threshold: float,
    mean: np.ndarray,
    cov: np.ndarray,
    iterations: np.ndarray,
    errors: np.ndarray,
    evaluations: np.ndarray,
) -> None:
    """Solve the problems of a block, see :func:`smoother`."""
    runs, epochs, n = batch.transition.shape[:3]
    expected = lanes.moving_states(batch.transition, batch.process_cov)
    reading = readings_of(batch, loss != NONE)
    m = reading.rows.shape[0]
    path, work, damping_work = path_of(epochs, n, m), work_of(n, m), work_of(n, n)
    costs = costs_of()
    cost, unexplained, linear = lanes.numbers(0.0), lanes.numbers(0.0), lanes.numbers(0.0)
    base = lanes.numbers(0.0)  # the cost by the linear problem: with a loss another one
    damping, felt = lanes.numbers(0.0), lanes.numbers(0.0)
    active = felt != felt
    for first in lanes.starts(runs):
        count, group = lanes.count_from(first, runs), lanes.members(first, runs)
        active[:] = False
        active[:count] = True
        damping[:] = FIRST_DAMPING
        lanes.spread(batch.prior_mean, work.x)
        # The undisturbed motion from the prior's mean.
        for k in range(epochs):
            gather_motion(batch, group, k, expected, path)
            lane_algebra.move(path.phi[k], path.moving[k], work.x, work.scratch)
            lane_algebra.copy(work.x, path.trial[k])
        costs.motion[:] = 0.0
        begun = damped = False
        while active.any():
            costs.unexplained[:] = 0.0
            costs.explained[:] = 0.0
            costs.weighted[:] = 0.0
            for k in range(epochs):
                linearise(batch, group, count, k, path.trial[k], reading)
                judge(path, reading, k, loss, threshold, costs)
                for r in range(count):
                    if not active[r]:
                        put_back(path, k, r)
            felt[:] = 0.0
            for r in range(count):
                if not active[r]:
                    continue
                run = first + r
                evaluations[run] += epochs
                left = costs.unexplained[0, 0, r]
                new_cost = 0.5 * (costs.motion[0, 0, r] + left + costs.explained[0, 0, r])
                good, final = True, False
                if begun:
                    good, final, damping[r] = decide(
                        cost[r], base[r], linear[r], new_cost, damping[r]
                    )
                if good:
                    take_trial(path, r)
                    cost[r], unexplained[r] = new_cost, left
                    base[r] = 0.5 * (costs.motion[0, 0, r] + left + costs.weighted[0, 0, r])
                    if begun:
                        iterations[run] += 1
                        final |= iterations[run] >= most
                else:
                    for k in range(epochs):
                        put_back(path, k, r)
                active[r] = not final
                if active[r] and damping[r] >= LEAST_FELT:
                    felt[r] = damping[r]
            begun = True
            damped = bool(felt.any())
            if damped and path.damping.gains.shape[0] == 0:
                path = with_damping(path)
            _filter(batch, path, felt, work, damping_work)
            if active.any():
                go_back(path, batch.prior_cov, damped, work, damping_work, costs)
                for r in range(count):
                    linear[r] = _linear_cost(costs, unexplained[r], r)
                    active[r] &= not arrived(base[r], linear[r])
        if damped:  # what is kept of the filter is undamped
            felt[:] = 0.0
            _filter(batch, path, felt, work, damping_work)
        # The filter has gone along the final trajectories: one step more, too small to be judged.
        go_back(path, batch.prior_cov, False, work, damping_work, costs)
        for r in range(count):
            errors[first + r] = cost[r]
            if is_last_step(base[r], _linear_cost(costs, unexplained[r], r)):
                take_trial(path, r)
        last = epochs - 1
        covariances(path, path.states, last, 0, last, first, count, mean, cov)


@compiled
def _linear_cost(costs: Costs, unexplained: float, r: int) -> float:
    """Return the cost of a run's trial by its linear problem."""
    return 0.5 * (costs.motion[0, 0, r] + unexplained + costs.promised[0, 0, r])


@compiled
def _filter(batch: Batch, path: Path, damping: np.ndarray, work: Work, damping_work: Work) -> None:
    """Filter the linear problems of a group, each run with its own damping λ (lanes,)."""
    damped = bool(damping.any())
    if damped:
        set_damping(path, damping, batch.prior_cov)
    lanes.spread(batch.prior_mean, work.x)
    lanes.spread(batch.prior_cov, work.p)
    for k in range(path.rows.shape[0]):
        filter_epoch(path, k, damped, work, damping_work)


def smoother(
    block: ProblemBlock, most: int, loss: str = "none", threshold: float = np.inf
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Solve the batch problem of every run.

    Parameters
    ----------
    block : the runs.
    most : limit of the steps.
    loss, threshold : on each whitened component of a reading, see :mod:`.robust_weights`.

    Returns
    -------
    mean (R, K, n), NaN where no step could be taken; cov (R, K, n, n) given all readings; counters.
    """
    runs, epochs, n = block.runs, block.epochs, block.dimension
    mean, cov = np.empty((runs, epochs, n)), np.empty((runs, epochs, n, n))
    iterations, evaluations = np.zeros(runs, dtype=np.int64), np.zeros(runs, dtype=np.int64)
    error = np.zeros(runs)
    _smooth(
        batch_of(block), most, number_of(loss, threshold), threshold,
        mean, cov, iterations, error, evaluations,
    )  # fmt: skip
    mean[(iterations == 0) & (error > 0.0)] = np.nan  # it gave up
    return mean, cov, {"iterations": iterations, "error": error, "map_evaluations": evaluations}
