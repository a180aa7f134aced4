"""Hypotheses about model errors: problems with more states or another noise.

A hypothesis changes nothing of the filter that takes it: its errors are further states, which the
equation of measurement C_k x and the transition lead to what is measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..block import ProblemBlock
from ..gravity.ellipsoid import EOTVOS, normal_gradient_of
from ..numerics.frozen import read_only
from ..problem import StateBlock, matched_with_map
from ..sensors.aiding import MGAL
from ..sensors.gradiometer.instrument import LOCAL_LEVEL
from ..sensors.model_arrays import linear_reach
from .robust_weights import losses

_FIXED = 1e-6
"""Standard deviation of the state that stands for the number one: a covariance is positive."""
_LARGER, _SHORTER = 2.0, 0.7
"""Deviation and distance of the process by which a map's error is estimated over those found."""
_THRESHOLD, _HEAVY = 2.385, 1.5
"""Thresholds of Cauchy's loss: as usual (Zhang 1997); of the density of many outliers."""
_CORE = 0.7
"""Scale of that density over the standard deviation of the noise among the outliers."""
_EARTH_RADIUS = 6.371e6
_COMPONENTS = ((0, 1, 2), (1, 3, 4), (2, 4, 5))
_WITHOUT_TRACE = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0])


@dataclass(frozen=True)
class Hypothesis:
    """What may differ from the model.

    Attributes
    ----------
    kind : its name in a summary.
    prior : its weight before any measurement, in any unit.
    noise : factor on the standard deviation of gravity and gradient channels.
    loss, threshold : of the noise, see :mod:`.robust_weights`.
    constant : standard deviation of a constant error of each such channel [unit of the channel].
    wander, length_m : standard deviation of another error of each channel, and its distance ℓ. The
        covariance is Matérn's with ν = 3/2, σ² (1 + √3 d/ℓ) exp(−√3 d/ℓ): smooth, as maps' errors.
    rough : whether that covariance is σ² exp(−d/ℓ) instead.
    gravity_mgal, gravity_km : standard deviation of each component of the gravity that the INS does
        not know, and the distance to 1/e of its correlation.
    integrated : whether the gravity's change is that of the gradients that are measured.
    estimate : the hypothesis by which the states are estimated, if another one than that whose
        evidence counts: see :func:`map_error`.
    """

    kind: str
    prior: float = 1.0
    noise: float = 1.0
    loss: str = "none"
    threshold: float = math.inf
    constant: float = 0.0
    wander: float = 0.0
    length_m: float = 0.0
    rough: bool = False
    gravity_mgal: float = 0.0
    gravity_km: float = math.inf
    integrated: bool = False
    estimate: Hypothesis | None = None

    @property
    def keeps_states(self) -> bool:
        """Whether the states are those of the block."""
        return not (self.constant or self.wander or self.gravity_mgal)

    @property
    def words(self) -> str:
        """The hypothesis as a person would say it."""
        said, noise = [], self.noise if self.estimate is None else self.estimate.noise
        if noise != 1.0:
            said.append(f"noise {noise:.2g} times as assumed")
        if self.loss != "none":
            said.append("outliers")
        if self.constant:
            said.append(f"constant errors of {self.constant:.2g} E")
        if self.wander:
            said.append(f"map errors of {self.wander:.2g} E over {self.length_m / 1e3:.2g} km")
        if self.gravity_mgal:
            far = f" over {self.gravity_km:.0f} km" if math.isfinite(self.gravity_km) else ""
            said.append(f"gravity of {self.gravity_mgal:.2g} mGal{far}")
        return ", ".join(said) or "as assumed"


def heavy_tails(kind: str, noise: float) -> Hypothesis:
    """Return the hypothesis that noise of a size has outliers among it.

    Tails that are heavy enough for a fifth of outliers tell the size of the others, but are no
    density of noise that has few of them: the states are estimated with Cauchy's usual threshold.
    """
    usual = Hypothesis(kind=kind, noise=noise, loss="cauchy", threshold=_THRESHOLD)
    return Hypothesis(
        kind=kind,
        noise=_CORE * noise,
        loss="cauchy",
        threshold=_HEAVY,
        estimate=usual,
    )


