"""Compiled bank of filters of several hypotheses about model errors.

Eight pairs of a filter and a run are processed in parallel, one per lane. A hypothesis has one
filter, or two filters: one for its evidence and one for its estimates. The filters of a family have
the same states: those of the block, and added states of the hypothesis. The added states are
independent processes, so their part of Φ is block-diagonal with small blocks.
Propagation and update omit the zeros of Φ and H. A test compares each filter with the plain filter
of :mod:`.extended_filter` on a problem with dense matrices.
"""

from __future__ import annotations

import math

import numpy as np

from ..numerics import lane_algebra, lanes
from ..numerics.kernels import compiled
from ..numerics.records import record
from ..numerics.vectors import load, store
from ..sensors.model_arrays import ModelArrays
from .extended_filter import HALVINGS
from .hypothesis_algebra import Added, joseph, predict, project
from .iterated_update import Rules, minimise, search_of, update
from .robust_weights import NONE
from .whitened_measurements import (
    Batch,
    LinearisedMeasurement,
    linearise,
    readings_of,
    scale_equations,
)

NEGLIGIBLE = -25.0
"""Logarithm of the weight at the end of a stage below which a hypothesis is dropped."""


@record
class Families:
    """G families of filters and the added states of each family.

    A family has some or all of these added states, in this order:

    - an error process of ``orders`` states for each of the c map-matched channels;
    - the unknown gravity (3 states), optionally followed by a state with the constant value 1;
    - a constant error of each map-matched channel.

    Attributes
    ----------
    starts : (G + 1,) index of the first filter of each family; the last entry is the number of
        filters.
    orders : (G,) number of states of each error process; 0 without error processes.
    coupled : (G,) number of added states that act on the states of the block: 0, 3 or 4.
    constants : (G,) number of constant errors.
    losses, thresholds : (G,) robust losses, see :mod:`.robust_weights`.
    first_linear : (G,) ``first_linear`` of :class:`.ModelArrays` for each family.
    columns : ``columns`` of :class:`.ModelArrays` for each family, concatenated.
    column_starts : (G + 1,) start of each family in ``columns``; the last entry is the length of
        ``columns``.
    linears : matrices C_k (R, K, m, N) of the linear part of h for each family, concatenated.
    linear_starts : (G,) start of each family in ``linears``.
    roots : (G,) index into ``inverses`` of :class:`Bank`.
    gradients : (G,) number of measurement equations of the gradiometer.
    used, used_counts : (G, equations, .), (G, equations) indices of the states on which each
        measurement equation depends, and the number of these states. Only updates with one
        linearisation and no loss need them.
    """

    starts: np.ndarray
    orders: np.ndarray
    coupled: np.ndarray
    constants: np.ndarray
    losses: np.ndarray
    thresholds: np.ndarray
    first_linear: np.ndarray
    columns: np.ndarray
    column_starts: np.ndarray
    linears: np.ndarray
    linear_starts: np.ndarray
    roots: np.ndarray
    gradients: np.ndarray
    used: np.ndarray
    used_counts: np.ndarray


@record
class Bank:
    """F filters of J hypotheses, ordered by family; each filter processes R runs.

    Attributes
    ----------
    batch : the runs, without the added states.
    families : the families of filters.
    iterations : largest number of linearisations of h in each update without a loss.
    hypotheses : (F,) index of the hypothesis of each filter.
    evident, estimating : (F,) whether the evidence of a filter is used; whether its estimates are
        used.
    scales : (F, m) factors on the noise standard deviations of the channels.
    heights : (F, 2) reduction of ln max p, where p is the noise density of a channel. The reduction
        is relative to the assumed normal density. The first value is the effect of the noise factor
        and applies to map-matched channels. The second is the effect of the loss and applies to all
        channels.
    peaks : (R, K, 3) three values for each epoch. The first is ln max p of the assumed noise
        density p of all available channels, without the term in 2π. The second is the number of
        available map-matched channels. The third is the number of available channels.
    motions : (F,) row of ``moves`` and ``drives`` for each filter.
    moves : (., R, K, 5) transition matrix (2, 2) of an error process, flattened, and transition
        factor of the unknown gravity.
    drives : (., R, K, 5) process noise covariance (2, 2) of an error process of unit variance,
        flattened, and process noise variance of the unknown gravity.
    variances : (F, c) stationary variances of the error processes of c channels.
    priors : (F, .) prior variances of the added states.
    coupling : (R, K, n, 4) submatrix of Φ: effect of the coupled added states on the block's
        states.
    inverses : (., 1 or K, m, m) inverse Cholesky factors of noise covariances.
    square : array of zeros with as many elements as the largest P. For a family with N states, the
        first N² elements replace ``prior_cov`` in the batch.
    """

    batch: Batch
    families: Families
    iterations: int
    hypotheses: np.ndarray
    evident: np.ndarray
    estimating: np.ndarray
    scales: np.ndarray
    heights: np.ndarray
    peaks: np.ndarray
    motions: np.ndarray
    moves: np.ndarray
    drives: np.ndarray
    variances: np.ndarray
    priors: np.ndarray
    coupling: np.ndarray
    inverses: np.ndarray
    square: np.ndarray


