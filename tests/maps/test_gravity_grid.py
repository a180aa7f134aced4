"""Nodes, gaps and units of grids of a user's own, and heights of the land under them."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
import rasterio
import rasterio.shutil
import xarray
from gravity_grids import (
    FUNCTIONALS,
    VALUES,
    described,
    write_gap,
    write_gaps,
    write_icgem,
    write_isg,
    write_marked,
    write_raster,
)
from grids import write_grid

from ggbench.gravity.meridians import Area
from ggbench.gravity.remove_restore import GravityGrid
from ggbench.gravity.terrain import Terrain
from ggbench.maps.gravity_grid import elevation_at, read_grid


@pytest.mark.parametrize(
    ("west", "expected"), [(179.0, 179.0), (180.0, -180.0), (275.0, -85.0), (-85.0, -85.0)]
)
def test_longitudes_from_180_on_are_western(west, expected, tmp_path):
    """Grids say 275° or −85° E; maps and flights say −85°. One across 180° stays in one piece."""
    path = tmp_path / "grid.nc"
    write_grid(path, "geoid", "", np.ones((20, 25)), south=30.0, west=west, step=0.1)
    grid = read_grid(path, "geoid")
    assert grid.west_deg == pytest.approx(expected)
    assert grid.longitude_deg[-1] == pytest.approx(expected + 2.4)
    assert grid.south_deg == 30.0


def test_zeros_are_gravity_where_another_value_marks_a_gap(tmp_path):
    path = tmp_path / "grid.gdf"
    write_gap(path, "9999999.0")
    assert read_grid(path, "disturbance").values.min() == 0.0


@pytest.mark.parametrize(("kind", "unit"), [("geoid", 1.0), ("anomaly", 1e-5)])
def test_a_raster_is_in_metres_or_milligal(kind, unit, tmp_path):
    path = tmp_path / "grid.asc"
    head = ["ncols 20", "nrows 20", "xllcorner 5.0", "yllcorner 40.0", "cellsize 0.1"]
    path.write_text("\n".join([*head, *[" ".join(["12.0"] * 20)] * 20, ""]))
    grid = read_grid(path, kind)
    np.testing.assert_allclose(grid.values, 12.0 * unit)
    assert (grid.south_deg, grid.west_deg) == pytest.approx((40.05, 5.05))


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("mGal", 1e-5),
        ("MGAL", 1e-5),
        ("µGal", 1e-8),
        ("\u03bcGal", 1e-8),
        ("uGal", 1e-8),
        ("Gal", 1e-2),
        ("m/s²", 1.0),
        ("m/s^2", 1.0),
        ("m s-2", 1.0),
    ],
)
def test_the_unit_of_gravity_is_the_one_of_the_file(unit, factor, tmp_path):
    """In rasters and netCDF alike, without a remark that something was assumed."""
    written = VALUES * 1e-5 / factor
    write_grid(tmp_path / "a.nc", "g", unit, written, south=45.0, west=7.0, step=0.1)
    for path in (write_raster(tmp_path / "a.tif", written, unit), tmp_path / "a.nc"):
        grid = read_grid(path, "anomaly")
        np.testing.assert_allclose(grid.values, 1e-5 * VALUES, rtol=1e-6)
        assert (grid.south_deg, grid.west_deg) == pytest.approx((45.0, 7.0))
        assert not any("assumed" in remark for remark in grid.remarks)


def test_gravity_without_a_unit_is_said_to_be_milligal(tmp_path):
    write_grid(tmp_path / "a.nc", "g", "", VALUES, south=45.0, west=7.0, step=0.1)
    for path in (write_raster(tmp_path / "a.tif", VALUES), tmp_path / "a.nc"):
        grid = read_grid(path, "anomaly")
        np.testing.assert_allclose(grid.values, 1e-5 * VALUES)
        assert grid.remarks == (f"{path.name}: no unit given, mGal assumed",)
        assert read_grid(path, "geoid").remarks == ()


def test_9999_microgal_are_gravity(tmp_path):
    write_marked(tmp_path / "a.nc", 9999.0, "µGal")
    assert read_grid(tmp_path / "a.nc", "anomaly").values[3, 4] == pytest.approx(9.999e-5)


def write_byn(path):
    """Canada's format: a header of 80 bytes, bounds in seconds, then integers from the north."""
    south, north, west, east, step = (round(3600 * x) for x in (45.0, 46.9, 7.0, 9.3, 0.1))
    head = struct.pack(
        "<4i4hd8h2d2hfh6x",
        *(south, north, west, east, step, step),
        *(0, 1, 1000.0, 4, 0, 0, 0, 0, 1, 0, 0, 0.0, 0.0, 0, 0, 0.0, 0),
    )
    path.write_bytes(head + np.rint(1000 * VALUES[::-1]).astype(">i4").tobytes())


