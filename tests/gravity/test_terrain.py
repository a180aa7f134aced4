"""Terrain from the formats in which elevation models come."""

import math

import numpy as np
import pytest
import rasterio
import xarray
from rasterio.transform import Affine, from_origin
from rasterio.warp import transform
from terrain_planes import (
    HEIGHTS,
    LATITUDES,
    LONGITUDES,
    N_LAT,
    N_LON,
    SOUTH,
    SOUTH_EAST,
    STEP,
    WEST,
    grid,
    plane,
    write_projected_voids,
    write_raster,
    write_voids,
)

from ggbench.gravity import optional_modules
from ggbench.gravity.meridians import Area
from ggbench.gravity.terrain import Terrain, TerrainError
from ggbench.gravity.terrain_files import read_terrain
from ggbench.maps.package_data import data_bytes


def assert_is_the_plane(terrain, tolerance=1e-6):
    heights = plane(terrain.latitudes_deg[:, np.newaxis], terrain.longitudes_deg)
    np.testing.assert_allclose(terrain.height_m, heights, atol=tolerance)


def assert_is_the_grid(terrain):
    assert terrain.height_m.shape == (N_LAT, N_LON)
    np.testing.assert_allclose(terrain.latitudes_deg, LATITUDES, atol=1e-7)
    np.testing.assert_allclose(terrain.longitudes_deg, LONGITUDES, atol=1e-7)
    assert_is_the_plane(terrain, 1e-3)


@pytest.mark.parametrize("kind", ["Area", "Point"])
def test_geotiff_of_cells_or_of_points(tmp_path, kind):
    # rasterio's transform is that of corners in both; the file itself then stores another one.
    path = write_raster(tmp_path / "alps.tif", tags={"AREA_OR_POINT": kind})
    with rasterio.open(path) as dataset:
        assert dataset.tags()["AREA_OR_POINT"] == kind
    assert_is_the_grid(read_terrain(path))


def test_geotiff_from_south_to_north(tmp_path):
    south_up = Affine(STEP, 0.0, WEST - STEP / 2, 0.0, STEP, SOUTH - STEP / 2)
    assert_is_the_grid(read_terrain(write_raster(tmp_path / "a.tif", HEIGHTS, transform=south_up)))


def test_srtm_tile(tmp_path):
    # 1201 x 1201 big-endian integers from the north-west; nodes lie on the degrees.
    rows, columns = np.indices((1201, 1201))
    tile = (rows - columns).astype(">i2")
    path = tmp_path / "N36W085.hgt"
    path.write_bytes(tile.tobytes())
    terrain = read_terrain(path)
    assert terrain.height_m.shape == (1201, 1201)
    assert terrain.latitudes_deg[[0, -1]] == pytest.approx([36.0, 37.0])
    assert terrain.longitudes_deg[[0, -1]] == pytest.approx([-85.0, -84.0])
    np.testing.assert_array_equal(terrain.height_m, (rows - columns)[::-1])


@pytest.mark.parametrize("reference", ["corner", "center"])
def test_ascii_grid(tmp_path, reference):
    shift = STEP / 2 if reference == "corner" else 0.0
    path = tmp_path / "alps.asc"
    rows = "\n".join(" ".join(f"{height:.6f}" for height in row) for row in HEIGHTS[::-1])
    path.write_text(
        f"ncols {N_LON}\nnrows {N_LAT}\nxll{reference} {WEST - shift}\n"
        f"yll{reference} {SOUTH - shift}\ncellsize {STEP}\nNODATA_value -9999\n{rows}\n"
    )
    assert_is_the_grid(read_terrain(path))


