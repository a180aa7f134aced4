"""Square roots of singular or slightly indefinite covariances."""

from __future__ import annotations

import numpy as np

_NO_NOISE = 1e-13
"""Eigenvalue of a correlation matrix below which a direction counts as free of noise."""


def ranked_root(cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return G (n, r), G Gᵀ = a covariance (n, n) of rank r, and its pseudo-inverse, transposed.

    The rank is determined in units of standard deviations, so that it does not depend on units.
    """
    sigma = np.sqrt(np.maximum(np.diag(cov), 0.0))
    unit = np.where(sigma > 0.0, sigma, 1.0)
    values, vectors = np.linalg.eigh(cov / np.outer(unit, unit))
    kept = values > _NO_NOISE
    values, vectors = np.sqrt(values[kept]), vectors[:, kept]
    return unit[:, np.newaxis] * vectors * values, vectors / values / unit[:, np.newaxis]


def nearest_root(matrix: np.ndarray) -> np.ndarray:
    """Return U (n, n), upper triangular, with UᵀU = the nearest positive part of P (n, n).

    Negative eigenvalues of the symmetric, correlation-scaled matrix are set to a rounding error.

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

    Sigma points with a negative centre weight may cause this. P is symmetrised and factorised by
    Cholesky. If that fails, the root is :func:`nearest_root`, and the repair is counted.
    """

    def __init__(self) -> None:
        self.repairs = 0

    def __call__(self, matrix: np.ndarray) -> np.ndarray:
        """Return U (n, n), upper triangular, with UᵀU = P or its nearest positive part."""
        try:
            return np.linalg.cholesky(0.5 * (matrix + matrix.T)).T
        except np.linalg.LinAlgError:
            self.repairs += 1
        return nearest_root(matrix)

    def repaired(self, matrix: np.ndarray) -> np.ndarray:
        """Return a covariance (n, n), symmetric and positive definite: P or its nearest one."""
        before = self.repairs
        root = self(matrix)
        return 0.5 * (matrix + matrix.T) if self.repairs == before else root.T @ root
