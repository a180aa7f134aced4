"""The multiple-model filter: filters of several hypotheses, weighted by their evidence.

The hypotheses are static (Magill 1965): what a model leaves out does not change during a flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..block import EstimateBlock, ProblemBlock
from ..numerics.kernels import LANES
from .banks import split_prior
from .extended_filter import UpdateOptions, extended_with_evidence
from .gaussian_sum import WIDTH, gaussian_sum_with_evidence
from .model_hypotheses import Hypothesis, augmented, takes

_SUMMARIES = 4
"""Times in a flight at which the weights are told in words."""
_WORTH_TELLING = 0.05


class CellOptions(NamedTuple):
    """How a hypothesis's filter searches.

    Attributes
    ----------
    spacing_m, most : of the prior's Gaussians, see :func:`.split_prior`.
    iterations : linearisations of h in each update.
    """

    spacing_m: float
    most: int
    iterations: int


def multiple_model(
    block: ProblemBlock, hypotheses: Sequence[Hypothesis], options: CellOptions
) -> EstimateBlock:
    """Run the filter; hypotheses that a block has nothing of are left out."""
    chosen = [hypothesis for hypothesis in hypotheses if takes(hypothesis, block)]
    priors = np.array([hypothesis.prior for hypothesis in chosen])
    runs, epochs, n = block.runs, block.epochs, block.dimension
    mean, cov = np.empty((runs, epochs, n)), np.empty((runs, epochs, n, n))
    weights, counts = np.empty((len(chosen), runs, epochs)), np.zeros(runs, dtype=np.int64)
    # The hypotheses' estimates of a group of runs are in memory at the same time.
    for first in range(0, runs, LANES):
        some = slice(first, min(first + LANES, runs))
        part = block.some(some.start, some.stop)
        found, evidences = [], []
        for hypothesis in chosen:
            estimate, evidence = filtered(part, hypothesis, options)
            evidences.append(evidence)
            counts[some] += estimate.info["map_evaluations"]
            if hypothesis.estimate is not None:
                estimate, _ = filtered(part, hypothesis.estimate, options)
                counts[some] += estimate.info["map_evaluations"]
            found.append(estimate)
        weights[:, some] = log_weights(np.array(evidences), priors)
        mix(weights[:, some], found, mean[some], cov[some])
    shares = np.exp(weights)
    info = {"map_evaluations": counts, "models": summaries(block.times, chosen, shares)}
    for kind in dict.fromkeys(hypothesis.kind for hypothesis in chosen):
        members = [j for j, hypothesis in enumerate(chosen) if hypothesis.kind == kind]
        info[f"weight_{kind}"] = shares[members, :, -1].sum(axis=0)
    return EstimateBlock(mean, cov, "filter", info=info)


def filtered(
    block: ProblemBlock, hypothesis: Hypothesis, options: CellOptions
) -> tuple[EstimateBlock, np.ndarray]:
    """Return the estimates of a block's own states by one hypothesis, and the evidence (R, K)."""
    problem, peak = augmented(block, hypothesis)
    n, loss, threshold = block.dimension, hypothesis.loss, hypothesis.threshold
    iterations = options.iterations if loss == "none" else max(options.iterations, 2)
    cells, _, _ = split_prior(block.problem(0), options.spacing_m, options.most, WIDTH)
    if len(cells) == 1:
        found, evidence = extended_with_evidence(
            problem, UpdateOptions(iterations=iterations, loss=loss, threshold=threshold)
        )
    else:
        found, evidence = gaussian_sum_with_evidence(
            problem, options.spacing_m, options.most, iterations, loss, threshold
        )
    own = replace(found, mean=found.mean[..., :n], cov=found.cov[..., :n, :n])
    return own, evidence + peak


def log_weights(evidences: np.ndarray, priors: np.ndarray) -> np.ndarray:
    """Return the logarithms of the hypotheses' weights (J, R, K), whose sum is one.

    NaN from the epoch on from which no hypothesis has an answer.

    Parameters
    ----------
    evidences : (J, R, K).
    priors : (J,).
    """
    weights = np.cumsum(evidences, axis=2) + np.log(priors)[:, np.newaxis, np.newaxis]
    weights = np.where(np.isfinite(weights), weights, -np.inf)
    with np.errstate(invalid="ignore"):
        return np.asarray(weights - np.logaddexp.reduce(weights, axis=0))


def mix(
    weights: np.ndarray, found: Sequence[EstimateBlock], mean: np.ndarray, cov: np.ndarray
) -> None:
    """Fill the moments (R, K, n), (R, K, n, n) of the mixture of estimates.

    Parameters
    ----------
    weights : (J, R, K) logarithms.
    """
    shares = np.exp(weights)
    mean[:], cov[:] = 0.0, 0.0
    for share, estimate in zip(shares, found, strict=True):
        counted = (share != 0.0)[..., np.newaxis]
        mean += share[..., np.newaxis] * np.where(counted, estimate.mean, 0.0)
    for share, estimate in zip(shares, found, strict=True):
        counted = (share != 0.0)[..., np.newaxis]
        off = np.where(counted, estimate.mean - mean, 0.0)
        spread = np.where(counted[..., np.newaxis], estimate.cov, 0.0)
        spread += off[..., :, np.newaxis] * off[..., np.newaxis, :]
        cov += share[..., np.newaxis, np.newaxis] * spread


def summaries(
    times: np.ndarray, hypotheses: Sequence[Hypothesis], shares: np.ndarray
) -> np.ndarray:
    """Return for each run in words which hypotheses weigh something, at some times of the flight.

    Parameters
    ----------
    times : (K,).
    shares : (J, R, K).
    """
    epochs = np.unique(np.linspace(0, len(times) - 1, _SUMMARIES + 1)[1:].astype(int))
    texts = []
    for run in range(shares.shape[1]):
        parts = []
        for k in epochs:
            share = shares[:, run, k]
            order = [j for j in np.argsort(-share, kind="stable") if share[j] >= _WORTH_TELLING]
            said = "; ".join(f"{hypotheses[j].words} {share[j]:.2f}" for j in order)
            parts.append(f"at {times[k]:.0f} s {said or 'nothing in particular'}")
        texts.append(" | ".join(parts))
    return np.array(texts, dtype=np.str_)
