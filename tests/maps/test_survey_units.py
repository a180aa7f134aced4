"""Survey files as agencies write them: formats, units, quantities, missing values, coordinates."""

from __future__ import annotations

import numpy as np
import pytest
from agency_surveys import (
    COUNT,
    DISTURBANCE,
    HEIGHTS,
    LATITUDES,
    LINES,
    LONGITUDES,
    OF_CSV,
    OF_PROJECTION,
    PLACES,
    TIMES,
    VALUES,
    csv,
    fields,
    gdf2,
    projected,
    tensor,
)

from ggbench.maps.geoid import geoid_heights
from ggbench.maps.survey_files import read_lines

STYLES = ("standard", "record", "identifier", "colons", "comma", "units", "described")


def is_the_survey(lines, factor=1.0):
    assert lines.names == ("10010", "10020", "90010")
    np.testing.assert_allclose(lines.values[:, 0], factor * VALUES, atol=1e-3)
    np.testing.assert_allclose(lines.height_m, HEIGHTS, atol=0.01)
    np.testing.assert_allclose(lines.latitude_deg, LATITUDES)
    np.testing.assert_allclose(lines.time_s, TIMES)
    return True


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("separator", [None, " ", "\t", ","])
def test_definitions_and_rows_as_agencies_write_them(style, separator, tmp_path):
    path = gdf2(tmp_path, fields("mGal"), style, separator)
    assert is_the_survey(read_lines(path, DISTURBANCE, quantity="disturbance"))


@pytest.mark.parametrize("numbered", ["DEFN{:03d}", "DEFN  {} ", "defn {} "])
def test_numbers_of_definitions(numbered, tmp_path):
    path = gdf2(tmp_path, fields("mGal"), "record", numbered=numbered)
    assert is_the_survey(read_lines(path, DISTURBANCE, quantity="disturbance"))


def test_several_fields_of_one_definition_and_columns_of_a_field(tmp_path):
    table = fields("mGal")
    path = gdf2(tmp_path, table)
    definitions = [f"{name}:{form}:{text}" for name, form, _, text, _ in table]
    definitions.insert(5, "SPEC:3F5.1:UNIT=CPS,NULL=-9.0")
    (tmp_path / "s.dfn").write_text(f"DEFN 1 ST=RECD,RT=;{';'.join(definitions)};END DEFN\n")
    rows = path.read_text().splitlines()
    path.write_text("\n".join(f"{row[:55]}  1.0  2.0  3.0{row[55:]}" for row in rows))
    assert is_the_survey(read_lines(path, DISTURBANCE, quantity="disturbance"))


def test_a_text_with_blanks_is_read_by_widths_and_a_cut_row_is_left_out(tmp_path):
    table = fields("mGal")
    table.insert(1, ("AIRCRAFT", "A20", 20, "", ["Cessna 208 B"] * COUNT))
    path = gdf2(tmp_path, table)
    path.write_text(path.read_text() + "   90010")
    found = read_lines(path, DISTURBANCE, quantity="disturbance")
    assert is_the_survey(found) and found.dropped == 1


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("mGal", 1.0),
        ("micrometres_per_second_squared", 0.1),
        ("um/s^2", 0.1),
        ("µm/s²", 0.1),
        ("gu", 0.1),
        ("uGal", 1e-3),
        ("m/s2", 1e5),
        ("", 1.0),
    ],
)
def test_the_unit_of_gravity_is_obeyed(unit, factor, tmp_path):
    """In a definition, and in brackets of CSV and XYZ; without one an assumption is remarked."""
    written = VALUES / factor
    table = fields(unit, values=written)
    table[-1] = (*table[-1][:-1], [f"{v:.8f}" for v in written])
    paths = [gdf2(tmp_path, table, separator="\t")]
    head = f"LINE,FID,LAT,LONG,HGT,GRAV [{unit}]" if unit else "LINE,FID,LAT,LONG,HGT,GRAV"
    paths.append(tmp_path / "s.csv")
    rows = [",".join(cells[n] for *_, cells in table) for n in range(COUNT)]
    paths[1].write_text("\n".join([head, *rows]))
    for path in paths:
        found = read_lines(path, DISTURBANCE, quantity="disturbance")
        assert is_the_survey(found)
        assert any("mGal assumed" in remark for remark in found.remarks) == (unit == "")
        assert any("converted" in remark for remark in found.remarks) == (factor != 1.0)


