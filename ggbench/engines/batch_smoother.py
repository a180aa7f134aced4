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
from .linear_problems import (
    Costs,
    Problems,
    gather_motions,
    linearise_track,
    put_back,
    smoother_of,
    take_trial,
    with_damping,
)
from .robust_weights import number_of
from .smoother_passes import covariances, filter_track, go_back, set_damping
from .step_rules import FIRST_DAMPING, LEAST_FELT, arrived, decide, is_last_step
from .whitened_measurements import batch_of


@compiled
def _smooth(
    problems: Problems,
    most: int,
    mean: np.ndarray,
    cov: np.ndarray,
    iterations: np.ndarray,
    errors: np.ndarray,
    evaluations: np.ndarray,
) -> None:
    """Solve the problems of a block, see :func:`smoother`."""
    runs, epochs = problems.batch.measurements.shape[:2]
    solver = smoother_of(problems)
    path, work, costs = solver.path, solver.work, solver.costs
    cost, unexplained, linear = lanes.numbers(0.0), lanes.numbers(0.0), lanes.numbers(0.0)
    base = lanes.numbers(0.0)  # the cost by the linear problem: with a loss another one
    damping, felt = lanes.numbers(0.0), lanes.numbers(0.0)
    active = felt != felt
    for first in lanes.starts(runs):
        count, group = lanes.count_from(first, runs), lanes.members(first, runs)
        active[:] = False
        active[:count] = True
        damping[:] = FIRST_DAMPING
        gather_motions(solver, group)
        # The undisturbed motion from the prior's mean.
        lanes.spread(problems.batch.prior_mean, work.x)
        for k in range(epochs):
            lane_algebra.move(path.phi[k], path.moving[k], work.x, work.scratch)
            lane_algebra.copy(work.x, path.trial[k])
        costs.motion[:] = 0.0
        begun = damped = False
        while active.any():
            linearise_track(solver, group, count)
            felt[:] = 0.0
            for r in range(count):
                if not active[r]:
                    put_back(path, r)
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
                    put_back(path, r)
                active[r] = not final
                if active[r] and damping[r] >= LEAST_FELT:
                    felt[r] = damping[r]
            begun = True
            damped = bool(felt.any())
            if damped:
                if path.damping.gains.shape[0] == 0:
                    solver = with_damping(solver)
                    path = solver.path
                set_damping(solver, felt)
            filter_track(solver, damped)
            if active.any():
                go_back(solver, damped)
                for r in range(count):
                    linear[r] = _linear_cost(costs, unexplained[r], r)
                    active[r] &= not arrived(base[r], linear[r])
        if damped:  # what is kept of the filter is undamped
            filter_track(solver, False)
        # The filter has gone along the final trajectories: one step more, too small to be judged.
        go_back(solver, False)
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
    problems = Problems(batch_of(block), number_of(loss, threshold), threshold)
    _smooth(problems, most, mean, cov, iterations, error, evaluations)
    mean[(iterations == 0) & (error > 0.0)] = np.nan  # it gave up
    return mean, cov, {"iterations": iterations, "error": error, "map_evaluations": evaluations}