def map_error(kind: str, wander: float, length_m: float, constant: float = 0.0) -> Hypothesis:
    """Return the hypothesis that the map errs.

    A smooth process tells the error's size and distance, but no filter may rely on it: the slope of
    the map that it linearises by has the error's slope in it, so that its gain is too large and its
    covariance too small. A rough process with larger steps forgives that, and by its evidence
    alone the size would come out too small. So the evidence is that of the smooth one, and the
    states are estimated with the rough one.
    """
    rough = Hypothesis(
        kind=kind,
        constant=constant,
        wander=_LARGER * wander,
        length_m=_SHORTER * length_m,
        rough=True,
    )
    return Hypothesis(
        kind=kind, constant=constant, wander=wander, length_m=length_m, estimate=rough
    )


def takes(hypothesis: Hypothesis, block: ProblemBlock) -> bool:
    """Return whether a block has what a hypothesis speaks of."""
    of_channels = hypothesis.constant or hypothesis.wander or hypothesis.noise != 1.0
    if of_channels and not _of_the_map(block).any():
        return False
    # Errors that are modelled as walks are rougher than they are: less noise would make up for it.
    if hypothesis.noise < 1.0 and _walking_errors(block):
        return False
    if hypothesis.wander and block.tracks is None:
        return False
    if hypothesis.gravity_mgal and (block.tracks is None or _accelerometer(block) is None):
        return False
    return not hypothesis.integrated or _whole_tensor(block)


class Motion(NamedTuple):
    """What hypotheses need to know of a block's tracks, epoch by epoch.

    Attributes
    ----------
    ways : (R, K) from the epoch before, or the start [m]; zero without a track.
    known : (R, K, 3) by how much what the INS errs by has changed since the start, on average over
        the time from the epoch before, as gradients tell [m/s²] ENU; zero if they do not.
    walked : (R, K) variance that the noise of the gradients adds to it.
    """

    ways: np.ndarray
    known: np.ndarray
    walked: np.ndarray

    def part(self, first: int, stop: int) -> Motion:
        """Return that of the epochs from ``first`` to before ``stop``."""
        return Motion(*(array[:, first:stop] for array in self))


def motion_of(block: ProblemBlock) -> Motion:
    """Return what hypotheses need to know of the tracks of a whole flight."""
    runs, epochs = block.runs, block.epochs
    known, walked = np.zeros((runs, epochs, 3)), np.zeros((runs, epochs))
    if block.tracks is None:
        return Motion(np.zeros((runs, epochs)), known, walked)
    if _whole_tensor(block):
        change, walked = _integrated_gradients(block)
        known = 0.5 * change
        known[:, 1:] += 0.5 * change[:, :-1]
    speeds = np.linalg.norm(block.tracks[..., 3:6], axis=2)
    return Motion(speeds * np.diff(block.times, prepend=0.0), known, walked)


def augmented(
    block: ProblemBlock, hypothesis: Hypothesis, motion: Motion
) -> tuple[ProblemBlock, np.ndarray]:
    """Return a block by a hypothesis, its states behind those of the block.

    Also what the evidence (R, K) lacks of it: the logarithm of the density of noise that is zero.

    Parameters
    ----------
    block : of the epochs of ``motion``.
    """
    channels = np.flatnonzero(_of_the_map(block))
    scales = np.ones(block.noise_cov.shape[-1])
    scales[channels] = hypothesis.noise
    noise_cov = block.noise_cov * np.outer(scales, scales)
    roots = np.linalg.cholesky(noise_cov).diagonal(axis1=-2, axis2=-1)
    height = -np.log(np.broadcast_to(roots, block.present.shape)) - _spread(hypothesis)
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


def _of_the_map(block: ProblemBlock) -> np.ndarray:
    """Return which channels (m,) are matched with the map."""
    return matched_with_map(block.channels, block.measurements.shape[2])


def _walking_errors(block: ProblemBlock) -> bool:
    """Return whether the model has errors of the map's channels that change during a flight."""
    linear = block.model.linear[:, :, _of_the_map(block)]
    states = np.flatnonzero(linear.any(axis=(0, 1, 2)))
    return bool(np.diagonal(block.process_cov, axis1=2, axis2=3)[..., states].any())


def _spread(hypothesis: Hypothesis) -> float:
    """Return ln ∫ exp(−ρ) less that of the normal density: what a loss's tails take."""
    if hypothesis.loss == "none":
        return 0.0
    half = hypothesis.threshold**2
    # exp(−ρ) of Cauchy's loss is Student's density of c² − 1 degrees of freedom, but for its peak.
    if hypothesis.loss == "cauchy":
        total = math.lgamma(0.5) + math.lgamma(0.5 * half - 0.5) - math.lgamma(0.5 * half)
        return math.log(hypothesis.threshold) + total - 0.5 * math.log(2.0 * math.pi)
    grid = np.linspace(-200.0, 200.0, 400_001)
    density = np.exp(-losses(grid, hypothesis.loss, hypothesis.threshold))
    return math.log(density.sum() * (grid[1] - grid[0])) - 0.5 * math.log(2.0 * math.pi)


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


