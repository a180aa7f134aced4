"""Strong tracking: fading factor that keeps the innovations white.

With the right model and gain the innovations γ of a filter are white. With a wrong one they are
not: the filter is too sure of its prediction and follows too slowly. Strong tracking (Zhou, Xi &
Zhang 1991; Zhou & Frank 1996) makes what the past contributes to the predicted covariance larger by
a fading factor λ ≥ 1, P⁻ = λ Φ P Φᵀ + Q, such that the innovations' covariance becomes what it is
seen to be:

    V_1 = γ_1 γ_1ᵀ,   V_k = (ρ V_{k−1} + γ_k γ_kᵀ) / (1 + ρ),
    N_k = V_k − H Q Hᵀ − β R,   M_k = H Φ P Φᵀ Hᵀ,   λ_k = max(1, tr N_k / tr M_k).

ρ is a forgetting factor, β ≥ 1 weakens the fading. λ is a number, and knows of the past only how
large innovations were: it cannot tell a wrong model from a large noise.

Of N and M no more than the traces matters, so that V is kept as its diagonal, of readings whitened
by R: channels of different units, or noises, then weigh alike. With equal noises that is the
published factor.
"""

from __future__ import annotations

import numpy as np

MOST = 1000.0
"""Largest fading factor: more than that is no longer a filter's past."""
_LEAST_SPREAD = 1e-12
"""tr M of whitened readings below which the past says nothing of them: nothing is to be faded."""


def innovation_power(
    before: np.ndarray, innovations: np.ndarray, seen: np.ndarray, rho: float
) -> np.ndarray:
    """Return the diagonals of V_k (J, m) of whitened innovations γ_k (J, m).

    Parameters
    ----------
    before : (J, m) those of V_{k−1}.
    seen : (m,) which channels had an innovation before: of the others it is the first.
    rho : ρ, 0 to 1.
    """
    squares = innovations**2
    return np.where(seen, (rho * before + squares) / (1.0 + rho), squares)


def fading_factors(
    power: np.ndarray, spread: np.ndarray, noise_spread: np.ndarray, beta: float
) -> np.ndarray:
    """Return λ_k (J,), without derivatives: from a predicted covariance that holds Q already.

    Parameters
    ----------
    power : (J, m) diagonals of V_k, of the whitened channels that there are.
    spread : (J, m) diagonals of P_zz without R: H (Φ P Φᵀ + Q) Hᵀ where h is linear.
    noise_spread : (J, m) diagonals of H Q Hᵀ with Hᵀ = (ΦPΦᵀ + Q)⁻¹ P_xz.
    beta : β ≥ 1.
    """
    n_trace = (power - noise_spread - beta).sum(axis=1)
    m_trace = (spread - noise_spread).sum(axis=1)
    known = m_trace >= _LEAST_SPREAD
    factors = n_trace / np.where(known, m_trace, 1.0)
    return np.where(known, np.clip(factors, 1.0, MOST), 1.0)


def faded(cov: np.ndarray, process_cov: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Return λ Φ P Φᵀ + Q (J, n, n) of ΦPΦᵀ + Q (J, n, n), Q (n, n) and λ (J,).

    As the sum of what it was and what is added, so that λ = 1 changes no bit.
    """
    return cov + (factors - 1.0)[:, np.newaxis, np.newaxis] * (cov - process_cov)
