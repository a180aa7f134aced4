"""Datums that a file names are heeded, or refused; never passed over."""

from __future__ import annotations

import netCDF4
import numpy as np
import pytest
from grids import write_grid
from rasterio.crs import CRS
from rasterio.warp import transform
from test_terrain_kinds import HEIGHTS, write_raster

from ggbench.errors import GGBenchError
from ggbench.gravity.terrain_files import read_terrain
from ggbench.maps.gravity_grid import read_grid
from ggbench.maps.nodes import GridRequest
from ggbench.maps.plan import Inputs, plan


@pytest.mark.parametrize(
    ("crs", "said"),
    [
        ("EPSG:4301", "from Tokyo to WGS 84"),
        ("EPSG:4807", "from NTF (Paris) to WGS 84"),
        ("EPSG:9518", "vertical datum EGM2008 height"),
        ("EPSG:4326+5773", "vertical datum EGM96 height"),
        ("EPSG:4979", "heights are above the ellipsoid"),
        ("EPSG:4258", ""),
        ("EPSG:4269", ""),
    ],
)
def test_a_raster_says_what_datum_it_has(crs, said, tmp_path):
    """Degrees of another datum become those of WGS 84; ETRS89 and NAD83 are no other."""
    terrain = read_terrain(write_raster(tmp_path / "a.tif", HEIGHTS, crs=crs))
    assert said in terrain.name
    moved = "to WGS 84" in terrain.name
    assert (terrain.height_m.shape == HEIGHTS.shape) == (not moved)
    if not moved:
        assert (terrain.south_deg, terrain.west_deg) == pytest.approx((45.0, 7.0))
        return
    # The heights are linear in the file's own degrees, half a kilometre (or a country) away.
    lat, lon = terrain.latitudes_deg[3], terrain.longitudes_deg[4]
    (x,), (y,) = transform("EPSG:4326", crs, [lon], [lat])
    assert terrain.height_m[3, 4] == pytest.approx(
        1e3 * (y - 45.0) + 1e2 * (x - 7.0) - 500.0, abs=2
    )


def test_heights_above_the_ellipsoid_need_no_geoid(tmp_path):
    file = write_raster(tmp_path / "a.tif", HEIGHTS, crs="EPSG:4979")
    with pytest.raises(GGBenchError, match="heights are above the ellipsoid: remove --geoid-h"):
        plan(Inputs(terrain=file, geoid_height_m=48.0), GridRequest(), "")


CONTRADICTIONS = {
    "a meridian": (
        {"longitude_of_prime_meridian": 2.337},
        "meridian at 2.337 degrees; only Greenwich",
    ),
    "a datum": (
        {"crs_wkt": CRS.from_epsg(4807).to_wkt()},
        r"is in NTF \(Paris\); only WGS 84 is all",
    ),
    "no datum": ({"crs_wkt": "WGS eighty-four"}, "has an invalid reference system"),
    "the same": ({"crs_wkt": CRS.from_epsg(4326).to_wkt()}, ""),
    "no words": ({"grid_mapping_name": "latitude_longitude"}, ""),
}


@pytest.mark.parametrize("name", CONTRADICTIONS)
@pytest.mark.parametrize("unit", ["m", "mGal"])
def test_a_grid_mapping_is_heeded(name, unit, tmp_path):
    """In netCDF files of heights and of gravity."""
    attributes, said = CONTRADICTIONS[name]
    file = tmp_path / "a.nc"
    write_grid(
        file,
        "z",
        unit,
        np.add.outer(np.arange(20.0), np.arange(20.0)),
        south=45.0,
        west=7.0,
        step=0.1,
    )
    with netCDF4.Dataset(file, "a") as opened:
        opened.createVariable("crs", "i4").setncatts(attributes)
        opened["z"].grid_mapping = "crs"

    def read():
        return read_terrain(file) if unit == "m" else read_grid(file, "anomaly")

    if not said:
        read()
        return
    with pytest.raises(GGBenchError, match=said):
        read()


def test_a_grid_of_icgem_on_another_ellipsoid_is_refused(tmp_path):
    """Undulations above another ellipsoid are other numbers; EGM96's radius is near enough."""
    for radius, taken in (("6378137.0 m", True), ("6378136.3 m", True), ("6378245.0 m", False)):
        head = [
            "functional geoid",
            "latitude_parallels 16",
            "longitude_parallels 16",
            "unit meter",
            f"radiusrefsys {radius}",
            "longitude latitude geoid",
            "end_of_head ==",
        ]
        rows = [f"{7 + 0.1 * j:.1f} {45 - 0.1 * i:.1f} 40.0" for i in range(16) for j in range(16)]
        file = tmp_path / "a.gdf"
        file.write_text("\n".join([*head, *rows, ""]))
        if taken:
            read_grid(file, "geoid")
        else:
            with pytest.raises(
                GGBenchError, match=r"an ellipsoid of radius 6\.37824e\+06 m; WGS84"
            ):
                read_grid(file, "geoid")
