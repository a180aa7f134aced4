"""How many floating-point operations an estimator needs, and how many the machine can do.

Dense operations with the textbook's equations, an addition and a multiplication counted as one
each; symmetry and zeros are not made use of, and h and H are not counted. n states, m channels:

EKF, an epoch
    Φ x: 2n²; Φ P Φᵀ + Q: 4n³ + n²; H P: 2mn²; H P Hᵀ + R: 2m²n + m²; its Cholesky factor: m³/3;
    gain: 2m²n; x + K y: 2mn; P − K (H P): 2mn² + n².
UKF, an epoch, with N = 2n + 1 points drawn before the prediction and again after it
    two Cholesky factors: 2n³/3; Φ X: 2Nn²; mean: 2Nn; covariance with Q: 2Nn² + n²; mean of the
    readings: 2Nm; S: 2Nm² + m²; cross covariance: 2Nnm; factor, gain and update as above.
Batch, I iterations, each a pass of the EKF and a backward pass of the adjoint vector (modified
Bryson–Frazier, 4n² + 4mn an epoch), and once the adjoint matrix and the smoothed covariance
    I − K H: 2mn²; two congruences: 8n³; Hᵀ S⁻¹ H: 2m²n + 2mn²; P − P Λ P: 4n³ + n².
    (Our engine does more: a difference loses digits where a prior is wide.)
"""

from __future__ import annotations

import numpy as np


def ekf(n: int, m: int, epochs: int) -> float:
    """Return the operations of an extended Kalman filter."""
    predict = 2 * n**2 + 4 * n**3 + n**2
    return epochs * (predict + 2 * m * n**2 + 2 * m**2 * n + m**2 + _update(n, m))


def ukf(n: int, m: int, epochs: int) -> float:
    """Return the operations of an unscented Kalman filter."""
    points = 2 * n + 1
    predict = 2 * n**3 / 3 + 4 * points * n**2 + 2 * points * n + n**2
    readings = 2 * points * m + 2 * points * m**2 + m**2 + 2 * points * n * m
    return epochs * (predict + readings + _update(n, m))


def batch(n: int, m: int, epochs: int, iterations: float) -> float:
    """Return the operations of a batch smoother with that many linearisations."""
    vector = epochs * (4 * n**2 + 4 * m * n)
    matrix = epochs * (2 * m * n**2 + 12 * n**3 + 2 * m**2 * n + 2 * m * n**2 + n**2)
    return iterations * (ekf(n, m, epochs) + vector) + matrix


def _update(n: int, m: int) -> float:
    return m**3 / 3 + 2 * m**2 * n + 2 * m * n + 2 * m * n**2 + n**2


class Dgemm:
    """Products of large matrices: the most that this machine's BLAS does on one thread."""

    size = 768
    runs_per_call = 1

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        self.left, self.right = rng.standard_normal((2, self.size, self.size))
        self.out = np.empty((self.size, self.size))

    @classmethod
    def operations(cls) -> float:
        """Return the operations of one product."""
        return 2.0 * cls.size**3

    def solve(self, run: int) -> np.ndarray:
        """Multiply once; there are no means."""
        np.matmul(self.left, self.right, out=self.out)
        return np.empty(0)
