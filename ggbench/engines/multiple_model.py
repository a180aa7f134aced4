"""The multiple-model filter: filters of several hypotheses, weighted by their evidence.

The hypotheses are static (Magill 1965): what a model leaves out does not change during a flight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..block import EstimateBlock, ProblemBlock
from ..problem import GravityMap
from . import position_grid
from .banks import split_prior
from .extended_filter import Starts, UpdateOptions, extended_with_evidence, prior_of
from .gaussian_sum import WIDTH, gaussian_sum_with_evidence
from .model_hypotheses import Hypothesis, Motion, augmented, motion_of, takes

_GROUP = 8
"""Runs whose filters are in memory at the same time."""
_SUMMARIES = 4
"""Times in a flight at which the weights are put in words."""
_WORTH_TELLING, _MOST_TOLD = 0.05, 3
_STAGES = (1, 2, 4, 8, 16)
"""Ends of the stages, in sixteenths of the epochs."""
_NEGLIGIBLE = -25.0
"""Logarithm of the weight at the end of a stage below which a hypothesis is dropped."""
_SAMPLES, _STEP_M, _EARTH_RADIUS = 64, 50.0, 6.371e6
_STRAIGHT = 0.3
"""Spacing over the distance in which the gradients' slope changes by itself."""
_CHECKS = 24
"""How often in a flight the search may end."""


class SearchOptions(NamedTuple):
    """How the filters search.

    Attributes
    ----------
    spacing_m, most : of the Gaussians of a wide prior, see :func:`.split_prior`.
    iterations : linearisations of h in each update.
    """

    spacing_m: float
    most: int
    iterations: int


class Mixture(NamedTuple):
    """What is known of a group of runs; arrays that are filled from epoch to epoch.

    Attributes
    ----------
    mean, cov : (R, K, n), (R, K, n, n).
    weights : (J, R, K) logarithms; −∞ of a hypothesis that does not run.
    counts : (R,) evaluations of h.
    """

    mean: np.ndarray
    cov: np.ndarray
    weights: np.ndarray
    counts: np.ndarray


def multiple_model(
    block: ProblemBlock, hypotheses: Sequence[Hypothesis], options: SearchOptions
) -> EstimateBlock:
    """Run the filter; hypotheses that a block has nothing of are left out.

    A wide prior is searched first, by Gaussian sums of those hypotheses that need no more states;
    as soon as the position is known to a spacing, all hypotheses begin there.
    """
    chosen = [hypothesis for hypothesis in hypotheses if takes(hypothesis, block)]
    priors = np.log([hypothesis.prior for hypothesis in chosen])
    runs, epochs, n = block.runs, block.epochs, block.dimension
    all_of = Mixture(
        mean=np.full((runs, epochs, n), np.nan),
        cov=np.full((runs, epochs, n, n), np.nan),
        weights=np.full((len(chosen), runs, epochs), -np.inf),
        counts=np.zeros(runs, dtype=np.int64),
    )
    log_cells, _, _ = split_prior(block.problem(0), options.spacing_m, options.most, WIDTH)
    # The hypotheses' estimates of a group of runs are in memory at the same time.
    for first in range(0, runs, _GROUP):
        some = slice(first, min(first + _GROUP, runs))
        part = block.some(some.start, some.stop)
        out = Mixture(
            all_of.mean[some], all_of.cov[some], all_of.weights[:, some], all_of.counts[some]
        )
        motion = motion_of(part)
        begins = np.zeros(part.runs, dtype=np.int64)
        logs = np.tile(priors[:, np.newaxis], part.runs)
        if len(log_cells) > 1:
            begins = _search(part, chosen, logs, motion, options, out)
        for begin in np.unique(begins):
            if begin < epochs:
                _follow(
                    block=part,
                    hypotheses=chosen,
                    logs=logs,
                    motion=motion,
                    options=options,
                    begin=int(begin),
                    chosen=begins == begin,
                    out=out,
                )
    shares = np.exp(all_of.weights)
    info = {"map_evaluations": all_of.counts, **summaries(block.times, chosen, shares)}
    for kind in dict.fromkeys(hypothesis.kind for hypothesis in chosen):
        members = [j for j, hypothesis in enumerate(chosen) if hypothesis.kind == kind]
        info[f"weight_{kind}"] = shares[members, :, -1].sum(axis=0)
    return EstimateBlock(all_of.mean, all_of.cov, "filter", info=info)


