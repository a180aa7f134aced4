"""The sensors beside the gradiometer: what they read is what the linearised model says of it."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from thinning import thinned

from ggbench.gravity.ellipsoid import metres_along
from ggbench.gravity.field import Field
from ggbench.ins.error_model import navigation_errors
from ggbench.ins.strapdown import steady_force
from ggbench.numerics.rotations import rotation_matrix
from ggbench.sensors.aiding import Barometer, Gravimeter, Motion, VelocityLog
from ggbench.sensors.gnss import Gnss

NORMAL = Field.normal()
SENSORS = {
    "gnss": Gnss(1.0, (1.0,) * 6),
    "gnss position": Gnss(1.0, (1.0,) * 3, velocity=False),
    "gnss on an arm": Gnss(1.0, (1.0,) * 6, lever=(3.0, -10.0, 2.0)),
    "gnss velocity": Gnss(1.0, (1.0,) * 3, position=False),
    "log in body axes": VelocityLog(1.0, (1.0,) * 3, components=("x", "y", "z")),
    "log of one axis": VelocityLog(1.0, (1.0,), components=("y",)),
    "log in level axes": VelocityLog(1.0, (1.0,) * 2, body=False),
    "barometer": Barometer(1.0, (1.0,)),
    "gravimeter": Gravimeter(1.0, (1.0,), steady_force=steady_force),
    "vector gravimeter": Gravimeter(
        1.0, (1.0,) * 3, components=("east", "north", "scalar"), steady_force=steady_force
    ),
}


def motions(seed: int, size: float) -> tuple[Motion, Motion, np.ndarray]:
    """A true motion at five epochs, what an INS indicates of it, and the INS's errors (5, 9).

    Errors of 100 m, 0.5 m/s and 10′, times ``size``.
    """
    rng = np.random.default_rng(seed)
    positions = np.radians([[40.0, 20.0, 0.0]] * 5) + 0.1 * rng.standard_normal((5, 3))
    positions[:, 2] = 1000.0 + 300.0 * rng.standard_normal(5)
    velocities = 60.0 * rng.standard_normal((5, 3))
    attitudes = np.empty((5, 3, 3))
    indicated = np.empty((5, 3, 3))
    errors = size * rng.standard_normal((5, 9)) * np.repeat([100.0, 0.5, 3e-3], 3)
    for k in range(5):
        turn = np.empty((3, 3))
        rotation_matrix(rng.standard_normal(3), attitudes[k])
        rotation_matrix(-errors[k, 6:], turn)
        indicated[k] = turn @ attitudes[k]
    # Metres are worth what they are where the INS believes to be: found by iteration.
    places = positions
    for _ in range(5):
        metres = np.hstack([metres_along(places), np.ones((5, 1))])
        places = positions + (errors[:, :3] / metres)[:, [1, 0, 2]]
    ins = Motion(places, velocities + errors[:, 3:6], indicated)
    return Motion(positions, velocities, attitudes), ins, errors


def test_the_errors_are_those_of_the_error_state():
    """The INS's errors of this file are the error state of the package, to rounding."""
    truth, ins, errors = motions(1, 1.0)
    states = np.hstack([ins.positions, ins.velocities, ins.attitudes.reshape(-1, 9)])[None]
    found = np.empty((1, 5, 9))
    navigation_errors(states, truth.positions, truth.velocities, truth.attitudes, found)
    np.testing.assert_allclose(found[0], errors, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", SENSORS)
def test_a_reading_is_what_the_model_says_to_the_squares_of_the_errors(name):
    """Exact reading − (offset + A x) falls with the square of the INS's errors, or is rounding."""
    sensor = SENSORS[name]
    left = []
    for size in (1.0, 0.1):
        truth, ins, errors = motions(2, size)
        offset, rows = sensor.about(ins)
        said = offset + np.einsum("kej,kj->ke", rows, errors)
        exact = sensor.exact(truth, ins, NORMAL)
        assert exact.shape == (5, len(sensor.channels)) == said.shape
        left.append(np.abs(exact - said).max())
    assert left[1] < max(0.02 * left[0], 1e-6)
    assert np.abs(exact - offset).max() > 30.0 * left[1]  # it does depend on the errors


def test_a_longer_arm_adds_what_the_states_say():
    """Exactly to positions; to velocities the change of C_nb δl with time, by differences."""
    truth, ins, _ = motions(2, 1.0)
    longer, turning = np.array([0.5, -2.0, 1.0]), 0.3 * np.random.default_rng(3).normal(size=(5, 3))
    short = SENSORS["gnss on an arm"]
    long = dataclasses.replace(short, lever=tuple(np.array(short.lever) + longer))
    added = short.by_arm(truth, turning) @ longer
    exact = long.exact(truth, ins, NORMAL) - short.exact(truth, ins, NORMAL)
    np.testing.assert_allclose(added[:, :3], exact[:, :3], rtol=1e-6)
    turn, step = np.empty((3, 3)), 1e-5
    for k in range(5):
        rotation_matrix(step * turning[k], turn)
        before, after = (truth.attitudes[k] @ turned @ longer for turned in (turn.T, turn))
        np.testing.assert_allclose(added[k, 3:], (after - before) / (2.0 * step), atol=1e-8)


@pytest.mark.parametrize("name", SENSORS)
def test_a_reading_may_be_seen_from_another_track(name):
    """As if the INS had indicated that one: to rounding, and what its noise is turned by.

    Tracks that are hundreds of metres, half a metre a second and minutes of arc apart. A gravimeter
    of one component does not know what is felt in the others: to a fifth, of tilts of 10′ and 3′.
    """
    sensor, own = SENSORS[name], np.random.default_rng(5)
    truth, old, _ = motions(5, 1.0)
    _, new, _ = motions(5, 0.3)
    noise = own.standard_normal((5, len(sensor.channels)))
    readings = sensor.exact(truth, old, NORMAL) + noise
    expected = sensor.exact(truth, new, NORMAL) + noise
    found = sensor.seen_from(readings, old, new)
    limits = {
        "gnss": 1e-4,
        "gnss position": 1e-4,
        "gnss on an arm": 1e-3,
        "vector gravimeter": 0.01,
    }  # the noise turns, too
    limit = limits.get(name, 1e-9)
    if name == "gravimeter":
        limit = 0.2 * np.abs(expected - readings).max()
    assert np.abs(found - expected).max() < limit
    if "log" not in name and name not in ("barometer", "gnss velocity"):
        assert np.abs(found - readings).max() > 1.0


def test_the_reading_of_a_gravimeter_without_errors_of_the_ins_is_the_disturbance(tmp_path):
    """Of its size, positive where gravity is too large; of its components as they are."""
    truth, _, _ = motions(3, 0.0)
    found = SENSORS["vector gravimeter"].exact(truth, truth, Bump())
    np.testing.assert_allclose(found, np.tile([10.0, 20.0, -30.0], (5, 1)), atol=1e-6)


class Bump(Field):
    """A field whose disturbance is 10, 20, 30 mGal to the east, to the north and up."""

    def __init__(self) -> None:
        pass

    def gravity_disturbance(self, latitude, longitude, height):
        return np.tile([1e-4, 2e-4, 3e-4], (len(latitude), 1))


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 225.0])
def test_the_eotvos_correction_is_the_textbooks(heading_deg):
    """7.503 V sin α cos φ + 0.004154 V² mGal with V in knots, on a sphere (Torge 1989, 5.4.5).

    To a percent: the textbook's Earth is a sphere.
    """
    knots, latitude, heading = 12.0, math.radians(30.0), math.radians(heading_deg)
    speed = knots * 1852.0 / 3600.0
    place = np.array([[latitude, 1.0, 0.0]])
    velocity = speed * np.array([[math.sin(heading), math.cos(heading), 0.0]])
    still = steady_force(place, np.zeros((1, 3)))
    found = 1e5 * (still - steady_force(place, velocity))[0, 2]
    expected = 7.503 * knots * math.sin(heading) * math.cos(latitude) + 0.004154 * knots**2
    assert found == pytest.approx(expected, rel=0.01)


