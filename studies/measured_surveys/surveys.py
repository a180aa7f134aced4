"""Selected survey data in the axes and units of ggbench."""

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
"""Factor from Falcon's UV, half of north-north minus east-east, to the component ``xx-yy``.

With this sign, fitted masses leave a residual of 4.8 E on held-back lines; with the other sign
5.5 E. The gravity of the masses has a correlation of 0.88 with the gravity of the survey."""
_FOSTERVILLE_THINNING = 8  # from 8 Hz to 1 Hz; the data are filtered at 0.18 Hz
_EAST_VICTORIA_THINNING = 4  # from 2 Hz to 0.5 Hz; the data are filtered over 56 s
_PROFILE = 5  # first passes of East Victoria, of the kind primary; later ones are repeats


def vinton(path: Path) -> pd.DataFrame:
    """Return the tensor of Vinton Dome with z up, and the date of each sample."""
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
    # UTC seconds since 6 January 1980, without leap seconds; the dates in headings are wrong.
    date = pd.to_datetime("1980-01-06") + pd.to_timedelta(table["time_s"] // _DAY, "D")
    table.insert(2, "date", date.dt.strftime("%Y-%m-%d"))
    table["time_s"] -= table["time_s"].min() // _DAY * _DAY
    return table.assign(**dict(zip(lines.components, lines.values.T, strict=True)))


def fosterville(path: Path) -> pd.DataFrame:
    """Return two components of Fosterville at 1 Hz; the kinds of lines alternate: odd, even."""
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
    """Return the free-air gravity of the ten passes of East Victoria, every two seconds."""
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
    """Return a table of the samples with line, kind, time and position."""
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
