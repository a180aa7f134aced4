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


def read(
    folder,
    renamed=None,
    cells=None,
    key="zz",
    quantity="gradient",
    columns=None,
    above="",
    below="",
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
        ({"LAT": "LONGITUDE", "LONG": "LATITUDE"}, {}, "columns are swapped"),
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
    "name",
    ["ALT_MSL", "Alt [m above mean sea level]", "Alt (m AMSL)", "OrthoHeight", "MSLALT", "AHD"],
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


@pytest.mark.parametrize("name", ["FAA", "GRAV", "gz", "FREE_AIR", "Gravity"])
def test_a_column_of_gravity_is_no_gradient(name, tmp_path):
    with pytest.raises(MapError, match=r"gravity by its name|is not a gradient"):
        read(tmp_path, {"VALUE": name})


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("LatCorr", "a correction"),
        ("Theoretical gravity", "normal gravity"),
        ("IGF", "normal gravity"),
        ("TC", "a correction"),
        ("FAA_ERR", "an error"),
        ("MagTF", "a magnetic field"),
    ],
)
def test_a_column_of_another_quantity_is_no_disturbance(name, said, tmp_path):
    with pytest.raises(MapError, match=said):
        read(tmp_path, {"VALUE": name}, key="disturbance", quantity="disturbance")


@pytest.mark.parametrize("name", ["Tzz_tc", "gDD_2p67", "Gzz terrain corrected", "Tzz_267"])
def test_values_corrected_for_terrain_are_remarked_on(name, tmp_path):
    assert any("corrected for the terrain" in r for r in read(tmp_path, {"VALUE": name}).remarks)


def test_a_row_of_units_below_the_names_is_obeyed(tmp_path):
    lines = read(tmp_path, below="-,s,deg,deg,ft,E\n")
    np.testing.assert_allclose(lines.height_m, 0.3048 * HEIGHTS)
    assert len(lines.line) == COUNT


def test_a_comment_of_units_below_the_names_is_obeyed(tmp_path):
    rows = [" ".join(CELLS[name][n] for name in CELLS if name != "LINE") for n in range(COUNT)]
    names = "/ FID LAT LONG HGT VALUE\n"
    path = tmp_path / "s.xyz"
    path.write_text(f"{names}/ s deg deg ft Eo\nLine 10\n" + "\n".join(rows) + "\n")
    keys = {key: name for key, name in KEYS.items() if key != "line"} | {"zz": "VALUE"}
    np.testing.assert_allclose(read_lines(path, keys).height_m, 0.3048 * HEIGHTS)


@pytest.mark.parametrize("comment", ["% made by a program\n", "// a survey\n", "# a survey\n"])
def test_comments_above_the_names(comment, tmp_path):
    np.testing.assert_allclose(read(tmp_path, above=comment).height_m, HEIGHTS)


@pytest.mark.parametrize(
    ("above", "said"),
    [("# datum NAD27\n", "datum NAD27"), ("# heights above mean sea level\n", "above sea level")],
)
def test_datums_in_comments_are_remarked_on(above, said, tmp_path):
    assert any(said in remark for remark in read(tmp_path, above=above).remarks)
    assert read(tmp_path, above="# a survey in WGS84\n").remarks == ()


@pytest.mark.parametrize("name", ["LAT_AGD66", "Latitude NAD27", "LAT_ED50"])
def test_coordinates_of_an_old_datum_need_its_code(name, tmp_path):
    with pytest.raises(MapError, match="give --crs"):
        read(tmp_path, {"LAT": name})


@pytest.mark.parametrize(
    ("column", "cell", "said"),
    [
        ("LAT", "33.1S", "write degrees with a sign"),
        ("LAT", "33°06'S", "write degrees with a sign"),
        ("HGT", '"400,5"', "not a decimal comma"),
        ("VALUE", "N/A", "leave missing values empty"),
        ("FID", "noon", "seconds or hh:mm:ss"),
    ],
)
def test_what_a_cell_may_hold_is_said(column, cell, said, tmp_path):
    with pytest.raises(MapError, match=said):
        read(tmp_path, cells={column: [cell] * COUNT})


