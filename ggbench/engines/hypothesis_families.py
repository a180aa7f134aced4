"""Construction of the filter bank of several hypotheses."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from ..block import ProblemBlock
from ..numerics.frozen import read_only
from ..sensors.aiding import MGAL
from ..sensors.model_arrays import immutable
from ..sensors.model_kernels import moving_errors
from .hypothesis_bank import Bank, Families
from .hypothesis_motion import Motion
from .model_hypotheses import Hypothesis, accelerometer, of_the_map, spread
from .robust_weights import NONE, number_of
from .whitened_measurements import Batch, batch_of, gradient_equations

_FIXED = 1e-6
"""Standard deviation of the state with the constant value 1: keeps P positive definite."""


class _Filter(NamedTuple):
    """A filter of the bank.

    Attributes
    ----------
    hypothesis : hypothesis that defines the model of the filter.
    owner : index of the hypothesis for which the filter is run.
    evident, estimating : whether the filter provides the evidence of hypothesis ``owner``; whether
        it provides the estimates.
    """

    hypothesis: Hypothesis
    owner: int
    evident: bool
    estimating: bool


class _Family(NamedTuple):
    """Properties that the filters of a family share.

    Attributes
    ----------
    order : number of states of each error process; 0 without error processes.
    coupled : number of added states that act on the states of the block.
    constant : whether each channel has a constant error.
    loss, threshold : see :mod:`.robust_weights`.
    noise : factor on the noise standard deviation of map-matched channels, if their noise is
        correlated with that of other channels. Otherwise 1, and each filter has its own factor.
    """

    order: int
    coupled: int
    constant: bool
    loss: int
    threshold: float
    noise: float


def bank_of(
    block: ProblemBlock, hypotheses: Sequence[Hypothesis], motion: Motion, iterations: int
) -> Bank:
    """Return the filter bank of several hypotheses.

    Parameters
    ----------
    block : block of R runs.
    hypotheses : hypotheses that apply to the block.
    motion : track data from :func:`.motion_of`.
    iterations : largest number of linearisations of h in each update; filters with a loss use at
        least two.
    """
    batch, of_map = batch_of(block), of_the_map(block)
    roots = np.linalg.cholesky(batch.noise_cov)
    mixed = mixed_noise(block)
    known = any(hypothesis.integrated for hypothesis in hypotheses)
    members: dict[_Family, list[_Filter]] = {}
    for index, hypothesis in enumerate(hypotheses):
        other = hypothesis.estimate
        members.setdefault(_family_of(hypothesis, mixed, known), []).append(
            _Filter(hypothesis, index, True, other is None)
        )
        if other is not None:
            members.setdefault(_family_of(other, mixed, known), []).append(
                _Filter(other, index, False, True)
            )
    filters = [one for some in members.values() for one in some]
    noises = np.array([1.0 if mixed else one.hypothesis.noise for one in filters])
    scales = np.where(of_map, noises[:, np.newaxis], 1.0)
    heights = [(math.log(one.hypothesis.noise), spread(one.hypothesis)) for one in filters]
    present = block.present
    lower = -np.log(np.broadcast_to(roots.diagonal(axis1=-2, axis2=-1), present.shape))
    peaks = np.stack(
        [
            np.sum(np.where(present, lower, 0.0), axis=2),
            present[..., of_map].sum(axis=2),
            present.sum(axis=2),
        ],
        axis=2,
    )
    units = np.ones(of_map.sum()) if block.channels else roots[0].diagonal()[of_map]
    families = _families(block, members, batch, iterations)
    motions, moves, drives = _motions([one.hypothesis for one in filters], motion)
    widths = _sizes(block, members)
    return Bank(
        batch=batch,
        families=families,
        iterations=iterations,
        hypotheses=np.array([one.owner for one in filters]),
        evident=np.array([one.evident for one in filters]),
        estimating=np.array([one.estimating for one in filters]),
        scales=scales,
        heights=np.array(heights),
        peaks=peaks,
        motions=motions,
        moves=moves,
        drives=drives,
        variances=np.array([(one.hypothesis.wander * units) ** 2 for one in filters]),
        priors=_priors(members, units, max(widths) - block.dimension),
        coupling=_coupling(block, motion, any(family.coupled for family in members)),
        inverses=np.stack([_inverse(batch, of_map, family.noise) for family in members]),
        square=read_only(np.zeros(max(widths) ** 2)),
    )


def mixed_noise(block: ProblemBlock) -> bool:
    """Return whether noise of map-matched channels is correlated with noise of other channels."""
    of_map = of_the_map(block)
    return bool(block.noise_cov[..., of_map, :][..., ~of_map].any())


def precisions_of(block: ProblemBlock, noises: Sequence[float]) -> np.ndarray:
    """Return the factors (S, equations) on whitened measurement equations for S noise factors.

    The equations are those of updates with one linearisation and no loss. A noise factor multiplies
    the noise of map-matched channels. The equations of these channels are multiplied by the inverse
    of the noise factor. :func:`mixed_noise` must be false for the block.
    """
    model, of_map = block.model, of_the_map(block)
    g, moving = len(model.channels), moving_errors(model.instrument)
    gradients = gradient_equations(g, moving, model.first_linear, False)
    mapped = [*of_map[:gradients], *of_map[g:]]
    mapped += [False] * max(3 - len(mapped), 0)
    return np.where(mapped, 1.0 / np.array(noises)[:, np.newaxis], 1.0)


def _family_of(hypothesis: Hypothesis, mixed: bool, known: bool) -> _Family:
    """Return the family of a filter.

    Parameters
    ----------
    mixed : whether noise of map-matched and other channels is correlated.
    known : whether filters with unknown gravity have a state for the known change of gravity. One
        family of all these filters fills the lanes better than a family for each kind.
    """
    order = (1 if hypothesis.rough else 2) if hypothesis.wander else 0
    coupled = 3 + known if hypothesis.gravity_mgal else 0
    loss = number_of(hypothesis.loss, hypothesis.threshold)
    threshold = hypothesis.threshold if loss != NONE else math.inf
    noise = hypothesis.noise if mixed else 1.0
    return _Family(order, coupled, hypothesis.constant != 0.0, loss, threshold, noise)


def _sizes(block: ProblemBlock, families: Iterable[_Family]) -> list[int]:
    """Return the number of states of each family."""
    c = int(of_the_map(block).sum())
    return [
        block.dimension + family.order * c + family.coupled + family.constant * c
        for family in families
    ]


def _inverse(batch: Batch, of_map: np.ndarray, noise: float) -> np.ndarray:
    """Return the inverse Cholesky factor of R with the factor ``noise`` on map-matched channels.

    ``of_map`` (m,) is the mask of these channels.
    """
    return batch.noise_inverse / np.where(of_map, noise, 1.0)


def _families(
    block: ProblemBlock, members: dict[_Family, list[_Filter]], batch: Batch, iterations: int
) -> Families:
    """Return the arrays of families."""
    model, of_map = block.model, of_the_map(block)
    channels, n, m = np.flatnonzero(of_map), block.dimension, len(of_map)
    g, moving, sizes = len(model.channels), moving_errors(model.instrument), _sizes(block, members)
    effects: list[np.ndarray] = []
    for family, size in zip(members, sizes, strict=True):
        effect = np.zeros((m, size), dtype=bool)
        if family.order:
            effect[channels, n + family.order * np.arange(len(channels))] = True
        if family.constant:
            effect[channels, np.arange(size - len(channels), size)] = True
        effects.append(effect)
    plain = np.zeros((m, n), dtype=bool)
    plain[:] = model.linear.any(axis=(0, 1))
    plain[:, :3] |= np.asarray(model.weights.any(axis=(0, 1, 3)))[:, np.newaxis]
    moved = np.flatnonzero(model.rows[:, :, :moving].any(axis=(0, 1, 2)))
    linked = np.asarray((batch.noise_inverse != 0.0).any(axis=0))
    lengths = [block.runs * block.epochs * m * size for size in sizes]
    linears, firsts, columns, gradients = np.zeros(sum(lengths)), [], [], []
    starts = np.cumsum([0, *lengths])
    there = block.present.astype(float)
    patterns: list[list[np.ndarray]] = []
    for family, effect, start, length in zip(members, effects, starts[:-1], lengths, strict=True):
        size = effect.shape[1]
        linear = linears[start : start + length].reshape(block.runs, block.epochs, m, size)
        if plain.any():
            linear[..., :n] = model.linear
        for channel, state in np.argwhere(effect):
            linear[:, :, channel, state] = there[:, :, channel]
        dependent = effect.copy()
        dependent[:, :n] |= plain
        reached = np.flatnonzero(dependent.any(axis=1))
        firsts.append(int(reached[0]) if len(reached) else m)
        columns.append(np.flatnonzero(dependent.any(axis=0)))
        whole = iterations > 1 or family.loss != NONE
        gradients.append(gradient_equations(g, moving, firsts[-1], whole))
        pattern = []
        for c in (*range(gradients[-1]), *range(g, m)):
            used = dependent[linked[c]].any(axis=0)
            if c < g:
                used[moved] = True
            pattern.append(np.flatnonzero(used))
        patterns.append(pattern)
    most = max(len(pattern) for pattern in patterns)
    counts = np.zeros((len(members), most), dtype=np.int64)
    widest = max((len(one) for pattern in patterns for one in pattern), default=0)
    used_states = np.zeros((len(members), most, max(widest, 1)), dtype=np.int64)
    for i, pattern in enumerate(patterns):
        for j, one in enumerate(pattern):
            counts[i, j] = len(one)
            used_states[i, j, : len(one)] = one
    return Families(
        starts=np.cumsum([0, *(len(some) for some in members.values())]),
        orders=np.array([family.order for family in members]),
        coupled=np.array([family.coupled for family in members]),
        constants=np.array([len(channels) * family.constant for family in members]),
        losses=np.array([family.loss for family in members]),
        thresholds=np.array([family.threshold for family in members]),
        first_linear=np.array(firsts),
        columns=immutable(np.concatenate(columns).astype(np.int64)),
        column_starts=np.cumsum([0, *(len(some) for some in columns)]),
        linears=read_only(linears),
        linear_starts=starts[:-1],
        roots=np.arange(len(members)),
        gradients=np.array(gradients),
        used=used_states,
        used_counts=counts,
    )


def _priors(members: dict[_Family, list[_Filter]], units: np.ndarray, added: int) -> np.ndarray:
    """Return the prior variances (F, ``added``) of the added states."""
    rows = np.zeros((sum(len(some) for some in members.values()), added))
    owners = [(family, one.hypothesis) for family, some in members.items() for one in some]
    for row, (family, hypothesis) in zip(rows, owners, strict=True):
        moving, at = family.order * len(units), family.order * len(units) + family.coupled
        row[:moving] = np.repeat((hypothesis.wander * units) ** 2, family.order)
        if family.coupled:
            row[moving : moving + 3] = (hypothesis.gravity_mgal / MGAL) ** 2
        if hypothesis.integrated:
            row[moving + 3] = _FIXED**2
        if family.constant:
            row[at : at + len(units)] = (hypothesis.constant * units) ** 2
    return rows


def _motions(
    hypotheses: Sequence[Hypothesis], motion: Motion
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ``motions``, ``moves`` and ``drives`` of :class:`.hypothesis_bank.Bank`."""
    kinds: dict[tuple[float, ...], int] = {}
    rows, moves, drives = [], [], []
    for hypothesis in hypotheses:
        wander = (hypothesis.length_m, float(hypothesis.rough)) if hypothesis.wander else (0.0, 0.0)
        far, integrated = hypothesis.gravity_km, float(hypothesis.integrated)
        felt = (hypothesis.gravity_mgal, far, integrated) if hypothesis.gravity_mgal else (0.0,) * 3
        key = (*wander, *felt)
        if key not in kinds:
            kinds[key] = len(kinds)
            move, drive = np.zeros((2, *motion.ways.shape, 5))
            if hypothesis.wander:
                fill = _fill_markov if hypothesis.rough else _fill_matern
                fill(motion.ways / hypothesis.length_m, move, drive)
            if hypothesis.gravity_mgal and hypothesis.integrated:
                move[..., 4], drive[..., 4] = 1.0, motion.walked
            elif hypothesis.gravity_mgal:
                move[..., 4] = np.exp(-1e-3 * motion.ways / far)
                drive[..., 4] = (hypothesis.gravity_mgal / MGAL) ** 2 * (1.0 - move[..., 4] ** 2)
            moves.append(move)
            drives.append(drive)
        rows.append(kinds[key])
    return np.array(rows), np.array(moves), np.array(drives)


