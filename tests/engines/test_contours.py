"""Contours of a reading, the nearest points on them, and the motion that brings a track there."""

from __future__ import annotations

import numpy as np
import pytest

from ggbench.engines.contours import contour, feet, fitted_transform


def bowl(cell: float, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Half the squares of a distance on a grid, and where that begins."""
    side = np.arange(-1.5 * radius, 1.5 * radius + cell, cell)
    return 0.5 * (side[:, None] ** 2 + side**2), np.full(2, side[0])


@pytest.mark.parametrize(("cell", "within"), [(20.0, 0.3), (5.0, 0.02)])
def test_the_contour_of_a_bowl_is_a_circle(cell, within):
    """Of a radius of 300 m, to the square of the cells; the slope there points outwards."""
    values, first = bowl(cell, 300.0)
    found = contour(values, 0.5 * 300.0**2, first, cell)
    distance = np.linalg.norm(found.points, axis=1)
    assert np.abs(distance - 300.0).max() < within
    np.testing.assert_allclose(found.slopes, found.points, atol=cell * 1.1)
    assert len(found.points) > 2.0 * np.pi * 300.0 / cell


def test_the_nearest_point_of_a_circle_is_in_its_direction():
    """Of points inside and outside, to a quarter of a cell; where there is no contour, none."""
    values, first = bowl(20.0, 300.0)
    circle = contour(values, 0.5 * 300.0**2, first, 20.0)
    nowhere = contour(values, -1.0, first, 20.0)
    directions = np.linspace(0.0, 2.0 * np.pi, 40)
    unit = np.stack([np.cos(directions), np.sin(directions)], axis=1)
    track = unit * np.where(np.arange(40) % 2, 250.0, 350.0)[:, None]
    found = feet([circle] * 39 + [nowhere], track, 20.0)
    assert found.found.tolist() == [True] * 39 + [False]
    assert np.linalg.norm(found.points - 300.0 * unit, axis=1)[:39].max() < 5.0


@pytest.mark.parametrize("similar", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_a_motion_is_recovered_from_true_points(similar, seed):
    """Turn, scale and shift to 1e-6 of what was applied, when every y is the true point of its x.

    Negative control: a rigid motion cannot be a stretched one.
    """
    generator = np.random.default_rng(seed)
    x = np.cumsum(generator.normal([50.0, 10.0], 5.0, size=(30, 2)), axis=0)
    turn, shift = generator.normal(0.0, 0.05), generator.normal(0.0, 500.0, 2)
    scale = 1.0 + generator.normal(0.0, 0.02)
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    y = (scale if similar else 1.0) * x @ matrix.T + shift
    found, moved = fitted_transform(x, y, similar, 0.5, 0.5)
    assert np.arctan2(found[1, 0], found[0, 0]) == pytest.approx(turn, abs=1e-6)
    assert np.sqrt(np.linalg.det(found)) == pytest.approx(scale if similar else 1.0, abs=1e-6)
    np.testing.assert_allclose(x @ found.T + moved, y, atol=1e-6)
    if similar:
        rigid, moved = fitted_transform(x, y, False, 0.5, 0.5)
        assert np.abs(x @ rigid.T + moved - y).max() > 0.1


def test_turn_and_scale_are_held_to_their_limits():
    """And the shift is the best one then: the middles of the points come together."""
    x = np.stack([np.linspace(0.0, 1000.0, 11), np.zeros(11)], axis=1)
    y = 1.2 * x[:, ::-1] + 7.0  # turned by 90 degrees
    matrix, shift = fitted_transform(x, y, True, 0.01, 0.02)
    assert np.arctan2(matrix[1, 0], matrix[0, 0]) == pytest.approx(0.01)
    assert 0.98 - 1e-12 <= np.sqrt(np.linalg.det(matrix)) <= 1.02
    np.testing.assert_allclose((x @ matrix.T + shift).mean(axis=0), y.mean(axis=0))
