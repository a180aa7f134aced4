"""Strong tracking: fading factor that matches the covariance of the innovations.

With a correct model and gain the innovations γ of a filter are white and have the predicted
covariance. With a wrong model the filter is overconfident and reacts too slowly. Strong tracking
(Zhou, Xi & Zhang 1991; Zhou & Frank 1996) multiplies the propagated covariance by a fading factor λ
≥ 1: P⁻ = λ Φ P Φᵀ + Q. The factor fits the predicted covariance of the innovations to the
observed covariance V. If β = 1 and λ > 1, both have the same trace:

    V_1 = γ_1 γ_1ᵀ,   V_k = (ρ V_{k−1} + γ_k γ_kᵀ) / (1 + ρ),
    N_k = V_k − H Q Hᵀ − β R,   M_k = H Φ P Φᵀ Hᵀ,   λ_k = max(1, tr N_k / tr M_k).

Here P is the covariance of the states, Φ the transition matrix, and Q the process noise covariance.
H is the Jacobian of the measurements, and R their noise covariance. ρ is a forgetting factor, and
β ≥ 1 weakens the fading. λ is a scalar that depends only on the size of past innovations, so it
cannot distinguish a wrong model from large noise.

Only the traces of N and M are needed, so only the diagonal of V is computed. Measurements are
whitened with the noise covariance R, so that channels of different units or noise have equal
weights. If all channels have equal noise, the result is the published factor.
"""

from __future__ import annotations

import numpy as np

MOST = 1000.0
"""Largest fading factor; it already discards nearly all earlier information."""
_LEAST_SPREAD = 1e-12
"""Smallest tr M, for whitened measurements, at which fading is applied.

Below it the propagated covariance hardly affects the predicted measurements.
"""


def innovation_power(
    before: np.ndarray, innovations: np.ndarray, seen: np.ndarray, rho: float
) -> np.ndarray:
    """Return the diagonals (J, m) of the matrices V_k of J filters with m whitened channels.

    Parameters
    ----------
    before : (J, m) diagonals of V_{k−1}.
    innovations : (J, m) whitened innovations γ_k.
    seen : (m,) mask of channels with an earlier innovation; for other channels V_k = γ_k γ_kᵀ.
    rho : forgetting factor ρ, 0 to 1.
    """
    squares = innovations**2
    return np.where(seen, (rho * before + squares) / (1.0 + rho), squares)


def fading_factors(
    power: np.ndarray, spread: np.ndarray, noise_spread: np.ndarray, beta: float
) -> np.ndarray:
    """Return the fading factors λ_k (J,) of J filters, computed without derivatives of h.

    Parameters
    ----------
    power : (J, m) diagonals of V_k for the available whitened channels.
    spread : (J, m) diagonals of the covariance P_zz of h, without R. For a linear h, P_zz is
        H (Φ P Φᵀ + Q) Hᵀ.
    noise_spread : (J, m) diagonals of H Q Hᵀ with Hᵀ = (Φ P Φᵀ + Q)⁻¹ P_xz. P_xz is the
        cross-covariance of the states and h.
    beta : β ≥ 1.
    """
    n_trace = (power - noise_spread - beta).sum(axis=1)
    m_trace = (spread - noise_spread).sum(axis=1)
    known = m_trace >= _LEAST_SPREAD
    factors = n_trace / np.where(known, m_trace, 1.0)
    return np.where(known, np.clip(factors, 1.0, MOST), 1.0)


def faded(cov: np.ndarray, process_cov: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Return the faded covariances (J, n, n) of J filters, λ Φ P Φᵀ + Q.

    ``cov`` (J, n, n) is Φ P Φᵀ + Q, ``process_cov`` (n, n) is Q, and ``factors`` (J,) are λ. An
    increment is added to ``cov``, so that λ = 1 changes no bit.
    """
    return cov + (factors - 1.0)[:, np.newaxis, np.newaxis] * (cov - process_cov)