@pytest.mark.parametrize(
    ("driver", "name"),
    [("GTX", "a.gtx"), ("GSAG", "a.grd"), ("GSBG", "a.grd"), ("GS7BG", "a.grd"), ("BYN", "a.byn")],
)
def test_grids_of_other_programs(driver, name, tmp_path):
    """Each is a geoid or gravity."""
    if driver == "BYN":
        write_byn(tmp_path / name)
    else:
        write_raster(tmp_path / "a.tif", VALUES.astype(np.float32))
        rasterio.shutil.copy(tmp_path / "a.tif", tmp_path / name, driver=driver)
    for kind, unit in (("geoid", 1.0), ("anomaly", 1e-5)):
        grid = read_grid(tmp_path / name, kind)
        np.testing.assert_allclose(grid.values, VALUES * unit, rtol=1e-5, atol=1e-12)
        assert (grid.south_deg, grid.west_deg) == pytest.approx((45.0, 7.0))


def test_a_geoid_of_the_international_service(tmp_path):
    write_isg(tmp_path / "a.isg")
    grid = read_grid(tmp_path / "a.isg", "geoid")
    np.testing.assert_allclose(grid.values, VALUES)
    assert (grid.south_deg, grid.west_deg) == pytest.approx((45.0, 7.0))


@pytest.mark.parametrize("functional", FUNCTIONALS)
def test_a_header_of_icgem_states_the_functional(functional, tmp_path):
    """Height anomalies need no correction."""
    kind = FUNCTIONALS[functional]
    path = write_icgem(tmp_path / "a.gdf", functional, "meter" if kind == "geoid" else "mgal")
    grid = read_grid(path, kind)
    assert grid.remarks == ()
    assert grid.is_height_anomaly == functional.startswith("height_anomaly")


@pytest.mark.parametrize("kind", ["geoid", "anomaly", "disturbance"])
def test_a_header_of_icgem_without_a_functional_is_remarked_on(kind, tmp_path):
    silent = write_icgem(tmp_path / "c.gdf", "", "m" if kind == "geoid" else "mgal")
    assert read_grid(silent, kind).remarks == (f"c.gdf states no functional; --{kind} is assumed",)


@pytest.mark.parametrize(
    ("text", "factor"),
    [("faa (mGal)", 1e-5), ("free-air gravity (EGM2008) [µGal]", 1e-8), ("Free air (m/s^2)", 1.0)],
)
def test_a_unit_in_the_description_is_the_unit(text, factor, tmp_path):
    for path in described(tmp_path, text, 1e-5 * VALUES / factor):
        grid = read_grid(path, "anomaly")
        np.testing.assert_allclose(grid.values, 1e-5 * VALUES, rtol=1e-6)
        assert not any("assumed" in remark for remark in grid.remarks)


def test_brackets_without_a_unit_are_passed_over(tmp_path):
    for path in described(tmp_path, "Gravity disturbance (EGM2008)"):
        (remark,) = read_grid(path, "disturbance").remarks
        assert "mGal assumed" in remark


def test_a_description_counts_more_than_the_name_of_a_file(tmp_path):
    described(tmp_path, "gravity disturbance")
    (tmp_path / "a.tif").rename(tmp_path / "bouguer_area.tif")
    assert read_grid(tmp_path / "bouguer_area.tif", "disturbance").height_m == 0.0


STEP = 0.01
"""Of the terrain [deg]; the grid's is ten times that."""


def under_a_grid(heights: np.ndarray) -> np.ndarray:
    """Elevations at 11 by 11 nodes within a terrain of 201 by 201, the tenth of each axis first."""
    terrain = Terrain(40.0, 5.0, STEP, STEP, heights, "made up")
    grid = GravityGrid("geoid", 40.5, 5.5, 10 * STEP, 10 * STEP, np.zeros((11, 11)))
    return elevation_at(grid, terrain)


