"""Grids of a user's own: where their nodes are, what is a gap, how high the land is under them."""

from __future__ import annotations

import math
import struct

import netCDF4
import numpy as np
import pytest
import rasterio
import rasterio.shutil
import xarray
from grids import write_grid
from rasterio.transform import from_origin

from ggbench.gravity.gradient_map import MapError
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


def test_the_value_that_marks_a_gap_is_none(tmp_path):
    """ICGEM's files name it in their header; whatever it is, it is no gravity."""
    for gap, good in (("0.0", False), ("9999999.0", True)):
        head = ["latitude_parallels 16", "longitude_parallels 16", "unit mgal", f"gapvalue {gap}"]
        rows = [
            f"{100 + 0.1 * j:.1f} {20 - 0.1 * i:.1f} {0.0 if i == j == 3 else 5.0}"
            for i in range(16)
            for j in range(16)
        ]
        path = tmp_path / "grid.gdf"
        path.write_text("\n".join([*head, "longitude latitude gravity", "end_of_head ==", *rows]))
        if good:
            assert read_grid(path, "disturbance").values.min() == 0.0
        else:
            with pytest.raises(MapError, match="has gaps"):
                read_grid(path, "disturbance")


def test_nodes_must_be_regular(tmp_path):
    """A node a tenth of a step off its place is no grid."""
    path = tmp_path / "grid.nc"
    write_grid(path, "geoid", "", np.ones((20, 20)), south=30.0, west=5.0, step=0.1)
    read_grid(path, "geoid")
    with netCDF4.Dataset(path, "a") as file:
        file.variables["lon"][7] += 0.01
    with pytest.raises(MapError, match="longitude must be regular"):
        read_grid(path, "geoid")


@pytest.mark.parametrize(("kind", "unit"), [("geoid", 1.0), ("anomaly", 1e-5)])
def test_a_raster_is_in_metres_or_milligal(kind, unit, tmp_path):
    path = tmp_path / "grid.asc"
    head = ["ncols 20", "nrows 20", "xllcorner 5.0", "yllcorner 40.0", "cellsize 0.1"]
    path.write_text("\n".join([*head, *[" ".join(["12.0"] * 20)] * 20, ""]))
    grid = read_grid(path, kind)
    np.testing.assert_allclose(grid.values, 12.0 * unit)
    assert (grid.south_deg, grid.west_deg) == pytest.approx((40.05, 5.05))


def write_raster(path, values, unit=""):
    """A GeoTIFF of 20 by 24 nodes, from 45° N and 7° E on."""
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        count=1,
        dtype=values.dtype,
        crs="EPSG:4326",
        height=20,
        width=24,
        transform=from_origin(6.95, 46.95, 0.1, 0.1),
    ) as dataset:
        dataset.write(values[::-1], 1)
        if unit:
            dataset.units = [unit]
    return path


VALUES = np.add.outer(np.arange(20.0), 0.1 * np.arange(24.0))


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


@pytest.mark.parametrize("unit", ["ft", "m", "mm", "E"])
def test_what_is_no_unit_of_gravity_is_refused_by_name(unit, tmp_path):
    write_grid(tmp_path / "a.nc", "g", unit, VALUES, south=45.0, west=7.0, step=0.1)
    for path in (write_raster(tmp_path / "a.tif", VALUES, unit), tmp_path / "a.nc"):
        with pytest.raises(MapError, match=f"gravity in '{unit}'; mGal, µGal, Gal or m/s² are"):
            read_grid(path, "disturbance")


def test_gravity_without_a_unit_is_said_to_be_milligal(tmp_path):
    write_grid(tmp_path / "a.nc", "g", "", VALUES, south=45.0, west=7.0, step=0.1)
    for path in (write_raster(tmp_path / "a.tif", VALUES), tmp_path / "a.nc"):
        grid = read_grid(path, "anomaly")
        np.testing.assert_allclose(grid.values, 1e-5 * VALUES)
        assert grid.remarks == (f"{path.name}: no unit given, mGal assumed",)
        assert read_grid(path, "geoid").remarks == ()


