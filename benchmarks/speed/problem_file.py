"""Estimation problem as plain arrays in a file, for programs without ggbench."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np


class Arrays(NamedTuple):
    """R runs of one case, with K epochs, m channels and n states; SI units, radians, eotvos.

    x_0 ~ N(prior_mean, prior_cov), x_k = transition_k x_{k−1} + N(0, process_cov_k),
    z_k = h_k(x_k) + N(0, noise_cov); :mod:`.numpy_model` defines h.
    """

    times: np.ndarray  # (K,) times of the epochs
    measurements: np.ndarray  # (R, K, m)
    noise_cov: np.ndarray  # (m, m)
    transition: np.ndarray  # (R, K, n, n)
    process_cov: np.ndarray  # (R, K, n, n)
    prior_mean: np.ndarray  # (n,)
    prior_cov: np.ndarray  # (n, n)
    reading_times: np.ndarray  # (K,) t − τ
    references: np.ndarray  # (R, K, 3) INS latitude, longitude, height at t − τ
    rows: np.ndarray  # (R, K, 3, n) from the state at t to the ENU position error at t − τ
    offsets: np.ndarray  # (R, K, m)
    gains: np.ndarray  # (K,)
    origin: np.ndarray  # (3,) first node of the map
    step: np.ndarray  # (3,) spacing of the nodes
    coefficients: np.ndarray  # (n0, n1, n2, 6) coefficients of the map's cubic B-spline
    even_zonals: np.ndarray  # (6,) J2, J4, ..., J12 of the normal field

    @property
    def runs(self) -> int:
        """Number of runs R."""
        return len(self.measurements)

    @property
    def scale(self) -> np.ndarray:
        """Standard deviations (n,) of the prior."""
        return np.sqrt(np.diag(self.prior_cov))


def save(path: Path, arrays: Arrays) -> None:
    """Write the arrays as an .npz file."""
    np.savez(path, **arrays._asdict())


def load(path: Path) -> Arrays:
    """Return the arrays in a file from :func:`save`."""
    with np.load(path) as file:
        return Arrays(**{name: file[name] for name in Arrays._fields})
