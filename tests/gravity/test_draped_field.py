"""Fields of draped maps: their third coordinate is the height above a base surface."""

import dataclasses
import math
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from ggbench.engines.multiple_model import cell_spacing
from ggbench.gravity.field import Field, OutsideMapError
from ggbench.gravity.gradient_map import GradientMap
from ggbench.judging.judgement import epochs_outside

NODES = 12, 11, 9
STEP = np.array([4e-5, 5e-5, 40.0])
ORIGIN = np.array([0.7, 0.2, 60.0])
METRES = np.array([6.37e6, 6.37e6 * math.cos(0.7), 1.0])


def base_at(latitude, longitude):
    """A rough surface of 300 m relief."""
    north, east = 6.37e6 * (latitude - 0.7), 4.87e6 * (longitude - 0.2)
    return 1500.0 + 150.0 * np.sin(north / 600.0) * np.cos(east / 500.0) + 0.05 * east


def field_at(latitude, longitude, height):
    """Nine smooth functions of the place."""
    north, east = 6.37e6 * (latitude - 0.7), 4.87e6 * (longitude - 0.2)
    one = np.sin(north / 900.0 + 0.3) * np.exp(-(height - 1500.0) / 700.0)
    two = np.cos(east / 800.0) * np.exp(-(height - 1500.0) / 800.0)
    return np.stack([(1 + m) * one + (5 - m) * two for m in range(9)], axis=-1)


def nodes():
    axes = [first + step * np.arange(n) for first, step, n in zip(ORIGIN, STEP, NODES, strict=True)]
    return np.meshgrid(*axes, indexing="ij")


@pytest.fixture(scope="module")
def draped() -> Field:
    latitude, longitude, above = nodes()
    base = base_at(latitude[:, :, 0], longitude[:, :, 0])
    values = field_at(latitude, longitude, above + base[..., np.newaxis])
    return Field.from_map(
        GradientMap(*ORIGIN, *STEP, values[..., :6], values[..., 6:], "a slope", base=base)
    )


@pytest.fixture(scope="module")
def places(draped) -> np.ndarray:
    share = np.random.default_rng(1).uniform(0.15, 0.85, (60, 3))
    found = draped.lower + share * (draped.upper - draped.lower)
    return np.stack(draped.over_nodes(*found.T), axis=-1)


def test_the_spline_is_evaluated_above_the_base(draped, places):
    disturbing = draped.tensor(*places.T) - Field.normal().tensor(*places.T)
    expected = field_at(*places.T)
    assert disturbing == pytest.approx(expected[:, :6], abs=0.02)
    assert draped.gravity_disturbance(*places.T) == pytest.approx(expected[:, 6:], abs=0.02)
    flat = draped.flattened().continued_tensor(places) - Field.normal().tensor(*places.T)
    assert np.abs(flat - expected[:, :6]).max() > 1.0  # the base is worth something


def test_derivatives_follow_the_chain_rule(draped, places):
    _, slopes = draped.tensor_and_derivative(*places.T)
    steps = 0.5 / METRES  # half a metre north, east, up
    for axis, column in ((0, 1), (1, 0), (2, 2)):
        step = np.zeros(3)
        step[axis] = steps[axis]
        ahead, behind = (draped.tensor(*(places + sign * step).T) for sign in (1.0, -1.0))
        metres = 1.0
        if axis < 2:  # by the radii of curvature there
            from ggbench.gravity.ellipsoid import metres_per_radian

            metres = np.array([metres_per_radian(p)[axis] for p in places])[:, np.newaxis]
            metres = metres * 2.0 * steps[axis]
        assert (ahead - behind) / metres == pytest.approx(slopes[..., column], abs=2e-6)


def test_the_base_of_the_map_counts_not_the_ellipsoid(draped, places):
    base = base_at(*places[:, :2].T)
    assert draped.base(places) == pytest.approx(base, abs=0.5)
    assert draped.coordinates(places)[:, 2] == pytest.approx(places[:, 2] - base, abs=0.5)
    assert draped.covers(places, 0.0).all()
    below = places - [0.0, 0.0, 400.0]
    assert not draped.covers(below, 0.0).any()
    with pytest.raises(OutsideMapError, match="60 to 380 m above its base surface, which lies at"):
        draped.tensor(*below.T)


def test_outside_the_border_is_continued(draped, places):
    """Below the lowest layer its value, with no slope upwards, and along the ground its own."""
    low = np.array(places)
    low[:, 2] = draped.base(low) + ORIGIN[2]
    sunk = low - [0.0, 0.0, 30.0]
    normal = Field.normal()
    expected = draped.tensor(*low.T) - normal.tensor(*low.T)
    found = draped.continued_tensor(sunk) - normal.tensor(*sunk.T)
    assert found == pytest.approx(expected, abs=1e-9)
    aside = low - [1.0, 0.0, 0.0]
    assert np.isfinite(draped.continued_tensor(aside)).all()


def test_an_estimate_above_the_base_is_inside_the_map(draped, places):
    """Heights are compared above the base surface; control: 1 km higher is outside."""
    problem = Mock(track=Mock(positions=places), map=draped, epochs=len(places))
    mean = np.zeros((len(places), 3))
    assert not epochs_outside(problem, mean).any()
    mean[:, 2] = -1000.0  # errors of the INS are taken from its positions
    assert epochs_outside(problem, mean).all()


def test_the_spacing_of_gaussians_is_found_on_draped_layers(draped):
    """In the middle of the layers, near that of level ones; heights there are above the base."""
    spacings = [
        cell_spacing(SimpleNamespace(map=one, channels=(), noise_cov=np.empty((0, 0))))
        for one in (draped, draped.flattened())
    ]
    assert 0.5 < spacings[0] / spacings[1] < 2.0


def test_a_base_of_zero_is_a_level_map(draped, places):
    """To the last digits: the chain rule adds nothing."""
    level = draped.flattened()
    zero = dataclasses.replace(draped, base_coefficients=np.zeros_like(draped.base_coefficients))
    flown = places - np.array([0.0, 0.0, 1500.0])
    flown[:, 2] = np.clip(flown[:, 2], 70.0, 370.0)
    for one, other in zip(
        level.tensor_and_derivative(*flown.T), zero.tensor_and_derivative(*flown.T), strict=True
    ):
        assert one == pytest.approx(other, rel=1e-14, abs=1e-14)


def test_a_map_keeps_its_base_when_it_is_degraded(draped):
    from ggbench.gravity.degraded_map import MapDegradation, degrade
    from ggbench.gravity.gradient_map import MapError

    latitude, longitude, above = nodes()
    base = base_at(latitude[:, :, 0], longitude[:, :, 0])
    values = field_at(latitude, longitude, above + base[..., np.newaxis])
    right = GradientMap(*ORIGIN, *STEP, values[..., :6], values[..., 6:], "a slope", base=base)
    assert degrade(right, MapDegradation(density_factor=0.9)).base is base
    with pytest.raises(MapError, match=r"correlation_km = 0\.2, too short .* at least 0\.415 km"):
        degrade(right, MapDegradation(correlated_noise_eotvos=1.0, correlation_m=200.0))
