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


def test_the_root_of_a_singular_matrix_has_rows_of_nothing():
    """Regular, of rank two, one and zero, no numbers; of the first three of four states."""
    rng = np.random.default_rng(5)
    roots = np.tile(rng.normal(size=(4, 4)), (LANES, 1, 1))
    roots[1, :, 2:] = 0.0
    roots[2, :, 1:] = 0.0
    roots[3] = 0.0
    matrices = roots @ roots.transpose(0, 2, 1)
    matrices[4] = np.nan
    out = unfilled(4, 4)
    out[:] = 7.0
    lane_algebra.transposed_root(in_lanes(matrices), 3, out)
    found = out_of_lanes(out, LANES)
    assert (found[:, 3] == 7.0).all()  # not asked for
    upper = found[:, :3]
    assert (upper[:, :, 3] == 0.0).all() and (np.tril(upper[:, :, :3], -1) == 0.0).all()
    assert np.isnan(upper[4, 0, 0])
    for lane in (0, 1, 2, 3, 5):
        root = upper[lane, :, :3]
        np.testing.assert_allclose(root.T @ root, matrices[lane, :3, :3], rtol=1e-9, atol=1e-12)
    assert (upper[1, 2] == 0.0).all() and (upper[2, 1:] == 0.0).all()


def test_a_gain_is_that_of_kalman():
    """K = P Hᵀ S⁻¹ with S = H P Hᵀ + 1, in every lane its own."""
    rng = np.random.default_rng(6)
    root, rows = rng.normal(size=(LANES, 4, 4)), rng.normal(size=(LANES, 3, 4))
    p = root @ root.transpose(0, 2, 1)
    hp, lower, half, gain = unfilled(3, 4), unfilled(3, 3), unfilled(3, 4), unfilled(3, 4)
    lane_algebra.kalman_gain(
        rows=in_lanes(rows), p=in_lanes(p), m=3, hp=hp, lower=lower, half=half, gain=gain
    )
    s = rows @ p @ rows.transpose(0, 2, 1) + np.eye(3)
    expected = np.linalg.solve(s, rows @ p)
    np.testing.assert_allclose(out_of_lanes(gain, LANES), expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(out_of_lanes(hp, LANES), rows @ p, rtol=1e-12, atol=1e-12)