@pytest.mark.parametrize("crs", ["EPSG:32632", "EPSG:3035"])
def test_projected_raster_is_resampled(tmp_path, crs):
    # UTM, and an equal-area projection whose grid is turned by 2 degrees here.
    (east,), (north,) = transform("EPSG:4326", crs, [WEST], [SOUTH])
    spacing, count = 100.0, 200
    x = east + spacing * (np.arange(count) + 0.5)
    y = north + spacing * (np.arange(count) + 0.5)
    grid_x, grid_y = np.meshgrid(x, y)
    longitude, latitude = transform(crs, "EPSG:4326", grid_x.ravel(), grid_y.ravel())
    heights = plane(np.array(latitude), np.array(longitude)).reshape(count, count)[::-1]
    corner = from_origin(east, north + spacing * count, spacing, spacing)
    path = write_raster(tmp_path / "utm.tif", heights, crs=crs, transform=corner)
    terrain = read_terrain(path)
    assert "resampled to latitude and longitude" in terrain.name
    assert min(terrain.height_m.shape) > 120
    # Half a cell in the wrong place would be a metre. The spline bends only at the borders.
    assert_is_the_plane(terrain, 0.5)
    lat, lon = terrain.latitudes_deg[4:-4], terrain.longitudes_deg[4:-4]
    np.testing.assert_allclose(
        terrain.height_m[4:-4, 4:-4], plane(lat[:, np.newaxis], lon), atol=0.01
    )


@pytest.mark.parametrize("engine", ["scipy", "netcdf4"])
@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize(
    ("suffix", "variable", "names"),
    [
        ("nc", "elevation", ("lat", "lon")),
        ("grd", "z", ("y", "x")),
        ("nc", "Band1", ("lat", "lon")),
    ],
)
def test_netcdf_grid(tmp_path, engine, order, suffix, variable, names):
    path = tmp_path / f"alps.{suffix}"
    data = grid(LATITUDES[::order], LONGITUDES, names)
    xarray.Dataset({variable: data, "crs": 4326}).to_netcdf(path, engine=engine)
    assert_is_the_grid(read_terrain(path))


def test_netcdf_with_longitude_first_and_up_to_360(tmp_path):
    west = LONGITUDES - 7.05
    data = grid(LATITUDES, west % 360.0).transpose("lon", "lat")
    data.to_dataset(name="z").to_netcdf(tmp_path / "a.nc", engine="scipy")
    terrain = read_terrain(tmp_path / "a.nc")
    assert terrain.longitudes_deg == pytest.approx(west)
    assert_is_the_plane(terrain)


def test_grid_across_the_date_line(tmp_path):
    longitude = np.array([179.8, 179.9, -180.0, -179.9, -179.8])
    np.savez(tmp_path / "a.npz", lat=LATITUDES, lon=longitude, z=np.zeros((N_LAT, 5)))
    terrain = read_terrain(tmp_path / "a.npz")
    assert terrain.west_deg == pytest.approx(179.8)
    assert terrain.longitude_step_deg == pytest.approx(0.1)


def test_heights_in_feet_become_metres(tmp_path):
    feet = grid() / 0.3048
    feet.attrs["units"] = "feet"
    feet.to_dataset(name="z").to_netcdf(tmp_path / "feet.nc", engine="scipy")
    path = write_raster(tmp_path / "feet.tif", HEIGHTS[::-1] / 0.3048, units=["ft"])
    for terrain in (read_terrain(tmp_path / "feet.nc"), read_terrain(path)):
        assert_is_the_grid(terrain)
        assert "converted from f" in terrain.name


def test_scaled_integers(tmp_path):
    path = write_raster(tmp_path / "a.tif", HEIGHTS[::-1] / 0.1, dtype="int32", scales=[0.1])
    np.testing.assert_allclose(read_terrain(path).height_m, HEIGHTS, atol=0.11)


@pytest.mark.parametrize("mark", [-32768.0, -9999.0, math.nan])
@pytest.mark.parametrize("declared", [True, False])
def test_few_voids_are_filled_and_named(tmp_path, mark, declared):
    heights = HEIGHTS[::-1].copy()
    heights[4, 7] = mark  # in the interior: a plane is restored exactly
    nodata = {"nodata": mark} if declared else {}
    terrain = read_terrain(write_raster(tmp_path / "a.tif", heights, **nodata))
    assert_is_the_grid(terrain)
    assert "1 voids filled, the first at 45.07000, 7.07000" in terrain.name