def _accelerometer(block: ProblemBlock) -> slice | None:
    """Return which states are biases of accelerometers; None without three of them."""
    for part in block.layout:
        if part.name == "accelerometer bias" and part.slice.stop - part.slice.start == 3:
            return part.slice
    return None


def _gravity_coupling(block: ProblemBlock) -> np.ndarray:
    """Return what an acceleration ENU [m/s²] that the INS does not know adds to x (R, K, n, 3).

    As a bias of the accelerometers does that is constant from epoch to epoch.
    """
    place = _accelerometer(block)
    assert place is not None and block.tracks is not None
    attitudes = block.tracks[..., 6:].reshape(*block.tracks.shape[:2], 3, 3)
    coupling = block.transition[..., place] @ attitudes.swapaxes(-1, -2)
    coupling[..., place, :] = 0.0
    return np.asarray(coupling)


def _whole_tensor(block: ProblemBlock) -> bool:
    """Return whether the gradiometer tells all of a tensor in axes of the local level."""
    model = block.model
    if block.tracks is None or model.instrument != LOCAL_LEVEL or len(model.lags) > 1:
        return False
    if model.lags.shape[1] != 1 or model.lags[0, 0] != 0 or not len(model.channels):
        return False
    return np.linalg.matrix_rank(np.vstack([model.channels, _WITHOUT_TRACE])) == 6


def _transport_rate(latitudes: np.ndarray, velocities: np.ndarray) -> np.ndarray:
    """Return ω_en (R, 3) [rad/s] of the local level ENU, to the flattening of the Earth."""
    east, north = velocities[:, 0], velocities[:, 1]
    rates = np.stack([-north, east, east * np.tan(latitudes)], axis=1)
    return np.asarray(rates / _EARTH_RADIUS)


def _integrated_gradients(block: ProblemBlock) -> tuple[np.ndarray, np.ndarray]:
    """Return the change (R, K, 3) of what the INS errs by, from gradients along its track.

    In m/s², ENU; and the variance (R, K) that the noise of the readings adds at each epoch.
    """
    assert block.tracks is not None
    model, tracks = block.model, block.tracks
    g = len(model.channels)
    covs = block.noise_cov.reshape(-1, *block.noise_cov.shape[-2:])
    sigma = math.sqrt(np.mean(covs[0].diagonal()[:g]))
    inverse = np.linalg.pinv(np.vstack([model.channels, _WITHOUT_TRACE * 1e3]))[:, :g]
    normal = np.zeros((*tracks.shape[:2], 6))
    for r in range(block.runs):
        for k in range(block.epochs):
            latitude, height = tracks[r, k, 0], tracks[r, k, 2]
            found = normal_gradient_of(math.sin(latitude), math.cos(latitude), height)
            normal[r, k, [0, 3, 4, 5]] = found
    gain = model.gain[..., np.newaxis]
    readings = block.measurements[..., :g] - model.offset[..., :g]
    readings = readings - gain * (normal @ model.channels.T)
    tensors = EOTVOS * (readings @ inverse.T)
    change, variance = np.zeros((*tracks.shape[:2], 3)), np.zeros(tracks.shape[:2])
    steps = np.diff(block.times, prepend=0.0)
    components = np.array(_COMPONENTS)
    held, total = tensors[:, 0], np.zeros((block.runs, 3))
    for k in range(block.epochs):
        there = np.asarray(block.present[:, k, :g].all(axis=1))[:, np.newaxis]
        new = np.where(there, tensors[:, k], held)
        velocity = tracks[:, max(k - 1, 0), 3:6] + tracks[:, k, 3:6]
        rate = 0.5 * (new + held)[:, components]
        turn = _transport_rate(tracks[:, k, 0], 0.5 * velocity)
        total = total - steps[k] * (
            np.einsum("rij,rj->ri", rate, 0.5 * velocity) + np.cross(turn, total)
        )
        held = new
        change[:, k] = total
        way = steps[k] * np.linalg.norm(0.5 * velocity, axis=1)
        variance[:, k] = (EOTVOS * sigma * way) ** 2
    return change, variance