@record
class Members:
    """M pairs of a filter and a run in a stage, and the states of all filters.

    The states are those at the beginning or at the end of the stage.

    Attributes
    ----------
    filters, runs : (M,) index of the filter of each pair; index of the run of each pair.
    slots : (M,) index into the S pairs (hypothesis, run) of :class:`Stage`.
    states : (F, R, .) mean and covariance of each filter for each run.
    """

    filters: np.ndarray
    runs: np.ndarray
    slots: np.ndarray
    states: np.ndarray


@record
class Stage:
    """Results of the epochs of a stage, for S pairs (hypothesis, run).

    Attributes
    ----------
    first, stop : first epoch of the stage, and the epoch after its last.
    mean, cov : (S, epochs, n), (S, epochs, n, n) estimates; covariances have only the lower half.
    evidence : (S, epochs) log evidence of each epoch.
    counts : (R,) number of evaluations of h.
    """

    first: int
    stop: int
    mean: np.ndarray
    cov: np.ndarray
    evidence: np.ndarray
    counts: np.ndarray


@compiled
def follow(
    bank: Bank,
    begin: int,
    ends: np.ndarray,
    chosen: np.ndarray,
    means: np.ndarray,
    covs: np.ndarray,
    logs: np.ndarray,
    mean: np.ndarray,
    cov: np.ndarray,
    weights: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Fill the mixture estimates of the chosen runs from epoch ``begin`` on.

    At the end of each stage, hypotheses with negligible weight are dropped. If all hypotheses of a
    run fail, its later results are NaN.

    Parameters
    ----------
    bank : the filters.
    begin, ends : first epoch; epoch after the last one of each stage.
    chosen : (R,) mask of the chosen runs.
    means, covs : (R, n), (R, n, n) mean and covariance of the block's states before epoch
        ``begin``.
    logs : (J, R) log weights of the hypotheses before epoch ``begin``; overwritten.
    mean, cov : (R, K, n), (R, K, n, n) mixture estimates, output.
    weights : (J, R, K) log weights of the hypotheses, output.
    counts : (R,) number of evaluations of h, increased.
    """
    n, filters, runs = means.shape[1], len(bank.hypotheses), len(chosen)
    largest = n + bank.priors.shape[1]
    states = np.empty((filters, runs, largest * (largest + 1)))
    slots = np.empty(logs.shape, dtype=np.int64)
    for f in range(filters):
        for run in range(runs):
            if chosen[run]:
                _begin(bank, f, means[run], covs[run], states[f, run])
    first = begin
    for stop in ends:
        count, limit = 0, -math.inf if first == begin else NEGLIGIBLE
        for run in range(runs):
            for j in range(logs.shape[0]):
                slots[j, run] = -1
                if chosen[run] and logs[j, run] > limit:
                    slots[j, run] = count
                    count += 1
        stage = Stage(
            first=first,
            stop=stop,
            mean=np.empty((count, stop - first, n)),
            cov=np.empty((count, stop - first, n, n)),
            evidence=np.empty((count, stop - first)),
            counts=counts,
        )
        for g in range(len(bank.families.orders)):
            members = _members(bank, g, slots, states)
            if len(members.filters) > 0:
                _advance(bank, g, members, stage)
        for run in range(runs):
            if chosen[run]:
                _mix(stage, slots[:, run], logs, run, mean[run], cov[run], weights)
        first = stop


@compiled
def _members(bank: Bank, g: int, slots: np.ndarray, states: np.ndarray) -> Members:
    """Return the filters of a family that are active in a stage.

    ``slots`` (J, R) are indices into the pairs of :class:`Stage`; negative for dropped hypotheses.
    """
    start, stop = bank.families.starts[g], bank.families.starts[g + 1]
    runs = slots.shape[1]
    found, at = np.empty((3, (stop - start) * runs), dtype=np.int64), 0
    for run in range(runs):
        for f in range(start, stop):
            slot = slots[bank.hypotheses[f], run]
            if slot >= 0:
                found[0, at], found[1, at], found[2, at] = f, run, slot
                at += 1
    return Members(found[0, :at], found[1, :at], found[2, :at], states)


@compiled
def _dimension(bank: Bank, g: int, n: int) -> int:
    """Return the number of states of a family."""
    families, processes = bank.families, bank.variances.shape[1]
    return n + families.orders[g] * processes + families.coupled[g] + families.constants[g]


@compiled
def _begin(bank: Bank, f: int, mean: np.ndarray, cov: np.ndarray, state: np.ndarray) -> None:
    """Fill the state of a filter before its first epoch: mean, then covariance."""
    g, n, families = 0, len(mean), bank.families
    while families.starts[g + 1] <= f:
        g += 1
    size = _dimension(bank, g, n)
    state[: size * (size + 1)] = 0.0
    for i in range(n):
        state[i] = mean[i]
        for j in range(n):
            state[size + i * size + j] = cov[i, j]
    for i in range(n, size):
        state[size + i * size + i] = bank.priors[f, i - n]
    if families.coupled[g] == 4:
        fixed = families.orders[g] * bank.variances.shape[1] + 3
        # Without variance the state is zero: the filter does not use the known change.
        state[n + fixed] = 1.0 if bank.priors[f, fixed] > 0.0 else 0.0


@compiled
def _family_batch(bank: Bank, g: int, size: int) -> Batch:
    """Return the runs with the measurement equation of a family of filters with ``size`` states."""
    batch, families = bank.batch, bank.families
    model = batch.model
    runs, epochs, m = model.linear.shape[:3]
    start = families.linear_starts[g]
    linear = families.linears[start : start + runs * epochs * m * size]
    columns = families.columns[families.column_starts[g] : families.column_starts[g + 1]]
    return Batch(
        model=ModelArrays(
            dimension=size,
            instrument=model.instrument,
            channels=model.channels,
            combined=model.combined,
            lags=model.lags,
            origin=model.origin,
            step=model.step,
            coefficients=model.coefficients,
            base=model.base,
            times=model.times,
            references=model.references,
            attitudes=model.attitudes,
            rows=model.rows,
            offset=model.offset,
            gain=model.gain,
            linear=linear.reshape((runs, epochs, m, size)),
            first_linear=families.first_linear[g],
            columns=columns,
            weights=model.weights,
            places=model.places,
            gravity=model.gravity,
        ),
        measurements=batch.measurements,
        present=batch.present,
        noise_cov=batch.noise_cov,
        noise_inverse=bank.inverses[families.roots[g]],
        transition=batch.transition,
        process_cov=batch.process_cov,
        prior_mean=batch.prior_mean,
        prior_cov=bank.square[: size * size].reshape((size, size)),
    )


@compiled
def _advance(bank: Bank, g: int, members: Members, stage: Stage) -> None:
    """Run the filters of a family over the epochs of a stage."""
    families, processes = bank.families, bank.variances.shape[1]
    n = bank.batch.transition.shape[2]
    size = _dimension(bank, g, n)
    batch = _family_batch(bank, g, size)
    searching = bank.iterations > 1 or families.losses[g] != NONE
    iterations = max(bank.iterations, 2) if families.losses[g] != NONE else bank.iterations
    rules = Rules(iterations, HALVINGS, families.losses[g], families.thresholds[g], True)
    reading = readings_of(batch, searching)
    search = search_of(batch, rules, reading)
    used, used_counts = families.used[g], families.used_counts[g]
    m = len(used_counts)
    while m > 1 and used_counts[m - 1] == 0:
        m -= 1
    expected = max(lanes.moving_states(batch.transition, batch.process_cov), 3)
    phi, q, turned = lanes.lanes(n, n), lanes.lanes(n, n), lanes.lanes(size, n)
    x, p, scratch = lanes.lanes(1, size), lanes.lanes(size, size), lanes.lanes(size, size)
    hp, half, gain = lanes.lanes(m, size), lanes.lanes(m, size), lanes.lanes(m, size)
    s, white = lanes.lanes(m, m), lanes.lanes(1, m)
    added = Added(
        base=n,
        order=families.orders[g],
        processes=processes if families.orders[g] > 0 else 0,
        coupled=families.coupled[g],
        move=lanes.lanes(1, 5),
        drive=lanes.lanes(1, 5),
        variances=lanes.lanes(1, processes),
        coupling=lanes.lanes(n, 4),
    )
    total = len(members.filters)
    for start in lanes.group_starts(total):
        count, at = lanes.count_from(start, total), lanes.group_members(start, total)
        group = members.runs[at]
        filters = members.filters[at]
        _load_states(members, at, x, p)
        scaled = _scale(bank, filters, families.gradients[g], reading, added)
        search.counts[:] = 0
        for k in range(stage.first, stage.stop):
            moving = lanes.gather(
                transition=batch.transition,
                process_cov=batch.process_cov,
                group=group,
                k=k,
                expected=expected,
                phi=phi,
                q=q,
            )
            _load_motion(bank, filters, group, k, added)
            predict(phi, q, moving, added, x, p, turned)
            linearise(batch, group, count, k, x, reading)
            if searching:
                minimise(search, group, count, k, x, p)
                update(search, x, p, scratch)
                for r in range(count):
                    reading.squared[0, 0, r] = 2.0 * search.cost[r]
                _write_evidence(bank, members, at, count, k, reading.squared, search.s, stage)
            else:
                if scaled:
                    scale_equations(reading)
                    factor = load(reading.precision, 0, 0)
                    store(reading.squared, 0, 0, factor * factor * load(reading.squared, 0, 0))
                project(reading.rows, used, used_counts, m, p, hp, s)
                lane_algebra.factorise(s, m, s)
                lane_algebra.whiten(s, m, reading.innovation, white)
                lane_algebra.add_squares(white, m, reading.squared)
                lane_algebra.solve_lower(s, m, hp, half)
                lane_algebra.correct(half, white, m, x)
                lane_algebra.solve_upper(s, m, half, gain)
                joseph(gain, hp, reading.rows, used, used_counts, p, scratch, half)
                _write_evidence(bank, members, at, count, k, reading.squared, s, stage)
            _write_estimates(bank, members, at, count, k, x, p, stage)
        for r in range(count):
            epochs = stage.stop - stage.first
            stage.counts[group[r]] += search.counts[r, 1] if searching else epochs
        _store_states(members, at, count, x, p)


@compiled
def _load_states(members: Members, at: np.ndarray, x: np.ndarray, p: np.ndarray) -> None:
    """Fill lanes with the states of filters."""
    size = p.shape[0]
    for r in range(len(at)):
        state = members.states[members.filters[at[r]], members.runs[at[r]]]
        for i in range(size):
            x[0, i, r] = state[i]
            for j in range(size):
                p[i, j, r] = state[size + i * size + j]


@compiled
def _store_states(
    members: Members, at: np.ndarray, count: int, x: np.ndarray, p: np.ndarray
) -> None:
    """Copy the states from ``count`` lanes back to their filters."""
    size = p.shape[0]
    for r in range(count):
        state = members.states[members.filters[at[r]], members.runs[at[r]]]
        for i in range(size):
            state[i] = x[0, i, r]
            for j in range(size):
                state[size + i * size + j] = p[i, j, r]


@compiled
def _scale(
    bank: Bank, filters: np.ndarray, gradients: int, reading: LinearisedMeasurement, added: Added
) -> bool:
    """Fill the precision of each equation and the variances of the error processes.

    The ``gradients`` equations of the gradiometer come first; if they are fewer than its channels,
    all channels have one scale. Return whether any precision differs from one.
    """
    m, g = reading.residual.shape[1], reading.white.shape[0]
    reading.precision[:] = 1.0
    scaled = False
    for r in range(len(filters)):
        scales = bank.scales[filters[r]]
        for c in range(m):
            scaled |= scales[c] != 1.0
            if c < gradients:
                reading.precision[0, c, r] = 1.0 / scales[c]
            elif c >= g:
                reading.precision[0, gradients + c - g, r] = 1.0 / scales[c]
        for c in range(bank.variances.shape[1]):
            added.variances[0, c, r] = bank.variances[filters[r], c]
    return scaled


@compiled
def _load_motion(bank: Bank, filters: np.ndarray, group: np.ndarray, k: int, added: Added) -> None:
    """Fill Φ and Q of the added states, and their coupling, at epoch ``k``."""
    if added.order > 0 or added.coupled > 0:
        for r in range(len(group)):
            row = bank.motions[filters[r]]
            for i in range(5):
                added.move[0, i, r] = bank.moves[row, group[r], k, i]
                added.drive[0, i, r] = bank.drives[row, group[r], k, i]
    if added.coupled > 0:
        lanes.gather_rows(bank.coupling, group, k, added.base, added.coupling)


@compiled
def _write_evidence(
    bank: Bank,
    members: Members,
    at: np.ndarray,
    count: int,
    k: int,
    squared: np.ndarray,
    lower: np.ndarray,
    stage: Stage,
) -> None:
    """Write ln p(z_k | z_0 … z_{k−1}), up to a constant that all hypotheses share."""
    for r in range(count):
        f = members.filters[at[r]]
        if bank.evident[f]:
            peak, heights = bank.peaks[members.runs[at[r]], k], bank.heights[f]
            total = -0.5 * squared[0, 0, r] + peak[0]
            total -= peak[1] * heights[0] + peak[2] * heights[1]
            for c in range(lower.shape[0]):
                total += math.log(lower[c, c, r])
            stage.evidence[members.slots[at[r]], k - stage.first] = total


@compiled
def _write_estimates(
    bank: Bank,
    members: Members,
    at: np.ndarray,
    count: int,
    k: int,
    x: np.ndarray,
    p: np.ndarray,
    stage: Stage,
) -> None:
    """Write the means and covariances of the block's states."""
    epochs, n = stage.mean.shape[1:]
    places, lane, used = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64), 0
    for r in range(count):
        if bank.estimating[members.filters[at[r]]]:
            lane[used], places[used] = r, members.slots[at[r]] * epochs + k - stage.first
            used += 1
    mean, cov = stage.mean.reshape(-1), stage.cov.reshape(-1)
    for i in range(n):
        for u in range(used):
            mean[places[u] * n + i] = x[0, i, lane[u]]
        for j in range(i + 1):  # an element of P of all lanes is in one line of the cache
            for u in range(used):
                cov[(places[u] * n + i) * n + j] = p[i, j, lane[u]]


