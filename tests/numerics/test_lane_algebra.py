"""Linear algebra of eight runs at once: what each lane is told of its own matrix."""

from __future__ import annotations

import numpy as np

from ggbench.numerics import lane_algebra
from ggbench.numerics.kernels import LANES
from ggbench.numerics.lanes import in_lanes, out_of_lanes, unfilled


def test_a_matrix_is_known_to_be_positive_or_not_in_its_own_lane():
    """Positive definite, singular, indefinite, or no numbers at all, side by side."""
    root = np.random.default_rng(3).normal(size=(3, 3))
    good = root @ root.T
    matrices = np.tile(good, (LANES, 1, 1))
    matrices[1] = np.diag([4.0, 0.0, 1.0])
    matrices[2] = np.diag([1.0, -1.0, 1.0])
    matrices[3] = np.nan
    matrices[4] = np.diag([1.0, 4.0, np.inf])
    matrices[5] = np.diag([4.0, 9.0, 0.0])
    lower, inverse = unfilled(3, 3), unfilled(1, 3)
    lane_algebra.triangular_root(in_lanes(matrices), lower, inverse)
    positive = [lane_algebra.is_positive(inverse, r) for r in range(LANES)]
    assert positive == [True, False, False, False, False, False, True, True]
    roots = np.tril(out_of_lanes(lower, LANES))
    for lane in (0, 6, 7):
        np.testing.assert_allclose(roots[lane] @ roots[lane].T, good, rtol=1e-12, atol=1e-12)
