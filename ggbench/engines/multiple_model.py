"""Multiple-model filter: filters of several hypotheses, weighted by their evidence.

The hypotheses are static (Magill 1965): one hypothesis is correct during a whole flight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from ..block import EstimateBlock, ProblemBlock
from ..problem import GravityMap
from . import position_grid
from .cell_screening import Screened, screened, screened_with_loss
from .gaussian_sum import WIDTH, CarriedSum, Hypotheses, prior_cells, space_for
from .hypothesis_bank import NEGLIGIBLE, Bank, follow
from .hypothesis_families import bank_of, mixed_noise, precisions_of
from .hypothesis_motion import motion_of
from .model_hypotheses import Hypothesis, applicable, of_the_map, spread
from .model_words import in_words

_GROUP = 8
"""Runs whose filters are in memory at the same time."""
_SUMMARIES = 4
"""Number of times in a flight for which the weights are summarised as a text."""
_STAGES = tuple(2.0 ** (-0.5 * number) for number in range(10, -1, -1))
"""Ends of the stages, in parts of the epochs."""
_LEAST = 8
"""Least number of epochs before a hypothesis is dropped or the search ends."""
_SAMPLES, _STEP_M, _EARTH_RADIUS = 64, 50.0, 6.371e6
_STRAIGHT = 0.3
"""Spacing over the distance in which the derivative of the gradients changes by its own size."""
_CHECKS = 24
"""Approximate number of epochs in a flight at which the search may end."""
_BEND = 0.1
"""Second-order term of a gradient at one standard deviation, over the noise."""
_ROUGHNESS: WeakKeyDictionary[GravityMap, tuple[float, float]] = WeakKeyDictionary()
"""Roughness of the maps that are in use."""


class SearchOptions(NamedTuple):
    """Options that the filters of all hypotheses share.

    Attributes
    ----------
    spacing_m, most : spacing [m] of the Gaussians of a wide prior, and their largest number, see
        :func:`.split_prior`.
    iterations : largest number of linearisations of h in each update.
    """

    spacing_m: float
    most: int
    iterations: int


class _Candidate(NamedTuple):
    """Gaussian sums of a hypothesis during the search.

    Attributes
    ----------
    place : index of the hypothesis.
    sums : Gaussian sum for the evidence, and the Gaussian sum for the estimates if it differs.
    peak : (1, K) log peak of the noise density, see :func:`_with_noise`.
    first_evidence : evidence of the first epoch, if screening has dropped Gaussians of the prior;
        else None.
    """

    place: int
    sums: list[CarriedSum]
    peak: np.ndarray
    first_evidence: float | None

    def advance(self, first: int, stop: int) -> np.ndarray:
        """Filter up to epoch ``stop`` − 1; return the evidence from epoch ``first`` on."""
        for one in self.sums:
            one.advance(stop)
        if self.first_evidence is not None:
            self.sums[0].evidence[0, 0] = self.first_evidence
        # Later epochs are not filled yet.
        return np.asarray(self.sums[0].evidence[:, first:stop] + self.peak[:, first:stop])


class Mixture(NamedTuple):
    """Mixture estimates of a group of runs, filled epoch by epoch.

    Attributes
    ----------
    mean, cov : (R, K, n), (R, K, n, n) moments of the mixture.
    weights : (J, R, K) log weights of the hypotheses; −∞ for an inactive hypothesis.
    counts : (R,) number of evaluations of h.
    """

    mean: np.ndarray
    cov: np.ndarray
    weights: np.ndarray
    counts: np.ndarray


def multiple_model(
    block: ProblemBlock, hypotheses: Sequence[Hypothesis], options: SearchOptions
) -> EstimateBlock:
    """Run the multiple-model filter with the hypotheses that apply to the block.

    Hypotheses that do not apply are omitted. With a wide prior, the hypotheses without added states
    first run as Gaussian sums. The filters of all hypotheses start when the largest standard
    deviation of the position is below 0.6 spacings of the Gaussians. This is tested about 24 times
    in a flight. If the prior is not wide, these filters start at the first epoch.
    """
    chosen = applicable(hypotheses, block)
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


def cell_spacing(block: ProblemBlock) -> float:
    """Return a spacing [m] of Gaussians at which linearisation errors of the map are small.

    The result is the larger of two spacings. Over a distance of the first spacing, the derivative
    of the gradients changes by 30 % of its RMS. The second spacing follows from the second-order
    term of a gradient. At one standard deviation from the mean of a Gaussian, this term is a tenth
    of the noise. The result is infinite
    if the block has no map or a map of infinite extent. It is also infinite if the second
    derivative of the map's gradients is zero.
    """
    gravity_map = block.map
    if gravity_map is None or not np.isfinite([*gravity_map.lower, *gravity_map.upper]).all():
        return math.inf
    slope, bend = _roughness_of(gravity_map)
    if bend == 0.0:
        return math.inf
    gradients = [channel.unit == "E" for channel in block.channels]
    variances = block.noise_cov.diagonal(axis1=-2, axis2=-1)[..., gradients]
    noise = math.sqrt(variances.min()) if any(gradients) else 0.0
    return max(_STRAIGHT * slope / bend, math.sqrt(2.0 * _BEND * noise / bend) / WIDTH)


def _roughness_of(gravity_map: GravityMap) -> tuple[float, float]:
    """Return rms first [E/m] and second derivatives [E/m²] of a map's gradients to the north.

    The points cover the whole map at the middle of its height range. The result is stored for each
    map that has a hash.
    """
    try:
        if gravity_map in _ROUGHNESS:
            return _ROUGHNESS[gravity_map]
    except TypeError:  # of a class whose maps have no hash
        return _roughness(gravity_map)
    _ROUGHNESS[gravity_map] = roughness = _roughness(gravity_map)
    return roughness


def _roughness(gravity_map: GravityMap) -> tuple[float, float]:
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
    slope = math.sqrt(np.mean((0.5 * (north - south)) ** 2)) / _STEP_M
    bend = math.sqrt(np.mean((north - 2.0 * middle + south) ** 2)) / _STEP_M**2
    return slope, bend


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
    logs : (J, R) log weights of the hypotheses before the first epoch; overwritten with those
        before the returned epoch.
    prior : Gaussians of the prior.
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
    """Fill the mixture of one run until the search ends; return the following epoch."""
    states = position_grid.states_in_metres(block)
    candidates = _candidates(block, hypotheses, prior, options, out.counts)
    sums = [one for candidate in candidates for one in candidate.sums]
    between = max(block.epochs // _CHECKS, 1)
    first, stop = 0, 1
    while True:
        span = slice(first, stop)
        weights = log_weights(np.array([one.advance(first, stop) for one in candidates]), logs)
        out.weights[[one.place for one in candidates], :, span] = weights
        mix(
            weights,
            np.array([one.sums[-1].mean[:, span] for one in candidates]),
            np.array([one.sums[-1].cov[:, span] for one in candidates]),
            out.mean[:, span],
            out.cov[:, span],
        )
        positions = out.cov[0, span][:, states][..., states]
        known = np.sqrt(np.linalg.eigvalsh(positions)[:, -1]) < WIDTH * options.spacing_m
        at = np.arange(first, stop)
        known &= (at % between == 0) & (at >= _LEAST)
        if known.any() or stop == block.epochs:
            out.counts[:] += sum(one.evaluations for one in sums)
            return first + int(known.argmax()) + 1 if known.any() else block.epochs
        logs = np.logaddexp.reduce(logs, axis=0) + weights[..., -1]
        left = ~(weights[:, 0, -1] <= NEGLIGIBLE) | (stop < _LEAST)
        logs = logs[left]
        candidates = [one for one, stays in zip(candidates, left, strict=True) if stays]
        checks = (stop - 1) // between
        later = 2 * stop if 2 * stop <= between else max(2 * checks, 1) * between + 1
        first, stop = stop, min(later, block.epochs)


def _candidates(
    block: ProblemBlock,
    hypotheses: Sequence[Hypothesis],
    prior: Hypotheses,
    options: SearchOptions,
    counts: np.ndarray,
) -> list[_Candidate]:
    """Return the Gaussian sums of one run before its first epoch.

    The number of evaluations of h is added to ``counts`` (1,).
    """
    whole = space_for(prior)
    first_epoch: dict[float, Screened] = {}
    noises = [one.noise for one in hypotheses if one.loss == "none"]
    if noises and options.iterations == 1 and not mixed_noise(block):
        results = screened(block, prior, precisions_of(block, noises))
        first_epoch = dict(zip(noises, results, strict=True))
        counts[:] += len(prior.weights)
    candidates = []
    for place, hypothesis in enumerate(hypotheses):
        problem, peak = _with_noise(block, hypothesis)
        rules = _iterations(hypothesis, options), hypothesis.loss, hypothesis.threshold
        part = first_epoch.get(hypothesis.noise)
        if hypothesis.loss != "none":
            part, evaluations = screened_with_loss(problem, prior, *rules)
            counts[:] += evaluations
        cells, space = (prior, whole) if part is None else (part.prior, space_for(part.prior))
        sums = [CarriedSum(problem, cells, space, *rules)]
        if (other := hypothesis.estimate) is not None:
            # From the Gaussians that the evidence leaves.
            rules = _iterations(other, options), other.loss, other.threshold
            problem, _ = _with_noise(block, other)
            sums.append(CarriedSum(problem, cells, space_for(cells), *rules))
        candidates.append(_Candidate(place, sums, peak, None if part is None else part.evidence))
    return candidates


def _follow(
    bank: Bank, begins: np.ndarray, block: ProblemBlock, logs: np.ndarray, out: Mixture
) -> None:
    """Fill the mixture of all hypotheses, from epoch ``begins`` (R,) of each run on.

    ``logs`` (J, R) are the log weights before this epoch.
    """
    runs, epochs = block.runs, block.epochs
    for begin in np.unique(begins[begins < epochs]):
        means, covs = out.mean[:, begin - 1].copy(), out.cov[:, begin - 1].copy()
        if begin == 0:
            means = np.tile(block.prior_mean, (runs, 1))
            covs = np.tile(block.prior_cov, (runs, 1, 1))
        rest = epochs - int(begin)
        parts = {min(max(int(rest * part), _LEAST), rest) for part in _STAGES}
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
    """Return the largest number of linearisations of an update; at least 2 with a loss."""
    return options.iterations if hypothesis.loss == "none" else max(options.iterations, 2)


def _with_noise(block: ProblemBlock, hypothesis: Hypothesis) -> tuple[ProblemBlock, np.ndarray]:
    """Return a block with the noise of a hypothesis, and the log peak of the noise density.

    The log peak (R, K) is the noise term that the evidence of the filters lacks. The term in 2π is
    omitted.
    """
    scales = np.where(of_the_map(block), hypothesis.noise, 1.0)
    noise_cov = block.noise_cov * np.outer(scales, scales)
    roots = np.linalg.cholesky(noise_cov).diagonal(axis1=-2, axis2=-1)
    height = -np.log(np.broadcast_to(roots, block.present.shape)) - spread(hypothesis)
    peak = np.sum(np.where(block.present, height, 0.0), axis=2)
    return replace(block, noise_cov=noise_cov), peak


def log_weights(evidences: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """Return the normalised log weights (J, R, K) of J hypotheses after each epoch.

    If all hypotheses of a run have failed at an epoch, the weights are NaN from that epoch on.

    Parameters
    ----------
    evidences : (J, R, K) log evidence of each epoch; NaN if a hypothesis has failed.
    logs : (J, R) log weights before the first epoch.
    """
    weights = np.cumsum(evidences, axis=2) + logs[:, :, np.newaxis]
    weights = np.where(np.isfinite(weights), weights, -np.inf)
    with np.errstate(invalid="ignore"):
        return np.asarray(weights - np.logaddexp.reduce(weights, axis=0))


def mix(
    weights: np.ndarray, means: np.ndarray, covs: np.ndarray, mean: np.ndarray, cov: np.ndarray
) -> None:
    """Fill ``mean`` (R, K, n) and ``cov`` (R, K, n, n) with the moments of a mixture.

    Parameters
    ----------
    weights : (J, R, K) log weights.
    means, covs : (J, R, K, n), (J, R, K, n, n) estimates of each hypothesis.
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
    """Return texts on the hypotheses of significant weight, for each run at several times.

    The result contains an array of texts (R,) for each time. Its key names the time, for example
    ``at_600_s``.

    Parameters
    ----------
    times : (K,) times of the epochs [s].
    shares : (J, R, K) weights of the hypotheses, from 0 to 1.
    """
    texts_at, words = {}, [hypothesis.words for hypothesis in hypotheses]
    for k in np.unique(np.linspace(0, len(times) - 1, _SUMMARIES + 1)[1:].astype(int)):
        texts = []
        for share in shares[:, :, k].T:
            named = in_words(zip(words, share.tolist(), strict=True))
            texts.append(named or "nothing in particular")
        texts_at[f"at_{times[k]:.0f}_s"] = np.array(texts, dtype=np.str_)
    return texts_at
