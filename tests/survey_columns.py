"""A survey of 12 samples whose columns bear names of any kind."""

from __future__ import annotations

import agency_surveys
import numpy as np

from ggbench.maps.survey_files import read_lines

COUNT = 12
VALUES = np.round(20.0 * np.sin(np.arange(COUNT)), 3)
HEIGHTS = 400.0 + np.arange(COUNT)
CELLS = {
    "LINE": [f"{n // 6}" for n in range(COUNT)],
    "FID": [f"{2 * n}" for n in range(COUNT)],
    "LAT": [f"{-33.0 + 0.001 * (n % 6):.6f}" for n in range(COUNT)],
    "LONG": [f"{142.5 + 0.01 * (n // 6):.6f}" for n in range(COUNT)],
    "HGT": [f"{v:.2f}" for v in HEIGHTS],
    "VALUE": [f"{v:.3f}" for v in VALUES],
}
RADIANS = {name: [f"{np.radians(float(v)):.9f}" for v in CELLS[name]] for name in ("LAT", "LONG")}
KEYS = agency_surveys.PLACES


def read(
    folder,
    renamed=None,
    cells=None,
    key="zz",
    quantity="gradient",
    columns=None,
    above="",
    below="",
    crs=None,
):
    """Return the lines of a CSV file with renamed columns and rows above and below the names."""
    renamed, cells = renamed or {}, CELLS | (cells or {})
    names = [renamed.get(name, name) for name in cells]
    rows = [",".join(column[n] for column in cells.values()) for n in range(COUNT)]
    path = folder / "s.csv"
    head = ",".join(f'"{name}"' for name in names)
    path.write_text(above + head + "\n" + below + "\n".join(rows) + "\n")
    keys = KEYS | {key: "VALUE"} | (columns or {})
    keys = {each: renamed.get(name, name) for each, name in keys.items()}
    return read_lines(path, keys, quantity=quantity, crs=crs)


def gdf2(folder, definition, values=None):
    """Return an ASEG-GDF2 file whose value has a definition."""
    forms = {"LINE": "I4", "FID": "F6.1", "LAT": "F12.6", "LONG": "F12.6", "HGT": "F8.2"}
    rows = [f"DEFN ST=RECD,RT=;{name}:{form}" for name, form in forms.items()]
    (folder / "s.dfn").write_text("\n".join([*rows, f"DEFN ST=RECD,RT=;VALUE:{definition}"]))
    cells = CELLS | {"VALUE": values or CELLS["VALUE"]}
    widths = {"LINE": 4, "FID": 6, "LAT": 12, "LONG": 12, "HGT": 8, "VALUE": 12}
    lines = [
        "".join(cells[name][n].rjust(width) for name, width in widths.items()) for n in range(COUNT)
    ]
    (folder / "s.dat").write_text("\n".join(lines) + "\n")
    return folder / "s.dat"
