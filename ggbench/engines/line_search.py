"""Compiled Gauss–Newton searches for most probable trajectories, with halved steps.

Each iteration linearises h about the whole trajectory and solves the linear problem with a Kalman
filter and smoother (Bell 1994). It halves the step until the cost decreases. This is the
line-search iterated extended Kalman smoother of Särkkä & Svensson 2020.

Eight searches are processed in parallel, one per lane; they may belong to different runs. A search
that has ended stays unchanged.

The motion cost ½ M(x, x) of a trajectory x is the cost of the prior and of the process noise. The
linear problem about a trajectory a has the measurement equations H x = y + noise of unit variance.
Let b be its minimum. Between a and b the motion cost is quadratic, so M(a, a), M(a, b) and M(b, b)
define it. At b the gradient of the linear problem is zero: M(b, a − b) = (y − H b)ᵀ H (a − b).
Therefore M(a, b) needs no stored multipliers:

    M(a, b) = M(b, b) + |y − H b|² − (y − H b)ᵀ (y − H a).
"""

from __future__ import annotations

import math

import numpy as np

from ..numerics import lane_algebra, lanes
from ..numerics.kernels import compiled
from ..numerics.records import record
from ..numerics.vectors import load, splat, store
from .linear_problems import (
    BatchProblem,
    CostTerms,
    Linearisation,
    Smoother,
    gather_motions,
    linearise_track,
    relinearise_epoch,
    smoother_of,
)
from .robust_weights import NONE, loss_of
from .smoother_passes import (
    backward_pass,
    covariances,
    filter_epoch,
    filter_track,
    restore_filter_state,
)
from .whitened_measurements import (
    Batch,
    LinearisedMeasurement,
    linearise,
    readings_of,
    take_readings,
    whiten_residuals,
)

HALVINGS = 15
CONVERGED = 1e-6
"""Decrease of the cost below which a search has ended: a thousandth of a standard deviation."""


@record
class MapSearches:
    """J searches for the trajectory of maximum posterior probability.

    Attributes
    ----------
    runs : (J,) index of the run of each search.
    states : (J, K, n) trajectories.
    start : (J, n) λ; the state before the first epoch is prior_mean + P_0 λ.
    motion : (J,) twice the motion cost of the trajectory.
    about : (J, K, n) trajectories of the latest linearisation.
    cost : (J,) cost of the trajectory: negative log posterior without constants.
    iterations : (J,) number of steps.
    evaluations : (J,) number of evaluations of h.
    converged : (J,) whether the predicted or the actual decrease of the cost in the last step is
        below the limit of convergence. The linear problem predicts the decrease. The value is False
        if no trial step decreases the cost.
    """

    runs: np.ndarray
    states: np.ndarray
    start: np.ndarray
    motion: np.ndarray
    about: np.ndarray
    cost: np.ndarray
    iterations: np.ndarray
    evaluations: np.ndarray
    converged: np.ndarray


@record
class TrialSlots:
    """Trial steps of line searches, evaluated together, one per slot.

    A search may use several slots.

    Attributes
    ----------
    lane, share : (lanes,) lane of the slot's search; trial step as a fraction of the Gauss–Newton
        step of this search.
    group : (lanes,) index of the run of the slot's search.
    left : (lanes,) sum of the losses ρ of the residuals after the trial step.
    x : (1, n, lanes) scratch.
    """

    lane: np.ndarray
    share: np.ndarray
    group: np.ndarray
    left: np.ndarray
    x: np.ndarray


@compiled
def _evaluate(smoother: Smoother, count: int, slots: TrialSlots) -> None:
    """Fill ``slots.left``, the sums of losses after the trial steps of ``count`` slots."""
    problems, path, reading = smoother.problems, smoother.path, smoother.reading
    n = path.states.shape[2]
    slots.left[:] = 0.0
    for k in range(path.moving.shape[0]):
        states, trial = path.states[k], path.trial[k]
        for s in lanes.each():
            lane, share = slots.lane[s], slots.share[s]
            for j in range(n):
                here = states[0, j, lane]
                slots.x[0, j, s] = here + share * (trial[0, j, lane] - here)
        take_readings(problems.batch, slots.group, k, reading)
        whiten_residuals(problems.batch, slots.group, count, k, slots.x, reading)
        _add_losses(problems, reading, slots.left)


