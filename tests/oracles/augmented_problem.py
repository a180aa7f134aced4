"""Problems with the states of a hypothesis as dense matrices, for the plain filter."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ggbench.block import ProblemBlock
from ggbench.engines.hypothesis_motion import Motion
from ggbench.engines.model_hypotheses import Hypothesis, accelerometer, of_the_map, spread
from ggbench.numerics.frozen import read_only
from ggbench.problem import StateBlock
from ggbench.sensors.aiding import MGAL
from ggbench.sensors.model_arrays import linear_reach

_FIXED = 1e-6
"""Standard deviation of the state that stands for the number one: a covariance is positive."""


def augmented(
    block: ProblemBlock, hypothesis: Hypothesis, motion: Motion
) -> tuple[ProblemBlock, np.ndarray]:
    """Return a block by a hypothesis, its states behind those of the block.

    Also what the evidence (R, K) lacks of it: the logarithm of the density of noise that is zero.

    Parameters
    ----------
    block : of the epochs of ``motion``.
    """
    channels = np.flatnonzero(of_the_map(block))
    scales = np.ones(block.noise_cov.shape[-1])
    scales[channels] = hypothesis.noise
    noise_cov = block.noise_cov * np.outer(scales, scales)
    roots = np.linalg.cholesky(noise_cov).diagonal(axis1=-2, axis2=-1)
    height = -np.log(np.broadcast_to(roots, block.present.shape)) - spread(hypothesis)
    peak = np.sum(np.where(block.present, height, 0.0), axis=2)
    n, g = block.dimension, len(channels)
    moving = (1 if hypothesis.rough else 2) * g if hypothesis.wander else 0
    felt = 3 if hypothesis.gravity_mgal else 0
    one = 1 if hypothesis.integrated else 0
    constants = g if hypothesis.constant else 0
    size = n + moving + felt + one + constants
    if size == n:
        return replace(block, noise_cov=noise_cov), peak
    phi, q = (
        np.zeros((block.runs, block.epochs, size, size)),
        np.zeros((block.runs, block.epochs, size, size)),
    )
    phi[..., :n, :n], q[..., :n, :n] = block.transition, block.process_cov
    mean, cov = np.zeros(size), np.zeros((size, size))
    mean[:n], cov[:n, :n] = block.prior_mean, block.prior_cov
    linear = np.zeros((*block.model.linear.shape[:-1], size))
    linear[..., :n] = block.model.linear
    added = np.arange(n, size)
    phi[..., added, added] = 1.0
    there = np.where(block.present[..., channels], 1.0, 0.0)
    ways = motion.ways
    units = 1.0 if block.channels else roots.reshape(-1, len(scales))[0, channels]
    units = units * np.ones(g)
    if moving:
        each, variances = moving // g, (hypothesis.wander * units) ** 2
        first, decay = n + each * np.arange(g), ways / hypothesis.length_m
        fill = _fill_markov if hypothesis.rough else _fill_matern
        fill(first, decay, variances, phi, q)
        cov[added[:moving], added[:moving]] = np.repeat(variances, each)
        linear[:, :, channels, first] = there
    if felt:
        place = slice(n + moving, n + moving + 3)
        sigma = hypothesis.gravity_mgal / MGAL
        coupling = _gravity_coupling(block)
        phi[..., :n, place] = coupling
        index = np.arange(place.start, place.stop)
        cov[index, index] = sigma**2
        if hypothesis.integrated:
            phi[..., :n, place.stop] = np.einsum("rkab,rkb->rka", coupling, motion.known)
            q[..., index, index] = motion.walked[..., np.newaxis]
            mean[place.stop], cov[place.stop, place.stop] = 1.0, _FIXED**2
        else:
            kept = np.exp(-1e-3 * ways / hypothesis.gravity_km)[..., np.newaxis]
            phi[..., index, index] = kept
            q[..., index, index] = sigma**2 * (1.0 - kept**2)
    if constants:
        last = added[-g:]
        cov[last, last] = (hypothesis.constant * units) ** 2
        linear[:, :, channels, last] = there
    first_linear, columns = linear_reach(linear, block.model.weights)
    model = replace(
        block.model,
        dimension=size,
        linear=read_only(linear),
        first_linear=first_linear,
        columns=columns,
    )
    return replace(
        block,
        noise_cov=noise_cov,
        transition=phi,
        process_cov=q,
        prior_mean=mean,
        prior_cov=cov,
        model=model,
        layout=(*block.layout, StateBlock(hypothesis.kind, slice(n, size), "1")),
        replays=None,
    ), peak


def _fill_markov(
    first: np.ndarray, decay: np.ndarray, variances: np.ndarray, phi: np.ndarray, q: np.ndarray
) -> None:
    """Fill Φ and Q of first-order Gauss–Markov processes; see :func:`_fill_matern`."""
    kept = np.exp(-decay)[..., np.newaxis]
    phi[..., first, first] = kept
    q[..., first, first] = variances * (1.0 - kept**2)


def _fill_matern(
    first: np.ndarray, decay: np.ndarray, variances: np.ndarray, phi: np.ndarray, q: np.ndarray
) -> None:
    """Fill Φ and Q of processes of Matérn's covariance, ν = 3/2 (Särkkä & Solin 2019, sec. 12.3).

    Their states are the error and its derivative by √3 d/ℓ, of the same variance.

    Parameters
    ----------
    first : (g,) the first state of each process.
    decay : (R, K) the way to each epoch over the distance ℓ.
    variances : (g,) σ².
    """
    scaled = math.sqrt(3.0) * decay
    fade = np.exp(-scaled)
    step = np.empty((*decay.shape, 2, 2))
    step[..., 0, 0], step[..., 0, 1] = fade * (1.0 + scaled), fade * scaled
    step[..., 1, 0], step[..., 1, 1] = -fade * scaled, fade * (1.0 - scaled)
    noise = np.eye(2) - step @ step.swapaxes(-1, -2)
    for i in range(2):
        for j in range(2):
            phi[..., first + i, first + j] = step[..., i, j, np.newaxis]
            q[..., first + i, first + j] = noise[..., i, j, np.newaxis] * variances


def _gravity_coupling(block: ProblemBlock) -> np.ndarray:
    """Return what an acceleration ENU [m/s²] that the INS does not know adds to x (R, K, n, 3).

    As a bias of the accelerometers does that is constant from epoch to epoch.
    """
    place = accelerometer(block)
    assert place is not None and block.tracks is not None
    attitudes = block.tracks[..., 6:].reshape(*block.tracks.shape[:2], 3, 3)
    coupling = block.transition[..., place] @ attitudes.swapaxes(-1, -2)
    coupling[..., place, :] = 0.0
    return np.asarray(coupling)