def test_a_void_at_the_border_is_filled(tmp_path):
    heights = HEIGHTS[::-1].copy()
    heights[0, 0] = math.nan
    terrain = read_terrain(write_raster(tmp_path / "a.tif", heights))
    assert terrain.height_m[-1, 0] == pytest.approx(HEIGHTS[-1, 0], abs=30.0)


def test_voids_outside_of_the_area_needed_do_not_count(tmp_path):
    """A quarter of the terrain is a void; the rest is as it is without one."""
    path = write_voids(tmp_path / "a.tif", [np.s_[:6, :8]])
    terrain = read_terrain(path, SOUTH_EAST)
    assert "48 voids filled, the first at" in terrain.name
    assert "48 of them outside of the area needed" in terrain.name
    np.testing.assert_allclose(terrain.height_m[:6], HEIGHTS[:6])
    np.testing.assert_allclose(terrain.height_m[:, 8:], HEIGHTS[:, 8:])


def test_voids_of_a_projected_raster_count_where_they_are_needed(tmp_path):
    """The corner that a warped raster leaves empty."""
    path = write_projected_voids(tmp_path / "utm.tif")
    terrain = read_terrain(path, Area(45.11, 45.13, 9.03, 9.06))
    np.testing.assert_allclose(terrain.height_m, 500.0)


def test_a_terrain_may_cross_the_date_line_and_go_around_the_earth(tmp_path):
    """What lies at 179° and at -179° is found beside each other, wherever the grid is cut."""
    east = 179.5 + 0.1 * np.arange(11)
    columns = (east + 180.0) % 360.0 - 180.0
    np.savez(tmp_path / "a.npz", lat=LATITUDES, lon=columns, z=np.tile(east, (N_LAT, 1)))
    terrain = read_terrain(tmp_path / "a.npz")
    np.testing.assert_allclose(terrain.longitudes_deg, east)
    np.testing.assert_allclose(terrain.height_m[0], east)
    around = np.arange(-180.0, 180.0, 0.5)
    np.savez(tmp_path / "b.npz", lat=LATITUDES, lon=around, z=np.tile(around, (N_LAT, 1)))
    terrain = read_terrain(tmp_path / "b.npz", Area(45.0, 45.1, 179.0, -179.0))
    part = terrain.crop(45.0, 45.1, 179.0, 181.0)
    np.testing.assert_allclose(part.longitudes_deg % 360.0, [179.0, 179.5, 180.0, 180.5, 181.0])
    np.testing.assert_allclose(part.height_m[0], [179.0, 179.5, -180.0, -179.5, -179.0])
    assert read_terrain(tmp_path / "b.npz", Area(45.0, 45.1, 10.0, 20.0)).west_deg == -180.0


def test_jacksboro_lies_where_it_should(tmp_path):
    # Cross Mountain, 36°11'54"N 84°13'50"W, 1077 m, is the highest mountain of the region; the
    # full pool of Norris Lake is a plain at one height.
    (tmp_path / "a.npz").write_bytes(data_bytes("jacksboro_dem_3arcsec.npz"))
    terrain = read_terrain(tmp_path / "a.npz")
    row, column = np.unravel_index(terrain.height_m.argmax(), terrain.height_m.shape)
    assert terrain.latitudes_deg[row] == pytest.approx(36 + 11 / 60 + 54 / 3600, abs=1e-3)
    assert terrain.longitudes_deg[column] == pytest.approx(-84 - 13 / 60 - 50 / 3600, abs=1e-3)
    assert terrain.height_m.max() == pytest.approx(1077.0, abs=2.0)


