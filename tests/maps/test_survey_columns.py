"""Names of survey columns: units at the end, signs, swapped coordinates, zero levels of heights."""

from __future__ import annotations

import numpy as np
import pytest

from ggbench.gravity.gradient_map import MapError
from ggbench.gravity.unit_names import unit_at_end
from ggbench.maps.geoid import geoid_heights
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
KEYS = {
    "line": "LINE",
    "time_s": "FID",
    "latitude_deg": "LAT",
    "longitude_deg": "LONG",
    "height_m": "HGT",
}


def read(folder, renamed=None, cells=None, key="zz", quantity="gradient", columns=None):
    """Return the lines of a CSV file with renamed columns."""
    renamed, cells = renamed or {}, CELLS | (cells or {})
    names = [renamed.get(name, name) for name in cells]
    rows = [",".join(column[n] for column in cells.values()) for n in range(COUNT)]
    path = folder / "s.csv"
    path.write_text("\n".join([",".join(f'"{name}"' for name in names), *rows]) + "\n")
    keys = KEYS | {key: "VALUE"} | (columns or {})
    keys = {each: renamed.get(name, name) for each, name in keys.items()}
    return read_lines(path, keys, quantity=quantity)


@pytest.mark.parametrize(
    "name",
    ["ALT_FT", "AltFt", "ALTFT", "Alt ft", "Height feet", "Height, feet", "alt.ft", "HeightFeet"],
)
def test_heights_in_feet_are_converted_however_the_name_says_it(name, tmp_path):
    lines = read(tmp_path, {"HGT": name})
    np.testing.assert_allclose(lines.height_m, 0.3048 * HEIGHTS)
    assert any("converted from" in remark for remark in lines.remarks)


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        ("GRAV_UMS2", 0.1),
        ("GRAV_um_s2", 0.1),
        ("Grav um/s^2", 0.1),
        ("GRAV_nms2", 1e-4),
        ("GravGU", 0.1),
        ("GRAV [g.u.]", 0.1),
        ("grav_mGal", 1.0),
    ],
)
def test_the_unit_of_gravity_at_the_end_of_its_name(name, factor, tmp_path):
    found = read(tmp_path, {"VALUE": name}, key="disturbance", quantity="disturbance")
    np.testing.assert_allclose(found.values[:, 0], factor * VALUES)


@pytest.mark.parametrize("name", ["Tzz_nT", "Tzz_nTm", "Tzz_nT/m", "Tzz_mGal", "Bzz [nT/m]"])
def test_a_name_with_a_unit_of_another_quantity_is_refused(name, tmp_path):
    with pytest.raises(MapError, match="units of zz are"):
        read(tmp_path, {"VALUE": name})


@pytest.mark.parametrize("name", ["Tzz_si", "Tzz_s2", "Tzz_1/s2"])
def test_gradients_per_second_squared_are_converted(name, tmp_path):
    found = read(tmp_path, {"VALUE": name}, {"VALUE": [f"{1e-9 * v:.6g}" for v in VALUES]})
    np.testing.assert_allclose(found.values[:, 0], VALUES, rtol=1e-4)


@pytest.mark.parametrize("name", ["LIFT", "drift", "GPS_H", "h", "field.altitude", "lat_deg"])
def test_words_that_end_as_units_do_are_none(name):
    assert unit_at_end(name, "height_m") == ""


@pytest.mark.parametrize(
    ("renamed", "cells", "said"),
    [
        ({"LAT": "LONGITUDE", "LONG": "LATITUDE"}, {}, "are the columns swapped"),
        ({"LONG": "LONG_W"}, {}, "positive west"),
        ({"LONG": "Longitude West"}, {}, "positive west"),
        ({"LAT": "LAT_S"}, {"LAT": ["33.1"] * COUNT}, "positive south"),
        ({"LAT": "Colatitude"}, {"LAT": ["33.1"] * COUNT}, "colatitudes"),
        ({"HGT": "depth"}, {}, "positive down"),
    ],
)
def test_a_name_that_contradicts_its_key_is_refused(renamed, cells, said, tmp_path):
    with pytest.raises(MapError, match=said):
        read(tmp_path, renamed, cells)


def test_coordinates_that_could_be_radians_are_refused_unless_their_unit_is_stated(tmp_path):
    cells = {name: [f"{np.radians(float(v)):.9f}" for v in CELLS[name]] for name in ("LAT", "LONG")}
    with pytest.raises(MapError, match="could be radians"):
        read(tmp_path, cells=cells)
    stated = {"LAT": "LAT [rad]", "LONG": "LONG [rad]"}
    np.testing.assert_allclose(read(tmp_path, stated, cells).latitude_deg[0], -33.0, atol=1e-6)
    near_zero = {"LAT": "LAT [deg]", "LONG": "LONG [deg]"}
    assert read(tmp_path, near_zero, cells).latitude_deg[0] < -0.5


@pytest.mark.parametrize(
    "name", ["ALT_MSL", "Alt [m above mean sea level]", "Alt (m AMSL)", "Orthometric height", "AHD"]
)
def test_heights_above_sea_level_are_made_ellipsoidal(name, tmp_path):
    lines = read(tmp_path, {"HGT": name})
    geoid = geoid_heights(lines.latitude_deg, lines.longitude_deg)
    np.testing.assert_allclose(lines.height_m, HEIGHTS + geoid, atol=0.1)
    assert any("above sea level" in remark for remark in lines.remarks)


@pytest.mark.parametrize("name", ["RADALT", "RALT", "Clearance", "Height above ground", "HAG"])
def test_heights_above_the_ground_are_remarked_on(name, tmp_path):
    lines = read(tmp_path, {"HGT": name})
    assert any("above the ground" in remark for remark in lines.remarks)