def test_a_finer_terrain_is_averaged_over_half_a_step_of_the_grid():
    """A single high cell is spread as a Gaussian of five cells: 1/(2π 25) of it, e⁻² a step off."""
    heights = np.zeros((201, 201))
    heights[100, 100] = 8e3
    found = under_a_grid(heights)
    top = 8e3 / (2.0 * math.pi * 5.0**2)
    assert found[5, 5] == pytest.approx(top, rel=1e-3)
    assert found[5, 6] == pytest.approx(top * math.exp(-2.0), rel=1e-2)
    assert found[4, 5] == pytest.approx(top * math.exp(-2.0), rel=1e-2)


def test_the_sea_has_no_height_and_a_slope_stays_one():
    rows = np.arange(201)[:, np.newaxis] * np.ones((1, 201))
    np.testing.assert_allclose(under_a_grid(10.0 * rows)[:, 3], 500.0 + 100.0 * np.arange(11))
    np.testing.assert_array_equal(under_a_grid(-10.0 - rows), 0.0)
    coast = under_a_grid(10.0 * (rows - 100.0))
    assert coast.min() >= 0.0 and coast[0, 0] == pytest.approx(0.0, abs=1e-3)


def test_a_terrain_as_coarse_as_the_grid_is_taken_between_its_nodes():
    terrain = Terrain(40.0, 5.0, 0.1, 0.1, np.add.outer(np.arange(21.0), np.zeros(21)), "coarse")
    grid = GravityGrid("geoid", 40.55, 5.5, 0.1, 0.1, np.zeros((5, 5)))
    np.testing.assert_allclose(elevation_at(grid, terrain)[:, 0], 5.5 + np.arange(5.0))


def wave(longitude: np.ndarray, rows: int = 40) -> np.ndarray:
    """Values that know their meridian."""
    return np.tile(10.0 * np.sin(np.radians(longitude)), (rows, 1))


AREA = Area(31.0, 32.0, 179.0, -179.0)


def test_a_grid_may_cross_the_date_line(tmp_path):
    """Its longitudes may jump there, from 179.9 to -180."""
    longitude = 172.0 + 0.1 * np.arange(160)
    path = tmp_path / "grid.nc"
    values = {"g": (("lat", "lon"), wave(longitude), {"units": "m"})}
    axes = {"lat": 30.0 + 0.1 * np.arange(40), "lon": (longitude + 180.0) % 360.0 - 180.0}
    xarray.Dataset(values, axes).to_netcdf(path)
    grid = read_grid(path, "geoid", area=AREA)
    np.testing.assert_allclose(grid.longitude_deg, longitude)
    np.testing.assert_allclose(grid.values[0], wave(grid.longitude_deg)[0], atol=1e-9)


@pytest.mark.parametrize(("west", "area"), [(0.0, Area(31.0, 32.0, -1.0, 1.0)), (-180.0, AREA)])
def test_a_grid_around_the_earth_is_cut_opposite_to_the_map(west, area, tmp_path):
    longitude = west + 0.5 * np.arange(720)
    path = tmp_path / "grid.nc"
    write_grid(path, "g", "m", wave(longitude), south=30.0, west=west, step=0.5)
    grid = read_grid(path, "geoid", area=area)
    here = area.about(float(grid.longitude_deg.mean()))
    assert grid.longitude_deg[0] + 170.0 < here.west < here.east < grid.longitude_deg[-1] - 170.0
    np.testing.assert_allclose(grid.values[0], wave(grid.longitude_deg)[0], atol=1e-9)
    untouched = read_grid(path, "geoid", area=Area(31.0, 32.0, west + 90.0, west + 91.0))
    assert untouched.west_deg == west


def test_gaps_count_only_where_values_are_needed(tmp_path):
    """The grid is cut to what is needed."""
    path = tmp_path / "grid.nc"
    values = write_gaps(path)
    grid = read_grid(path, "geoid", area=Area(31.05, 33.0, 365.55, 368.0))
    assert (grid.south_deg, grid.west_deg) == pytest.approx((31.0, 5.5))
    np.testing.assert_array_equal(grid.values, values[10:31, 5:31])
