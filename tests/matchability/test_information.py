"""Information and ambiguity: equal to the benchmark's own Jacobians, and reached by estimators."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.special import ndtr
from small_cases import blank_map, rough_map, small_case

from ggbench.gravity.degraded_map import MapDegradation, degrade
from ggbench.gravity.ellipsoid import metres_per_radian, normal_gravity
from ggbench.gravity.field import Field
from ggbench.gravity.gradient_map import MapError
from ggbench.matchability import information as info
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.runs import simulate

HEIGHT = 10_000.0
CENTRE = np.array([math.radians(33.5), math.radians(108.05), HEIGHT])


@pytest.fixture(scope="module")
def field():
    """Of 10 E over 3 km, 40 km wide."""
    noise = MapDegradation(correlated_noise_eotvos=10.0, correlation_m=3000.0, seed=1)
    return Field.from_map(degrade(blank_map(), noise))


@pytest.fixture(scope="module")
def track():
    along = np.linspace(-5e3, 5e3, 21)[:, np.newaxis]
    return info.moved(CENTRE, along * (math.sin(0.6), math.cos(0.6)))


@pytest.mark.parametrize(("kind", "components"), [("tensor", None), ("uu", ["zz"])])
def test_information_is_the_sum_over_the_benchmarks_jacobians(tmp_path, kind, components):
    """J of a flight's readings at what its INS indicates, to rounding."""
    changes = {
        "field.source": rough_map(tmp_path / "rough.nc"),
        "gradiometer.instrument": "local-level",
        "gradiometer.noise_eotvos": 0.7,
    } | ({} if components is None else {"gradiometer.components": components})
    problem, _ = simulate(prepare(small_case(changes)), seed=1, run=0)
    at_zero = np.zeros(problem.dimension)
    expected = np.zeros((2, 2))
    for k in range(problem.epochs):
        rows = problem.model.jacobian(k, at_zero)[:, :2]
        expected += rows.T @ np.linalg.solve(problem.noise_cov, rows)
    field = problem.map
    instrument = info.Instrument(kind, 0.7)
    flown = prepare(small_case(changes))
    found = info.information(instrument.jacobians(flown.model_field, problem.track.positions))
    assert field is not None
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.trace(expected))


def test_a_gravimeter_sees_the_slope_of_gravity(field, track):
    """Normal gravity's along latitude, and less Γ_EU and Γ_NU of the map; curvature is 0.1 E."""
    found = info.Instrument("gravity", 2.0).jacobians(field, track)[:, 0] * 2.0 / info.MGAL
    tensor = field.tensor(*track.T) - Field.normal().tensor(*track.T)
    north = [normal_gravity(place[0], HEIGHT)[1] / metres_per_radian(place)[0] for place in track]
    expected = np.stack([-tensor[:, 2], -tensor[:, 4]], axis=1) * 1e-9
    expected[:, 1] += north
    np.testing.assert_allclose(found, expected, atol=3e-10)
    assert np.abs(expected).max() > 5e-9


@pytest.mark.parametrize("kind", info.KINDS)
def test_jacobians_are_the_slopes_of_the_readings(field, track, kind):
    instrument = info.Instrument(kind, 0.5)
    step = 5.0
    for axis in range(2):
        offset = step * np.eye(2)[axis]
        ahead, behind = (instrument.readings(field, info.moved(track, s * offset)) for s in (1, -1))
        slope = (ahead - behind) / (2.0 * step)
        found = instrument.jacobians(field, track)[..., axis]
        np.testing.assert_allclose(found, slope, atol=1e-4 * np.abs(found).max())


def test_an_efficient_estimator_reaches_the_accuracy(field, track):
    """Least squares over 100 draws: their mean square over tr J⁻¹ is χ² over its degrees.

    Of at least 100 degrees (one direction could have all of it); 4 of its deviations are passed
    once in 16 000 seeds.
    """
    instrument = info.Instrument("tensor", 1.0)
    truth = instrument.readings(field, track)
    rng = np.random.default_rng(11)
    squares = []
    for _ in range(100):
        seen = truth + rng.standard_normal(truth.shape)
        fit = least_squares(
            lambda d, seen=seen: (instrument.readings(field, info.moved(track, d)) - seen).ravel(),
            np.zeros(2),
            jac=lambda d: instrument.jacobians(field, info.moved(track, d)).reshape(-1, 2),
        )
        squares.append(fit.x @ fit.x)
    expected = info.accuracy(info.information(instrument.jacobians(field, track))) ** 2
    assert np.mean(squares) / expected == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / 100.0))


def test_accuracy_and_isotropy_of_known_information():
    j = np.diag([4.0, 1.0])
    assert info.accuracy(j) == pytest.approx(math.sqrt(1.25))
    assert info.isotropy(j) == pytest.approx(0.25)
    assert info.accuracy(np.diag([1.0, 0.0])) == np.inf
    assert math.isnan(info.isotropy(np.zeros((2, 2))))


