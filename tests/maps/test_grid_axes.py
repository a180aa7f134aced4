"""Axes, units and quantities of netCDF grids as programs state them."""

from __future__ import annotations

import numpy as np
import pytest
from grids import LATITUDES, VALUES, grid
from terrain_planes import write_tile

from ggbench.gravity.terrain_files import read_terrain
from ggbench.gravity.units import GRAVITY, HEIGHTS
from ggbench.gravity.voids import marks_removed
from ggbench.maps.gravity_grid import read_grid


@pytest.mark.parametrize("names", [("y", "x"), ("a", "b"), ("northing", "easting"), ("x", "y")])
def test_units_of_axes_decide_which_is_the_latitude(names, tmp_path):
    found = read_grid(grid(tmp_path, names=names, long_name="faa"), "anomaly")
    assert (found.south_deg, found.west_deg) == pytest.approx((42.0, 3.0))
    np.testing.assert_allclose(found.values, 1e-5 * VALUES)


def test_a_grid_across_greenwich_has_longitudes_from_0_to_360(tmp_path):
    axes = (LATITUDES, (358.5 + np.arange(30) / 10.0) % 360.0)
    found = read_grid(grid(tmp_path, axes=axes, long_name="faa"), "anomaly")
    assert found.west_deg == pytest.approx(-1.5)


@pytest.mark.parametrize(
    "attributes",
    [
        {"long_name": "gravity anomaly", "unit": "um/s^2"},
        {"long_name": "gravity anomaly", "Units": "um/s2"},
        {"long_name": "free air anomaly, um/s2"},
        {"long_name": "free air anomaly in gravity units"},
    ],
)
def test_units_of_values_however_they_are_stated(attributes, tmp_path):
    found = read_grid(grid(tmp_path, **attributes), "anomaly")
    np.testing.assert_allclose(found.values, 1e-6 * VALUES)
    assert any("converted from" in remark for remark in found.remarks)


@pytest.mark.parametrize(
    ("units", "others", "is_void"),
    [
        (GRAVITY, np.linspace(-150.0, 300.0, 50), True),
        (HEIGHTS, np.linspace(0.0, 3000.0, 50), True),
        (HEIGHTS, np.linspace(-4000.0, 0.0, 500), False),  # sea floor at all depths
        (HEIGHTS, np.linspace(-998.0, 0.0, 500), False),
    ],
)
def test_999_below_zero_is_a_void_far_from_all_other_values(units, others, is_void):
    written = np.append(others, -999.0)
    found, remark = marks_removed(written, written * (1e-5 if units is GRAVITY else 1.0), units)
    assert np.isnan(found[-1]) == is_void and ("-999" in remark) is is_void
    assert np.isfinite(found[:-1]).all()


@pytest.mark.parametrize(
    "long_name", ["", "Elevation relative to sea level", "height above EGM96 geoid", "topography"]
)
def test_a_terrain_may_state_its_zero_level(long_name, tmp_path):
    terrain = read_terrain(grid(tmp_path, values=100.0 + VALUES, long_name=long_name))
    assert terrain.height_m.min() > 79.0


def test_a_terrain_in_feet_may_say_so_as_unit(tmp_path):
    terrain = read_terrain(grid(tmp_path, values=100.0 + VALUES, unit="ft"))
    assert terrain.height_m.max() < 37.0


def test_a_tile_is_big_endian(tmp_path):
    path = tmp_path / "N46E008.hgt"
    write_tile(path, ">i2")
    assert 300.0 <= read_terrain(path).height_m.min() < 400.0
