"""The multiple-model filter: filters of several hypotheses, weighted by their evidence.

The hypotheses are static (Magill 1965): what a model leaves out does not change during a flight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..block import EstimateBlock, ProblemBlock
from ..problem import GravityMap
from . import position_grid
from .cell_screening import Screened, screened
from .gaussian_sum import WIDTH, CarriedSum, Hypotheses, prior_cells, space_for
from .hypothesis_bank import Bank, follow
from .hypothesis_families import bank_of, mixed_noise, precisions_of
from .hypothesis_motion import motion_of
from .model_hypotheses import Hypothesis, of_the_map, spread, takes

_GROUP = 8
"""Runs whose filters are in memory at the same time."""
_SUMMARIES = 4
"""Times in a flight at which the weights are put in words."""
_WORTH_TELLING, _MOST_TOLD = 0.05, 3
_STAGES = (1, 2, 4, 8, 16)
"""Ends of the stages, in sixteenths of the epochs."""
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
    prior = prior_cells(block, options.spacing_m, options.most)
    # The states of a group of runs are in memory at the same time.
    for first in range(0, runs, _GROUP):
        some = slice(first, min(first + _GROUP, runs))
        part = block if runs <= _GROUP else block.some(some.start, some.stop)
        out = Mixture(
            all_of.mean[some],
            all_of.cov[some],
            np.full((len(chosen), part.runs, epochs), -np.inf),
            all_of.counts[some],
        )
        begins = np.zeros(part.runs, dtype=np.int64)
        logs = np.tile(priors[:, np.newaxis], part.runs)
        if len(prior.weights) > 1:
            begins = _search(part, chosen, logs, prior, options, out)
        bank = bank_of(part, chosen, motion_of(part), options.iterations)
        _follow(bank, begins, part, logs, out)
        all_of.weights[:, some] = out.weights
    shares = np.exp(all_of.weights)
    info = {"map_evaluations": all_of.counts, **summaries(block.times, chosen, shares)}
    for kind in dict.fromkeys(hypothesis.kind for hypothesis in chosen):
        members = [j for j, hypothesis in enumerate(chosen) if hypothesis.kind == kind]
        info[f"weight_{kind}"] = shares[members, :, -1].sum(axis=0)
    return EstimateBlock(all_of.mean, all_of.cov, "filter", info=info)


def map_spacing(gravity_map: GravityMap | None) -> float:
    """Return the spacing [m] of Gaussians within which a map's gradients are straight enough.

    A part of the ratio of their rms slope to the rms change of it, along meridians across the
    whole map in the middle of its layers. Infinite without a map that has an end.
    """
    if gravity_map is None or not np.isfinite([*gravity_map.lower, *gravity_map.upper]).all():
        return math.inf
    lower, upper = gravity_map.lower, gravity_map.upper
    step = _STEP_M / _EARTH_RADIUS
    margin = 0.01 * (upper - lower)
    margin[0] = max(margin[0], step)  # of maps of less than 5 km
    latitudes, longitudes = (
        np.linspace(lower[i] + margin[i], upper[i] - margin[i], _SAMPLES) for i in range(2)
    )
    at = np.meshgrid(latitudes, longitudes, indexing="ij")
    height = np.full(at[0].shape, 0.5 * (lower[2] + upper[2]))
    south, middle, north = (
        gravity_map.tensor(*gravity_map.over_nodes(at[0] + i * step, at[1], height))
        for i in (-1.0, 0.0, 1.0)
    )
    slope = np.mean((0.5 * (north - south)) ** 2)
    bend = np.mean((north - 2.0 * middle + south) ** 2)
    return float(_STRAIGHT * _STEP_M * np.sqrt(slope / bend)) if bend > 0.0 else math.inf


def _search(
    block: ProblemBlock,
    hypotheses: Sequence[Hypothesis],
    logs: np.ndarray,
    prior: Hypotheses,
    options: SearchOptions,
    out: Mixture,
) -> np.ndarray:
    """Fill the mixture of Gaussian sums; return the epoch (R,) from which all hypotheses run.

    Parameters
    ----------
    logs : (J, R) the weights of the hypotheses; made what they are at that epoch.
    prior : the prior's Gaussians.
    """
    simple = [j for j, hypothesis in enumerate(hypotheses) if hypothesis.keeps_states]
    begins = np.empty(block.runs, dtype=np.int64)
    for run in range(block.runs):
        one = slice(run, run + 1)
        own = Mixture(out.mean[one], out.cov[one], out.weights[simple, one].copy(), out.counts[one])
        begins[run] = begin = _search_run(
            block=block if block.runs == 1 else block.some(run, run + 1),
            hypotheses=[hypotheses[j] for j in simple],
            logs=logs[simple, one],
            prior=prior,
            options=options,
            out=own,
        )
        out.weights[simple, one] = own.weights
        total = np.logaddexp.reduce(logs[simple, run])
        logs[simple, run] = total + own.weights[:, 0, begin - 1]
    return begins


def _search_run(
    block: ProblemBlock,
    hypotheses: Sequence[Hypothesis],
    logs: np.ndarray,
    prior: Hypotheses,
    options: SearchOptions,
    out: Mixture,
) -> int:
    """Fill the mixture of one run until its position is known; return the epoch after that."""
    space, states = space_for(prior), position_grid.states_in_metres(block.problem(0))
    first_epoch: dict[float, Screened] = {}
    noises = [one.noise for one in hypotheses if one.loss == "none"]
    if noises and options.iterations == 1 and not mixed_noise(block):
        results = screened(block, prior, precisions_of(block, noises))
        first_epoch = dict(zip(noises, results, strict=True))
        out.counts[:] += len(prior.weights)
    sums: list[CarriedSum] = []
    evident, peaks, estimating, known_first = [], [], [], []
    for hypothesis in hypotheses:
        for one in (hypothesis, hypothesis.estimate):
            if one is not None:
                problem, peak = _with_noise(block, one)
                rules = _iterations(one, options), one.loss, one.threshold
                part = first_epoch.get(one.noise) if one.loss == "none" else None
                if part is None:
                    sums.append(CarriedSum(problem, prior, space, *rules))
                else:
                    sums.append(CarriedSum(problem, part.prior, space_for(part.prior), *rules))
                    known_first.append((sums[-1], part.evidence))
                if one is hypothesis:
                    evident.append(sums[-1])
                    peaks.append(peak)
        estimating.append(sums[-1])
    between = max(block.epochs // _CHECKS, 1)
    first, stop = 0, 1
    while True:
        for one_sum in sums:
            one_sum.advance(stop)
        for one_sum, evidence in known_first if first == 0 else ():
            one_sum.evidence[0, 0] = evidence  # Gaussians that were left out count, too
        evidences = np.array([one_sum.evidence[:, first:stop] for one_sum in evident])
        evidences += np.array(peaks)[..., first:stop]
        weights = log_weights(evidences, logs)
        span = slice(first, stop)
        out.weights[..., span] = weights
        mix(
            weights,
            np.array([one_sum.mean[:, span] for one_sum in estimating]),
            np.array([one_sum.cov[:, span] for one_sum in estimating]),
            out.mean[:, span],
            out.cov[:, span],
        )
        positions = out.cov[0, span][:, states][..., states]
        known = np.sqrt(np.linalg.eigvalsh(positions)[:, -1]) < WIDTH * options.spacing_m
        known &= np.arange(first, stop) % between == 0
        if known.any() or stop == block.epochs:
            out.counts[:] += sum(one_sum.evaluations for one_sum in sums)
            return first + int(known.argmax()) + 1 if known.any() else block.epochs
        logs = np.logaddexp.reduce(logs, axis=0) + weights[..., -1]
        first, stop = stop, min(max(2 * (stop - 1), between) + 1, block.epochs)


def _follow(
    bank: Bank, begins: np.ndarray, block: ProblemBlock, logs: np.ndarray, out: Mixture
) -> None:
    """Fill the mixture of all hypotheses from the epoch (R,) on from which each run has them.

    ``logs`` (J, R) are the logarithms of the weights before that epoch.
    """
    runs, epochs = block.runs, block.epochs
    for begin in np.unique(begins[begins < epochs]):
        means, covs = out.mean[:, begin - 1].copy(), out.cov[:, begin - 1].copy()
        if begin == 0:
            means = np.tile(block.prior_mean, (runs, 1))
            covs = np.tile(block.prior_cov, (runs, 1, 1))
        parts = {max((epochs - int(begin)) * part // 16, 1) for part in _STAGES}
        follow(
            bank=bank,
            begin=int(begin),
            ends=np.array(sorted(int(begin) + part for part in parts)),
            chosen=begins == begin,
            means=means,
            covs=covs,
            logs=logs,
            mean=out.mean,
            cov=out.cov,
            weights=out.weights,
            counts=out.counts,
        )


def _iterations(hypothesis: Hypothesis, options: SearchOptions) -> int:
    """Return how often an update linearises; a loss needs a second time."""
    return options.iterations if hypothesis.loss == "none" else max(options.iterations, 2)


def _with_noise(block: ProblemBlock, hypothesis: Hypothesis) -> tuple[ProblemBlock, np.ndarray]:
    """Return a block with the noise of a hypothesis.

    Also what the evidence (R, K) lacks of it: the logarithm of the density of noise that is zero.
    """
    scales = np.where(of_the_map(block), hypothesis.noise, 1.0)
    noise_cov = block.noise_cov * np.outer(scales, scales)
    roots = np.linalg.cholesky(noise_cov).diagonal(axis1=-2, axis2=-1)
    height = -np.log(np.broadcast_to(roots, block.present.shape)) - spread(hypothesis)
    peak = np.sum(np.where(block.present, height, 0.0), axis=2)
    return replace(block, noise_cov=noise_cov), peak


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
