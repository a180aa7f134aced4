"""`ggbench map build --lines` as a user meets it: a map with its error, noise, and mistakes."""

from __future__ import annotations

import json
import re

import netCDF4
import numpy as np
import pytest
from click.testing import CliRunner
from made_surveys import survey
from thinning import thinned

from ggbench.cli.main import main
from ggbench.gravity.gradient_map import MapError
from ggbench.maps.recipe import Path, read, write
from ggbench.simulation.field_source import channel_errors
from ggbench.spec.sensors import FieldSpec

SETTINGS = ["--depth", "600", "--source-spacing", "500", "--damping", "0.1"]
COLUMNS = ("time_s", "latitude_deg", "longitude_deg", "height_m")


@pytest.fixture(autouse=True)
def inside(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_csv(survey(noise=1.0, repeats=(2, 5)), "s.csv")


def write_csv(lines, name):
    rows = ["line,kind,time_s,latitude_deg,longitude_deg,height_m," + ",".join(lines.components)]
    for n, line in enumerate(lines.line):
        at = [getattr(lines, key)[n] for key in COLUMNS]
        numbers = [f"{value:.7f}" for value in (*at, *lines.values[n])]
        rows.append(",".join([lines.names[line], lines.kinds[line], *numbers]))
    Path(name).write_text("\n".join(rows))


def run(*words, code=0):
    result = CliRunner().invoke(main, ["map", "build", *map(str, words)])
    assert result.exit_code == code, (result.output, result.exception)
    return " ".join(result.output.split())


def test_a_map_is_stored_with_its_error_and_the_noise_of_the_readings():
    said = run(
        "--lines", "s.csv", "--leave-out", "repeat", *SETTINGS, "-o", "m.nc", "--noise", "n.json"
    )
    assert "Chosen: point masses 500 m apart, 600 m below the flights, damping 0.1" in said
    assert "without repeat: 12 lines" in said
    made = read("m.nc")
    assert np.isfinite(made.standard_error[:6]).all() and np.isnan(made.standard_error[6:]).all()
    with netCDF4.Dataset("m.nc") as file:
        assert file["gradient_uu"].standard_error == pytest.approx(made.standard_error[5])
        assert json.loads(file.parameters)["left_out"] == ["repeat"]
    write("again.nc", made)
    np.testing.assert_array_equal(read("again.nc").standard_error, made.standard_error)
    write("again.nc", made)
    np.testing.assert_array_equal(read("again.nc").error_distance, made.error_distance)
    noise = json.loads(Path("n.json").read_text())
    assert noise["components"] == ["xx", "xy", "xz", "yy", "yz"]
    assert "12 lines of s.csv" in noise["provenance"] and "not repeat" in noise["provenance"]


@thinned("depth", [200, 800, 3000])
@thinned("limits", [[], ["--lowest", "700"], ["--highest", "300"]])
def test_default_bounds_of_lines_at_one_height_always_work(depth, limits):
    """Whatever the depth; as a control, spacings that a user sets too wide are refused."""
    level = survey()
    level.height_m[:] = 80.0
    write_csv(level, "level.csv")
    options = ["--depth", str(depth), "--source-spacing", "500", "--damping", "0.1"]
    run("--lines", "level.csv", *options, *limits, "-o", "m.nc")
    assert min(read("m.nc").tensor.shape[:3]) >= 4
    said = run("--lines", "level.csv", *options, "--height-spacing", "9000", "-o", "m.nc", code=2)
    assert "at least 4 along each axis" in said


def test_rows_of_zeros_are_excluded_and_counted():
    lines = survey(noise=1.0)
    lines.values[100:112] = 0.0
    write_csv(lines, "zero.csv")
    said = run("--lines", "zero.csv", *SETTINGS, "-o", "m.nc")
    assert "xx, xy, xz, yy, yz: rows of zeros read as missing values, 12 times" in said
    assert "12 samples with missing values are excluded" in said


def turned(lines):
    """Axes east, north, down."""
    lines.values[:, [lines.components.index("xz"), lines.components.index("yz")]] *= -1.0


def exchanged(lines):
    """Axes north, east, up."""
    lines.values[:] = lines.values[
        :, [lines.components.index(c) for c in ("yy", "xy", "yz", "xx", "xz")]
    ]


def marked(lines):
    """A missing value with a mark that looks like a number."""
    lines.values[100, 0] = -54321.0


@thinned("spoil", [turned, exchanged, marked])
def test_a_survey_that_no_field_fits_gets_a_warning(spoil):
    """It names components with both numbers. As a control, the right survey gets none."""
    lines = survey()
    write_csv(lines, "right.csv")
    assert "Warning" not in run("--lines", "right.csv", *SETTINGS, "-o", "m.nc")
    spoil(lines)
    write_csv(lines, "wrong.csv")
    said = run("--lines", "wrong.csv", *SETTINGS, "-o", "m.nc")
    warning = said[said.index("Warning: ") : said.index("Standard error")]
    found = re.findall(r"(x[xyz]|y[yz]) ([\d.]+) E and ([\d.]+) E", warning)
    assert found and all(float(left) > 0.7 * float(read) for _, left, read in found)
    expected = {
        turned: "fit best with --axes east-north-down",
        exchanged: "fit best with axes x north, y east, z up",
        marked: "Check axes (--axes), signs, units and void values",
    }
    assert expected[spoil] in warning


@pytest.mark.parametrize("axes", ["east-north-up", "north-east-down"])
def test_axes_that_fit_are_named_whatever_was_said(axes):
    """Lines in axes east, north, down; with the axes that are named there is no warning."""
    lines = survey()
    turned(lines)
    write_csv(lines, "wrong.csv")
    said = run("--lines", "wrong.csv", *SETTINGS, "--axes", axes, "-o", "m.nc")
    assert "fit best with --axes east-north-down" in said
    right = run("--lines", "wrong.csv", *SETTINGS, "--axes", "east-north-down", "-o", "m.nc")
    assert "Warning" not in right


def test_an_error_that_cannot_be_computed_is_neither_stated_nor_stored():
    """As a control, errors that are known are stored, and all are of a right survey (above)."""
    lines = survey()
    turned(lines)
    write_csv(lines, "wrong.csv")
    said = run("--lines", "wrong.csv", *SETTINGS, "-o", "m.nc")
    assert "EN not known" in said and "nan" not in said and " 0.00 E over" not in said
    error = read("m.nc").standard_error[:6]
    assert np.isnan(error[1]) and error[0] > 0.0
    assert np.isnan(read("m.nc").error_distance[1])
    with netCDF4.Dataset("m.nc") as file:
        assert "standard_error" not in file["gradient_en"].ncattrs()
    with pytest.raises(MapError, match="contains no standard error of some components"):
        channel_errors(FieldSpec(source=str(Path("m.nc").resolve())), ["xx"])


def test_what_the_standard_error_leaves_out_is_said_and_stored():
    said = run("--lines", "s.csv", *SETTINGS, "-o", "m.nc")
    assert "exclude errors that are constant along a line" in said
    with netCDF4.Dataset("m.nc") as file:
        assert "exclude the unknown constant of each line" in file.comment


@pytest.mark.parametrize(
    "words, said",
    [
        (["--leave-out", "11x"], "no line has the name or kind '11x'"),
        (["--components", "xx,zx"], "allowed are xx, xy"),
        (["--components", "zz"], "no column 'zz'"),
        (["--column", "xx"], "must be written NAME=COLUMN"),
        (["--quantity", "disturbance"], "no column 'disturbance'"),
        (["--terrain", "dem.asc"], "--lines excludes --terrain"),
        (["--noise", "n.txt"], "must be named *.json"),
        (["--depth", "500", "--lowest", "-700"], "lies below the sources"),
    ],
)
def test_a_mistake_gets_a_sentence(words, said):
    assert said in run("--lines", "s.csv", *SETTINGS, "-o", "m.nc", *words, code=2)


def test_options_of_lines_need_lines():
    said = run("--terrain", "dem.asc", "--leave-out", "1", "-o", "m.nc", code=2)
    assert "--leave-out requires --lines" in said
