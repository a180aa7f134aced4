"""Elevation models as people have them: depths, marks of voids, tiles, grids of other programs."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from sea_floors import HEIGHTS, write_netcdf, write_raster

from ggbench.gravity.gradient_map import MapError
from ggbench.gravity.terrain import TerrainError
from ggbench.gravity.terrain_files import read_terrain
from ggbench.maps.gravity_grid import read_grid


@pytest.mark.parametrize(
    ("name", "attributes"),
    [
        ("z", {"positive": "down"}),
        ("z", {"standard_name": "sea_floor_depth_below_geoid"}),
        ("depth", {"positive": "down", "units": "m"}),
    ],
)
def test_depths_become_heights_and_it_is_said(tmp_path, name, attributes):
    """A sea floor that counts downwards is no range of mountains, in netCDF and GeoTIFF."""
    files = write_netcdf(tmp_path / "a.nc", -HEIGHTS, name, **attributes), tmp_path / "a.tif"
    write_raster(files[1], -HEIGHTS, **attributes)
    for file in files:
        terrain = read_terrain(file)
        np.testing.assert_allclose(terrain.height_m, HEIGHTS)
        assert "depths" in terrain.name and "negated" in terrain.name


def test_what_is_called_a_depth_is_one_where_it_is_positive_throughout(tmp_path):
    deep = HEIGHTS - 1000.0
    for values in (deep, -deep):
        terrain = read_terrain(write_netcdf(tmp_path / "a.nc", values, "depth"))
        np.testing.assert_allclose(terrain.height_m, deep)
        assert ("negated" in terrain.name) == (values is not deep)
    up = write_netcdf(tmp_path / "a.nc", HEIGHTS, "depth", positive="up")
    np.testing.assert_allclose(read_terrain(up).height_m, HEIGHTS)


@pytest.mark.parametrize("unit", ["meters above mean sea level", "m a.s.l.", "m (above geoid)"])
def test_a_unit_may_name_the_zero_level(tmp_path, unit):
    terrain = read_terrain(write_netcdf(tmp_path / "a.nc", HEIGHTS, units=unit))
    np.testing.assert_allclose(terrain.height_m, HEIGHTS)
    assert f"heights in {unit!r}" in terrain.name


@pytest.mark.parametrize("mark", [32767.0, -3.4028235e38, 9999.0, -9999.0, 1.70141e38])
@pytest.mark.parametrize("unit", ["m", "ft"])
def test_undeclared_marks_of_voids_are_recognised(tmp_path, mark, unit):
    """Whatever the unit is; but 9999 ft is a height."""
    written = (HEIGHTS / 0.3048 if unit == "ft" else HEIGHTS).astype(np.float32)
    written[5, 7] = mark
    for terrain in (
        read_terrain(write_netcdf(tmp_path / "a.nc", written, units=unit)),
        read_terrain(write_raster(tmp_path / "a.tif", written, unit)),
    ):
        if (mark, unit) == (9999.0, "ft"):
            assert terrain.height_m[5, 7] == pytest.approx(3047.7, abs=0.1)
        else:
            np.testing.assert_allclose(terrain.height_m, HEIGHTS, atol=1e-3)
            assert "undeclared" in terrain.name and "1 voids filled" in terrain.name


@pytest.mark.long
@pytest.mark.parametrize("shape", [(601, 601), (25, 25), (3601, 1801)])
def test_a_tile_of_any_size_is_one_degree(tmp_path, shape):
    rows, columns = np.indices(shape)
    path = tmp_path / "s36w085.SRTM.hgt"
    path.write_bytes((rows - columns).astype(">i2").tobytes())
    terrain = read_terrain(path)
    assert "void" not in terrain.name
    assert terrain.latitudes_deg[[0, -1]] == pytest.approx([-36.0, -35.0])
    assert terrain.longitudes_deg[[0, -1]] == pytest.approx([-85.0, -84.0])
    np.testing.assert_array_equal(terrain.height_m, (rows - columns)[::-1])


def test_the_void_of_tiles_is_declared_by_their_format(tmp_path):
    heights = np.full((25, 25), 100, dtype=">i2")
    heights[10, 12] = -32768
    (tmp_path / "N36E007.hgt").write_bytes(heights.tobytes())
    terrain = read_terrain(tmp_path / "N36E007.hgt")
    assert "1 voids filled" in terrain.name and "undeclared" not in terrain.name
    np.testing.assert_allclose(terrain.height_m, 100.0)


@pytest.mark.parametrize("driver", ["GSAG", "GSBG", "GS7BG"])
def test_grids_of_surfer(tmp_path, driver):
    write_raster(tmp_path / "a.tif", HEIGHTS)
    rasterio.shutil.copy(tmp_path / "a.tif", tmp_path / "a.grd", driver=driver)
    np.testing.assert_allclose(read_terrain(tmp_path / "a.grd").height_m, HEIGHTS, atol=1e-3)


@pytest.mark.long
def test_a_missing_database_of_proj_is_named(tmp_path):
    """With the variable of another installation; a process of its own, as PROJ reads it once."""
    path = write_raster(tmp_path / "a.tif", HEIGHTS, crs="EPSG:32632", step=100.0)
    code = f"from ggbench.gravity.terrain_files import *; read_terrain(Path({str(path)!r}))"
    for variable, value in (("PROJ_LIB", str(tmp_path)), ("PROJ_DATA", "/elsewhere")):
        environment = {k: v for k, v in os.environ.items() if k not in ("PROJ_LIB", "PROJ_DATA")}
        ended = subprocess.run(
            [sys.executable, "-c", code],
            env=environment | {variable: value},
            capture_output=True,
            text=True,
            check=False,
        )
        assert "PROJ's database proj.db, which is not found" in ended.stderr
        assert f"{variable} = {value!r} points to another installation: unset it" in ended.stderr


def virtual_raster(source: str) -> str:
    """A raster of GDAL that holds no values, but the name of a file that does."""
    return (
        '<VRTDataset rasterXSize="16" rasterYSize="12"><SRS>EPSG:4326</SRS>'
        "<GeoTransform>6.95,0.1,0,46.15,0,-0.1</GeoTransform>"
        '<VRTRasterBand dataType="Float32" band="1"><SimpleSource>'
        f"<SourceFilename>{source}</SourceFilename><SourceBand>1</SourceBand>"
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )


@pytest.mark.parametrize("suffix", [".tif", ".tiff", ".asc", ".grd", ".hgt", ".nc", ".gtx", ".isg"])
def test_a_raster_leads_to_no_other_file(suffix, tmp_path):
    """A virtual raster under another name is refused, be its source local; control: the source."""
    source = write_raster(tmp_path / "source.tif", HEIGHTS)
    (tmp_path / f"N46E007{suffix}").write_text(virtual_raster(str(source)))
    with pytest.raises((TerrainError, MapError)):
        if suffix in (".gtx", ".isg"):
            read_grid(tmp_path / f"N46E007{suffix}", "geoid")
        else:
            read_terrain(tmp_path / f"N46E007{suffix}")
    np.testing.assert_allclose(read_terrain(source).height_m, HEIGHTS)


@pytest.fixture
def listener(monkeypatch):
    """A socket without a connection, and its address."""
    monkeypatch.setenv("GDAL_HTTP_TIMEOUT", "1")
    monkeypatch.setenv("GDAL_HTTP_CONNECTTIMEOUT", "1")
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        yield server, f"http://127.0.0.1:{server.getsockname()[1]}/x.tif"


@contextlib.contextmanager
def connections(server: socket.socket) -> Iterator[threading.Event]:
    """Set an event at each connection. A thread closes it at once, so that GDAL does not wait."""
    arrived, ended = threading.Event(), threading.Event()

    def close() -> None:
        while not ended.is_set():
            with contextlib.suppress(TimeoutError):
                server.accept()[0].close()
                arrived.set()

    server.settimeout(0.1)
    thread = threading.Thread(target=close)
    thread.start()
    try:
        yield arrived
    finally:
        ended.set()
        thread.join()


@pytest.mark.parametrize("name", ["a.tif", "a.asc", "a.grd"])
def test_a_raster_leads_not_into_the_network(name, tmp_path, listener):
    """Nothing arrives at the address that it names; control: without the rule GDAL asks there."""
    server, address = listener
    (tmp_path / name).write_text(virtual_raster(f"/vsicurl/{address}"))
    with pytest.raises(TerrainError, match="cannot be read as a raster"):
        read_terrain(tmp_path / name)
    with pytest.raises(BlockingIOError):
        server.accept()
    if name == "a.tif":
        with connections(server) as arrived:
            with pytest.raises(rasterio.RasterioIOError), rasterio.open(tmp_path / name) as data:
                data.read(1)
            assert arrived.wait(10.0)


def test_a_mask_file_leads_not_into_the_network(tmp_path, listener):
    """It is refused, whatever it contains; control: without the rule GDAL asks there."""
    server, address = listener
    path = write_raster(tmp_path / "a.tif", HEIGHTS)
    np.testing.assert_allclose(read_terrain(path).height_m, HEIGHTS)
    declared = '<Metadata><MDI key="INTERNAL_MASK_FLAGS_1">2</MDI></Metadata></VRTDataset>'
    mask = virtual_raster(address).replace("</VRTDataset>", declared)
    (tmp_path / "a.tif.msk").write_text(mask)
    with pytest.raises(TerrainError, match=r"has a mask file, a\.tif\.msk, which could refer"):
        read_terrain(path)
    with pytest.raises(BlockingIOError):
        server.accept()
    with connections(server) as arrived:
        with contextlib.suppress(rasterio.RasterioIOError), rasterio.open(path) as data:
            data.read_masks(1)
        assert arrived.wait(10.0)


def test_an_ascii_grid_by_its_suffix(tmp_path):
    path = tmp_path / "b.asc"
    rasterio.shutil.copy(write_raster(tmp_path / "a.tif", HEIGHTS), path, driver="AAIGrid")
    np.testing.assert_allclose(read_terrain(path).height_m, HEIGHTS)
