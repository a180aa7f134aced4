"""Messages of survey files."""

from __future__ import annotations

import re

import agency_surveys as agencies
import pytest
import survey_columns as columns
import survey_formats as formats
from refusals import refused

from ggbench.gravity.gradient_map import MapError
from ggbench.maps.survey_files import read_lines


def named(folder, value=None, cell=None, **options):
    """A CSV file; ``value`` names its last column, and ``cell`` fills a column with a text."""
    if value:
        options["renamed"] = {"VALUE": value}
    if cell:
        options["cells"] = {cell[0]: [cell[1]] * columns.COUNT}
    columns.read(folder, **options)


def gravity(folder, value):
    named(folder, value, key="disturbance", quantity="disturbance")


def with_format(folder, definition):
    """A file of ASEG-GDF2 whose values have such a format."""
    read_lines(columns.gdf2(folder, definition), columns.KEYS | {"zz": "VALUE"})


def of_agency(
    folder,
    unit="mGal",
    name="GRAV",
    text="",
    key="disturbance",
    quantity="disturbance",
    factor=None,
    cell=None,
    separator=None,
):
    """A file of ASEG-GDF2 with a value's unit, name, description and factor."""
    table = agencies.fields(unit, name, null=text)
    if factor:
        table[-1] = (*table[-1][:-1], [f"{factor * v:.14f}" for v in agencies.VALUES])
    if cell:
        row, column, written = cell
        table[column][-1][row] = written
    path = agencies.gdf2(folder, table, separator=separator)
    read_lines(path, agencies.PLACES | {key: name}, quantity=quantity)


def of_odd_words(folder):
    """One row has a word too many for rows of words, and all are too short for widths."""
    path = agencies.gdf2(folder, agencies.fields("mGal"), separator=" ")
    path.write_text(path.read_text().replace("10020 ", "10020 north ", 1))
    read_lines(path, agencies.DISTURBANCE, quantity="disturbance")


def of_zeros(folder):
    read_lines(agencies.tensor(folder, range(agencies.COUNT)))


def with_cell(folder, row, column, text):
    """A CSV file with a text in one place."""
    read_lines(agencies.csv(folder, cells={(row, column): text}), agencies.OF_CSV)


def in_metres(folder, keys=agencies.OF_PROJECTION, crs=None):
    read_lines(agencies.projected(folder), keys, quantity="disturbance", crs=crs)


def of_format(folder, write=formats.xyz, changed=None, components=()):
    read_lines(write(folder), formats.RENAMED | (changed or {}), components)


def without_definitions(folder):
    path = formats.gdf2(folder)
    (folder / "lines.dfn").unlink()
    read_lines(path)


def of_unnamed_components(folder):
    read_lines(formats.csv(folder), {"xx": "a", "xz": "b"})


def of_text(folder, name, text=None, encoding="utf-8"):
    """A file of any name and text, or none."""
    if text is not None:
        (folder / name).write_text(text, encoding=encoding)
    read_lines(folder / name)


def each(subject, maker, key, texts, message):
    """Rows with one message for several texts."""
    return {f"{subject} {text}": (maker, {key: text}, message) for text in texts}


