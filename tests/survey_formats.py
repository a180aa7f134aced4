"""A survey of three lines in the formats of survey files."""

from __future__ import annotations

import gzip

ROWS = [
    (name, kind, 10.0 * n + k, 30.0 + 0.001 * k, -93.0 + 0.01 * n, 80.0 + k, 1.5 * k, 1.0 - 2.0 * k)
    for n, (name, kind) in enumerate((("10", "primary"), ("20", "primary"), ("900", "tie")))
    for k in range(5)
]
RENAMED = {
    "time_s": "Time",
    "latitude_deg": "Lat",
    "longitude_deg": "Lon",
    "height_m": "Alt",
    "xx": "Txx",
    "xz": "Txz",
}


def csv(folder):
    head = "line,kind,time_s,latitude_deg,longitude_deg,height_m,xx,xz\n"
    path = folder / "lines.csv.gz"
    path.write_bytes(gzip.compress((head + "".join(_joined(r, ",") for r in ROWS)).encode()))
    return path


def csv_of_numpy(folder):
    """Its names follow a #, below a remark; a passed-over column holds commas."""
    head = (
        "# a survey, of May\n# line,kind,time_s,latitude_deg,longitude_deg,height_m,xx,xz,place\n"
    )
    path = folder / "lines.csv"
    path.write_text(head + "".join(_joined((*r, '"30 N, 93 W"'), ",") for r in ROWS))
    return path


def xyz(folder):
    out = ["/ exported", "/ Time Lat Lon Alt Txx Txz", "/===== ==== ===== ==== ==== ===="]
    for name, kind in dict.fromkeys(row[:2] for row in ROWS):
        out.append(f"{'Tie' if kind == 'tie' else 'Line'}  {name}")
        out += [_joined(row[2:], " ").strip() for row in ROWS if row[0] == name]
    path = folder / "lines.XYZ"
    path.write_text("\n".join(out))
    return path


def gdf2(folder):
    names = ("LINE:I6", "Time:F10.3", "Lat:F12.6", "Lon:F12.6", "Alt:F8.2", "Txx:F9.2: NULL=-99999")
    names = (*names, "Txz:F9.2")
    text = [f"DEFN {n + 1} ST=RECD,RT=DATA; {name}" for n, name in enumerate(names)]
    text.append("DEFN 8 ST=RECD,RT=DATA; END DEFN")
    text.append("DEFN 1 ST=RECD,RT=PROJ; COORDSYS: A40: NAME=WGS84")
    (folder / "lines.dfn").write_text("\n".join(text))
    rows = [
        f"{int(r[0]):6d}{r[2]:10.3f}{r[3]:12.6f}{r[4]:12.6f}{r[5]:8.2f}{r[6]:9.2f}{r[7]:9.2f}"
        for r in ROWS
    ]
    path = folder / "lines.dat"
    path.write_text("\n".join(rows))
    return path


def _joined(row, mark):
    return mark.join(map(str, row)) + "\n"