def test_a_tilt_of_a_second_of_arc_is_five_milligals():
    """1″ · g = 4.75 mGal, with its sign: what leans to the east feels a pull to the east."""
    truth, _, _ = motions(4, 0.0)
    tilt, turn = math.radians(1.0 / 3600.0), np.empty((3, 3))
    rotation_matrix(np.array([0.0, -tilt, 0.0]), turn)  # φ = +1″ about north
    leaning = truth._replace(attitudes=turn @ truth.attitudes)
    sensor = SENSORS["vector gravimeter"]
    found = sensor.exact(truth, leaning, NORMAL)
    np.testing.assert_allclose(found[:, 0], 4.75, rtol=0.02)
    row = sensor.about(leaning)[1][:, 0, 7]
    np.testing.assert_allclose(row * tilt, found[:, 0], rtol=1e-3)


@thinned("times", [np.arange(1.0, 261.0), np.cumsum(np.tile([0.5, 2.0], 130))])
def test_biases_keep_their_size_and_forget_within_their_time(times):
    """A Gauss–Markov process: σ at all epochs, correlation e^(−Δt/T), whatever the epochs.

    Of 400 drawn at two epochs 20 s apart: σ to 10 % (3 deviations), the correlation to 0.1
    (3 deviations).
    """
    sensor = Barometer(1.0, (1.0,), bias=7.0, bias_time=30.0)
    first = 200
    then = int(np.searchsorted(times, times[first] + 20.0))
    drawn = np.array([sensor.biases(times, np.random.default_rng(n))[:, 0] for n in range(400)])
    assert drawn[:, first].std() == pytest.approx(7.0, rel=0.1)
    assert drawn[:, 0].std() == pytest.approx(7.0, rel=0.1)
    expected = math.exp(-(times[then] - times[first]) / 30.0)
    found = np.corrcoef(drawn[:, first], drawn[:, then])[0, 1]
    assert found == pytest.approx(expected, abs=0.1)


def test_a_bias_without_a_time_is_constant():
    drawn = Barometer(1.0, (1.0,), bias=7.0).biases(np.arange(9.0), np.random.default_rng(1))
    assert np.ptp(drawn) == 0.0 != drawn[0, 0]
