"""The nearest positive part of a covariance."""

from __future__ import annotations

import numpy as np
import pytest

from ggbench.numerics.positive import nearest_root


def test_the_root_of_a_positive_matrix_is_its_root():
    """Upper triangular, whatever the units of its states."""
    units = np.geomspace(1e-9, 1e3, 5)
    factor = np.random.default_rng(1).normal(size=(5, 8)) * units[:, np.newaxis]
    root = nearest_root(factor @ factor.T)
    assert np.array_equal(root, np.triu(root))
    scaled = (root.T @ root - factor @ factor.T) / np.outer(units, units)
    assert np.abs(scaled).max() < 1e-12


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_has_no_positive_part(bad):
    """It is an error with a reason, and no matrix of NaN that goes on."""
    matrix = np.eye(3)
    matrix[0, 2] = matrix[2, 0] = bad
    with pytest.raises(np.linalg.LinAlgError, match="a covariance is not finite"):
        nearest_root(matrix)
