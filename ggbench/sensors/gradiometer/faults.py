"""What a gradiometer does to the tensor that it should deliver: truth that no estimator is told.

In this order: scale factor and misalignment of the mount, the errors of its rotating disks, bias
and drift, white noise, outliers, the low-pass, the noise behind it; then readings drop out. When
readings are taken at wrong times, :mod:`ggbench.simulation.runs` takes the tensor there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...numerics.rotations import rotation_matrix
from .instrument import Gradiometer


@dataclass(frozen=True)
class Faults:
    """Errors of a gradiometer beyond white noise and the biases that a model may know.

    Attributes
    ----------
    scale_factor : σ of each channel's relative error, drawn once per run.
    misalignment : σ of the mount's rotation about each of its axes, drawn once per run [rad].
    outlier_share : probability that a reading of a channel is an outlier.
    outlier : σ of what is added to an outlier, of all channels or of each [unit of the channel].
    dropout_share : probability that a reading, with all its channels, is missing.
    dropouts : (start, end) times between which all readings are missing [s].
    clock : σ of the error of the time by which inertial axes are known, once per run [s] (eq. 12).
    jitter : σ of the error of each reading's time [s].
    """

    scale_factor: float = 0.0
    misalignment: float = 0.0
    outlier_share: float = 0.0
    outlier: float | tuple[float, ...] = 0.0
    dropout_share: float = 0.0
    dropouts: tuple[tuple[float, float], ...] = ()
    clock: float = 0.0
    jitter: float = 0.0

    @property
    def distorts(self) -> bool:
        """Whether there are scale factors or a misalignment."""
        return self.scale_factor > 0.0 or self.misalignment > 0.0

    def distort(
        self, tensors: np.ndarray, channels: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        """Return channels (K, m) of true tensors (K, 6) in the mount, misaligned and scaled."""
        turn = np.empty((3, 3))
        rotation_matrix(self.misalignment * rng.standard_normal(3), turn)
        scale = 1.0 + self.scale_factor * rng.standard_normal(len(channels))
        full = tensors[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
        turned = (turn @ full @ turn.T)[:, *np.triu_indices(3)]
        return np.asarray(scale * (turned @ channels.T))

    def outliers(self, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
        """Return what outliers add to readings of a shape [E]."""
        struck = rng.random(shape) < self.outlier_share
        return np.where(struck, np.asarray(self.outlier) * rng.standard_normal(shape), 0.0)

    def missing(self, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return which of the readings (K,) drop out in a run."""
        lost = rng.random(len(times)) < self.dropout_share
        return np.asarray(lost | self.in_dropouts(times))

    def in_dropouts(self, times: np.ndarray) -> np.ndarray:
        """Return which times (K,) lie in the intervals without readings."""
        inside = [(times > start - 1e-9) & (times < end + 1e-9) for start, end in self.dropouts]
        return np.logical_or.reduce([np.zeros(len(times), dtype=bool), *inside])

    def expected_share(self, times: np.ndarray) -> np.ndarray:
        """Return the share of all runs (K,) in which each of the readings is there."""
        return np.where(self.in_dropouts(times), 0.0, 1.0 - self.dropout_share)


def biases(
    gradiometer: Gradiometer, channels: int, times: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return the biases (K, m) of a run at its epochs [E]: constant at the start, then a walk."""
    start = gradiometer.bias_eotvos * rng.standard_normal(channels)
    steps = np.sqrt(np.diff(times, prepend=0.0))[:, np.newaxis]
    walk = gradiometer.drift * steps * rng.standard_normal((len(times), channels))
    return np.asarray(start + np.cumsum(walk, axis=0))
