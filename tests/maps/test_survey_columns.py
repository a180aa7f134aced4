"""Names of survey columns: units at the end, signs, swapped coordinates, zero levels of heights."""

from __future__ import annotations

import numpy as np
import pytest
from survey_columns import CELLS, COUNT, HEIGHTS, KEYS, RADIANS, VALUES, gdf2, read

from ggbench.gravity.unit_names import unit_at_end
from ggbench.maps.geoid import geoid_heights
from ggbench.maps.survey_files import read_lines


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


@pytest.mark.parametrize("name", ["Tzz_si", "Tzz_s2", "Tzz_1/s2"])
def test_gradients_per_second_squared_are_converted(name, tmp_path):
    found = read(tmp_path, {"VALUE": name}, {"VALUE": [f"{1e-9 * v:.6g}" for v in VALUES]})
    np.testing.assert_allclose(found.values[:, 0], VALUES, rtol=1e-4)


@pytest.mark.parametrize("name", ["LIFT", "drift", "GPS_H", "h", "field.altitude", "lat_deg"])
def test_words_that_end_as_units_do_are_none(name):
    assert unit_at_end(name, "height_m") == ""


def test_coordinates_that_could_be_radians_are_read_where_their_unit_is_stated(tmp_path):
    stated = {"LAT": "LAT [rad]", "LONG": "LONG [rad]"}
    np.testing.assert_allclose(read(tmp_path, stated, RADIANS).latitude_deg[0], -33.0, atol=1e-6)
    near_zero = {"LAT": "LAT [deg]", "LONG": "LONG [deg]"}
    assert read(tmp_path, near_zero, RADIANS).latitude_deg[0] < -0.5


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


@pytest.mark.parametrize("name", ["Tzz_tc", "gDD_2p67", "Gzz terrain corrected", "Tzz_267"])
def test_values_corrected_for_terrain_are_remarked_on(name, tmp_path):
    assert any(
        "indicates a terrain correction" in r for r in read(tmp_path, {"VALUE": name}).remarks
    )


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


def test_rows_may_end_with_an_empty_field(tmp_path):
    ended = {"VALUE": [cell + "," for cell in CELLS["VALUE"]]}
    np.testing.assert_allclose(read(tmp_path, cells=ended).values[:, 0], VALUES)


def test_columns_without_names_and_stars_are_passed_over(tmp_path):
    cells = {"": ["1"] * COUNT, " ": ["2"] * COUNT}
    found = read(tmp_path, cells=cells | {"VALUE": ["****", *CELLS["VALUE"][1:]]})
    assert found.dropped == 1 and len(found.line) == COUNT - 1


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


def test_degrees_of_a_datum_are_read(tmp_path):
    found = read(tmp_path, crs="EPSG:4283")
    np.testing.assert_allclose(found.latitude_deg[0], -33.0, atol=1e-4)


@pytest.mark.parametrize(
    ("renamed", "above"), [({"VALUE": "Tzz_NED"}, ""), ({}, "# z axis down\n"), ({}, "# NED\n")]
)
def test_axes_that_are_named_are_remarked_on(renamed, above, tmp_path):
    assert any("give --axes" in remark for remark in read(tmp_path, renamed, above=above).remarks)