def test_undeclared_marks_of_gaps_are_gaps(tmp_path):
    """And 9999 µGal is gravity, of 10 mGal."""
    for mark, unit, gap in ((9999.0, "mGal", True), (9999.0, "µGal", False), (3e38, "µGal", True)):
        values = VALUES.copy()
        values[3, 4] = mark
        write_grid(tmp_path / "a.nc", "g", unit, values, south=45.0, west=7.0, step=0.1)
        if gap:
            with pytest.raises(MapError, match="has gaps: 1 nodes"):
                read_grid(tmp_path / "a.nc", "anomaly")
        else:
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
    """ISG 1.0: a header of words, then rows from north to south."""
    head = [
        "begin_of_head",
        "model name : made",
        "model type : gravimetric",
        "units : meters",
        "reference : WGS84",
        "lat min = 44.95",
        "lat max = 46.95",
        "lon min = 6.95",
        "lon max = 9.35",
        "delta lat = 0.10",
        "delta lon = 0.10",
        "nrows = 20",
        "ncols = 24",
        "nodata = -9999.0000",
        "ISG format = 1.0",
        "end_of_head",
    ]
    rows = [" ".join(f"{value:.4f}" for value in row) for row in VALUES[::-1]]
    (tmp_path / "a.isg").write_text("\n".join([*head, *rows, ""]))
    grid = read_grid(tmp_path / "a.isg", "geoid")
    np.testing.assert_allclose(grid.values, VALUES)
    assert (grid.south_deg, grid.west_deg) == pytest.approx((45.0, 7.0))
    with pytest.raises(MapError, match="has gravity in 'meters'; mGal"):
        read_grid(tmp_path / "a.isg", "anomaly")


def test_what_is_no_grid_at_all_is_refused(tmp_path):
    (tmp_path / "a.docx").write_bytes(b"not a grid")
    with pytest.raises(MapError, match=r"a.docx cannot be read as a raster"):
        read_grid(tmp_path / "a.docx", "geoid")


def test_grids_that_must_be_converted_first_are_named(tmp_path):
    """Geosoft's, and those of GMT 3, which are a single row of values."""
    (tmp_path / "a.grd").write_bytes(struct.pack("<5i", 4, 1, 24, 20, 1) + bytes(2412))
    with pytest.raises(MapError, match=r"is a Geosoft grid, .* as GeoTIFF or as a Surfer grid"):
        read_grid(tmp_path / "a.grd", "anomaly")
    data = {"x_range": ("side", [7.0, 9.3]), "y_range": ("side", [45.0, 46.9])}
    data |= {"dimension": ("side", [24, 20]), "z": ("xysize", VALUES.ravel())}
    xarray.Dataset(data).to_netcdf(tmp_path / "b.grd", engine="scipy")
    with pytest.raises(MapError, match=r"in the format of GMT 3, without coordinates; convert it"):
        read_grid(tmp_path / "b.grd", "anomaly")


def write_icgem(path, functional, unit):
    """A file of ICGEM's calculation service, of a constant 5."""
    head = ["latitude_parallels 16", "longitude_parallels 16", f"unit {unit}"]
    head += [f"functional {functional}"] if functional else []
    rows = [f"{100 + 0.1 * j:.1f} {20 - 0.1 * i:.1f} 5.0" for i in range(16) for j in range(16)]
    path.write_text("\n".join([*head, "end_of_head ==", *rows]))
    return path


KINDS = {
    "geoid": "geoid",
    "height_anomaly": "geoid",
    "height_anomaly_ell": "geoid",
    "gravity_anomaly": "anomaly",
    "gravity_anomaly_cl": "anomaly",
    "gravity_anomaly_sa": "anomaly",
    "gravity_disturbance": "disturbance",
    "gravity_disturbance_sa": "disturbance",
}


@pytest.mark.parametrize("functional", KINDS)
@pytest.mark.parametrize("kind", ["geoid", "anomaly", "disturbance"])
def test_a_header_of_icgem_contradicts_the_option(functional, kind, tmp_path):
    """A disturbance is no anomaly, whatever the user says; height anomalies need no correction."""
    right = KINDS[functional]
    path = write_icgem(tmp_path / "a.gdf", functional, "meter" if right == "geoid" else "mgal")
    if kind == right:
        grid = read_grid(path, kind)
        assert grid.remarks == ()
        assert grid.is_height_anomaly == functional.startswith("height_anomaly")
    else:
        message = f"its functional is {functional}, not a {kind}: give the file as --{right}"
        with pytest.raises(MapError, match=message):
            read_grid(path, kind)


@pytest.mark.parametrize("kind", ["geoid", "anomaly", "disturbance"])
def test_other_functionals_of_icgem_are_refused_by_name(kind, tmp_path):
    """Bouguer anomalies above all, and topography, which has the unit of a geoid."""
    bouguer = write_icgem(tmp_path / "a.gdf", "gravity_anomaly_bg", "mgal")
    with pytest.raises(MapError, match=r"its functional gravity_anomaly_bg \(Bouguer anomalies"):
        read_grid(bouguer, kind)
    with pytest.raises(MapError, match=r"its functional topography_grd; allowed"):
        read_grid(write_icgem(tmp_path / "b.gdf", "topography_grd", "meter"), kind)
    silent = write_icgem(tmp_path / "c.gdf", "", "m" if kind == "geoid" else "mgal")
    assert read_grid(silent, kind).remarks == (f"c.gdf names no functional: read as --{kind}",)


def test_bouguer_anomalies_in_netcdf_are_refused(tmp_path):
    write_grid(tmp_path / "a.nc", "bouguer_anomaly", "mGal", VALUES, south=45.0, west=7.0, step=0.1)
    with pytest.raises(
        MapError, match=r"holds 'bouguer_anomaly': that is a Bouguer.*; only free-air anomalies"
    ):
        read_grid(tmp_path / "a.nc", "anomaly")


