"""The innovation test and Joseph's form, of one measurement."""

from __future__ import annotations

import numpy as np


def normalised_square(innovation: np.ndarray, innovation_cov: np.ndarray) -> float:
    """Return yᵀ S⁻¹ y of an innovation (m,) and its covariance (m, m)."""
    return float(innovation @ np.linalg.solve(innovation_cov, innovation))


def joseph(
    cov: np.ndarray, gain: np.ndarray, rows: np.ndarray, noise_cov: np.ndarray
) -> np.ndarray:
    """Return the covariance (n, n) after an update with any gain K (n, m), optimal or not.

    (I − K H) P (I − K H)ᵀ + K R Kᵀ of P (n, n), H (m, n), R (m, m).
    """
    kept = np.eye(len(cov)) - gain @ rows
    return np.asarray(kept @ cov @ kept.T + gain @ noise_cov @ gain.T)