SWAPPED = {"LAT": "LONGITUDE", "LONG": "LATITUDE"}
COMMAS = {"LAT": [cell.replace(".", ",") for cell in columns.CELLS["LAT"]]}
STOPPED = {"FID": [f"10:00:{n:02d}" for n in range(columns.COUNT - 1)] + ["noon"]}
SOUTH = ("LAT", "33.1")
METRES = "line,time_s,latitude_deg,longitude_deg,height_m,xx\n" + "1,1,3327615,436298,80,1\n" * 5
TOO_SMALL = "smaller than the noise of any instrument: state the unit"
GRADIENT = {"key": "zz", "quantity": "gradient"}
BAD = {
    **each(
        "gradients with the name",
        named,
        "value",
        ["Tzz_nT", "Tzz_nTm", "Tzz_nT/m", "Tzz_mGal", "Bzz [nT/m]"],
        "units of zz are",
    ),
    "swapped coordinates": (named, {"renamed": SWAPPED}, "columns are swapped"),
    "short name of west longitudes": (named, {"renamed": {"LONG": "LONG_W"}}, "positive west"),
    "west longitudes": (named, {"renamed": {"LONG": "Longitude West"}}, "positive west"),
    "south latitudes": (named, {"renamed": {"LAT": "LAT_S"}, "cell": SOUTH}, "positive south"),
    "colatitudes": (named, {"renamed": {"LAT": "Colatitude"}, "cell": SOUTH}, "colatitudes"),
    "depths": (named, {"renamed": {"HGT": "depth"}}, "positive down"),
    "radians": (named, {"cells": columns.RADIANS}, "could be radians"),
    **each(
        "gravity for gradients,",
        named,
        "value",
        ["FAA", "GRAV", "gz", "FREE_AIR", "Gravity"],
        r"indicates gravity, not a gradient|is not a gradient",
    ),
    **each("corrections for gravity,", gravity, "value", ["LatCorr", "TC"], "a correction"),
    **each("normal gravity,", gravity, "value", ["Theoretical gravity", "IGF"], "normal gravity"),
    "errors of gravity": (gravity, {"value": "FAA_ERR"}, "an error"),
    "a magnetic field by its name": (gravity, {"value": "MagTF"}, "a magnetic field"),
    **{
        f"coordinates of an old datum, {name}": (named, {"renamed": {"LAT": name}}, "give --crs")
        for name in ("LAT_AGD66", "Latitude NAD27", "LAT_ED50")
    },
    "hemisphere in a cell": (named, {"cell": ("LAT", "33.1S")}, "write degrees with a sign"),
    "minutes in a cell": (named, {"cell": ("LAT", "33°06'S")}, "write degrees with a sign"),
    "quoted decimal comma": (named, {"cell": ("HGT", '"400,5"')}, "not a decimal comma"),
    "words for no value": (named, {"cell": ("VALUE", "N/A")}, "leave missing values empty"),
    "words for times": (named, {"cell": ("FID", "noon")}, "seconds or hh:mm:ss"),
    "a clock that stops": (named, {"cells": STOPPED}, "line 13: FID is 'noon' and must be a time"),
    "decimal commas": (named, {"cells": COMMAS}, "line 2 has 7 fields, but there are 6 columns"),
    **{
        f"degrees and minutes, {name}": (
            named,
            {"renamed": {"LONG": name}},
            r"decimal degrees|units of longitude_deg",
        )
        for name in ("Longitude_DMS", "LONG DDMM", "lon (dms)")
    },
    "a projection for degrees": (
        named,
        {"crs": "EPSG:32754"},
        "a projection in metres, but all coordinates",
    ),
    **each(
        "format",
        with_format,
        "definition",
        ["99999999F12.3", "F99999999999.3"],
        "at most 10000 columns of 10000 characters",
    ),
    "a word too many": (
        of_odd_words,
        {},
        r"6 columns with .* of 69 characters.* rows have 6 to 7 values; .*line 1",
    ),
    **{
        f"gravity in {unit}": (
            of_agency,
            {"unit": unit, "name": "FIELD"},
            f"the column FIELD is in '{unit}'; units of disturbance are",
        )
        for unit in ("nT", "Eotvos")
    },
    **{
        f"gradients in {unit}": (
            of_agency,
            {"unit": unit, "name": "FIELD", **GRADIENT},
            f"the column FIELD is in '{unit}'; units of zz are",
        )
        for unit in ("mGal", "nT", "furlong")
    },
    "gradients per second squared": (
        of_agency,
        {"unit": "", "name": "FIELD", "factor": 1e-9, "separator": " ", **GRADIENT},
        TOO_SMALL,
    ),
    "gravity in metres per second squared": (
        of_agency,
        {"unit": "", "name": "FIELD", "factor": 1e-5, "separator": " "},
        TOO_SMALL,
    ),
    "short name of Bouguer": (of_agency, {"name": "BA_TC"}, "Bouguer or isostatic"),
    "Bouguer with a density": (of_agency, {"name": "GBA267"}, "Bouguer or isostatic"),
    "Bouguer by description": (of_agency, {"text": "NAME=Complete Bouguer"}, "Bouguer"),
    "free air by name": (of_agency, {"name": "FREE_AIR"}, "--quantity anomaly --column"),
    "free air by description": (
        of_agency,
        {"text": "NAME=Free air anomaly"},
        "--quantity anomaly --column anomaly=GRAV",
    ),
    "observed gravity": (of_agency, {"name": "OBS_GRAV"}, "observed gravity"),
    "total magnetic intensity": (of_agency, {"name": "TMI"}, "magnetic"),
    "a disturbance for an anomaly": (
        of_agency,
        {"text": "NAME=Gravity disturbance", "key": "anomaly", "quantity": "anomaly"},
        "--quantity disturbance --column disturbance=GRAV",
    ),
    "zeros alone": (of_zeros, {}, "xx, xy, zz are 0 in all samples"),
    "a value that no field has": (
        of_agency,
        {"cell": (7, 5, "123456.0"), "separator": " "},
        r"line 8: disturbance is 123456; .*--void",
    ),
    "a line without a name": (
        with_cell,
        {"row": 3, "column": 0, "text": " "},
        "line 5: Line is empty",
    ),
    "a line without a kind": (
        with_cell,
        {"row": 3, "column": 6, "text": " "},
        "line 5: kind is empty",
    ),
    "a word for a number": (
        with_cell,
        {"row": 3, "column": 5, "text": "high"},
        "line 5: Tzz is 'high' and must be a number",
    ),
    "a decimal comma": (
        with_cell,
        {"row": 3, "column": 5, "text": "1,2"},
        "line 5 has 8 fields, but there are 7 columns",
    ),
    "metres without a projection": (
        in_metres,
        {"keys": agencies.DISTURBANCE},
        "LONG is in 'm'; units of longitude_deg are deg",
    ),
    "unknown projection": (
        in_metres,
        {"crs": "EPSG:0"},
        "--crs EPSG:0 is not a coordinate reference system",
    ),
    "eastings without a projection": (in_metres, {}, "has no column 'longitude_deg'"),
    "a component's column is not there": (
        of_format,
        {"changed": {"xx": "Tzz"}, "components": ("xx",)},
        "no column 'Tzz'; name it, as in --column xx=COLUMN; it has Time",
    ),
    "a component is not there": (of_format, {"components": ("xx", "yy")}, "no column 'yy'"),
    "unknown key of a column": (
        of_format,
        {"changed": {"heigth": "Alt"}},
        r"--column heigth=\.\.\. has an unknown key; known: line, kind",
    ),
    "a component twice": (of_format, {"components": ("xx", "xx")}, "each at most once"),
    "heights are not there": (of_format, {"changed": {"height_m": "Height"}}, "no column 'Height'"),
    "no component at all": (of_unnamed_components, {}, "no column of a component"),
    "no definitions": (without_definitions, {}, r"needs its definition file lines\.dfn"),
    "unknown suffix": (of_text, {"name": "lines.txt"}, r"must be named \*\.xyz"),
    "no file": (of_text, {"name": "none.csv"}, "cannot read the survey"),
    "no names of columns": (
        of_text,
        {"name": "bad.xyz", "text": "Line 1\n1 2 3\n"},
        "names its 3 columns",
    ),
    "metres for degrees": (
        of_text,
        {"name": "m.csv", "text": METRES},
        "for metres in a projection give --crs",
    ),
    "UTF-16": (
        of_text,
        {"name": "s.csv", "text": "LINE,FID\n", "encoding": "utf-16"},
        "UTF-16 text",
    ),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_survey_is_refused_in_one_sentence(kind, tmp_path):
    make, options, message = BAD[kind]
    with refused(MapError, message):
        make(tmp_path, **options)


@pytest.mark.parametrize(
    ("key", "quantity", "factor", "unit"),
    [("zz", "gradient", 1e-9, "s^-2"), ("disturbance", "disturbance", 1e-5, "m/s2")],
)
def test_the_units_of_too_small_values_are_both_named(key, quantity, factor, unit, tmp_path):
    """With the first option of the message, the values are those of the survey."""
    table = agencies.fields("", "FIELD")
    table[-1] = (*table[-1][:-1], [f"{factor * v:.14f}" for v in agencies.VALUES])
    path = agencies.gdf2(tmp_path, table, separator=" ")
    with pytest.raises(MapError, match=TOO_SMALL) as caught:
        read_lines(path, agencies.PLACES | {key: "FIELD"}, quantity=quantity)
    options = re.findall("--column 'KEY=(FIELD .*?)'", str(caught.value))
    assert options == [f"FIELD [{unit}]", "FIELD [E]" if key == "zz" else "FIELD [mGal]"]
    lines = read_lines(path, agencies.PLACES | {key: options[0]}, quantity=quantity)
    assert lines.values[:, 0] == pytest.approx(agencies.VALUES, abs=1e-4)
