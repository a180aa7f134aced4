"""Axes, units and quantities of netCDF grids as programs state them."""

from __future__ import annotations

import netCDF4
import numpy as np
import pytest

from ggbench.gravity.gradient_map import MapError
from ggbench.gravity.terrain import TerrainError
from ggbench.gravity.terrain_files import read_terrain
from ggbench.gravity.units import GRAVITY, HEIGHTS
from ggbench.gravity.voids import marks_removed
from ggbench.maps.gravity_grid import read_grid

LATITUDES = 42.0 + np.arange(20) / 10.0
LONGITUDES = 3.0 + np.arange(30) / 10.0
VALUES = 20.0 * np.sin(np.arange(600.0)).reshape(20, 30)


def grid(
    folder,
    *,
    names=("lat", "lon"),
    axes=(LATITUDES, LONGITUDES),
    units=("degrees_north", "degrees_east"),
    axis_names=("", ""),
    values=VALUES,
    title="",
    **attributes,
):
    """Return a netCDF file of a variable z on two axes."""
    path = folder / "grid.nc"
    with netCDF4.Dataset(path, "w") as file:
        for name, nodes, unit, long_name in zip(names, axes, units, axis_names, strict=True):
            file.createDimension(name, len(nodes))
            axis = file.createVariable(name, "f8", (name,))
            axis[:] = nodes
            axis.setncatts({k: v for k, v in (("units", unit), ("long_name", long_name)) if v})
        variable = file.createVariable("z", "f8", names)
        variable.setncatts(attributes)
        variable[:] = values
        file.title = title
    return path


@pytest.mark.parametrize("names", [("y", "x"), ("a", "b"), ("northing", "easting"), ("x", "y")])
def test_units_of_axes_decide_which_is_the_latitude(names, tmp_path):
    found = read_grid(grid(tmp_path, names=names, long_name="faa"), "anomaly")
    assert (found.south_deg, found.west_deg) == pytest.approx((42.0, 3.0))
    np.testing.assert_allclose(found.values, 1e-5 * VALUES)


BAD_AXES = {
    "swapped": ({"units": ("degrees_east", "degrees_north")}, "contradict the name"),
    "west": ({"units": ("degrees_north", "degrees_west")}, "positive north and east"),
    "south": ({"units": ("degrees_south", "degrees_east")}, "positive north and east"),
    "radians": ({"units": ("radians", "radians")}, "degrees are needed"),
    "kilometres": ({"names": ("y", "x"), "units": ("km", "km")}, "degrees are needed"),
    "colatitude": ({"axis_names": ("colatitude", "")}, "geodetic latitudes are needed"),
    "geocentric": ({"axis_names": ("geocentric latitude", "")}, "geodetic latitudes are needed"),
}


@pytest.mark.parametrize("name", BAD_AXES)
def test_axes_that_are_no_degrees_north_and_east_are_refused(name, tmp_path):
    changed, said = BAD_AXES[name]
    with pytest.raises(MapError, match=said):
        read_grid(grid(tmp_path, **changed), "anomaly")
    with pytest.raises(TerrainError, match=said):
        read_terrain(grid(tmp_path, values=100.0 + VALUES, **changed))


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
    ("kind", "attributes", "said"),
    [
        ("anomaly", {"long_name": "error of free-air anomaly"}, "an error"),
        ("anomaly", {"long_name": "standard deviation"}, "an error"),
        ("anomaly", {"description": "Bouguer anomaly"}, "Bouguer"),
        ("anomaly", {"title": "Complete Bouguer anomaly of Iberia"}, "Bouguer"),
        ("geoid", {"long_name": "mean sea surface"}, "a height of a surface"),
        ("geoid", {"long_name": "elevation"}, "a height of a surface"),
        ("geoid", {"long_name": "geoid error"}, "an error"),
    ],
)
def test_other_quantities_in_descriptions_are_refused(kind, attributes, said, tmp_path):
    with pytest.raises(MapError, match=said):
        read_grid(grid(tmp_path, **attributes), kind)


def test_a_variable_with_another_axis_is_named(tmp_path):
    path = tmp_path / "grid.nc"
    with netCDF4.Dataset(path, "w") as file:
        for name, nodes in (("time", [0.0, 1.0]), ("lat", LATITUDES), ("lon", LONGITUDES)):
            file.createDimension(name, len(nodes))
            file.createVariable(name, "f8", (name,))[:] = nodes
        file.createVariable("z", "f8", ("time", "lat", "lon"))[:] = np.stack([VALUES, VALUES])
    with pytest.raises(MapError, match=r"found z on time \(2\), lat \(20\), lon \(30\)"):
        read_grid(path, "anomaly")


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
    ("long_name", "said"),
    [
        ("geoid undulation", "a geoid"),
        ("free-air anomaly", "a free-air anomaly"),
        ("slope", "a slope"),
        ("hillshade", "a slope"),
        ("canopy height above ground", "a slope"),
        ("height error", "an error"),
    ],
)
def test_a_grid_of_another_quantity_is_no_terrain(long_name, said, tmp_path):
    with pytest.raises(TerrainError, match=said):
        read_terrain(grid(tmp_path, values=100.0 + VALUES, long_name=long_name))


@pytest.mark.parametrize(
    "long_name", ["", "Elevation relative to sea level", "height above EGM96 geoid", "topography"]
)
def test_a_terrain_may_state_its_zero_level(long_name, tmp_path):
    terrain = read_terrain(grid(tmp_path, values=100.0 + VALUES, long_name=long_name))
    assert terrain.height_m.min() > 79.0


def test_a_terrain_in_feet_may_say_so_as_unit(tmp_path):
    terrain = read_terrain(grid(tmp_path, values=100.0 + VALUES, unit="ft"))
    assert terrain.height_m.max() < 37.0


def test_a_tile_of_swapped_bytes_is_refused(tmp_path):
    rows, columns = np.mgrid[:1201, :1201]
    heights = (500.0 + 0.5 * rows + 200.0 * np.sin(columns / 40.0)).astype(int)
    path = tmp_path / "N46E008.hgt"
    heights.astype(">i2").tofile(path)
    assert 300.0 <= read_terrain(path).height_m.min() < 400.0
    heights.astype("<i2").tofile(path)
    with pytest.raises(TerrainError, match="wrong order, little-endian"):
        read_terrain(path)
