"""The nearest positive part of a covariance that rounding or a negative weight has spoilt."""

from __future__ import annotations

import numpy as np


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