def test_units_of_places_and_times_are_obeyed(tmp_path):
    feet = gdf2(tmp_path, fields("mGal", height_unit="feet", heights=HEIGHTS / 0.3048))
    assert is_the_survey(read_lines(feet, DISTURBANCE, quantity="disturbance"))
    table = fields("mGal")
    table[1] = ("FID", "F14.7", 14, "UNIT=hours", [f"{v / 3600.0:.7f}" for v in TIMES])
    hours = read_lines(gdf2(tmp_path, table), DISTURBANCE, quantity="disturbance")
    np.testing.assert_allclose(hours.time_s, TIMES, atol=1e-3)
    clock = [f"{int(t // 3600):02d}:{int(t % 3600 // 60):02d}:{t % 60:04.1f}" for t in TIMES]
    table[1] = ("FID", "A12", 12, "", clock)
    assert is_the_survey(read_lines(gdf2(tmp_path, table), DISTURBANCE, quantity="disturbance"))


@pytest.mark.parametrize(("unit", "factor"), [("E", 1.0), ("s^-2", 1e9), ("1e-9 s-2", 1.0)])
def test_the_unit_of_gradients_is_obeyed(unit, factor, tmp_path):
    table = fields(unit)
    table[-1] = (*table[-1][:-1], [f"{v / factor:.14f}" for v in VALUES])
    path = gdf2(tmp_path, table, separator=" ")
    assert is_the_survey(read_lines(path, PLACES | {"zz": "GRAV"}))


@pytest.mark.parametrize(("quantity", "factor"), [("gradient", 1e-9), ("disturbance", 1e-5)])
def test_values_too_small_for_any_instrument_are_read_with_their_unit(quantity, factor, tmp_path):
    """As gradients in s⁻² and gravity in m/s²."""
    table = fields(name="FIELD")
    table[-1] = (*table[-1][:-1], [f"{factor * v:.14f}" for v in VALUES])
    path = gdf2(tmp_path, table, separator=" ")
    key, unit, si = {
        "gradient": ("zz", "E", "s^-2"),
        "disturbance": ("disturbance", "mGal", "m/s2"),
    }[quantity]
    found = read_lines(path, PLACES | {key: f"FIELD [{si}]"}, quantity=quantity)
    assert is_the_survey(found)
    tiny = read_lines(path, PLACES | {key: f"FIELD [{unit}]"}, quantity=quantity)
    assert is_the_survey(tiny, factor)


@pytest.mark.parametrize("name", ["GFAAGU", "GFAAMGAL", "FREE_AIR_UGAL"])
def test_a_unit_at_the_end_of_a_name_is_obeyed(name, tmp_path):
    factor = {"GU": 0.1, "AL": 1.0}[name[-2:]] if "UGAL" not in name else 1e-3
    path = gdf2(tmp_path, fields(name=name))
    found = read_lines(path, PLACES | {"anomaly": name}, quantity="anomaly")
    step = np.diff(found.values[:, 0])[:5]
    np.testing.assert_allclose(step, factor * np.diff(VALUES)[:5], atol=0.02)


def test_a_gravity_disturbance_by_its_description_is_one(tmp_path):
    neutral = gdf2(tmp_path, fields("mGal", "GRAV", null="NAME=Gravity disturbance"))
    assert is_the_survey(read_lines(neutral, DISTURBANCE, quantity="disturbance"))


def test_the_unit_of_the_user_comes_before_that_of_the_definition(tmp_path):
    path = gdf2(tmp_path, fields("furlong", "FIELD"))
    assert is_the_survey(read_lines(path, PLACES | {"zz": "FIELD [E]"}))


def test_an_anomaly_becomes_a_disturbance_by_the_height_of_the_geoid(tmp_path):
    """0.3086 mGal a metre.

    Geoscience Australia's heights of the geoid near 33.0° S, 142.1° E are 9.0 to 9.1 m.
    """
    path = gdf2(tmp_path, fields("mGal", "FREE_AIR"))
    found = read_lines(path, PLACES | {"anomaly": "FREE_AIR"}, quantity="anomaly")
    geoid = geoid_heights(LATITUDES, LONGITUDES)
    np.testing.assert_allclose(found.values[:, 0] - VALUES, 0.3086 * geoid, atol=0.02)
    assert found.components == ("disturbance",) and found.unit == "mGal"
    np.testing.assert_allclose(geoid, 9.0, atol=1.5)


MARKS = ["-9999.999", "-99999.00", "-1.0E+32", "9999.99", "-999.99", "1.70141e38", "-32768"]


