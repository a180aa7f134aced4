"""Square roots of singular or slightly indefinite covariances."""

from __future__ import annotations

import numpy as np

_NO_NOISE = 1e-13
"""Eigenvalue of a correlation matrix below which a direction counts as free of noise."""


def ranked_root(cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a root G (n, r) of a covariance (n, n), and the matrix (G⁺)ᵀ (n, r).

    The covariance has the rank r and is equal to G Gᵀ. G⁺ is a left inverse of G: G⁺ G = I. The
    rank is that of the correlation matrix, so it does not depend on the units of the states.
    """
    sigma = np.sqrt(np.maximum(np.diag(cov), 0.0))
    unit = np.where(sigma > 0.0, sigma, 1.0)
    values, vectors = np.linalg.eigh(cov / np.outer(unit, unit))
    kept = values > _NO_NOISE
    values, vectors = np.sqrt(values[kept]), vectors[:, kept]
    return unit[:, np.newaxis] * vectors * values, vectors / values / unit[:, np.newaxis]


def nearest_root(matrix: np.ndarray) -> np.ndarray:
    """Repair a covariance (n, n), and return its upper triangular square root U (n, n).

    UᵀU is the repaired covariance. ``matrix`` is the covariance P before repair.

    P is made symmetric and scaled to a correlation matrix. Small or negative eigenvalues of this
    matrix are raised to a limit: n times the machine precision times the largest eigenvalue.

    Raises
    ------
    numpy.linalg.LinAlgError
        If P is not finite.
    """
    if not np.isfinite(matrix).all():
        raise np.linalg.LinAlgError("a covariance is not finite")
    symmetric = 0.5 * (matrix + matrix.T)
    scale = np.sqrt(np.abs(np.diag(symmetric)))
    scale[scale == 0.0] = 1.0
    values, vectors = np.linalg.eigh(symmetric / np.outer(scale, scale))
    values = np.maximum(values, len(values) * np.finfo(float).eps * values[-1])
    # The triangular factor of any square root of P is one, too.
    return np.asarray(np.linalg.qr((scale[:, None] * vectors * np.sqrt(values)).T).R)


class MatrixSquareRoot:
    """Upper-triangular square root of a covariance that may have lost positive definiteness.

    An unscented filter with a negative weight of the central point may lose positive definiteness.
    The covariance is made symmetric and factorised by Cholesky's method. If this fails, the root is
    that of :func:`nearest_root`, and the repair is counted.
    """

    def __init__(self) -> None:
        self.repairs = 0

    def __call__(self, matrix: np.ndarray) -> np.ndarray:
        """Return an upper triangular U (n, n) with UᵀU = P, or P after repair."""
        try:
            return np.linalg.cholesky(0.5 * (matrix + matrix.T)).T
        except np.linalg.LinAlgError:
            self.repairs += 1
        return nearest_root(matrix)

    def repaired(self, matrix: np.ndarray) -> np.ndarray:
        """Return a symmetric covariance (n, n), repaired if it was not positive definite."""
        before = self.repairs
        root = self(matrix)
        return 0.5 * (matrix + matrix.T) if self.repairs == before else root.T @ root
