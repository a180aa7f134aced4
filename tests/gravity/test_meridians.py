"""Longitudes count as those that they are laid beside: any turn, and across the date line."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ggbench.gravity.meridians import Area, eastern, rolled, turns


def test_longitudes_come_within_half_a_turn():
    longitudes = np.array([275.7, -84.3, 635.7, 10.0, math.nan])
    found = longitudes + turns(longitudes, -84.0)
    np.testing.assert_allclose(found, [-84.3, -84.3, -84.3, 10.0, math.nan], atol=1e-9)
    assert turns(-3.1, 3.1, math.tau) == math.tau
    assert turns(-84.3, -84.0) == 0.0


def test_an_eastern_bound_follows_its_western_one_across_the_date_line():
    assert eastern(179.0, -179.0) == 181.0
    assert eastern(-84.4, -84.3) == -84.3
    assert eastern(-84.4, 275.7) == pytest.approx(-84.3)
    assert eastern(-84.3, -84.4) == -84.4  # exchanged, not 359.9° wide
    assert eastern(-180.0, 180.0) == 180.0


def test_an_area_is_counted_as_a_longitude_is():
    assert Area(1.0, 2.0, 179.0, -179.0).about(-170.0) == (1.0, 2.0, -181.0, -179.0)
    assert Area(west=275.6).about(-84.0) == (None, None, pytest.approx(-84.4), None)
    assert Area(1.0, 2.0, 3.0, None).widened(0.5, 0.25) == (0.5, 2.5, 2.75, None)


def test_what_goes_around_the_earth_is_cut_elsewhere():
    """A meridian keeps its values; the one that a grid has twice is there once."""
    longitudes = np.arange(-180.0, 181.0, 10.0)
    values = np.cos(np.radians(longitudes))[np.newaxis]
    found, west = rolled(values, -180.0, 10.0, 175.0)
    assert found.shape == (1, 36)
    expected = np.cos(np.radians(west + 10.0 * np.arange(36)))
    np.testing.assert_allclose(found[0], expected, atol=1e-12)
    assert west <= 0.0 < 340.0 < west + 350.0
    same, west = rolled(values[:, :30], -180.0, 10.0, 175.0)
    assert same.shape == (1, 30) and west == -180.0
