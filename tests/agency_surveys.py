"""A survey of 18 samples in files as agencies write them."""

from __future__ import annotations

import numpy as np
import rasterio.warp

LINES = np.repeat([10010, 10020, 90010], 6)
COUNT = len(LINES)
TIMES = 36_000.0 + 2.0 * np.arange(COUNT)
LATITUDES = -33.0 + 0.001 * np.tile(np.arange(6), 3)
LONGITUDES = 142.5 + 0.01 * np.repeat(np.arange(3), 6)
HEIGHTS = 400.0 + np.arange(COUNT)
VALUES = np.round(20.0 * np.sin(np.arange(COUNT)), 2)
PLACES = {
    "line": "LINE",
    "time_s": "FID",
    "latitude_deg": "LAT",
    "longitude_deg": "LONG",
    "height_m": "HGT",
}
DISTURBANCE = {"disturbance": "GRAV"} | PLACES


def fields(unit="", name="GRAV", values=VALUES, null="", height_unit="m", heights=HEIGHTS):
    """Name, format, width, attributes and texts of each field."""
    value_attributes = ",".join(filter(None, (f"UNIT={unit}" if unit else "", null)))
    return [
        ("LINE", "I8", 8, "NAME=Line number", [f"{v}" for v in LINES]),
        ("FID", "F10.1", 10, "", [f"{v:.1f}" for v in TIMES]),
        ("LAT", "F14.8", 14, "UNIT=dega", [f"{v:.8f}" for v in LATITUDES]),
        ("LONG", "F14.8", 14, "UNIT=degrees", [f"{v:.8f}" for v in LONGITUDES]),
        ("HGT", "F9.2", 9, f"UNIT={height_unit}", [f"{v:.2f}" for v in heights]),
        (name, "F14.3", 14, value_attributes, [f"{v:.3f}" for v in values]),
    ]


def defined(style, name, form, attributes):
    """A definition as one of the agencies writes it."""
    return {
        "standard": f"ST=RECD,RT=DATA; {name}: {form}: {attributes}",
        "record": f"ST=RECORD,RT=DATA;{name}:{form}:{attributes}",
        "identifier": f"ST=RECD,RT=;RT:A4;{name}:{form}:{attributes}",
        "colons": f"ST=RECORD,RT=;{name}:{form}:"
        + attributes.replace(",", ":").replace("UNIT=", "UNIT:"),
        "comma": f"ST=RECD,RT=DATA;{name}:{form.lower()},{attributes}",
        "units": f"ST=RECD,RT=; {name} : {form} : " + attributes.replace("UNIT=", "UNITS = "),
        "described": f"ST=RECD,RT=;{name}:{form}:{name} ,{attributes},a description",
    }[style]


def gdf2(folder, table, style="standard", separator=None, numbered="DEFN {} ", name="s"):
    lines = [
        numbered.format(n) + defined(style, field, form, attributes)
        for n, (field, form, _, attributes, _) in enumerate(table, 1)
    ]
    lines = ["DEFN   ST=RECD,RT=COMM;RT:A4;COMMENTS:A76", *lines]
    lines.append(numbered.format(len(table) + 1) + "ST=RECD,RT=;END DEFN")
    (folder / f"{name}.dfn").write_text("\n".join(lines) + "\n")
    rows = [
        "".join(cells[n].rjust(width) for *_, width, _, cells in table)
        if separator is None
        else separator.join(cells[n] for *_, cells in table)
        for n in range(COUNT)
    ]
    path = folder / f"{name}.dat"
    path.write_text("\n".join(rows) + "\n")
    return path


COMPONENTS = ("xx", "xy", "zz")


def tensor(folder, zeros, at=COMPONENTS):
    """A survey of gradients; the rows ``zeros`` have 0 in the components ``at``."""
    rows = ["line,time_s,latitude_deg,longitude_deg,height_m," + ",".join(COMPONENTS)]
    for n in range(COUNT):
        places = (LINES[n], TIMES[n], LATITUDES[n], LONGITUDES[n], HEIGHTS[n])
        void = {name: "-0.00" if name == "xy" else "0.00" for name in at if n in zeros}
        values = (void.get(name, f"{VALUES[n] + 1.0:.2f}") for name in COMPONENTS)
        rows.append(",".join([*map(str, places), *values]))
    (folder / "t.csv").write_text("\n".join(rows))
    return folder / "t.csv"


def csv(folder, cells=None, head="Line,Fid,Lat,Lon,Height,Tzz,kind"):
    table = fields()
    rows = [[column[n] for *_, column in table] + ["primary"] for n in range(COUNT)]
    for (row, column), cell in (cells or {}).items():
        rows[row][column] = cell
    path = folder / "s.csv"
    path.write_text("\n".join([head, *map(",".join, rows)]))
    return path


OF_CSV = {
    "line": "Line",
    "time_s": "Fid",
    "latitude_deg": "Lat",
    "longitude_deg": "Lon",
    "height_m": "Height",
    "zz": "Tzz",
}
OF_PROJECTION = {
    "easting_m": "LONG",
    "northing_m": "LAT",
    "line": "LINE",
    "height_m": "HGT",
    "time_s": "FID",
    "disturbance": "GRAV",
}


def projected(folder):
    """The survey in metres of a projection."""
    east, north = rasterio.warp.transform("EPSG:4326", "EPSG:32754", LONGITUDES, LATITUDES)
    table = fields("mGal")
    table[2] = ("LAT", "F14.3", 14, "UNIT=m", [f"{v:.3f}" for v in north])
    table[3] = ("LONG", "F14.3", 14, "UNIT=m", [f"{v:.3f}" for v in east])
    return gdf2(folder, table)
