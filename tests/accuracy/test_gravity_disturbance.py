"""What gravity that the mechanization does not know costs, and what its map gains it back.

Of the scenario `ship_strategic`, by the compiled EKF on fixed seeds.
"""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from scipy.stats import norm

from ggbench.campaign import registry
from ggbench.gravity.ellipsoid import metres_per_radian
from ggbench.ins import strapdown
from ggbench.judging.run_errors import evaluate_block
from ggbench.simulation.error_free_flight import Flight, prepare
from ggbench.simulation.runs import simulate_block
from ggbench.spec import scenario

RUNS, SEED = 24, 4
SETTLED_S = 10_000.0


@functools.cache
def flight(name: str) -> Flight:
    cases = {case.name: case for case in scenario.load("ship_strategic").cases}
    return prepare(cases[name])


@functools.cache
def judged(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Mean squared position error [m²] and NEES of position and velocity, (RUNS,) each."""
    made = flight(name)
    block, truth = simulate_block(made, SEED, range(RUNS))
    estimate = registry.choose("ekf[engine=numba]").estimator.estimate_block(block)
    settled = made.times >= SETTLED_S
    found, flaws = evaluate_block(truth.error_state, estimate.mean, estimate.cov)
    assert not any(flaws)
    return (found.position_error[:, settled] ** 2).mean(axis=1), found.nees[:, settled].mean(axis=1)


def mrse(name: str) -> float:
    return math.sqrt(judged(name)[0].mean())


each_noise = pytest.mark.parametrize("noise", ["", pytest.param("-0.1E", marks=pytest.mark.long)])


@each_noise
def test_compensation_gives_back_what_the_disturbance_takes(noise):
    """MRSE and NEES of the same runs over normal gravity, to two percent; not so without it."""
    normal, felt, compensated = (f"{name}{noise}" for name in ("not-felt", "felt", "compensated"))
    print(mrse(normal), mrse(felt), mrse(compensated), judged(felt)[1].mean())
    assert mrse(felt) > 2.0 * mrse(normal)
    assert judged(felt)[1].mean() > 30.0
    assert mrse(compensated) == pytest.approx(mrse(normal), rel=0.02)
    assert judged(compensated)[1].mean() == pytest.approx(judged(normal)[1].mean(), rel=0.02)


@each_noise
def test_a_compensated_filter_is_consistent_and_efficient(noise):
    """NEES of six, and the bound's error, within the scatter of the runs: false alarms 1e-3 each.

    The same two judgements find the filter wrong that is not told of the disturbance.
    """
    name, unknown = f"compensated{noise}", f"felt{noise}"
    made = flight(name)
    bound = made.bound.filtering[made.times >= SETTLED_S][:, :3, :3]
    squared = float(np.einsum("kii->k", bound).mean())

    def off(values: np.ndarray, expected: float) -> float:
        return float((values.mean() - expected) / (values.std(ddof=1) / math.sqrt(RUNS)))

    limit = norm.isf(5e-4)
    for values, expected, wrong in zip(judged(name), (squared, 6.0), judged(unknown), strict=True):
        assert abs(off(values, expected)) < limit
        assert off(wrong, expected) > limit


@pytest.mark.long
def test_with_a_wrong_map_it_is_the_gradients_that_do_harm():
    """Compensated from a map 0.3 E off, errors are those over normal gravity, matched to it."""
    matched, compensated = mrse("not-felt-wrong-map"), mrse("compensated-wrong-map")
    print(mrse("not-felt"), matched, compensated)
    assert matched > 1.5 * mrse("not-felt")
    assert compensated == pytest.approx(matched, rel=0.05)


def test_an_ins_answers_a_constant_disturbance_as_schuler_says():
    """Twenty minutes at rest in 20 mGal to the east: δv = −(δg/ω) sin ωt, to one percent.

    ω² = g/R; while the Earth has hardly turned, and the height is kept by the altimeter.
    """
    position, dt, count = np.array([math.radians(2.0), 1.0, 0.0]), 0.5, 2400
    still = np.repeat(position[np.newaxis], count + 1, axis=0)
    disturbance = np.tile([20e-5, 0.0, 0.0], (count, 1))
    attitudes = np.repeat(np.eye(3)[np.newaxis], count + 1, axis=0)
    increments = strapdown.error_free_increments(
        still, np.zeros((count + 1, 3)), attitudes, disturbance, dt
    )
    _, velocities, _ = strapdown.navigate(
        position, np.zeros(3), np.eye(3), *increments, dt, np.zeros(count),
        strapdown.altimeter_gains(100.0),
    )  # fmt: skip
    _, east = metres_per_radian(position)
    rate = math.sqrt(9.7805 / east)
    times = dt * np.arange(count + 1)
    expected = -20e-5 / rate * np.sin(rate * times)
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(velocities[:, 0], expected, atol=0.01 * np.abs(expected).max())
