"""Messages of grids of gravity and of a geoid."""

from __future__ import annotations

import struct

import netCDF4
import numpy as np
import pytest
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
from grids import BAD_AXES, LATITUDES, LONGITUDES, grid, write_grid
from grids import VALUES as WAVES
from refusals import refused

from ggbench.gravity.gradient_map import MapError
from ggbench.gravity.meridians import Area
from ggbench.maps.gravity_grid import read_grid


def content(path, data):
    path.write_bytes(data)


def raster(path, unit=""):
    write_raster(path, VALUES, unit)


def netcdf(path, unit, name="g"):
    write_grid(path, name, unit, VALUES, south=45.0, west=7.0, step=0.1)


def uneven_longitudes(path):
    """A node a tenth of a step off its place."""
    write_grid(path, "geoid", "", np.ones((20, 20)), south=30.0, west=5.0, step=0.1)
    with netCDF4.Dataset(path, "a") as file:
        file.variables["lon"][7] += 0.01


def gmt_3(path):
    data = {"x_range": ("side", [7.0, 9.3]), "y_range": ("side", [45.0, 46.9])}
    data |= {"dimension": ("side", [24, 20]), "z": ("xysize", VALUES.ravel())}
    xarray.Dataset(data).to_netcdf(path, engine="scipy")


def ggxf(path):
    """As NGS publishes GEOID2022: values in a group, and no coordinates."""
    with netCDF4.Dataset(path, "w") as file:
        file.ggxfVersion = "GGXF-1.0"
        group = file.createGroup("SGEOID2022")
        group.createDimension("gridi", 20)
        group.createVariable("geoidHeight", "f4", ("gridi",))[:] = 1.0


def with_text(path, text, factor=1.0):
    """A grid whose description alone states its unit, by the suffix as netCDF or raster."""
    described(path.parent, text, VALUES * factor)


def with_axes(path, **options):
    grid(path.parent, **options)


def three_axes(path):
    with netCDF4.Dataset(path, "w") as file:
        for name, nodes in (("time", [0.0, 1.0]), ("lat", LATITUDES), ("lon", LONGITUDES)):
            file.createDimension(name, len(nodes))
            file.createVariable(name, "f8", (name,))[:] = nodes
        file.createVariable("z", "f8", ("time", "lat", "lon"))[:] = np.stack([WAVES, WAVES])


