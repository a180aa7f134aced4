"""h of the sensors beside the gradiometer, over a map that bends: one formula in all kernels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_cases import GRAVIMETER, ON_BOARD, rough_map, small_flight

from ggbench.block import ProblemBlock
from ggbench.numerics.lanes import in_lanes, lanes, members, out_of_lanes
from ggbench.sensors.aiding_kernels import MOVED, linearise_aiding, read_aiding_pairs
from ggbench.simulation.runs import simulate_block

RUNS = 3


@pytest.fixture(scope="module", params=["states", "no states"])
def block(request, tmp_path_factory) -> ProblemBlock:
    """Receiver, log, barometer and a vector gravimeter over a field of thousands of E.

    With states of gravity and of the antenna's place.
    """
    steep = rough_map(tmp_path_factory.mktemp("map") / Path("steep.nc"), rms=3000.0)
    changes = {
        "field": {"source": steep, "gravity_disturbance": True},
        "gradiometer": None,
        "gravimeter.components": ["scalar", "east", "north"],
        "model.field.compensate": True,
    }
    if request.param == "states":
        changes["model.disturbance.horizontal_mgal"] = 20.0
        changes["gnss.lever_arm_sigma_m"] = 2.0
    return simulate_block(small_flight(ON_BOARD | GRAVIMETER | changes), 1, range(RUNS))[0]


@pytest.fixture(scope="module")
def states(block) -> tuple[int, np.ndarray]:
    """An epoch at which everything is read, and errors of hundreds of metres (R, n) there."""
    k = int(np.flatnonzero(block.present[0].all(axis=1))[0])
    sigma = np.sqrt(np.diag(block.prior_cov))
    x = np.random.default_rng(5).normal(size=(RUNS, block.dimension)) * sigma
    x[:, :3] = np.random.default_rng(6).normal(size=(RUNS, 3)) * 300.0
    return k, x


def predicted(block: ProblemBlock, k: int, run: int, x: np.ndarray) -> np.ndarray:
    return block.problem(run).model.predict(k, x)


def steps(block: ProblemBlock) -> np.ndarray:
    """Steps of each state over which h is a straight line to a millionth of its noise."""
    found = 1e-3 * np.sqrt(np.diag(block.prior_cov))
    found[:3] = 0.1
    return found


def test_jacobian_is_the_derivative_of_h(block, states):
    """By central differences, to 1e-6 of what a state's deviation does: curvature has its part."""
    k, x = states
    sigma = np.sqrt(np.diag(block.prior_cov))
    for run in range(RUNS):
        given = block.problem(run).model.jacobian(k, x[run])
        for j, step in enumerate(steps(block)):
            away = np.zeros(block.dimension)
            away[j] = step
            ahead, behind = (predicted(block, k, run, x[run] + s * away) for s in (1.0, -1.0))
            slope = (ahead - behind) / (2.0 * step)
            largest = np.abs(given * sigma).max(axis=1)
            assert (np.abs(slope - given[:, j]) * sigma[j] < 1e-6 * largest + 1e-9).all()
    assert np.ptp([block.problem(0).model.jacobian(k, s)[-1, 0] for s in x]) > 1e-3  # it bends


def test_the_kernel_of_eight_runs_is_h_and_its_slope(block, states):
    """Both of each run, as its own model gives them."""
    k, x = states
    group = members(0, RUNS)
    out, slope = lanes(1, block.measurements.shape[2]), lanes(block.measurements.shape[2], MOVED)
    offset = in_lanes(block.model.offset[:, k][:, np.newaxis])
    linearise_aiding(
        block.model.aiding, group, RUNS, k, offset, in_lanes(x[:, np.newaxis]), out, slope
    )
    for run in range(RUNS):
        model = block.problem(run).model
        expected = model.predict(k, x[run])
        np.testing.assert_allclose(out[0, :, run], expected, rtol=1e-12, atol=1e-9)
        np.testing.assert_allclose(
            slope[:, :, run], model.jacobian(k, x[run])[:, :MOVED], rtol=1e-12, atol=1e-12
        )


def test_pairs_of_points_are_the_odd_and_the_even_part_of_h(block, states):
    """Half the difference and half the sum of h(x ± d) − h(x), point by point."""
    k, x = states
    n, m = block.dimension, block.measurements.shape[2]
    group, spread = members(0, RUNS), 1.7
    sigma = np.sqrt(np.diag(block.prior_cov))
    root = np.tril(0.5 * np.random.default_rng(7).normal(size=(RUNS, n, n))) * sigma[:, np.newaxis]
    root[:, :3, :3] = np.tril(np.random.default_rng(8).normal(size=(RUNS, 3, 3))) * 200.0
    out, slope = lanes(1, m), lanes(m, MOVED)
    offset = in_lanes(block.model.offset[:, k][:, np.newaxis])
    at, lower = in_lanes(x[:, np.newaxis]), in_lanes(root)
    linearise_aiding(block.model.aiding, group, RUNS, k, offset, at, out, slope)
    odd, even = lanes(m, n), lanes(m, n)
    read_aiding_pairs(block.model.aiding, group, RUNS, k, at, lower, spread, slope, odd, even)
    odds, evens = out_of_lanes(odd, RUNS), out_of_lanes(even, RUNS)
    bent = 0.0
    for run in range(RUNS):
        centre = predicted(block, k, run, x[run])
        for q in range(n):
            ahead, behind = (
                predicted(block, k, run, x[run] + s * spread * root[run, :, q]) for s in (1.0, -1.0)
            )
            half, mean = 0.5 * (ahead - behind), 0.5 * (ahead + behind) - centre
            np.testing.assert_allclose(odds[run, :, q], half, rtol=1e-9, atol=1e-8)
            np.testing.assert_allclose(evens[run, :, q], mean, rtol=1e-9, atol=1e-8)
            bent = max(bent, float(np.abs(mean).max()))
    assert bent > 0.1
