"""Cautious updates of a Kalman filter, with one reading: gated, or underweighted.

What they are and where they come from: :mod:`ggbench.engines.cautious_update`, which does the same
compiled.
"""

from __future__ import annotations

import numpy as np

from .robust import Loss


def refusal(
    gate: float, underweighting: float, loss: Loss, iterations: int = 1, noise_memory: int = 0
) -> str | None:
    """Return why a gate or an underweighting means nothing, or None if they do."""
    if gate != 0.0 and not 0.0 < gate < 1.0:
        return f"gate must be a probability between 0 and 1, or 0 for none, and is {gate:g}"
    if not 0.0 <= underweighting < np.inf:
        return f"underweighting must be finite and not negative, and is {underweighting:g}"
    if gate or underweighting:
        name = "gate" if gate else "underweighting"
        if loss != "none":
            return f"{name} and a loss are two answers to the same readings: choose one"
        if iterations > 1:
            return f"{name} is of the plain update, and not with iterations = {iterations}"
        if noise_memory:
            return f"{name} needs the given noise, and not a noise_memory"
    return None


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
