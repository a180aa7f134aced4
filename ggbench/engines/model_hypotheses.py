"""Hypotheses about model errors, as additional states or different noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..block import ProblemBlock
from ..problem import matched_with_map
from .hypothesis_motion import whole_tensor
from .robust_weights import losses

_LARGER, _SHORTER = 2.0, 0.7
"""Factors on standard deviation and correlation length of a map error, for the estimates."""
_THRESHOLD, _HEAVY = 2.385, 1.5
"""Thresholds of Cauchy's loss: the usual one (Zhang 1997), and the one for many outliers."""
_CORE = 0.7
"""Factor on the noise standard deviation in the filter for many outliers."""
_ADAPTED = 1.03
"""Noise of the filter for the estimates over that of the hypothesis. The weights of a loss follow
from the innovations, so that the gain is slightly too large."""


@dataclass(frozen=True)
class Hypothesis:
    """Hypothesis that the true model deviates from the assumed model.

    Attributes
    ----------
    kind : name of the hypothesis in a summary.
    prior : prior weight; weights of several hypotheses need not sum to one.
    noise : factor on the noise standard deviation of gravity and gradient channels.
    loss, threshold : robust loss for noise with outliers, see :mod:`.robust_weights`.
    constant : standard deviation of a constant error of each gravity or gradient channel [unit of
        the channel].
    wander, length_m : standard deviation σ [unit of the channel] and correlation length ℓ [m] of a
        variable error of each gravity or gradient channel. The error is a Matérn process of the
        distance d along the track, with ν = 3/2 and covariance σ² (1 + √3 d/ℓ) exp(−√3 d/ℓ). It is
        smooth like map errors.
    rough : whether the covariance of the variable error is σ² exp(−d/ℓ) instead.
    gravity_mgal, gravity_km : standard deviation of each component of the unknown gravity, and
        distance at which the correlation is 1/e.
    integrated : whether the change of the unknown gravity is integrated from measured gradients.
    estimate : hypothesis of a second filter for the estimates, see :func:`map_error`. None: one
        filter gives both evidence and estimates.
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
        """Whether the hypothesis adds no states."""
        return not (self.constant or self.wander or self.gravity_mgal)

    @property
    def words(self) -> str:
        """Description of the hypothesis for summaries."""
        said, noise = [], self.noise
        if self.loss != "none" and self.estimate is not None:
            noise /= _CORE  # of heavy_tails
        if noise != 1.0:
            said.append(f"noise {noise:.2g} times as assumed")
        if self.loss != "none":
            said.append("outliers")
        if self.constant:
            said.append(f"constant errors of {self.constant:.3g} E")
        if self.wander:
            said.append(f"map errors of {self.wander:.3g} E over {self.length_m / 1e3:.3g} km")
        if self.gravity_mgal:
            far = f" over {self.gravity_km:.0f} km" if math.isfinite(self.gravity_km) else ""
            said.append(f"gravity of {self.gravity_mgal:.3g} mGal{far}")
        return ", ".join(said) or "as assumed"


def heavy_tails(kind: str, noise: float) -> Hypothesis:
    """Return the hypothesis of noise with outliers.

    The evidence comes from a filter with tails heavy enough for 20 % outliers, so that outliers do
    not bias the estimated size of other model errors. These tails are too heavy if outliers are
    few. Therefore the estimates come from a filter with the usual threshold of Cauchy's loss, and
    with 3 % more noise. Without the additional noise the mean NEES of nine campaigns with 10 %
    outliers is 6.26 ± 0.09 (standard error). The expected value is 6.
    """
    usual = Hypothesis(kind=kind, noise=_ADAPTED * noise, loss="cauchy", threshold=_THRESHOLD)
    return Hypothesis(
        kind=kind,
        noise=_CORE * noise,
        loss="cauchy",
        threshold=_HEAVY,
        estimate=usual,
    )


def map_error(kind: str, wander: float, length_m: float, constant: float = 0.0) -> Hypothesis:
    """Return the hypothesis of map errors.

    The evidence comes from a filter with a smooth error process, which identifies size and
    correlation length of the map error correctly. The estimates of this filter are overconfident:
    the gradient of the map includes the gradient of its error, so the gain is too large and the
    covariance too small. Therefore the estimates come from a filter with a rough error process and
    larger process noise. The evidence of that second filter would favour too small a map error.

    Parameters
    ----------
    kind : name of the hypothesis.
    wander, length_m, constant : see :class:`Hypothesis`.
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


def applicable(hypotheses: Sequence[Hypothesis], block: ProblemBlock) -> list[Hypothesis]:
    """Return the hypotheses that apply to a block.

    - Errors and noise factors of map-matched channels require such channels.
    - A noise factor below 1 requires that these channels depend on no state with process noise.
    - A variable error requires a track.
    - Unknown gravity requires a track and accelerometer biases among the states.
    - Integrated gravity requires the whole tensor, see :func:`.whole_tensor`.
    """
    mapped, tracked = of_the_map(block).any(), block.tracks is not None
    steered = tracked and accelerometer(block) is not None
    # Errors that are modelled as walks are rougher than they are: less noise would make up for it.
    walking, whole = _walking_errors(block), whole_tensor(block)

    def applies(hypothesis: Hypothesis) -> bool:
        of_channels = hypothesis.constant or hypothesis.wander or hypothesis.noise != 1.0
        return not (
            (of_channels and not mapped)
            or (hypothesis.noise < 1.0 and walking)
            or (hypothesis.wander and not tracked)
            or (hypothesis.gravity_mgal and not steered)
            or (hypothesis.integrated and not whole)
        )

    return [hypothesis for hypothesis in hypotheses if applies(hypothesis)]


def of_the_map(block: ProblemBlock) -> np.ndarray:
    """Return the mask (m,) of the channels that are matched with the map.

    These are the channels of gravity and gravity gradients; see :func:`.matched_with_map`.
    """
    return matched_with_map(block.channels, block.measurements.shape[2])


def _walking_errors(block: ProblemBlock) -> bool:
    """Return whether map-matched channels depend linearly on states with process noise."""
    channels = np.flatnonzero(of_the_map(block))
    if not (channels >= block.model.first_linear).any():
        return False
    states = np.flatnonzero(block.model.linear[:, :, channels].any(axis=(0, 1, 2)))
    return bool(np.diagonal(block.process_cov, axis1=2, axis2=3)[..., states].any())


def spread(hypothesis: Hypothesis) -> float:
    """Return ln (∫ exp(−ρ(r)) dr / √(2π)) of the loss ρ of a hypothesis.

    It is zero without a loss.
    """
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


def accelerometer(block: ProblemBlock) -> slice | None:
    """Return the indices of the three accelerometer biases, or None if they are not states."""
    for part in block.layout:
        if part.name == "accelerometer bias" and part.slice.stop - part.slice.start == 3:
            return part.slice
    return None
