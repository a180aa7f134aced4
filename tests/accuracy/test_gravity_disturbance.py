"""What gravity that the mechanization does not know costs, and what its map gains it back.

Of the scenario `ship_strategic`, by the compiled EKF on fixed seeds.
"""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from oracles import points
from scipy.stats import norm
from scipy.stats import t as student

from ggbench.campaign import registry
from ggbench.gravity.ellipsoid import metres_per_radian
from ggbench.ins import strapdown
from ggbench.ins.known_gravity import integrate
from ggbench.judging.run_errors import evaluate_block
from ggbench.numerics.lanes import in_lanes, lanes
from ggbench.simulation.error_free_flight import Flight, prepare
from ggbench.simulation.flight_bounds import flight_bound
from ggbench.simulation.runs import simulate_block
from ggbench.spec import scenario

RUNS, SEED = 12, 4
SETTLED_S = 10_000.0


@functools.cache
def flight(name: str) -> Flight:
    cases = {case.name: case for case in scenario.load("ship_strategic").cases}
    return prepare(cases[name])


@functools.cache
def judged(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Mean squared position error [m²] and NEES of position and velocity, (RUNS,) each."""
    return judge(flight(name), RUNS)


def judge(made: Flight, runs: int) -> tuple[np.ndarray, np.ndarray]:
    """The same of any flight, (runs,)."""
    block, truth = simulate_block(made, SEED, range(runs))
    estimate = registry.choose("ekf").estimator.estimate_block(block)
    settled = made.times >= SETTLED_S
    found, flaws = evaluate_block(truth.error_state, estimate.mean, estimate.cov)
    assert not any(flaws)
    return (found.position_error[:, settled] ** 2).mean(axis=1), found.nees[:, settled].mean(axis=1)


def mrse(name: str) -> float:
    return math.sqrt(judged(name)[0].mean())


each_noise = pytest.mark.parametrize("noise", ["", pytest.param("-0.1E", marks=pytest.mark.long)])


@each_noise
@pytest.mark.long
def test_compensation_gives_back_what_the_disturbance_takes(noise):
    """MRSE and NEES of the same runs over normal gravity, to two percent; not so without it."""
    normal, felt, compensated = (f"{name}{noise}" for name in ("not-felt", "felt", "compensated"))
    print(mrse(normal), mrse(felt), mrse(compensated), judged(felt)[1].mean())
    assert mrse(felt) > 2.0 * mrse(normal)
    assert judged(felt)[1].mean() > 30.0
    assert mrse(compensated) == pytest.approx(mrse(normal), rel=0.02)
    assert judged(compensated)[1].mean() == pytest.approx(judged(normal)[1].mean(), rel=0.02)


@pytest.mark.long
@each_noise
def test_a_compensated_filter_is_consistent_and_efficient(noise):
    """NEES of six, and the bound's error, within the scatter of the runs: false alarms 1e-3 each.

    The same two judgements find the filter wrong that is not told of the disturbance.
    """
    name, unknown = f"compensated{noise}", f"felt{noise}"
    made = flight(name)
    bound = flight_bound(made).filtering[made.times >= SETTLED_S][:, :3, :3]
    squared = float(np.einsum("kii->k", bound).mean())

    def off(values: np.ndarray, expected: float) -> float:
        return float((values.mean() - expected) / (values.std(ddof=1) / math.sqrt(RUNS)))

    limit = norm.isf(5e-4)
    for values, expected, wrong in zip(judged(name), (squared, 6.0), judged(unknown), strict=True):
        assert abs(off(values, expected)) < limit
        assert off(wrong, expected) > limit


@pytest.mark.long
@pytest.mark.parametrize("noise", ["", "-0.1E"])
def test_integrated_gradients_are_worth_a_map(noise):
    """No map of gravity, and the error is that over normal gravity: to 5 %, to 5 % of the bound.

    NEES is 4 to 8: the disturbance at the start is one draw of what the states assume, the same in
    all runs. Where it is taken for a constant, as without the readings, it is beyond 30.
    """
    name = f"integrated{noise}"
    made = flight(name)
    bound = flight_bound(made).filtering[made.times >= SETTLED_S][:, :3, :3]
    print(mrse(name), math.sqrt(np.einsum("kii->k", bound).mean()), judged(name)[1].mean())
    assert mrse(name) == pytest.approx(mrse(f"not-felt{noise}"), rel=0.05)
    assert mrse(name) < 1.05 * math.sqrt(np.einsum("kii->k", bound).mean())
    assert 4.0 < judged(name)[1].mean() < 8.0
    assert judged(f"constant{noise}")[1].mean() > 30.0
    assert mrse(f"constant{noise}") > 2.0 * mrse(name)


@pytest.mark.long
def test_what_is_integrated_and_what_was_at_the_start_are_the_disturbance():
    """Along the true track, of exact readings: to 0.02 mGal in six hours, of 30 and more.

    What was at the start turns with the axes, which is half a mGal of it.
    """
    made = flight("integrated")
    gravity, truth, mgal = made.added_gravity(made.field), made.trajectory, 1e-5
    attitudes = truth.attitudes.reshape(-1, 9)
    track = in_lanes(np.hstack([truth.positions, truth.velocities, attitudes])[np.newaxis])
    moved, earth, transport = lanes(3, 3), np.empty(3), np.empty(3)
    felt = made.field.gravity_disturbance(*truth.positions.T)
    start = np.repeat(felt[:1], len(felt), axis=0)
    for n in range(len(felt) - 1):
        integrate(gravity.readings, track, n, truth.dt, moved)
        latitude, _, height = truth.positions[n]
        points.frame_rates(latitude, height, truth.velocities[n], earth, transport)
        start[n + 1] = start[n] - truth.dt * np.cross(transport, start[n])
    total = gravity.readings.total[:, :, 0]
    assert (np.ptp(felt, axis=0) > 30.0 * mgal).all()
    # At the readings; between them the last one is held.
    left = np.abs(total + start - felt) / mgal
    assert left[made.epochs].max() < 0.02 < 0.1 < np.abs(start - felt[0]).max() / mgal
    assert left[made.epochs[0] :].max() < 0.1


STARTS = (
    (15.2, 114.2, 60.0),
    (14.9, 114.0, 30.0),
    (15.0, 115.0, 0.0),
    (15.6, 113.8, 90.0),
    (16.2, 114.0, 80.0),
    (15.8, 116.2, 270.0),
    (16.2, 116.0, 240.0),
    (15.0, 116.0, 300.0),
    (15.5, 115.5, 180.0),
    (16.4, 115.0, 150.0),
)
"""Latitude, longitude and heading [°] of flights that stay within the region."""


@pytest.mark.long
@pytest.mark.parametrize("name", ["states", "states-0.1E"])
def test_states_are_consistent_over_flights_and_not_over_runs(name):
    """NEES of six in the mean of ten flights, each over another part of the field.

    Within their scatter, at a false alarm rate of 1e-3. Runs of one flight share the field, one
    draw of the process, so that their number says nothing: flight by flight it is 3 to 10. And the
    error is at most 5 % beyond the bound of an estimator with these states, in the mean square.
    """
    base = next(case for case in scenario.load("ship_strategic").cases if case.name == name)
    nees, ratios = [], []
    for latitude, longitude, heading in STARTS:
        places = {"latitude_deg": latitude, "longitude_deg": longitude, "heading_deg": heading}
        moved = base.trajectory.model_copy(update=places)
        made = prepare(base.model_copy(update={"trajectory": moved}))
        squared, found = judge(made, 16)
        bound = flight_bound(made).filtering[made.times >= SETTLED_S][:, :3, :3]
        nees.append(float(found.mean()))
        ratios.append(float(squared.mean() / np.einsum("kii->k", bound).mean()))
    print(np.round(nees, 1), np.mean(nees), np.sqrt(ratios), math.sqrt(np.mean(ratios)))
    scatter = np.std(nees, ddof=1) / math.sqrt(len(nees))
    assert abs(np.mean(nees) - 6.0) < student.isf(5e-4, len(nees) - 1) * scatter
    assert max(nees) < 12.0
    assert math.sqrt(np.mean(ratios)) < 1.05


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
        position,
        np.zeros(3),
        np.eye(3),
        *increments,
        dt,
        heights=np.zeros(count),
        gains=strapdown.altimeter_gains(100.0),
    )
    _, east = metres_per_radian(position)
    rate = math.sqrt(9.7805 / east)
    times = dt * np.arange(count + 1)
    expected = -20e-5 / rate * np.sin(rate * times)
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(velocities[:, 0], expected, atol=0.01 * np.abs(expected).max())