@compiled
def _left(costs: CostTerms, r: int) -> float:
    """Return Σ ρ of the residuals along the linearisation trajectory of lane ``r``."""
    return 0.5 * (costs.unexplained[0, 0, r] + costs.explained[0, 0, r])


@compiled
def _add_losses(problems: BatchProblem, reading: LinearisedMeasurement, left: np.ndarray) -> None:
    """Add Σ ρ of the residuals of a measurement to ``left`` (lanes,)."""
    for c in range(reading.residual.shape[1]):
        for r in lanes.each():
            residual = reading.residual[0, c, r]
            if problems.loss == NONE:
                left[r] += 0.5 * residual * residual
            else:
                left[r] += loss_of(residual, problems.loss, problems.threshold)


@compiled
def _mixed_motion(path: Linearisation, costs: CostTerms, mixed: np.ndarray) -> None:
    """Fill ``mixed`` (1, 1, lanes) with M(a, b) of trajectories a and trial trajectories b."""
    total = load(costs.motion, 0, 0) + load(costs.promised, 0, 0)
    for k in range(path.moving.shape[0]):
        rows, target, states, trial = path.rows[k], path.target[k], path.states[k], path.trial[k]
        for c in range(rows.shape[0]):
            here = there = load(target, 0, c)
            for j in range(rows.shape[1]):
                row = load(rows, c, j)
                here -= row * load(states, 0, j)
                there -= row * load(trial, 0, j)
            total -= here * there
    store(mixed, 0, 0, total)


@compiled
def assign_trials(
    trying: np.ndarray, halved: np.ndarray, group: np.ndarray, slots: TrialSlots
) -> int:
    """Assign the next trial steps of unfinished line searches to evaluation slots.

    Each unfinished search gets the same number of slots, or fewer if it has fewer trial steps left.
    The slots contain successive halvings of its Gauss–Newton step.

    Parameters
    ----------
    trying : (lanes,) mask of the searches whose cost has not decreased yet, one search per lane.
    halved : (lanes,) number of trial steps that each search has evaluated.
    group : (lanes,) run of each search.
    slots : ``lane``, ``share`` and ``group`` are filled; unused slots repeat the first slot.

    Returns
    -------
    Number of used slots.
    """
    share, used = len(trying) // trying.sum(), 0
    for r in lanes.each():
        if trying[r]:
            for e in range(min(share, HALVINGS - halved[r])):
                slots.lane[used], slots.group[used] = r, group[r]
                slots.share[used] = 0.5 ** (halved[r] + e)
                used += 1
    for s in range(used, len(trying)):
        slots.lane[s], slots.group[s] = slots.lane[0], slots.group[0]
        slots.share[s] = slots.share[0]
    return used


@compiled
def _to_lanes(tracks: np.ndarray, which: np.ndarray, out: np.ndarray) -> None:
    """Copy the trajectories (J, K, n) of searches ``which`` (lanes,) to (K, 1, n, lanes)."""
    for r in lanes.each():
        for k in range(out.shape[0]):
            for j in range(out.shape[2]):
                out[k, 0, j, r] = tracks[which[r], k, j]


@compiled
def _out_of_lanes(values: np.ndarray, first: int, count: int, tracks: np.ndarray) -> None:
    """Copy (K, 1, n, lanes) to trajectories (J, K, n) of ``count`` searches from ``first`` on."""
    for r in range(count):
        for k in range(values.shape[0]):
            for j in range(values.shape[2]):
                tracks[first + r, k, j] = values[k, 0, j, r]