def map_spacing(gravity_map: GravityMap | None) -> float:
    """Return the spacing [m] of Gaussians within which a map's gradients are straight enough.

    A part of the ratio of their rms slope to the rms change of it, along meridians across the
    whole map at half its height. Infinite without a map that has an end.
    """
    if gravity_map is None or not np.isfinite([*gravity_map.lower, *gravity_map.upper]).all():
        return math.inf
    lower, upper = gravity_map.lower, gravity_map.upper
    margin = 0.01 * (upper - lower)
    latitudes, longitudes = (
        np.linspace(lower[i] + margin[i], upper[i] - margin[i], _SAMPLES) for i in range(2)
    )
    at = np.meshgrid(latitudes, longitudes, indexing="ij")
    height = np.full(at[0].shape, 0.5 * (lower[2] + upper[2]))
    step = _STEP_M / _EARTH_RADIUS
    south, middle, north = (
        gravity_map.tensor(at[0] + i * step, at[1], height) for i in (-1.0, 0.0, 1.0)
    )
    slope = np.mean((0.5 * (north - south)) ** 2)
    bend = np.mean((north - 2.0 * middle + south) ** 2)
    return float(_STRAIGHT * _STEP_M * np.sqrt(slope / bend)) if bend > 0.0 else math.inf