KINDS = ("geoid", "anomaly", "disturbance")
GEOSOFT = struct.pack("<5i", 4, 1, 24, 20, 1) + bytes(2412)
OTHER_QUANTITIES = {
    "vgg (Eotvos)": "that is a gravity gradient",
    "EMAG2 (nT)": "gravity in 'nT'",
    "total magnetic intensity": "that is a magnetic field",
    "gravity (s^-2)": r"gravity in 's\^-2'",
    "Complete Bouguer anomaly [mGal]": "Bouguer or isostatic",
    "isostatic residual (mGal)": "Bouguer or isostatic",
    "CBA_267": "Bouguer or isostatic",
    "geoid (m)": "that is a geoid",
    "observed gravity": "that is observed gravity",
}
"""Descriptions of grids that are no gravity that a map can be made of."""
DIFFER = r"anomalies differ from disturbances by 0\.3 mGal"
OF_AXES = {
    **BAD_AXES,
    "errors of anomalies": ({"long_name": "error of free-air anomaly"}, "an error"),
    "standard deviations": ({"long_name": "standard deviation"}, "an error"),
    "Bouguer in the description": ({"description": "Bouguer anomaly"}, "Bouguer"),
    "Bouguer in the title": ({"title": "Complete Bouguer anomaly of Iberia"}, "Bouguer"),
}
BAD = {
    "zeros that mark gaps": ("grid.gdf", "disturbance", write_gap, {"mark": "0.0"}, "has gaps"),
    "gaps that are not declared": (
        "a.nc",
        "anomaly",
        write_marked,
        {"mark": 9999.0, "unit": "mGal"},
        "has gaps: 1 nodes",
    ),
    "gaps of a huge number": (
        "a.nc",
        "anomaly",
        write_marked,
        {"mark": 3e38, "unit": "µGal"},
        "has gaps: 1 nodes",
    ),
    "rows of gaps": (
        "grid.nc",
        "geoid",
        write_gaps,
        {},
        "200 nodes without a value .* the first at 30° N, 5° E",
    ),
    "gaps in the area needed": (
        "grid.nc",
        "geoid",
        write_gaps,
        {},
        "the first at 30.2° N, 5.5° E; fill them",
        Area(30.25, 33.0, 5.5, 8.0),
    ),
    "uneven longitudes": ("grid.nc", "geoid", uneven_longitudes, {}, "longitude must be regular"),
    **{
        f"gravity in {unit}, {suffix}": (
            f"a.{suffix}",
            "disturbance",
            write,
            {"unit": unit},
            f"gravity in '{unit}'; mGal, µGal, Gal or m/s² are",
        )
        for unit in ("ft", "m", "mm", "E")
        for suffix, write in (("tif", raster), ("nc", netcdf))
    },
    "a geoid for gravity": ("a.isg", "anomaly", write_isg, {}, "has gravity in 'meters'; mGal"),
    "unknown suffix": (
        "a.docx",
        "geoid",
        content,
        {"data": b"not a grid"},
        "a.docx cannot be read as a raster",
    ),
    "a virtual raster": ("a.vrt", "geoid", raster, {}, r"allowed suffixes are \.tif"),
    "a grid of Geosoft": (
        "a.grd",
        "anomaly",
        content,
        {"data": GEOSOFT},
        "is a Geosoft grid, .* as GeoTIFF or as a Surfer grid",
    ),
    "a grid of GMT 3": (
        "b.grd",
        "anomaly",
        gmt_3,
        {},
        "in the format of GMT 3, without coordinates; convert it",
    ),
    "a grid of GGXF": ("geoid.ggxf", "geoid", ggxf, {}, "is a GGXF file"),
    **{
        f"functional {functional} for --{kind}": (
            "a.gdf",
            kind,
            write_icgem,
            {"functional": functional, "unit": "meter" if right == "geoid" else "mgal"},
            f"its functional is {functional}, not a {kind}: give the file as --{right}",
        )
        for functional, right in FUNCTIONALS.items()
        for kind in KINDS
        if kind != right
    },
    **{
        f"functional of Bouguer anomalies for --{kind}": (
            "a.gdf",
            kind,
            write_icgem,
            {"functional": "gravity_anomaly_bg", "unit": "mgal"},
            r"its functional gravity_anomaly_bg \(Bouguer anomalies",
        )
        for kind in KINDS
    },
    **{
        f"functional of topography for --{kind}": (
            "b.gdf",
            kind,
            write_icgem,
            {"functional": "topography_grd", "unit": "meter"},
            "its functional topography_grd; allowed",
        )
        for kind in KINDS
    },
    "a variable of Bouguer anomalies": (
        "a.nc",
        "anomaly",
        netcdf,
        {"unit": "mGal", "name": "bouguer_anomaly"},
        "holds 'bouguer_anomaly': that is a Bouguer.*; only free-air anomalies",
    ),
    **{
        f"{text} for --{kind}, {suffix}": (f"a.{suffix}", kind, with_text, {"text": text}, message)
        for text, message in OTHER_QUANTITIES.items()
        for kind in ("anomaly", "disturbance")
        for suffix in ("nc", "tif")
    },
    **{
        f"{text} for --disturbance, {suffix}": (
            f"a.{suffix}",
            "disturbance",
            with_text,
            {"text": text, "factor": factor},
            DIFFER,
        )
        for text, factor in (
            ("faa (mGal)", 1.0),
            ("free-air gravity (EGM2008) [µGal]", 1e3),
            ("Free air (m/s^2)", 1e-5),
        )
        for suffix in ("nc", "tif")
    },
    **{
        f"a disturbance for --anomaly, {suffix}": (
            f"a.{suffix}",
            "anomaly",
            with_text,
            {"text": "Gravity disturbance (EGM2008)"},
            "give it as a disturbance",
        )
        for suffix in ("nc", "tif")
    },
    **{
        f"file {name}": (name, "disturbance", raster, {"unit": "mGal"}, "holds '")
        for name in ("bouguer_victoria.tif", "vgg.tif")
    },
    **{
        kind: ("grid.nc", "anomaly", with_axes, options, message)
        for kind, (options, message) in OF_AXES.items()
    },
    **{
        f"{text} for --geoid": ("grid.nc", "geoid", with_axes, {"long_name": text}, message)
        for text, message in (
            ("mean sea surface", "a height of a surface"),
            ("elevation", "a height of a surface"),
            ("geoid error", "an error"),
        )
    },
    "an axis of time": (
        "grid.nc",
        "anomaly",
        three_axes,
        {},
        r"found z on time \(2\), lat \(20\), lon \(30\)",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_grid_is_refused_in_one_sentence(case, tmp_path):
    name, kind, write, options, message, *area = BAD[case]
    write(tmp_path / name, **options)
    with refused(MapError, message):
        read_grid(tmp_path / name, kind, area=area[0] if area else None)
