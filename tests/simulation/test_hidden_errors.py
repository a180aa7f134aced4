"""Errors of the true gradiometer that no estimator is told of: they have the law that is stated.

Of each statement the probability of a false alarm is 1e-4.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from laws import ALARM, likely
from scipy.stats import binom, chi2, kstest, norm
from scipy.stats import t as student
from small_cases import LEVEL, OUTLIERS, TILT, small_flight

from ggbench.judging.references import CaseBound
from ggbench.sensors.gradiometer.faults import Faults
from ggbench.simulation.flight_bounds import flight_bound
from ggbench.simulation.runs import simulate, simulate_block

RUNS = range(60)
DIAGONAL = [0, 3, 5]


def measured(changes: dict[str, Any]) -> np.ndarray:
    """Measurements (60, 20, 6) of a flight with changes [E]."""
    return simulate_block(small_flight(changes), 17, RUNS)[0].measurements


def test_all_channels_are_struck_at_once():
    """Then each by an error of its own; the share is that of readings."""
    added = measured(OUTLIERS | {"truth.gradiometer.outlier_channels": "all"}) - measured({})
    struck = added != 0.0
    np.testing.assert_array_equal(struck.any(axis=2), struck.all(axis=2))
    assert likely(struck.all(axis=2).sum(), binom(1200, 0.2))
    of_one = added[struck.all(axis=2)]
    assert likely((of_one**2).sum() / 25.0, chi2(of_one.size))
    assert abs((of_one[:, 0] * of_one[:, 5]).sum() / 25.0) < 3.9 * np.sqrt(len(of_one))


def test_bursts_strike_readings_in_a_row():
    """Of the stated share still, in bursts of 10 s at the readings' interval; of each channel.

    The share of a run of 20 s scatters as a burst lasts: from run to run and channel to channel
    there are 360 of them.
    """
    added = measured(OUTLIERS | {"truth.gradiometer.outlier_burst_s": 10.0}) - measured({})
    struck = added != 0.0
    assert likely(struck[:, 0].sum(), binom(360, 0.2))
    assert likely(struck[:, -1].sum(), binom(360, 0.2))
    kept = math.exp(-1.0 / 8.0)  # of the state a second before: (1 - share) times 10 s
    after = struck[:, 1:][struck[:, :-1]]
    assert likely(after.sum(), binom(after.size, 0.2 + 0.8 * kept))
    assert not np.array_equal(struck[..., 0], struck[..., 5])


def test_a_burst_in_all_channels_is_one_burst():
    """The two keys together."""
    both = {"truth.gradiometer.outlier_burst_s": 10.0, "truth.gradiometer.outlier_channels": "all"}
    struck = measured(OUTLIERS | both) != measured({})
    np.testing.assert_array_equal(struck.any(axis=2), struck.all(axis=2))
    assert struck[:, 1:][struck[:, :-1]].mean() > 0.8


def test_the_noise_grows_with_the_motion():
    """By the same numbers, times 1 + rate/limit + acceleration/limit of each reading.

    On a circle of 3°/s at 50 m/s the acceleration is 2.6 m/s²; flown straight, nothing changes.
    """
    circle = {
        "trajectory.vehicle": "ship",
        "trajectory.speed_mps": 50.0,
        "trajectory.segment": [
            {"kind": "turn", "by_heading_deg": 60.0, "turn_rate_deg_per_s": 3.0}
        ],
    }
    limits = {
        "truth.gradiometer.noise_doubles_at_deg_per_s": 6.0,
        "truth.gradiometer.noise_doubles_at_mps2": 1.3,
    }
    quiet = small_flight(circle | LEVEL | {"gradiometer.noise_eotvos": 1.0})
    noisy = small_flight(circle | LEVEL | limits | {"gradiometer.noise_eotvos": 1.0})
    exact = small_flight(circle | LEVEL).noise_free
    plain, grown = (simulate(f, 1, 0)[0].measurements - exact for f in (quiet, noisy))
    factors = grown / plain
    np.testing.assert_allclose(factors, np.repeat(factors[:, :1], 6, axis=1), rtol=1e-6)
    np.testing.assert_allclose(factors[8:12], 1.0 + 0.5 + 2.0, rtol=0.02)
    straight = small_flight(limits)
    assert straight.noise_growth == pytest.approx(1.0, abs=2e-3)  # the Earth and gravity's change


@pytest.mark.parametrize("freedom", [3.0, 8.0])
def test_the_noise_is_students_with_the_stated_deviation(freedom):
    """Kolmogorov-Smirnov for the whole law, the number beyond 4 deviations for its tails."""
    rng = np.random.default_rng(6)
    noise = rng.standard_normal((20_000, 6)) * Faults(freedom=freedom).tails((20_000, 6), rng)
    law = student(freedom, scale=math.sqrt((freedom - 2.0) / freedom))
    assert law.std() == pytest.approx(1.0)
    assert kstest(noise.ravel(), law.cdf).pvalue > ALARM
    beyond = (np.abs(noise) > 4.0).sum()
    assert likely(beyond, binom(noise.size, 2.0 * law.sf(4.0)))
    assert beyond > 10.0 * noise.size * 2.0 * norm.sf(4.0)


def test_what_students_noise_changes_is_the_noise_alone():
    """Each reading keeps the sign of its normal error; an estimator is told of the deviation."""
    exact = measured({"gradiometer.noise_eotvos": 1e-6})
    quiet, heavy = small_flight({}), small_flight({"truth.gradiometer.noise_freedom": 3.0})
    (one, truth), (other, truth_other) = (simulate_block(f, 17, RUNS) for f in (quiet, heavy))
    np.testing.assert_array_equal(truth.error_state, truth_other.error_state)
    np.testing.assert_array_equal(one.noise_cov, other.noise_cov)
    normal, tailed = one.measurements - exact, other.measurements - exact
    np.testing.assert_array_equal(np.sign(normal), np.sign(tailed))
    sigma = quiet.true.gradiometer.noise_eotvos
    law = student(3.0, scale=sigma / math.sqrt(3.0))
    assert kstest(tailed.ravel(), law.cdf).pvalue > ALARM


@pytest.mark.parametrize("freedom", [3.0, 8.0])
def test_the_bound_is_that_of_students_law(freedom):
    """It has more information than a normal law of the same variance: E (d log p / dx)²."""
    law = student(freedom, scale=math.sqrt((freedom - 2.0) / freedom))
    x = np.linspace(-300.0, 300.0, 600_001)
    slope = np.gradient(law.logpdf(x), x)
    gained = float(np.sum(slope**2 * law.pdf(x)) * (x[1] - x[0]))
    noise = 1e-2
    heavy = small_flight({"truth.gradiometer.noise_freedom": freedom})
    finer = small_flight({"truth.gradiometer.noise_eotvos": noise / math.sqrt(gained)})
    normal = small_flight({})
    assert heavy.true.gradiometer.noise_eotvos == noise
    bounds = [CaseBound(flight, flight_bound(flight)).final_m for flight in (heavy, finer, normal)]
    assert bounds[0] == pytest.approx(bounds[1], rel=1e-5)
    assert bounds[0] < 0.99 * bounds[2]


def test_a_scale_factor_walks_from_its_start():
    """By the stated variance after t, in independent steps, of each channel by itself.

    60 runs of three channels: chi-square at the last reading and for all steps.
    """
    exact = measured(LEVEL)
    drift = 1e4
    share = measured(LEVEL | {"truth.gradiometer.scale_drift_ppm_per_sqrt_h": drift}) / exact - 1.0
    walk = share[..., DIAGONAL] / (1e-6 * drift / 60.0)
    assert likely((walk[:, -1] ** 2).sum() / 20.0, chi2(180))
    steps = np.diff(walk, axis=1, prepend=0.0)
    assert likely((steps**2).sum(), chi2(3600))
    assert abs((steps[:, 1:] * steps[:, :-1]).sum()) < 3.9 * math.sqrt(3420)
    assert abs((steps[..., 0] * steps[..., 1]).sum()) < 3.9 * math.sqrt(1200)


def test_a_drift_and_a_drawn_scale_factor_add():
    """At the first reading of a slow drift the factor is nearly what was drawn."""
    drawn = {"truth.gradiometer.scale_factor_ppm": 1e4}
    slow = {"truth.gradiometer.scale_drift_ppm_per_sqrt_h": 1e-3}
    np.testing.assert_allclose(measured(LEVEL | drawn | slow), measured(LEVEL | drawn), rtol=1e-9)


def test_a_tilt_turns_the_tensor_about_the_horizontal_axes():
    """Angles of the stated deviation and correlation, found in yz and xz, and a rotation of all.

    60 runs of 20 readings a second apart, two angles: chi-square for the first angles and for the
    innovations of a Gauss-Markov process of 5 s.
    """
    exact, tilted = measured(LEVEL), measured(LEVEL | TILT)
    xx, yy, zz = (exact[..., i] for i in DIAGONAL)
    added = (tilted - exact) / math.radians(1.0 / 60.0)
    # To first order a turn about east by a changes yz by (yy - zz) a, one about north xz.
    angles = np.stack([added[..., 4] / (yy - zz), added[..., 2] / (zz - xx)], axis=-1)
    assert likely((angles[:, 0] ** 2).sum(), chi2(120))
    kept = math.exp(-1.0 / 5.0)
    new = (angles[:, 1:] - kept * angles[:, :-1]) / math.sqrt(1.0 - kept**2)
    assert likely((new**2).sum(), chi2(new.size))
    assert abs((new[..., 0] * new[..., 1]).sum()) < 3.9 * math.sqrt(1140)
    for before, after in zip(exact[:3].reshape(-1, 6), tilted[:3].reshape(-1, 6), strict=True):
        full = [v[[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3) for v in (before, after)]
        np.testing.assert_allclose(*map(np.linalg.eigvalsh, full), rtol=0.0, atol=1e-4)
    # None about the vertical: east and north would mix to first order.
    assert np.abs(added[..., 1]).max() < 0.01 * np.abs(added[..., 2]).max()


@pytest.mark.parametrize(
    "changes",
    [
        TILT | LEVEL,
        {"truth.gradiometer.noise_freedom": 3.0},
        {"truth.gradiometer.scale_drift_ppm_per_sqrt_h": 100.0},
        OUTLIERS | {"truth.gradiometer.outlier_burst_s": 5.0},
    ],
    ids=["tilt", "student", "scale drift", "bursts"],
)
def test_a_run_is_the_same_in_any_block(changes):
    """As all else that is drawn: by the run's own streams, whatever runs are beside it."""
    flight = small_flight(changes)
    block, _ = simulate_block(flight, 17, [4, 11, 2])
    alone, _ = simulate(flight, 17, 11)
    np.testing.assert_array_equal(block.measurements[1], alone.measurements)