OTHER_QUANTITIES = {
    "vgg (Eotvos)": "that is a gravity gradient",
    "EMAG2 (nT)": "gravity in 'nT'",
    "total magnetic intensity": "that is a magnetic field",
    "gravity (s^-2)": "gravity in 's\\^-2'",
    "Complete Bouguer anomaly [mGal]": "Bouguer or isostatic",
    "isostatic residual (mGal)": "Bouguer or isostatic",
    "CBA_267": "Bouguer or isostatic",
    "geoid (m)": "that is a geoid",
    "observed gravity": "that is observed gravity",
}
"""Descriptions of grids that are no gravity that a map can be made of."""


def described(folder, text, values=VALUES):
    """The same grid as GMT's netCDF, its unit in the description alone, and as a raster."""
    write_grid(folder / "a.nc", "z", "", values, south=45.0, west=7.0, step=0.1)
    with netCDF4.Dataset(folder / "a.nc", "a") as file:
        file["z"].long_name = text
    raster = write_raster(folder / "a.tif", values)
    with rasterio.open(raster, "r+") as dataset:
        dataset.set_band_description(1, text)
    return folder / "a.nc", raster


@pytest.mark.parametrize("text", OTHER_QUANTITIES)
def test_another_quantity_in_the_description_is_refused(text, tmp_path):
    for path in described(tmp_path, text):
        for kind in ("anomaly", "disturbance"):
            with pytest.raises(MapError, match=OTHER_QUANTITIES[text]):
                read_grid(path, kind)


@pytest.mark.parametrize(
    ("text", "factor"),
    [("faa (mGal)", 1e-5), ("free-air gravity (EGM2008) [µGal]", 1e-8), ("Free air (m/s^2)", 1.0)],
)
def test_a_unit_in_the_description_is_the_unit(text, factor, tmp_path):
    for path in described(tmp_path, text, 1e-5 * VALUES / factor):
        grid = read_grid(path, "anomaly")
        np.testing.assert_allclose(grid.values, 1e-5 * VALUES, rtol=1e-6)
        assert not any("assumed" in remark for remark in grid.remarks)
        with pytest.raises(MapError, match=r"anomalies differ from disturbances by 0\.3 mGal"):
            read_grid(path, "disturbance")


def test_a_disturbance_is_no_anomaly_and_brackets_without_a_unit_are_passed_over(tmp_path):
    for path in described(tmp_path, "Gravity disturbance (EGM2008)"):
        with pytest.raises(MapError, match="give it as a disturbance"):
            read_grid(path, "anomaly")
        (remark,) = read_grid(path, "disturbance").remarks
        assert "mGal assumed" in remark


def test_the_name_of_a_file_counts_where_no_description_names_a_quantity(tmp_path):
    for name in ("bouguer_victoria.tif", "vgg.tif"):
        with pytest.raises(MapError, match="holds '"):
            read_grid(write_raster(tmp_path / name, VALUES, "mGal"), "disturbance")
    described(tmp_path, "gravity disturbance")
    (tmp_path / "a.tif").rename(tmp_path / "bouguer_area.tif")
    assert read_grid(tmp_path / "bouguer_area.tif", "disturbance").height_m == 0.0


def test_a_grid_of_ggxf_is_named(tmp_path):
    """As NGS publishes GEOID2022: values in a group, and no coordinates."""
    with netCDF4.Dataset(tmp_path / "geoid.ggxf", "w") as file:
        file.ggxfVersion = "GGXF-1.0"
        group = file.createGroup("SGEOID2022")
        group.createDimension("gridi", 20)
        group.createVariable("geoidHeight", "f4", ("gridi",))[:] = 1.0
    with pytest.raises(MapError, match="is a GGXF file"):
        read_grid(tmp_path / "geoid.ggxf", "geoid")


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
    """The grid is cut to what is needed; a gap in that has a place."""
    path = tmp_path / "grid.nc"
    values = np.arange(1600.0).reshape(40, 40) / 100.0
    values[:5] = np.nan
    write_grid(path, "g", "m", values, south=30.0, west=5.0, step=0.1)
    with pytest.raises(MapError, match=r"200 nodes without a value .* the first at 30° N, 5° E"):
        read_grid(path, "geoid")
    grid = read_grid(path, "geoid", area=Area(31.05, 33.0, 365.55, 368.0))
    assert (grid.south_deg, grid.west_deg) == pytest.approx((31.0, 5.5))
    np.testing.assert_array_equal(grid.values, values[10:31, 5:31])
    with pytest.raises(MapError, match=r"the first at 30.2° N, 5.5° E; fill them"):
        read_grid(path, "geoid", area=Area(30.25, 33.0, 5.5, 8.0))