@compiled
def _mix(
    stage: Stage,
    slots: np.ndarray,
    logs: np.ndarray,
    run: int,
    mean: np.ndarray,
    cov: np.ndarray,
    weights: np.ndarray,
) -> None:
    """Fill weights (J, R, K), mean (K, n) and cov (K, n, n) of a run's mixture in a stage.

    Parameters
    ----------
    slots : (J,) index of each hypothesis into the pairs of ``stage``; negative if dropped.
    logs : (J, R) log weights before the stage; replaced by the log weights after the stage.
    """
    hypotheses, n = logs.shape[0], mean.shape[1]
    totals, off = np.zeros(hypotheses), np.empty(n)
    for k in range(stage.first, stage.stop):
        at, largest, whole = k - stage.first, -math.inf, 0.0
        for j in range(hypotheses):
            weight = -math.inf
            if slots[j] >= 0:
                totals[j] += stage.evidence[slots[j], at]
                weight = totals[j] + logs[j, run]
            weights[j, run, k] = weight if math.isfinite(weight) else -math.inf
            largest = max(largest, weights[j, run, k])
        for j in range(hypotheses):
            whole += math.exp(weights[j, run, k] - largest)  # NaN if there is no finite one
        norm = largest + math.log(whole)
        for j in range(hypotheses):
            weights[j, run, k] -= norm
        missing = math.isnan(norm)
        mean[k] = math.nan if missing else 0.0
        cov[k] = math.nan if missing else 0.0
        if missing:
            continue
        for j in range(hypotheses):
            share = math.exp(weights[j, run, k])
            if share != 0.0:
                for i in range(n):
                    mean[k, i] += share * stage.mean[slots[j], at, i]
        for j in range(hypotheses):
            share = math.exp(weights[j, run, k])
            if share != 0.0:
                its_cov = stage.cov[slots[j], at]
                for i in range(n):
                    off[i] = stage.mean[slots[j], at, i] - mean[k, i]
                    for c in range(i + 1):
                        cov[k, i, c] += share * (its_cov[i, c] + off[i] * off[c])
        for i in range(n):
            for c in range(i):
                cov[k, c, i] = cov[k, i, c]
    for j in range(hypotheses):
        logs[j, run] = weights[j, run, stage.stop - 1]
