"""Survey files: three formats hold the same lines, axes turn, and mistakes get a sentence."""

from __future__ import annotations

import gzip
from itertools import product

import numpy as np
import pytest

from ggbench.gravity.gradient_map import MapError
from ggbench.maps.survey_files import read_lines
from ggbench.maps.survey_lines import AXES, COMPONENTS, in_our_axes

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


@pytest.mark.parametrize(
    "write, columns", [(csv, {}), (csv_of_numpy, {}), (xyz, RENAMED), (gdf2, RENAMED)]
)
def test_the_formats_hold_the_same_lines(tmp_path, write, columns):
    found = read_lines(write(tmp_path), columns)
    assert found.names == ("10", "20", "900")
    assert found.kinds == ("primary", "primary", "primary" if write is gdf2 else "tie")
    assert found.components == ("xx", "xz")
    expected = np.array([row[2:] for row in ROWS], dtype=float)
    at = (found.time_s, found.latitude_deg, found.longitude_deg, found.height_m)
    np.testing.assert_allclose(np.column_stack([*at, found.values]), expected)


@pytest.mark.parametrize("axes, component", list(product(AXES, COMPONENTS)))
def test_components_turn_as_a_tensor_does(axes, component):
    """A random tensor, turned by a matrix, against names and signs."""
    turn = {
        "east-north-up": np.eye(3),
        "east-north-down": np.diag([1.0, 1.0, -1.0]),
        "north-east-down": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    }[axes]
    ours = np.random.default_rng(4).normal(size=(3, 3))
    ours += ours.T

    def value(name, tensor):
        return COMPONENTS[name] @ tensor[np.triu_indices(3)]

    name, sign = in_our_axes(component, axes)
    assert sign * value(component, turn @ ours @ turn.T) == pytest.approx(value(name, ours))


def test_samples_with_missing_values_are_left_out(tmp_path):
    path = xyz(tmp_path)
    path.write_text(path.read_text().replace("84.0 6.0", "84.0 *"))
    found = read_lines(path, RENAMED)
    assert found.dropped == 3
    assert np.bincount(found.line).tolist() == [4, 4, 4]
    gdf2(tmp_path)
    dat = tmp_path / "lines.dat"
    dat.write_text(dat.read_text().replace("     6.00", "   -99999"))
    assert read_lines(dat, RENAMED).dropped == 3


@pytest.mark.parametrize(
    "columns, components, said",
    [
        ({"xx": "Tzz"}, ("xx",), "no column 'Tzz'; name it, as in --column xx=COLUMN; it has Time"),
        ({}, ("xx", "yy"), "no column 'yy'"),
        ({"heigth": "Alt"}, (), "--column heigth=... has an unknown key; known: line, kind"),
        ({}, ("xx", "xx"), "each at most once"),
        ({"height_m": "Height"}, (), "no column 'Height'"),
    ],
)
def test_a_column_that_is_not_there_gets_a_sentence(tmp_path, columns, components, said):
    with pytest.raises(MapError) as error:
        read_lines(xyz(tmp_path), RENAMED | columns, components)
    assert said in str(error.value)


def test_a_file_that_is_no_survey_gets_a_sentence(tmp_path):
    path = gdf2(tmp_path)
    (tmp_path / "lines.dfn").unlink()
    with pytest.raises(MapError, match=r"needs its definition file lines\.dfn"):
        read_lines(path)
    with pytest.raises(MapError, match=r"must be named \*\.xyz"):
        read_lines(tmp_path / "lines.txt")
    with pytest.raises(MapError, match="cannot read the survey"):
        read_lines(tmp_path / "none.csv")
    (tmp_path / "bad.xyz").write_text("Line 1\n1 2 3\n")
    with pytest.raises(MapError, match="names its 3 columns"):
        read_lines(tmp_path / "bad.xyz")
    with pytest.raises(MapError, match="no column of a component"):
        read_lines(csv(tmp_path), {"xx": "a", "xz": "b"})
    (tmp_path / "m.csv").write_text(
        "line,time_s,latitude_deg,longitude_deg,height_m,xx\n" + "1,1,3327615,436298,80,1\n" * 5
    )
    with pytest.raises(MapError, match="for metres in a projection give --crs"):
        read_lines(tmp_path / "m.csv")