def test_a_clock_that_stops_is_refused_with_its_line(tmp_path):
    cells = {"FID": [f"10:00:{n:02d}" for n in range(COUNT - 1)] + ["noon"]}
    with pytest.raises(MapError, match="line 13: FID is 'noon' and must be a time"):
        read(tmp_path, cells=cells)


def test_rows_wider_than_the_names_are_refused_unless_their_end_is_empty(tmp_path):
    """Decimal commas would move each value into another column."""
    cells = {"LAT": [cell.replace(".", ",") for cell in CELLS["LAT"]]}
    with pytest.raises(MapError, match="line 2 has 7 fields, but there are 6 columns"):
        read(tmp_path, cells=cells)
    ended = {"VALUE": [cell + "," for cell in CELLS["VALUE"]]}
    np.testing.assert_allclose(read(tmp_path, cells=ended).values[:, 0], VALUES)


def test_columns_without_names_and_stars_are_passed_over(tmp_path):
    cells = {"": ["1"] * COUNT, " ": ["2"] * COUNT}
    found = read(tmp_path, cells=cells | {"VALUE": ["****", *CELLS["VALUE"][1:]]})
    assert found.dropped == 1 and len(found.line) == COUNT - 1


def test_text_in_utf_16_is_named(tmp_path):
    (tmp_path / "s.csv").write_text("LINE,FID\n", encoding="utf-16")
    with pytest.raises(MapError, match="UTF-16 text"):
        read_lines(tmp_path / "s.csv")


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


@pytest.mark.parametrize(
    "text",
    [
        "NAME=Gravity disturbance (um/s^2)",
        "Gravity disturbance in micrometres per second squared",
        "um/s2:Gravity disturbance",
        'UNIT="um/s^2"',
        "Disturbance, gravity units",
    ],
)
def test_a_unit_in_a_description_is_obeyed(text, tmp_path):
    path = gdf2(tmp_path, f"F12.3:{text}")
    found = read_lines(path, KEYS | {"disturbance": "VALUE"}, quantity="disturbance")
    np.testing.assert_allclose(found.values[:, 0], 0.1 * VALUES, atol=1e-4)


def test_fortran_writes_exponents_and_stars(tmp_path):
    values = ["*" * 12, *(f"{v:.4e}".replace("e", "D") for v in VALUES[1:])]
    found = read_lines(gdf2(tmp_path, "D12.4:UNIT=Eo", values), KEYS | {"zz": "VALUE"})
    np.testing.assert_allclose(found.values[:, 0], VALUES[1:], rtol=1e-3)


@pytest.mark.parametrize("form", ["99999999F12.3", "F99999999999.3"])
def test_a_format_without_measure_is_refused_at_once(form, tmp_path):
    with pytest.raises(MapError, match="at most 10000 columns of 10000 characters"):
        read_lines(gdf2(tmp_path, form), KEYS | {"zz": "VALUE"})


def test_a_projection_for_degrees_is_refused(tmp_path):
    read(tmp_path)
    with pytest.raises(MapError, match="a projection in metres, but all coordinates"):
        read_lines(tmp_path / "s.csv", KEYS | {"zz": "VALUE"}, crs="EPSG:32754")
    found = read_lines(tmp_path / "s.csv", KEYS | {"zz": "VALUE"}, crs="EPSG:4283")
    np.testing.assert_allclose(found.latitude_deg[0], -33.0, atol=1e-4)


@pytest.mark.parametrize("name", ["Longitude_DMS", "LONG DDMM", "lon (dms)"])
def test_degrees_minutes_and_seconds_by_name_are_refused(name, tmp_path):
    with pytest.raises(MapError, match=r"decimal degrees|units of longitude_deg"):
        read(tmp_path, {"LONG": name})


@pytest.mark.parametrize(
    ("renamed", "above"), [({"VALUE": "Tzz_NED"}, ""), ({}, "# z axis down\n"), ({}, "# NED\n")]
)
def test_axes_that_are_named_are_remarked_on(renamed, above, tmp_path):
    assert any("give --axes" in remark for remark in read(tmp_path, renamed, above=above).remarks)