def test_ambiguity_begins_as_information_does(field, track):
    instrument = info.Instrument("tensor", 1.0)
    j = info.information(instrument.jacobians(field, track))
    grid = info.offsets(20.0, 10.0)
    assert grid.shape == (5, 5, 2)
    found = info.ambiguity(field, instrument, track, grid)
    expected = 0.5 * np.einsum("stk,kl,stl->st", grid, j, grid)
    inside = ~np.isnan(found)
    assert inside.sum() == 13  # a disc of the grid
    assert found[2, 2] == 0.0
    np.testing.assert_allclose(found[inside], expected[inside], rtol=0.02, atol=1e-12)


def test_tracks_that_leave_the_map_are_no_hypotheses(field, track):
    grid = info.offsets(40e3, 10e3)
    found = info.ambiguity(field, info.Instrument(), track, grid)
    assert np.isnan(found[0, 4])
    assert np.isfinite(found[4, 4])
    assert np.isfinite(info.least(found, grid, 5e3, 40e3))
    assert math.isnan(info.least(np.full_like(found, np.nan), grid, 5e3, 40e3))


def wells(depths, grid):
    """A(d) of 100 with a basin at zero and one at each given offset index."""
    found = np.full(grid.shape[:2], 100.0)
    for (i, j), depth in depths.items():
        found[i, j] = depth
    return found


def test_the_union_bound_is_over_basins_beyond_what_is_right():
    grid = info.offsets(10e3, 1e3)  # the middle is [10, 10]
    found = wells({(10, 10): 0.0, (10, 12): 1.0, (10, 16): 5.0, (4, 10): 7.0}, grid)
    expected = ndtr(-math.sqrt(2.5)) + ndtr(-math.sqrt(3.5))
    bound = info.false_fix_bound(found, grid, 3e3, 9e3)
    # The plain of 100 nepers is one basin a node, of 1e-12 each.
    assert bound == pytest.approx(expected, rel=1e-6)
    assert info.least(found, grid, 3e3, 9e3) == 5.0
    assert info.least(found, grid, 1e3, 9e3) == 1.0
    # A prior is one more reading: |d|²/2σ² nepers.
    expected = sum(ndtr(-math.sqrt(0.5 * (a + 36.0 / 8.0))) for a in (5.0, 7.0))
    assert info.false_fix_bound(found, grid, 3e3, 9e3, 2e3) == pytest.approx(expected, rel=1e-6)
    assert info.false_fix_bound(np.zeros_like(found), grid, 3e3, 9e3) == 1.0


def test_two_hypotheses_are_confused_as_often_as_the_bound_says():
    """20 000 draws; four binomial deviations are passed once in 16 000 seeds."""
    rng = np.random.default_rng(5)
    right, wrong = rng.standard_normal((2, 12)) * 0.7
    a = 0.5 * np.sum((right - wrong) ** 2)
    seen = right + rng.standard_normal((20_000, 12))
    confused = np.mean(np.sum((seen - wrong) ** 2, 1) < np.sum((seen - right) ** 2, 1))
    grid = info.offsets(10e3, 1e3)
    bound = info.false_fix_bound(wells({(10, 10): 0.0, (10, 16): a}, grid), grid, 3e3, 9e3)
    assert 0.02 < bound < 0.5
    assert confused == pytest.approx(bound, abs=4.0 * math.sqrt(bound / 20_000))


def test_what_spills_over():
    """Of a circle exp(−r²/2s²); of an ellipse by 40 000 draws, to four deviations."""
    assert info.spill(np.eye(2) / 9.0, 6.0) == pytest.approx(math.exp(-2.0), rel=1e-9)
    assert info.spill(np.eye(2) / 18.0, 6.0, math.sqrt(18.0)) == pytest.approx(math.exp(-2.0))
    cov = np.array([[4.0, 1.5], [1.5, 1.0]])
    draws = np.random.default_rng(2).multivariate_normal(np.zeros(2), cov, 40_000)
    share = np.mean(np.hypot(*draws.T) > 3.0)
    expected = info.spill(np.linalg.inv(cov), 3.0)
    assert share == pytest.approx(expected, abs=4.0 * math.sqrt(expected / 40_000))
    assert info.spill(np.diag([1.0, 0.0]), 3.0) == 1.0


@pytest.mark.parametrize(("kind", "noise"), [("tensor", 0.0), ("tensor", math.nan), ("mass", 1.0)])
def test_an_instrument_that_cannot_be(kind, noise):
    with pytest.raises(MapError, match=r"noise must be|instrument is one of"):
        info.Instrument(kind, noise)