@compiled
def search(problems: BatchProblem, most: int, enough: float, found: MapSearches) -> None:
    """Run Gauss–Newton searches until they converge or reach the largest number of steps.

    Parameters
    ----------
    problems : problems of all runs.
    most : largest number of steps of a search.
    enough : a search has converged if the actual or predicted decrease of the cost in a step is
        smaller than this.
    found : J searches; all arrays except ``runs`` are updated.
    """
    searches, epochs, n = found.states.shape
    smoother = smoother_of(problems)
    path, work, costs = smoother.path, smoother.work, smoother.costs
    mixed, cost, moved = lanes.lanes(1, 1), lanes.numbers(0.0), lanes.numbers(0.0)
    share, before = lanes.numbers(0.0), lanes.numbers(0.0)
    promise = lanes.numbers(0.0)  # of the linear problem: by how much the cost falls
    slots = TrialSlots(
        lane=lanes.integers(),
        share=lanes.numbers(0.0),
        group=lanes.integers(),
        left=lanes.numbers(0.0),
        x=lanes.lanes(1, n),
    )
    seeking, trying = lanes.flags(), lanes.flags()
    halved, group = lanes.integers(), lanes.integers()
    for first in lanes.group_starts(searches):
        count, own = lanes.count_from(first, searches), lanes.group_members(first, searches)
        for r in lanes.each():
            group[r], moved[r] = found.runs[own[r]], found.motion[own[r]]
        _to_lanes(found.states, own, path.states)
        _to_lanes(found.states, own, path.trial)
        gather_motions(smoother, group)
        linearise_track(smoother, group, count)
        for r in lanes.each():
            cost[r] = 0.5 * moved[r] + _left(costs, r)
            seeking[r] = r < count and np.isfinite(cost[r])
        fresh = True  # whether the linear problems are those about the trajectories
        for _ in range(most):
            if not seeking.any():
                break
            if not fresh:
                for k in range(epochs):
                    lane_algebra.copy(path.states[k], path.trial[k])
                linearise_track(smoother, group, count)
            filter_track(smoother)
            backward_pass(smoother)
            _mixed_motion(path, costs, mixed)
            for r in lanes.each():
                linear = costs.motion[0, 0, r] + costs.promised[0, 0, r]
                promise[r] = 0.5 * (moved[r] + costs.weighted[0, 0, r] - linear)
                if seeking[r] and promise[r] < enough:
                    # The last step is taken without evaluating h at its end, where rounding could
                    # hide its gain.
                    cost[r] -= max(promise[r], 0.0)
                    moved[r], seeking[r] = costs.motion[0, 0, r], False
                    found.iterations[first + r] += 1
                    found.converged[first + r] = True
                    _move(path, 1.0, r, first + r, work.back, found)
            if not seeking.any():
                break
            # Most often the whole step is taken: its end is where h is to be linearised next.
            linearise_track(smoother, group, count)
            for r in lanes.each():
                before[r], share[r], halved[r] = cost[r], 0.0, 1
                new = 0.5 * costs.motion[0, 0, r] + _left(costs, r)
                if seeking[r] and new < cost[r]:
                    cost[r], moved[r], share[r] = new, costs.motion[0, 0, r], 1.0
                trying[r] = seeking[r] and share[r] == 0.0
            fresh = not trying.any()
            while trying.any():
                used = assign_trials(trying, halved, group, slots)
                _evaluate(smoother, used, slots)
                for s in range(used):
                    r, part = slots.lane[s], slots.share[s]
                    if not trying[r]:
                        continue
                    halved[r] += 1
                    rest = 1.0 - part
                    motion = rest * rest * moved[r] + 2.0 * rest * part * mixed[0, 0, r]
                    motion += part * part * costs.motion[0, 0, r]
                    new = 0.5 * motion + slots.left[s]
                    if new < cost[r]:
                        cost[r], moved[r], share[r] = new, motion, part
                    trying[r] = share[r] == 0.0 and halved[r] < HALVINGS
            for r in range(count):
                if seeking[r]:
                    job = first + r
                    found.iterations[job] += 1
                    found.evaluations[job] += epochs * (1 + halved[r])
                    seeking[r] = not before[r] - cost[r] < enough
                    stuck = share[r] == 0.0 and not promise[r] < enough
                    found.converged[job] = not seeking[r] and not stuck
                    _move(path, share[r], r, job, work.back, found)
        for r in range(count):
            found.cost[first + r], found.motion[first + r] = cost[r], moved[r]
            found.evaluations[first + r] += epochs
        _out_of_lanes(path.states, first, count, found.states)


