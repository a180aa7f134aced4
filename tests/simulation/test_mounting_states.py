"""A gradiometer whose mount is turned by unknown angles: drawn once per run, and estimated."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import assert_as_the_oracle
from problems import estimator, final_nees, rng
from small_cases import GRAVIMETER, ON_BOARD, TINY, small_flight

from ggbench.block import ProblemBlock
from ggbench.simulation.error_free_flight import Flight
from ggbench.simulation.flight_bounds import flight_bound
from ggbench.simulation.runs import Truth, simulate_block

SIGMA = 3.0
UNKNOWN = {"gradiometer.mounting_sigma_arcmin": SIGMA}
ANGLES = slice(15, 18)
TURNING = {
    "trajectory.segment": [{"kind": "turn", "by_heading_deg": 60.0, "turn_rate_deg_per_s": 3.0}],
}
MOUNTS = ("local-level", "platform", "strapdown")
RUNS = 24


def flown(rough: str, mount: str, changes: dict[str, object]) -> Flight:
    own = {"field": {"source": rough}, "gradiometer.instrument": mount}
    return small_flight(TURNING | own | UNKNOWN | changes)


def worst_residual(block: ProblemBlock, truth: Truth, but: slice = slice(0)) -> float:
    """The largest of run 0 at the truth, some states taken as zero."""
    problem, states = block.problem(0), truth.error_state[0].copy()
    states[:, but] = 0.0
    return max(
        float(np.abs(z - problem.model.predict(k, states[k])).max())
        for k, z in enumerate(problem.measurements)
    )


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize(
    "more",
    [
        {},
        {"gradiometer.bias_eotvos": 1.0},
        {"gradiometer.latency_s": 0.3},
        {"gradiometer.filter": "butterworth"},
    ],
    ids=["plain", "biased", "late", "filtered"],
)
def test_h_at_the_truth_is_the_reading(rough, mount, more):
    """Of an INS without errors and a quiet instrument: to 1e-4 E; without the angles E are missing.

    Behind a filter, or late, a strapdown instrument is modelled as if it had not turned since then:
    h is not exact in the turn.
    """
    quiet = {"gradiometer.noise_eotvos": 1e-6}
    block, truth = simulate_block(flown(rough, mount, TINY | quiet | more), 1, range(1))
    assert block.layout[5].name == "gradiometer mounting error" and block.layout[5].unit == "rad"
    turned = mount == "strapdown" and ("gradiometer.latency_s" in more or "filter" in str(more))
    assert worst_residual(block, truth) < (0.6 if turned else 1e-4)
    assert worst_residual(block, truth, ANGLES) > 3.0


def test_the_true_angles_are_drawn_and_add_to_those_of_the_truth_alone(rough):
    """Constant in a run; σ of 180 numbers within 4 of its own deviations: false alarms 6e-5."""
    block, truth = simulate_block(flown(rough, "local-level", {}), 3, range(60))
    angles = np.degrees(truth.error_state[:, :, ANGLES]) * 60.0
    assert (angles == angles[:, :1]).all()
    low, high = (SIGMA * (1.0 + 4.0 * sign / np.sqrt(360.0)) for sign in (-1.0, 1.0))
    assert low < angles[:, 0].std() < high
    fixed = {"truth.gradiometer.mounting_error_arcmin": [30.0, -20.0, 60.0]}
    more, both = simulate_block(flown(rough, "local-level", fixed), 3, range(2))
    added = np.degrees(both.error_state[:, :, ANGLES]) * 60.0 - angles[:2]
    np.testing.assert_allclose(added, np.broadcast_to([30.0, -20.0, 60.0], added.shape))
    assert (more.measurements != block.measurements[:2]).any()


@pytest.mark.parametrize("mount", MOUNTS)
def test_jacobian_is_the_derivative_of_h(rough, mount):
    """By central differences, at errors of the prior's size: to 1e-6 of a column's largest."""
    block, truth = simulate_block(flown(rough, mount, {}), 2, range(1))
    model, k, x = block.problem(0).model, 7, truth.error_state[0, 7]
    given = model.jacobian(k, x)
    for j, sigma in enumerate(np.sqrt(np.diag(block.prior_cov))):
        step = np.zeros(block.dimension)
        step[j] = 0.1 * sigma
        slope = (model.predict(k, x + step) - model.predict(k, x - step)) / (0.2 * sigma)
        largest = np.abs(given[:, j]).max()
        np.testing.assert_allclose(slope, given[:, j], atol=1e-5 * largest + 1e-9)
    assert np.abs(given[:, ANGLES]).max() > 1e3


@pytest.mark.parametrize("mount", MOUNTS)
def test_without_angles_the_instrument_is_as_it_was(rough, mount):
    """H and H of the INS's own states: as of a mount that is exactly known, to 1e-6 E and 1e-6.

    A platform's, which turns with the position, to 0.1 mE at 300 m: it is linear here.
    """
    mounted = simulate_block(flown(rough, mount, {}), 2, range(1))[0].problem(0)
    known = flown(rough, mount, {"gradiometer.mounting_sigma_arcmin": 0.0})
    plain = simulate_block(known, 2, range(1))[0].problem(0)
    assert plain.dimension == 15
    x = np.zeros(18)
    x[:3], x[6:9] = [300.0, -200.0, 50.0], 1e-4
    one, other = (p.model.jacobian(7, s) for p, s in ((mounted, x), (plain, x[:15])))
    sigma = np.sqrt(np.diag(plain.prior_cov))
    np.testing.assert_allclose(one[:, :15] * sigma, other * sigma, atol=1e-5)
    one, other = (p.model.predict(7, s) for p, s in ((mounted, x), (plain, x[:15])))
    np.testing.assert_allclose(one, other, atol=1e-4)


def test_an_exactly_known_mount_is_no_state(rough):
    """Nor of estimators that believe it."""
    block, _ = simulate_block(
        flown(rough, "platform", {"model.gradiometer.mounting_sigma_arcmin": 0.0}), 1, range(1)
    )
    known = flown(rough, "platform", {"gradiometer.mounting_sigma_arcmin": 0.0})
    plain, _ = simulate_block(known, 1, range(1))
    assert block.dimension == plain.dimension == 15
    assert np.abs(block.measurements - plain.measurements).max() > 1.0


NOISY = {"gradiometer.noise_eotvos": 0.05}
LEFT = {
    "local-level": (0.01, 0.01, 1.3),
    "platform": (0.5, 1.1, 0.8),
    "strapdown": (0.03, 0.03, 0.03),
}
"""RMS error of the angles at the end, over that of the prior."""


@pytest.mark.parametrize("mount", MOUNTS)
def test_a_filter_with_the_states_is_consistent_and_finds_the_angles(rough, mount):
    """Position and angles: NEES within 4 deviations of χ², false alarms 6e-5.

    How far the angles end below their prior depends on the mount: of a level one gravity says
    nothing of the heading, of a platform's inertial axes little of any. Each is as its bound.
    Control: a filter that believes the mount.
    """
    flight = flown(rough, mount, NOISY)
    block, truth = simulate_block(flight, 5, range(RUNS))
    mean = final_nees(block, truth, [0, 1, 2, *range(15, 18)]).mean()
    assert abs(mean - 6.0) < 4.0 * np.sqrt(12.0 / RUNS)
    found = estimator("ekf").estimate_block(block)
    sigma = np.sqrt(np.diagonal(found.cov, axis1=2, axis2=3))[:, -1, ANGLES]
    off = (found.mean - truth.error_state)[:, -1, ANGLES]
    prior = np.radians(SIGMA / 60.0)
    rms = np.sqrt((off**2).mean(axis=0)) / prior
    assert (rms < LEFT[mount]).all() and np.median(rms) < 0.7
    bound = np.sqrt(np.diag(flight_bound(flight).filtering[-1, ANGLES, ANGLES]))
    np.testing.assert_allclose(sigma.mean(axis=0), bound, rtol=0.05)
    believed = flown(rough, mount, NOISY | {"model.gradiometer.mounting_sigma_arcmin": 0.0})
    fooled = simulate_block(believed, 5, range(RUNS))
    assert final_nees(*fooled, [0, 1, 2]).mean() > 3.0 + 4.0 * np.sqrt(6.0 / RUNS)


EVERYTHING = (
    ON_BOARD
    | GRAVIMETER
    | {
        "gnss.lever_arm_sigma_m": 2.0,
        "gradiometer.bias_eotvos": 0.1,
        "model.disturbance.horizontal_mgal": 20.0,
    }
)


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize("label", ["ekf", "ukf"])
def test_engines_carry_the_states_as_the_frameworks_do(rough, label, mount):
    """Also next to states of gravity, biases and a lever arm: to 1e-6 of the prior's deviations."""
    field = {"field": {"source": rough, "gravity_disturbance": True}}
    block, _ = simulate_block(flown(rough, mount, EVERYTHING | NOISY | field), 5, range(2))
    names = [b.name for b in block.layout]
    assert names[5:8] == [
        "gravity disturbance ENU",
        "gradiometer mounting error",
        "gradiometer bias",
    ]
    assert_as_the_oracle(label, block)


@pytest.mark.parametrize(
    "label", ["ins", "closed-loop", "factor-graph[mode=batch]", "particle[particles=500]"]
)
def test_other_estimators_take_the_states(rough, label):
    """Their angles are no worse than the prior's."""
    block, truth = simulate_block(flown(rough, "local-level", NOISY), 5, range(1))
    found = estimator(label).estimate(block.problem(0), rng())
    off = found.mean[-1, ANGLES] - truth.error_state[0, -1, ANGLES]
    assert np.abs(off).max() < np.radians(3.0 * SIGMA / 60.0)


def test_a_filter_of_linear_states_refuses(rough):
    block, _ = simulate_block(flown(rough, "local-level", NOISY), 5, range(1))
    assert "mounting angles" in (estimator("rao-blackwellised").skip(block.problem(0)) or "")