def _search(
    block: ProblemBlock,
    hypotheses: Sequence[Hypothesis],
    logs: np.ndarray,
    motion: Motion,
    options: SearchOptions,
    out: Mixture,
) -> np.ndarray:
    """Fill the mixture of Gaussian sums; return the epoch (R,) from which all hypotheses run.

    ``logs`` (J, R), the weights of the hypotheses, are made what they are at that epoch.
    """
    simple = [j for j, hypothesis in enumerate(hypotheses) if hypothesis.keeps_states]
    found, evidences = [], []
    for j in simple:
        for one in (hypotheses[j], hypotheses[j].estimate):
            if one is None:
                continue
            problem, peak = augmented(block, one, motion)
            estimate, evidence = gaussian_sum_with_evidence(
                problem,
                options.spacing_m,
                options.most,
                _iterations(one, options),
                one.loss,
                one.threshold,
            )
            out.counts[:] += estimate.info["map_evaluations"]
            if one is hypotheses[j]:
                evidences.append(evidence + peak)
        found.append(estimate)
    weights = log_weights(np.array(evidences), logs[simple])
    mix(
        weights,
        np.array([estimate.mean for estimate in found]),
        np.array([estimate.cov for estimate in found]),
        out.mean,
        out.cov,
    )
    out.weights[simple] = weights
    states = position_grid.states_in_metres(block.problem(0))
    deviations = np.sqrt(np.linalg.eigvalsh(out.cov[..., states, :][..., states])[..., -1])
    known = deviations < WIDTH * options.spacing_m
    epochs = np.arange(block.epochs)
    checked = known & (epochs % max(block.epochs // _CHECKS, 1) == 0)
    begins = np.where(checked.any(axis=1), checked.argmax(axis=1) + 1, block.epochs)
    total = np.logaddexp.reduce(logs[simple], axis=0)
    for run, begin in enumerate(begins):
        logs[simple, run] = total[run] + weights[:, run, begin - 1]
    return np.asarray(begins)


def _follow(
    block: ProblemBlock,
    hypotheses: Sequence[Hypothesis],
    logs: np.ndarray,
    motion: Motion,
    options: SearchOptions,
    begin: int,
    chosen: np.ndarray,
    out: Mixture,
) -> None:
    """Fill the mixture of all hypotheses from an epoch on, in the chosen runs (R,).

    At the end of each stage the hypotheses are dropped that weigh nothing.
    """
    runs, n = block.runs, block.dimension
    before = begin - 1
    starts = None if begin == 0 else (out.mean[:, before], out.cov[:, before])
    states: dict[tuple[int, bool], Starts] = {}
    alive = np.tile(chosen, (len(hypotheses), 1))
    logs = logs.copy()
    ends = sorted({begin + max((block.epochs - begin) * part // 16, 1) for part in _STAGES})
    for first, stop in pairwise([begin, *ends]):
        shape = len(hypotheses), runs, stop - first
        mean, cov = np.zeros((*shape, n)), np.zeros((*shape, n, n))
        evidence = np.full(shape, -np.inf)
        part = block.part(first, stop, block.prior_mean, block.prior_cov)
        for j, hypothesis in enumerate(hypotheses):
            if not alive[j].any():
                continue
            for one in (hypothesis, hypothesis.estimate):
                if one is None:
                    continue
                key = j, one is hypothesis
                problem, peak = augmented(part, one, motion.part(first, stop))
                if key not in states:
                    states[key] = _starts(problem, starts)
                estimate, found = extended_with_evidence(
                    problem,
                    UpdateOptions(
                        iterations=_iterations(one, options), loss=one.loss, threshold=one.threshold
                    ),
                    states[key],
                )
                states[key] = Starts(
                    np.ascontiguousarray(estimate.mean[:, -1:]),
                    np.ascontiguousarray(estimate.cov[:, -1:]),
                )
                out.counts[:] += np.where(alive[j], estimate.info["map_evaluations"], 0)
                if one is hypothesis:
                    evidence[j] = found + peak
                mean[j], cov[j] = estimate.mean[..., :n], estimate.cov[..., :n, :n]
        evidence[~alive] = -np.inf
        weights = log_weights(evidence, logs)
        part_mean, part_cov = np.empty(mean.shape[1:]), np.empty(cov.shape[1:])
        mix(weights, mean, cov, part_mean, part_cov)
        out.mean[chosen, first:stop] = part_mean[chosen]
        out.cov[chosen, first:stop] = part_cov[chosen]
        out.weights[:, chosen, first:stop] = weights[:, chosen]
        logs = weights[:, :, -1]
        alive &= logs > _NEGLIGIBLE


def _starts(problem: ProblemBlock, known: tuple[np.ndarray, np.ndarray] | None) -> Starts:
    """Return the prior of a problem's runs; of its first states, what is known of them by now."""
    starts = prior_of(problem)
    if known is not None:
        n = known[0].shape[1]
        starts.means[:, 0, :n] = known[0]
        starts.covs[:, 0, :n, :n] = known[1]
    return starts


def _iterations(hypothesis: Hypothesis, options: SearchOptions) -> int:
    """Return how often an update linearises; a loss needs a second time."""
    return options.iterations if hypothesis.loss == "none" else max(options.iterations, 2)


def log_weights(evidences: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """Return the logarithms of the hypotheses' weights (J, R, K), whose sum is one.

    NaN from the epoch on from which no hypothesis has an answer.

    Parameters
    ----------
    evidences : (J, R, K).
    logs : (J, R) of the weights before.
    """
    weights = np.cumsum(evidences, axis=2) + logs[:, :, np.newaxis]
    weights = np.where(np.isfinite(weights), weights, -np.inf)
    with np.errstate(invalid="ignore"):
        return np.asarray(weights - np.logaddexp.reduce(weights, axis=0))


def mix(
    weights: np.ndarray, means: np.ndarray, covs: np.ndarray, mean: np.ndarray, cov: np.ndarray
) -> None:
    """Fill the moments (R, K, n), (R, K, n, n) of the mixture of estimates.

    Parameters
    ----------
    weights : (J, R, K) logarithms.
    means, covs : (J, R, K, n), (J, R, K, n, n).
    """
    shares = np.exp(weights)
    mean[:], cov[:] = 0.0, 0.0
    there = np.flatnonzero((shares != 0.0).any(axis=(1, 2)))
    for share, its_mean in zip(shares[there], means[there], strict=True):
        counted = (share != 0.0)[..., np.newaxis]
        mean += share[..., np.newaxis] * np.where(counted, its_mean, 0.0)
    for share, its_mean, its_cov in zip(shares[there], means[there], covs[there], strict=True):
        counted = (share != 0.0)[..., np.newaxis]
        off = np.where(counted, its_mean - mean, 0.0)
        spread = np.where(counted[..., np.newaxis], its_cov, 0.0)
        spread += off[..., :, np.newaxis] * off[..., np.newaxis, :]
        cov += share[..., np.newaxis, np.newaxis] * spread


def summaries(
    times: np.ndarray, hypotheses: Sequence[Hypothesis], shares: np.ndarray
) -> dict[str, np.ndarray]:
    """Return for some times which hypotheses weigh something then, in words for each run (R,).

    Parameters
    ----------
    times : (K,).
    shares : (J, R, K).
    """
    texts_at = {}
    for k in np.unique(np.linspace(0, len(times) - 1, _SUMMARIES + 1)[1:].astype(int)):
        texts = []
        for share in shares[:, :, k].T:
            order = [j for j in np.argsort(-share, kind="stable") if share[j] >= _WORTH_TELLING]
            parts = [f"{hypotheses[j].words} {100.0 * share[j]:.0f} %" for j in order[:_MOST_TOLD]]
            texts.append(", ".join(parts) or "nothing in particular")
        texts_at[f"at_{times[k]:.0f}_s"] = np.array(texts, dtype=np.str_)
    return texts_at
