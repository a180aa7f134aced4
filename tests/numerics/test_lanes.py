"""Runs in lanes: who goes with whom, and that nobody is lost or changed on the way."""

from __future__ import annotations

import numpy as np
import pytest

from ggbench.numerics.kernels import LANES
from ggbench.numerics.lanes import group_members, groups, in_lanes, out_of_lanes


@pytest.mark.parametrize("runs", [1, LANES - 1, LANES, LANES + 1, 3 * LANES])
def test_every_run_is_in_one_group_that_fits(runs):
    found = [range(runs)[some] for some in groups(runs)]
    assert [run for group in found for run in group] == list(range(runs))
    assert all(0 < len(group) <= LANES for group in found)


@pytest.mark.parametrize("runs", [1, 3, LANES])
def test_runs_come_back_from_their_lanes(runs):
    """Bit by bit; lanes that are left repeat the last run, in NumPy as in compiled code."""
    matrices = np.random.default_rng(1).normal(size=(runs, 4, 3))
    together = in_lanes(matrices)
    assert together.shape == (4, 3, LANES)
    assert together.flags.c_contiguous
    np.testing.assert_array_equal(out_of_lanes(together, runs), matrices)
    np.testing.assert_array_equal(np.moveaxis(together, -1, 0), matrices[group_members(0, runs)])
    assert (together[:, :, runs:] == together[:, :, runs - 1 : runs]).all()