@compiled
def _move(
    path: Linearisation, share: float, r: int, job: int, back: np.ndarray, found: MapSearches
) -> None:
    """Apply the fraction ``share`` of the Gauss–Newton step of search ``job`` in lane ``r``.

    The previous trajectory is stored in ``found.about``. ``back`` (1, n, lanes) are the starts λ of
    the solutions of the linear problems.
    """
    about = found.about[job]
    for j in range(found.start.shape[1]):
        start = found.start[job, j]
        found.start[job, j] = start + share * (back[0, j, r] - start)
    for k in range(path.moving.shape[0]):
        states, trial = path.states[k], path.trial[k]
        for j in range(states.shape[1]):
            here = states[0, j, r]
            about[k, j] = here
            # A whole step to the last bit: about its end the next problem is linearised already.
            moved = here + share * (trial[0, j, r] - here)
            states[0, j, r] = trial[0, j, r] if share == 1.0 else moved


@compiled
def undisturbed(batch: Batch, found: MapSearches) -> None:
    """Propagate the starts of J searches without process noise.

    ``states`` (J, K, n) and ``motion`` (J,) of ``found`` are filled; ``start`` is the input.
    """
    n = batch.prior_cov.shape[0]
    x, moved = np.empty(n), np.empty(n)
    for job in range(found.runs.shape[0]):
        found.motion[job] = 0.0
        for i in range(n):
            away = 0.0
            for j in range(n):
                away += batch.prior_cov[i, j] * found.start[job, j]
            x[i] = batch.prior_mean[0, i] + away
            found.motion[job] += found.start[job, i] * away
        for k in range(found.states.shape[1]):
            phi = batch.transition[found.runs[job], k]
            for i in range(n):
                moved[i] = 0.0
                for j in range(n):
                    moved[i] += phi[i, j] * x[j]
            for i in range(n):
                x[i] = found.states[job, k, i] = moved[i]


@compiled
def filtered_tracks(batch: Batch, found: MapSearches) -> None:
    """Fill ``states`` (J, K, n) with the smoothed trajectories of an extended Kalman filter.

    ``start`` (J, n) and ``motion`` (J,) of these trajectories are also filled.
    """
    runs, epochs, n = found.states.shape
    smoother = smoother_of(BatchProblem(batch, NONE, np.inf))
    path, work = smoother.path, smoother.work
    for first in lanes.group_starts(runs):
        count, group = lanes.count_from(first, runs), lanes.group_members(first, runs)
        gather_motions(smoother, group)
        restore_filter_state(smoother, -1)
        for k in range(epochs):
            predicted = path.trial[k]
            lane_algebra.copy(work.x, predicted)
            lane_algebra.move(path.phi[k], path.moving[k], predicted, work.scratch)
            linearise(batch, group, count, k, predicted, smoother.reading)
            relinearise_epoch(smoother, k)
            filter_epoch(smoother, k)
        backward_pass(smoother)
        for r in range(count):
            found.motion[first + r] = smoother.costs.motion[0, 0, r]
            for j in range(n):
                found.start[first + r, j] = work.back[0, j, r]
        _out_of_lanes(path.trial, first, count, found.states)


