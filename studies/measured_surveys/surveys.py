"""Selection of survey data, in ggbench's axes and units."""

from __future__ import annotations

from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
from rasterio.warp import transform

from ggbench.maps.survey_files import read_lines
from ggbench.maps.survey_lines import SurveyLines

_ROOT = "galileoqc-1.0.16/docs/source/tutorials/"
VINTON = f"{_ROOT}VintonData/VintonDome.xyz"
FOSTERVILLE = f"{_ROOT}FostervilleData/Foster_craig.hdf5"
EAST_VICTORIA = f"{_ROOT}EastVicData/EastVicRepeats.xyz"
_DAY = 86400.0
UV_SIGN = -1.0
"""Falcon's UV is half of north-north less east-east: masses that fit it so leave 4.8 E of lines
held back, with the other sign 5.5 E; their gravity correlates with the survey's own by 0.88."""
_FOSTERVILLE_THINNING = 8  # of 8 Hz behind a filter of 0.18 Hz
_EAST_VICTORIA_THINNING = 4  # of 2 Hz behind a filter of 56 s
_PROFILE = 5  # passes of East Victoria that are called primary, the others repeats


def vinton(path: Path) -> pd.DataFrame:
    """Return the tensor of Vinton Dome, z up, with the day of flight."""
    columns = {
        "time_s": "Time",
        "latitude_deg": "Lat",
        "longitude_deg": "Lon",
        "height_m": "Altitude",
        "xx": "Txx_slv",
        "xy": "Tyx_slv",
        "xz": "Txz_slv",
        "yy": "Tyy_slv",
        "yz": "Tyz_slv",
    }
    lines = read_lines(path, columns, axes="east-north-down")
    repeats = ["." in name for name in lines.names]
    kinds = np.where(repeats, "repeat", lines.kinds)
    table = _located(lines, kinds[lines.line])
    # UTC since 6 January 1980 without leap seconds; the dates in the file's headings are wrong.
    date = pd.to_datetime("1980-01-06") + pd.to_timedelta(table["time_s"] // _DAY, "D")
    table.insert(2, "date", date.dt.strftime("%Y-%m-%d"))
    table["time_s"] -= table["time_s"].min() // _DAY * _DAY
    return table.assign(**dict(zip(lines.components, lines.values.T, strict=True)))


def fosterville(path: Path) -> pd.DataFrame:
    """Return two components of Fosterville at 1 Hz; lines are odd or even, in their order."""
    tables = []
    with netCDF4.Dataset(path) as file:
        lines = file["Whizz Version 1.0/Lines"].groups
        for number, (name, line) in enumerate(sorted(lines.items())):
            every = slice(None, None, _FOSTERVILLE_THINNING)
            easting, northing, height, time, ne, uv = (
                np.asarray(line[key][every], dtype=float)
                for key in (
                    "GNSS_Easting_WGS84UTM55",
                    "GNSS_Northing_WGS84UTM55",
                    "Elevation_GNSS_GRS80",
                    "Time_SSM_UTC1980",
                    "Falc_A_NE_0p00_0p18Hz_MeanLev",
                    "Falc_A_UV_0p00_0p18Hz_MeanLev",
                )
            )
            longitude, latitude = transform("EPSG:32755", "EPSG:4326", easting, northing)
            tables.append(
                pd.DataFrame(
                    {
                        "line": name,
                        "kind": "even" if number % 2 else "odd",
                        "time_s": time,
                        "latitude_deg": latitude,
                        "longitude_deg": longitude,
                        "height_m": height,
                        "xy": ne,
                        "xx-yy": UV_SIGN * uv,
                    }
                )
            )
    table = pd.concat(tables, ignore_index=True)
    table["time_s"] -= table["time_s"].min() // _DAY * _DAY
    return table.dropna()


def east_victoria(path: Path) -> pd.DataFrame:
    """Return free-air gravity of the ten passes, a sample every two seconds."""
    columns = {
        "line": "LINE",
        "time_s": "FTIME",
        "latitude_deg": "LAT",
        "longitude_deg": "LONG",
        "height_m": "MGA-Z",
        "disturbance": "FA56s_GRS80",
    }
    lines = read_lines(path, columns, quantity="disturbance")
    kinds = np.where(np.arange(len(lines.names)) < _PROFILE, "primary", "repeat")
    table = _located(lines, kinds[lines.line]).assign(disturbance=lines.values[:, 0])
    number = table.groupby("line", sort=False).cumcount()
    return table[number % _EAST_VICTORIA_THINNING == 0]


def _located(lines: SurveyLines, kinds: np.ndarray) -> pd.DataFrame:
    """The samples with line, kind, time and place."""
    return pd.DataFrame(
        {
            "line": np.array(lines.names)[lines.line],
            "kind": kinds,
            "time_s": lines.time_s,
            "latitude_deg": lines.latitude_deg,
            "longitude_deg": lines.longitude_deg,
            "height_m": lines.height_m,
        }
    )