@pytest.mark.parametrize("mark", MARKS)
def test_marks_of_missing_values_that_are_not_declared(mark, tmp_path):
    """They are left out and counted, in every column that is read."""
    for column in (4, 5):
        table = fields("mGal")
        table[column][-1][8:10] = [mark] * 2
        found = read_lines(
            gdf2(tmp_path, table, separator=" "), DISTURBANCE, quantity="disturbance"
        )
        assert found.dropped == 2 and len(found.values) == COUNT - 2
        assert any(
            f"undeclared values {mark} are treated as missing (2 times)" in r for r in found.remarks
        )


@pytest.mark.parametrize("components", [(), ("xx",), ("zz", "xy")])
def test_rows_of_zeros_are_missing_values(components, tmp_path):
    """Whichever components are used; as a control, a 0 beside other values is a value."""
    found = read_lines(tensor(tmp_path, (2, 9)), components=components)
    assert found.dropped == 2 and len(found.values) == COUNT - 2
    np.testing.assert_array_equal(found.time_s, np.delete(TIMES, (2, 9)))
    assert "xx, xy, zz: rows of zeros read as missing values, 2 times" in found.remarks
    found = read_lines(tensor(tmp_path, (2, 9), ("xx", "xy")), components=components)
    assert found.dropped == 0 and len(found.values) == COUNT
    assert not any("zeros" in remark for remark in found.remarks)


def test_zeros_of_one_component_are_values(tmp_path):
    path = tensor(tmp_path, (2, 9))
    path.write_text(path.read_text().replace("xx,xy,zz", "a,b,zz"))
    assert read_lines(path).dropped == 0
    assert read_lines(path, voids=(0.0,)).dropped == 2


def test_marks_that_are_declared_and_values_of_nines(tmp_path):
    """As a control, 99.99 mGal among values of up to 100 mGal is one of them."""
    table = fields("mGal", null="NULL=-777.5")
    table[5][-1][2] = "-777.5"
    found = read_lines(gdf2(tmp_path, table), DISTURBANCE, quantity="disturbance")
    assert found.dropped == 1 and not any("undeclared" in r for r in found.remarks)
    table = fields("mGal")
    table[5][-1][:3] = ["100.000", "99.99", "-777.5"]
    path = gdf2(tmp_path, table)
    assert read_lines(path, DISTURBANCE, quantity="disturbance").dropped == 0
    found = read_lines(path, DISTURBANCE, quantity="disturbance", voids=(-777.5,))
    assert found.dropped == 1


HEADINGS = ["Line {}", "L{}", "LINE:{}", "Line  {} 2008/07/03", "line {}", "Line {} Flight 7"]


def test_blank_numbers_are_missing_values(tmp_path):
    assert is_the_survey(read_lines(csv(tmp_path), OF_CSV))
    assert read_lines(csv(tmp_path, cells={(3, 5): ""}), OF_CSV).dropped == 1


@pytest.mark.parametrize("heading", HEADINGS)
@pytest.mark.parametrize("tie", [False, True])
def test_headings_of_geosoft(heading, tie, tmp_path):
    if tie and heading[:1] == "L":
        heading = heading.replace("Line", "Tie").replace("LINE", "TIE").replace("L{", "T{")
    path = tmp_path / "s.xyz"
    rows = ["/ XYZ EXPORT", "/ FID LAT LONG HGT Tzz"]
    table = fields()[1:]
    for line in dict.fromkeys(LINES):
        rows.append(heading.format(line))
        rows += [" ".join(c[n] for *_, c in table) for n in np.flatnonzero(line == LINES)]
    path.write_text("\n".join(rows))
    found = read_lines(path, PLACES | {"line": "line", "zz": "Tzz"})
    assert is_the_survey(found)
    assert found.kinds == ("tie" if "T" in heading[:1] else "primary",) * 3


def test_coordinates_of_a_projection_are_read_with_its_name(tmp_path):
    """They are where they were, to a centimetre."""
    path = projected(tmp_path)
    found = read_lines(path, OF_PROJECTION, quantity="disturbance", crs="EPSG:32754")
    np.testing.assert_allclose(found.latitude_deg, LATITUDES, atol=1e-7)
    np.testing.assert_allclose(found.longitude_deg, LONGITUDES, atol=1e-7)


def test_a_survey_without_times_is_a_map_without_noise(tmp_path):
    names = {key: name for key, name in DISTURBANCE.items() if key != "time_s"}
    found = read_lines(gdf2(tmp_path, fields("mGal")), names, quantity="disturbance")
    assert np.isnan(found.time_s).all() and found.dropped == 0
    assert any("no time_s" in remark for remark in found.remarks)