@compiled
def answer(problems: BatchProblem, found: MapSearches, mean: np.ndarray, cov: np.ndarray) -> None:
    """Fill mean (J, K, n) and smoothed covariance (J, K, n, n) of the searches' trajectories.

    The covariance uses the last linearisation of each search.
    """
    searches, last = found.states.shape[0], found.states.shape[1] - 1
    smoother = smoother_of(problems)
    path = smoother.path
    for first in lanes.group_starts(searches):
        count = lanes.count_from(first, searches)
        _filter_again(smoother, found, first)
        covariances(
            path,
            path.states,
            newest=last,
            oldest=0,
            final=last,
            first=first,
            count=count,
            mean=mean,
            cov=cov,
        )


@compiled
def ends(
    problems: BatchProblem,
    found: MapSearches,
    mean: np.ndarray,
    cov: np.ndarray,
    log_width: np.ndarray,
) -> None:
    """Fill mean (J, 1, n) and covariance (J, 1, n, n) at the last epoch, and log widths (J,).

    A log width is ½ ln (det of the posterior covariance of the whole trajectory / det of its prior
    covariance). It equals −½ Σ ln det S_k with the innovation covariances S_k in units of the
    noise.
    """
    searches = found.states.shape[0]
    smoother = smoother_of(problems)
    path, lower = smoother.path, smoother.path.updates.lower
    for first in lanes.group_starts(searches):
        count = lanes.count_from(first, searches)
        _filter_again(smoother, found, first)
        last = path.states[path.states.shape[0] - 1]
        lanes.scatter(x=last, p=smoother.work.p, first=first, count=count, k=0, mean=mean, cov=cov)
        for r in range(count):
            total = 0.0
            for k in range(lower.shape[0]):
                for c in range(lower.shape[1]):
                    total += math.log(lower[k, c, c, r])  # of the inverse of the root's diagonal
            log_width[first + r] = total


@compiled
def _filter_again(smoother: Smoother, found: MapSearches, first: int) -> None:
    """Run the Kalman filter on the latest linearised problems of a group of searches."""
    searches, path, group = found.states.shape[0], smoother.path, lanes.integers()
    count, own = lanes.count_from(first, searches), lanes.group_members(first, searches)
    for r in lanes.each():
        group[r] = found.runs[own[r]]
    _to_lanes(found.states, own, path.states)
    _to_lanes(found.about, own, path.trial)
    gather_motions(smoother, group)
    linearise_track(smoother, group, count)
    filter_track(smoother)


@compiled
def screen(
    problems: BatchProblem,
    along: np.ndarray,
    shown: np.ndarray,
    places: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add the losses of the residuals at some epochs to ``out`` (R, S), for S starts.

    The states are propagated without noise from each start.

    Parameters
    ----------
    along : (n, d) matrix that maps coordinates (d,) of a start to the state before the first epoch.
    shown : (K,) mask of the epochs whose residuals are used.
    places : (d, vectors, lanes) coordinates of the starts, eight starts per vector.
    """
    batch, (n, d) = problems.batch, along.shape
    runs, epochs = batch.measurements.shape[:2]
    reading = readings_of(batch)
    x, left = lanes.lanes(1, n), lanes.numbers(0.0)
    for run in range(runs):
        group = lanes.group_members(run, run + 1)
        base, gain = batch.prior_mean[0].copy(), along.copy()
        for k in range(epochs):
            phi = batch.transition[run, k]
            base, gain = phi @ base, phi @ gain
            if not shown[k]:
                continue
            take_readings(batch, group, k, reading)
            for v, first in enumerate(lanes.group_starts(out.shape[1])):
                for i in range(n):
                    total = splat(base[i])
                    for a in range(d):
                        total += splat(gain[i, a]) * load(places, a, v)
                    store(x, 0, i, total)
                whiten_residuals(batch, group, len(group), k, x, reading)
                left[:] = 0.0
                _add_losses(problems, reading, left)
                for r in range(lanes.count_from(first, out.shape[1])):
                    out[run, first + r] += left[r]