def test_parallel_valleys_are_alike_but_for_a_hill(tmp_path):
    """The formula of the data's README; each valley is its neighbour, 3.15 km away."""
    (tmp_path / "a.npz").write_bytes(data_bytes("parallel_valleys_6arcsec.npz"))
    terrain = read_terrain(tmp_path / "a.npz")
    latitude = terrain.latitudes_deg[:, np.newaxis]
    north = (latitude - 45.135) * 111.1e3
    metres = 111.3e3 * np.cos(np.radians(45.135))
    depth = 250.0 + 60.0 * np.cos(2.0 * np.pi * north / 4300.0)
    depth = depth + 40.0 * np.cos(2.0 * np.pi * north / 2700.0 + 1.0)
    expected = np.full(terrain.height_m.shape, 800.0)
    for centre in 7.02 + 0.04 * np.arange(9):
        expected -= depth * np.exp(-(((terrain.longitudes_deg - centre) * metres / 600.0) ** 2))
    east = (terrain.longitudes_deg - 7.18) * metres - 900.0
    hill = 220.0 * np.exp(-(((north - 9000.0) / 800.0) ** 2) - (east / 800.0) ** 2)
    np.testing.assert_allclose(terrain.height_m, expected + hill, atol=0.51)
    away = np.abs(terrain.height_m[:, 24:] - terrain.height_m[:, :-24])
    assert away[: len(latitude) // 2].max() <= 1.0 < 100.0 < away.max()


def test_jacksboro_is_matplotlibs_sample(tmp_path):
    from matplotlib.cbook import get_sample_data

    (tmp_path / "a.npz").write_bytes(data_bytes("jacksboro_dem_3arcsec.npz"))
    ours = read_terrain(tmp_path / "a.npz")
    theirs = read_terrain(get_sample_data("jacksboro_fault_dem.npz", asfileobj=False))
    np.testing.assert_array_equal(ours.height_m, theirs.height_m)
    np.testing.assert_allclose(ours.latitudes_deg, theirs.latitudes_deg)
    np.testing.assert_allclose(ours.longitudes_deg, theirs.longitudes_deg)


def test_topography_of_a_scenario(tmp_path):
    path = tmp_path / "relief.npz"
    path.write_bytes(data_bytes("itu_p1511_5min_qinling.npz"))
    terrain = read_terrain(path)
    assert terrain.height_m.shape == (158, 182)
    assert (terrain.south_deg, terrain.west_deg) == pytest.approx((27 - 1 / 24, 101 - 1 / 24))
    # Xi'an lies at 400 m, mount Taibai in the south-west of it above 3000.
    at = {
        name: terrain.height_m[round((lat - 27.0) * 12 + 0.5), round((lon - 101.0) * 12 + 0.5)]
        for name, lat, lon in (("Xi'an", 34.3, 108.9), ("Taibai", 34.0, 107.8))
    }
    assert 350 < at["Xi'an"] < 500 < 2300 < at["Taibai"]


def test_crop_covers_its_bounds_as_far_as_the_terrain_reaches():
    whole = Terrain(SOUTH, WEST, STEP, STEP, HEIGHTS, "alps")
    part = whole.crop(45.031, 45.08, 367.04, 367.092)
    assert part.latitudes_deg[[0, -1]] == pytest.approx([45.03, 45.08])
    assert part.longitudes_deg[[0, -1]] == pytest.approx([7.04, 7.10])
    assert_is_the_plane(part)
    assert whole.crop(0.0, 90.0, -100.0, 100.0).height_m.shape == HEIGHTS.shape
    with pytest.raises(TerrainError, match=r"heights of shape \(0, 16\)"):
        whole.crop(60.0, 61.0, 6.0, 8.0)
    with pytest.raises(TerrainError, match="must each be in ascending order"):
        whole.crop(46.0, 45.0, 6.0, 8.0)


@pytest.mark.parametrize("name", ["a.tif", "a.nc"])
def test_a_missing_package_is_named(tmp_path, monkeypatch, name):
    def missing(module):
        raise ImportError(f"No module named {module!r}")

    (tmp_path / name).write_bytes(b"")
    monkeypatch.setattr(optional_modules.importlib, "import_module", missing)
    with pytest.raises(TerrainError, match=r"needs the package .*pip install 'ggbench\[terrain\]'"):
        read_terrain(tmp_path / name)