def _fill_markov(decay: np.ndarray, move: np.ndarray, drive: np.ndarray) -> None:
    """Fill Φ and Q of first-order Gauss–Markov processes; see :func:`_fill_matern`."""
    move[..., 0] = np.exp(-decay)
    drive[..., 0] = 1.0 - move[..., 0] ** 2


def _fill_matern(decay: np.ndarray, move: np.ndarray, drive: np.ndarray) -> None:
    """Fill Φ and Q of Matérn processes with ν = 3/2 (Särkkä & Solin 2019, sec. 12.3).

    The two states of a process are the error and its derivative with respect to √3 d/ℓ. Both have
    the same variance.

    Parameters
    ----------
    decay : (R, K) distance flown since the previous epoch, divided by the correlation length ℓ.
    move, drive : (R, K, 5) output, Φ and Q of unit variance, row by row.
    """
    scaled = math.sqrt(3.0) * decay
    fade = np.exp(-scaled)
    step = np.empty((*decay.shape, 2, 2))
    step[..., 0, 0], step[..., 0, 1] = fade * (1.0 + scaled), fade * scaled
    step[..., 1, 0], step[..., 1, 1] = -fade * scaled, fade * (1.0 - scaled)
    noise = np.eye(2) - step @ step.swapaxes(-1, -2)
    move[..., :4] = step.reshape(*decay.shape, 4)
    drive[..., :4] = noise.reshape(*decay.shape, 4)


def _coupling(block: ProblemBlock, motion: Motion, wanted: bool) -> np.ndarray:
    """Return the effect (R, K, n, 4) of an uncompensated acceleration, ENU [m/s²], on x.

    The first three columns are the effect of an acceleration that is constant between epochs, like
    an accelerometer bias. The last column is the effect of its known change ``motion.known``. If
    ``wanted`` is false, the result is zeros (1, 1, 1, 4).
    """
    if not wanted:
        return np.zeros((1, 1, 1, 4))
    place = accelerometer(block)
    assert place is not None and block.tracks is not None
    attitudes = block.tracks[..., 6:].reshape(*block.tracks.shape[:2], 3, 3)
    coupling = np.empty((block.runs, block.epochs, block.dimension, 4))
    coupling[..., :3] = block.transition[..., place] @ attitudes.swapaxes(-1, -2)
    coupling[..., place, :3] = 0.0
    coupling[..., 3] = np.einsum("rkab,rkb->rka", coupling[..., :3], motion.known)
    return coupling
