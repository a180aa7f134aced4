"""Equation of measurement of all sensors, over a map that bends: one formula in all kernels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_cases import GRAVIMETER, ON_BOARD, rough_map, small_flight

from ggbench.block import ProblemBlock
from ggbench.engines.sigma_points import SigmaPoints, read_sigma_points
from ggbench.gravity.spline import TENSOR_WORK
from ggbench.numerics.lanes import group_members, in_lanes, lanes, out_of_lanes
from ggbench.sensors.model_arrays import EpochContext, ModelArrays, PointScratch
from ggbench.sensors.model_kernels import Expansion, expand, moving_errors
from ggbench.simulation.runs import simulate_block

RUNS = 3


@pytest.fixture(scope="module", params=["states", "no states", "gradiometer"])
def block(request, tmp_path_factory) -> ProblemBlock:
    """Receiver, log, barometer and a vector gravimeter over a field of thousands of E.

    With states of gravity and of the antenna's place, or with a gradiometer that has biases.
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
    if request.param == "gradiometer":
        del changes["gradiometer"]
        changes["gradiometer.bias_eotvos"] = 5.0
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


def point_scratch(count: int) -> PointScratch:
    return PointScratch(lanes(3, count), lanes(24, count), np.empty(TENSOR_WORK))


def expansion_of(model: ModelArrays) -> Expansion:
    g, (m, n) = len(model.channels), model.linear.shape[2:]
    return Expansion(
        slope=lanes(g, 6),
        b=lanes(moving_errors(model.instrument), model.rows.shape[-1]),
        errors=lanes(6, 1),
        linear=lanes(m, n),
        by_tensor=lanes(1, m),
        predicted=lanes(1, m),
        context=EpochContext(lanes(model.lags.shape[1], 3), lanes(1, 9), lanes(1, m), lanes(1, 1)),
        points=point_scratch(1),
    )


def test_the_kernel_of_eight_runs_is_h_and_its_slope(block, states):
    """Both of each run, as its own model gives them."""
    k, x = states
    at = expansion_of(block.model)
    expand(block.model, group_members(0, RUNS), RUNS, k, in_lanes(x[:, np.newaxis]), at)
    g, moving, columns = len(at.slope), *at.b.shape[:2]
    for run in range(RUNS):
        model = block.problem(run).model
        jacobian = at.linear[:, :, run].copy()
        jacobian[:g, :columns] += at.slope[:, :moving, run] @ at.b[:, :, run]
        expected = model.predict(k, x[run])
        np.testing.assert_allclose(at.predicted[0, :, run], expected, rtol=1e-12, atol=1e-9)
        np.testing.assert_allclose(jacobian, model.jacobian(k, x[run]), rtol=1e-12, atol=1e-12)


def test_pairs_of_points_are_the_odd_and_the_even_part_of_h(block, states):
    """Half the difference and half the sum of h(x ± d) − h(x), point by point."""
    k, x = states
    n, m = block.dimension, block.measurements.shape[2]
    group, spread, model = group_members(0, RUNS), 1.7, block.model
    sigma = np.sqrt(np.diag(block.prior_cov))
    root = np.tril(0.5 * np.random.default_rng(7).normal(size=(RUNS, n, n))) * sigma[:, np.newaxis]
    root[:, :3, :3] = np.tril(np.random.default_rng(8).normal(size=(RUNS, 3, 3))) * 200.0
    at, centre, lower = expansion_of(model), in_lanes(x[:, np.newaxis]), in_lanes(root)
    g, moving = len(model.channels), moving_errors(model.instrument)
    pairs = SigmaPoints(
        shift=lanes(moving, n),
        odd=lanes(m, n),
        even=lanes(m, n),
        far=np.zeros((lower.shape[2], n), dtype=np.int64),
        counts=np.zeros(lower.shape[2], dtype=np.int64),
        errors=lanes(6, 2 * n),
        found=lanes(g, 2 * n),
        chosen=lanes(1, 2),
        points=point_scratch(2 * n),
    )
    expand(model, group, RUNS, k, centre, at)
    read_sigma_points(
        model=model,
        group=group,
        count=RUNS,
        k=k,
        x=centre,
        lower=lower,
        spread=spread,
        at=at,
        out=pairs,
    )
    odds, evens = out_of_lanes(pairs.odd, RUNS), out_of_lanes(pairs.even, RUNS)
    bent = 0.0
    for run in range(RUNS):
        middle = predicted(block, k, run, x[run])
        for q in range(n):
            ahead, behind = (
                predicted(block, k, run, x[run] + s * spread * root[run, :, q]) for s in (1.0, -1.0)
            )
            half, mean = 0.5 * (ahead - behind), 0.5 * (ahead + behind) - middle
            np.testing.assert_allclose(odds[run, :, q], half, rtol=1e-9, atol=1e-8)
            np.testing.assert_allclose(evens[run, :, q], mean, rtol=1e-9, atol=1e-8)
            bent = max(bent, float(np.abs(mean).max()))
    assert bent > 0.1
