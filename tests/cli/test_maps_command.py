"""`ggbench map` as a user meets it: maps of every kind of source, pictures, one-sentence errors."""

from __future__ import annotations

import json
import math
import shlex
from dataclasses import replace
from importlib.resources import files

import netCDF4
import numpy as np
import pandas as pd
import pytest
import rasterio
import xarray
from click.testing import CliRunner
from command import invoke
from grids import write_grid
from matplotlib.image import imread
from problems import SMALL
from random_harmonics import write_gfc
from rasterio.transform import from_origin
from shipped_fields import disturbing_field
from small_cases import blank_map
from thinning import thinned

from ggbench.cli.main import main
from ggbench.figures.numbers import short
from ggbench.gravity import ellipsoid
from ggbench.gravity.degraded_map import MapDegradation, degrade
from ggbench.gravity.field import Field
from ggbench.gravity.harmonics import gravity_and_gradient, without_normal_field
from ggbench.maps.gravity_model import read_model
from ggbench.maps.recipe import Path, read, write
from ggbench.maps.shipped_parts import COEFFICIENTS, disturbing_coefficients

DATA = files("ggbench.scenarios") / "data"
GEOID = DATA / "egm2008_geoid_2.5min_qinling.npz"
RELIEF = DATA / "itu_p1511_5min_qinling.npz"
DEM = DATA / "jacksboro_dem_3arcsec.npz"
BOX = ["--south", "33.2", "--north", "33.6", "--west", "108", "--east", "108.5"]
HEIGHTS = ["--lowest", "9000", "--highest", "11000", "--height-spacing", "500"]


@pytest.fixture(autouse=True)
def inside(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def run(*words, code=0):
    result = CliRunner().invoke(main, ["map", *map(str, words)])
    assert result.exit_code == code, (result.output, result.exception)
    return " ".join(result.output.split())


def test_a_geoid_gives_the_map_that_the_package_makes_of_it():
    """The shipped region as if it were a user's own, with and without the relief."""
    for land, words in ((True, ["--land-correction", RELIEF]), (False, [])):
        own_words = ["--geoid", GEOID, *words, *BOX, *HEIGHTS, "--precision", "float64"]
        run("build", "-o", "own.nc", *own_words)
        own = read(Path("own.nc"))
        axes = [
            first + step * np.arange(count)
            for first, step, count in zip(
                (own.latitude0, own.longitude0, own.height0),
                (own.latitude_step, own.longitude_step, own.height_step),
                own.tensor.shape,
                strict=False,
            )
        ]
        tensor, vector = disturbing_field("egm2008_qinling", *axes, land_correction=land)
        assert np.abs(own.tensor - tensor).max() < 2e-5
        assert np.abs(own.gravity_disturbance - vector).max() < 1e-8
        assert math.degrees(axes[0][-1]) >= 33.6 - 1e-9


def test_coefficients_give_their_synthesis():
    write_gfc(Path("model.gfc"), 60)
    words = "build -o map.nc --coefficients model.gfc --max-degree 50 --spacing-arcmin 5"
    output = run(*words.split(), *BOX, *HEIGHTS)
    assert "degree 2 to 50" in output
    field = Field.from_map(read(Path("map.nc")))
    model = without_normal_field(read_model(Path("model.gfc"), 50).coefficients)
    place = (math.radians(33.37), math.radians(108.22), 9810.0)
    vector, tensor = gravity_and_gradient(model, *([x] for x in place))
    normal = Field.normal().tensor(*place)
    np.testing.assert_allclose(field.tensor(*place) - normal, tensor[0, 0, 0], atol=1e-4)
    np.testing.assert_allclose(field.gravity_disturbance(*place), vector[0, 0, 0], atol=1e-9)


@pytest.mark.parametrize(("kind", "unit"), [("anomaly", "mGal"), ("disturbance", "m s-2")])
def test_a_grid_of_gravity_gives_the_field_that_it_was_made_of(kind, unit):
    """EGM2008 to degree 120 as a grid, against harmonics to degree 60 removed and restored."""
    model = disturbing_coefficients(COEFFICIENTS)
    step, shape = 0.25, (57, 61)
    latitude, longitude = (
        np.radians(first + step * np.arange(count))
        for first, count in zip((26.0, 100.0), shape, strict=True)
    )
    from ggbench.gravity.harmonics import potential

    values = -gravity_and_gradient(model, latitude, longitude, [0.0])[0][:, :, 0, 2]
    if kind == "anomaly":
        gamma = np.array([ellipsoid.normal_gravity(a, 0.0) for a in latitude])
        ratio = (gamma[:, 2] / gamma[:, 0])[:, np.newaxis]
        values = 1e5 * (values + ratio * potential(model, latitude, longitude, [0.0])[:, :, 0])
    write_grid("grid.nc", "gravity", unit, values, south=26.0, west=100.0, step=step)
    words = f"build -o map.nc --{kind} grid.nc --max-degree 60 --spacing-arcmin 2"
    run(*words.split(), *BOX, *HEIGHTS)
    made = read(Path("map.nc"))
    at = [[made.latitude0], [made.longitude0], [made.height0]]
    _, whole = gravity_and_gradient(model, *at)
    _, low = gravity_and_gradient(model.between(2, 60), *at)
    error = np.abs(made.tensor[0, 0, 0] - whole[0, 0, 0]).max()
    assert error < 0.05 * np.abs(whole - low).max()


def test_a_grid_of_icgem_says_itself_where_it_holds():
    """Rows from north to south; the height is the file's, and no map can lie below it."""
    latitude, longitude = np.arange(38.0, 27.9, -0.25), np.arange(103.0, 114.1, 0.25)
    values = 30.0 * np.add.outer(np.sin(4.0 * latitude), np.cos(3.0 * longitude))
    head = [
        f"latitude_parallels {latitude.size}",
        f"longitude_parallels {longitude.size}",
        "unit mgal",
        "height_over_ell 2000.0 m",
        "gapvalue 9999999.0",
        "",
        "longitude latitude gravity_disturbance",
        "end_of_head ===",
    ]

    def write(path, extra=""):
        rows = [
            f"{lon} {lat} {extra} {values[i, j]}"
            for i, lat in enumerate(latitude)
            for j, lon in enumerate(longitude)
        ]
        Path(path).write_text("\n".join([*head, *rows]))

    write("grid.gdf")
    write_grid("grid.nc", "g", "mGal", values[::-1], south=28.0, west=103.0, step=0.25)
    tensors = []
    for words in (["grid.gdf"], ["grid.nc", "--grid-height", 2000]):
        run("build", "-o", "map.nc", "--disturbance", *words, *BOX, "--spacing-arcmin", 5)
        tensors.append(read(Path("map.nc")).tensor)
    np.testing.assert_allclose(*tensors, atol=1e-6)
    words = ["build", "-o", "map.nc", "--disturbance", "grid.gdf", *BOX]
    assert "at least 2000 m is allowed" in run(*words, "--lowest", 1000, code=2)
    assert "refers to a height of 2000 m, not to" in run(*words, "--grid-height", 1000, code=2)
    assert "a geoid in 'mgal'; metres" in run(*words[:3], "--geoid", "grid.gdf", code=2)
    write("grid.gdf", "178.0")
    assert "values on the topography" in run(*words, code=2)
    Path("grid.gdf").write_text("\n".join([*head, "103.0 38.0 x"]))
    assert "is not a grid in the format of ICGEM" in run(*words, code=2)


@pytest.mark.long
def test_a_terrain_map_says_all_about_itself(monkeypatch):
    """With bounds, heights and spacing of its own; shown, drawn, in its file."""
    output = run(
        "build",
        "-o",
        "dem.nc",
        "--terrain",
        DEM,
        "--density",
        2600,
        "--west",
        275.65,
        "--lowest",
        1600,
    )
    assert "longitude: -84.35° to" in output
    assert "a map from a terrain alone contains only the attraction" in output
    assert "Wrote dem.nc" in output
    with xarray.open_dataset("dem.nc") as data:
        attributes, heights = data.attrs, data["height"].to_numpy()
        rms = float(np.sqrt((data["gradient_uu"].isel(height=0) ** 2).mean()))
    assert json.loads(attributes["parameters"])["density_kg_m3"] == 2600.0
    sha256 = json.loads(attributes["source_files"])[DEM.name]
    assert len(sha256) == 64
    assert str(DEM.parent) not in " ".join(map(str, attributes.values()))
    assert attributes["history"].endswith(
        "--terrain jacksboro_dem_3arcsec.npz --density 2600.0 --west 275.65 --lowest 1600.0"
    )

    shown = run("show", "dem.nc", "-o", "dem.png", "--height", 2000)
    for words in ("kg/m³", "East-North-Up", sha256, f" {rms:.3g} ", f"{heights[0]:g} m to"):
        assert words in shown
    picture = imread("dem.png")
    assert picture.shape[1] > 800
    assert picture.std() > 0.05


@pytest.mark.long
def test_a_sum_is_finer_than_its_coefficients():
    """The terrain adds to the harmonics what is beyond them, and no more than it has."""
    write_gfc(Path("model.gfc"), 180)
    degrees = np.arange(241) / 60.0  # four by four, with waves of 2 and of a third of a degree
    waves = [500.0 * np.sin(np.pi * degrees), 150.0 * np.sin(6.0 * np.pi * degrees)]
    relief = 1000.0 + sum(np.add.outer(wave, wave) for wave in waves)
    np.savez("relief.npz", lat=30.0 + degrees, lon=100.0 + degrees, z=relief)
    box = [*BOX, "--spacing-arcmin", 5, *HEIGHTS]
    box[1:8:2] = [31, 33, 101, 103]
    made = {}
    for name, words in (
        ("sum", ["--coefficients", "model.gfc", "--terrain", "relief.npz"]),
        ("terrain", ["--terrain", "relief.npz"]),
        ("coefficients", ["--coefficients", "model.gfc"]),
    ):
        output = run("build", "-o", "map.nc", *words, *box)
        made[name] = read(Path("map.nc")).tensor
        assert ("the spacing of 300″ exceeds" in output) == ("terrain" in words[-2])
    added, whole = made["sum"] - made["coefficients"], made["terrain"]
    assert 0.1 < added.std() / whole.std() < 1.0
    assert np.corrcoef(added[..., 5].ravel(), whole[..., 5].ravel())[0, 1] > 0.8
    sources = "--coefficients model.gfc --terrain relief.npz --terrain-from-degree 2000"
    run("build", "-o", "map.nc", *sources.split(), *box)
    nothing_left = read(Path("map.nc")).tensor - made["coefficients"]
    assert nothing_left.std() < 0.02 * added.std()


BAD = {
    "nothing": ([], "a map needs a source: give --terrain, --coefficients"),
    "two grids": (["--geoid", GEOID, "--anomaly", "x.nc"], "give one of them"),
    "two spacings": (
        ["--terrain", DEM, "--spacing-arcsec", 3, "--spacing-arcmin", 1],
        "give either",
    ),
    "no coefficients": (["--terrain", DEM, "--max-degree", 9], "require --coefficients"),
    "missing file": (["--terrain", "gone.tif"], "cannot read gone.tif: No such file"),
    "missing model": (["--coefficients", "gone.gfc", *BOX], "cannot read gone.gfc"),
    "missing grid": (["--geoid", "gone.nc"], "cannot read gone.nc: No such file"),
    "no model": (["--coefficients", "text.txt", *BOX], "no line 'end_of_head'"),
    "no grid": (["--geoid", "text.nc"], "text.nc cannot be read as a netCDF file"),
    "no bounds": (["--coefficients", "model.gfc"], "cover the whole Earth: give --south"),
    "degree too high": (["--coefficients", "model.gfc", "--max-degree", 99, *BOX], "up to 8"),
    "shipped degree": (
        ["--geoid", GEOID, "--max-degree", 121],
        "to degree 120: for degree 121 give --coefficients",
    ),
    "lowest degree": (["--coefficients", "model.gfc", "--min-degree", 9, *BOX], "between 2 and"),
    "outside": (["--geoid", GEOID, "--south", 20], "20 lies outside the area of the inputs"),
    "not a number": (["--geoid", GEOID, "--south", "nan"], "--south nan must be a finite number"),
    "upside down": (["--geoid", GEOID, "--south", 34, "--north", 33], "must be less than --north"),
    "below ground": (["--terrain", DEM, "--lowest", 900], "900 lies 176 m below the highest"),
    "heights": (["--terrain", DEM, "--highest", 1000], "must lie above --lowest"),
    "space": (["--terrain", DEM, "--lowest", 1e7], "at most at 1e+06 m"),
    "no spacing": (["--geoid", GEOID, "--spacing-arcsec", 0], "must be positive"),
    "endless": (["--geoid", GEOID, "--spacing-arcsec", 1e-3], "more than 1000000 nodes"),
    "too many": (["--geoid", GEOID, "--spacing-arcsec", 2], "at most 400000000 in total"),
    "around the Earth": (
        ["--coefficients", "model.gfc", "--west", -400, *BOX[:4], *BOX[6:]],
        "--west -400 is not a longitude",
    ),
    "too few": (
        ["--geoid", GEOID, "--highest", 100, "--height-spacing", 90],
        "at least 4 along each axis",
    ),
    "density": (["--terrain", DEM, "--density", -1], "density = -1.0 must lie between"),
    "correction": (["--terrain", DEM, "--land-correction", DEM], "requires --geoid"),
    "small relief": (["--geoid", GEOID, "--land-correction", DEM], "it must cover the grid"),
    "raised geoid": (["--geoid", GEOID, "--grid-height", 10], "a geoid refers to the ellipsoid"),
    "small terrain": (["--coefficients", "model.gfc", "--terrain", DEM], "less than one wave"),
    "grid and terrain": (["--geoid", GEOID, "--terrain", RELIEF], "needs --terrain-from-degree"),
    "archive": (["--anomaly", GEOID], "an .npz file holds a geoid"),
    "units": (["--geoid", "gravity.nc"], "has a geoid in 'mGal'; metres or feet are allowed"),
    "huge values": (["--anomaly", "huge.nc"], "values of anomaly are at most 0.02"),
    "gaps": (["--anomaly", "gaps.nc"], "gaps.nc has gaps"),
    "small grid": (["--anomaly", "gravity.nc"], "nothing remains"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("files")
    write_gfc(path / "model.gfc", 8)
    for name in ("text.txt", "text.nc"):
        (path / name).write_text("This is no data.\n")
    values = 1e-3 * np.ones((20, 20))
    write_grid(path / "gravity.nc", "g", "mGal", values, south=33.0, west=108.0, step=0.1)
    write_grid(path / "huge.nc", "g", "mGal", 1e7 * values, south=33.0, west=108.0, step=0.1)
    values[3, 4] = np.nan
    write_grid(path / "gaps.nc", "g", "mGal", values, south=33.0, west=108.0, step=0.1)
    return path


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_is_refused_with_one_sentence(name, folder, monkeypatch):
    monkeypatch.chdir(folder)
    words, message = BAD[name]
    output = run("build", "-o", "bad.nc", *words, code=2)
    assert output.startswith("ggbench: ")
    assert message in output
    assert "Traceback" not in output
    assert not (folder / "bad.nc").exists()


def test_files_that_cannot_be_shown_or_written_are_refused(folder, monkeypatch):
    monkeypatch.chdir(folder)
    assert "gone.nc: No such file" in run("show", "gone.nc", code=2)
    assert "cannot be read as a netCDF file" in run("show", "text.nc", code=2)
    assert "lacks height" in run("show", "gravity.nc", code=2)
    assert "must be named *.nc" in run("build", "-o", "x.tif", "--terrain", DEM, code=2)
    words = ["--geoid", GEOID, *BOX, *HEIGHTS, "--spacing-arcmin", 5]
    assert "cannot write the map" in run("build", "-o", "text.txt/x.nc", *words, code=2)
    run("build", "-o", "good.nc", *words)
    assert "cannot write the figure" in run("show", "good.nc", "-o", "text.txt/x.png", code=2)
    (folder / "good.nc").unlink()


def test_what_a_map_says_of_itself_cannot_harm_a_terminal():
    """No escape of its words is printed, nor megabytes of them."""
    words = ["--geoid", GEOID, *BOX, *HEIGHTS, "--spacing-arcmin", 5]
    run("build", "-o", "map.nc", *words)
    with netCDF4.Dataset("map.nc", "a") as data:
        data.source = "\x1b]0;owned\x07" + "\x1b[31m!" * 10**6
        data.history = "\x1b[2J" + "long " * 10**6
    shown = run("show", "map.nc")
    assert "\x1b" not in shown and "\x07" not in shown
    assert "source: �]0;owned��[31m!" in shown
    assert "(5000004 characters)" in shown
    assert len(shown) < 12_000


@pytest.mark.long
def test_cells_of_a_map_are_scored():
    """Every cell a row of the table and a square of the figure, best and worst on the screen."""
    write(Path("own.nc"), degrade(blank_map(), MapDegradation(correlated_noise_eotvos=10.0)))
    output = run(
        *shlex.split("score own.nc --height 10000 --cell-deg 0.07 --sigma-km 1.5"),
        *shlex.split("--noise 0.5 --spacing 200 --readings 11"),
        *shlex.split("-o out/score.csv --figure out/score.png"),
    )
    assert "9 cells of 0.07° at 10000 m: tensor, 0.5 E; nodes 200 m apart" in output
    assert "principal components explain" in output
    assert "Wrote out/score.csv" in output
    table = pd.read_csv("out/score.csv")
    assert len(table) == 9
    thirds = ("highest third", "lowest third", "middle third")
    assert sorted(table["grade"]) == [third for third in thirds for _ in range(3)]
    best = table.sort_values("track_m").iloc[0]
    sentence = " ".join(output.split())
    assert f"allows an RMS position error of {short(best['track_m'])} m" in sentence
    assert "The probability of a wrong match, more than 750 m off, is at most" in sentence
    for unfit in ("nepers", "√tr", "e-", "unsuitable"):
        assert unfit not in output.replace("score.csv", "")
    assert np.isfinite(table.drop(columns="grade").to_numpy()).all()
    assert imread("out/score.png").shape[1] > 800
    few = run("score", "own.nc", "--cell-deg", 0.1, "--sigma-km", 1.5, "--readings", 11)
    assert "Too few cells for principal components" in few


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["nosuch"], "nosuch is not a map: give a file *.nc of"),
        (["nosuch.nc"], "cannot read the map nosuch.nc: No such file"),
        (["jacksboro"], "no cell of 0.5° with a margin of 15 km"),
        (["egm2008_qinling", "--height", "1"], "which has 3000 to 30000 m"),
        (["jacksboro", "--noise", "0"], "a noise must be positive and finite, and is 0"),
        (["jacksboro", "--cell-deg", "-1"], "the side of a cell is -1°"),
        (["jacksboro", "-o", "score.txt"], "score.txt must be named *.csv"),
        (["jacksboro", "--figure", "score.pdf"], "score.pdf must be named *.png"),
    ],
)
def test_what_cannot_be_scored_is_said_in_a_sentence(words, sentence):
    output = run("score", *words, code=2)
    assert sentence in output
    assert output.startswith("ggbench: ")
    assert "Traceback" not in output


def write_hills(name, west, holes=()):
    """Two low hills every 3 arc seconds from 36.2° N, as GeoTIFF; cells of ``holes`` are voids."""
    step = 3.0 / 3600.0
    rows, columns = np.meshgrid(np.arange(100), np.arange(120), indexing="ij")
    heights = 100.0 + 120.0 * np.exp(-(((rows - 45) / 12.0) ** 2) - ((columns - 50) / 12.0) ** 2)
    heights += 80.0 * np.exp(-(((rows - 70) / 9.0) ** 2) - ((columns - 90) / 9.0) ** 2)
    if holes:
        heights[holes] = -9999.0
    profile = {"height": 100, "width": 120, "count": 1, "dtype": "float32", "crs": "EPSG:4326"}
    corner = from_origin(west, 36.2 + 100 * step, step, step)
    with rasterio.open(name, "w", nodata=-9999.0, transform=corner, **profile) as file:
        file.write(heights.astype("float32"), 1)


@pytest.mark.long
def test_a_terrain_across_the_date_line_is_mapped_shown_and_flown_over():
    """A map, a track whose longitudes jump, and a flight that is planned and told."""
    write_hills("dem.tif", 179.95)
    box = "--west 179.97 --east -179.97 --highest 620"
    output = run("build", "-o", "map.nc", "--terrain", "dem.tif", *box.split())
    assert "longitude: 179.97° to 180.03" in output
    assert "longitude: 179.97° to 180.03" in run("show", "map.nc", "-o", "map.png")
    times = np.arange(0.0, 61.0, 5.0)
    longitude = 179.985 + 4.5e-4 * times
    rows = [times, np.full(13, 36.24), (longitude + 180.0) % 360.0 - 180.0, np.full(13, 450.0)]
    names = "time_s,latitude_deg,longitude_deg,height_m"
    np.savetxt("track.csv", np.column_stack(rows), "%.10f", ",", header=names, comments="")
    table, rest = SMALL.index("[trajectory]"), SMALL.index("[imu]")
    text = SMALL[:table] + '[trajectory]\nfile = "track.csv"\n\n' + SMALL[rest:]
    found = read(Path("map.nc"))
    write(Path("turned.nc"), replace(found, longitude0=found.longitude0 - math.tau))
    told = []
    for source in ("map.nc", "turned.nc"):
        Path("own.toml").write_text(text.replace('source = "normal"', f'source = "{source}"'))
        told.append(" ".join(invoke(["validate", "own.toml"], Path.cwd()).stdout.split()))
    assert "60 s, 2.43 km" in told[0] and "1.35 km from the map's border" in told[0], told[0]
    assert told[1] == told[0]


def test_voids_count_where_the_map_needs_heights():
    holes = slice(None, 30), slice(90, None)
    write_hills("dem.tif", 275.6, holes)
    whole = run("build", "-o", "map.nc", "--terrain", "dem.tif", code=2)
    assert "900 voids among 12000 cells, the first at latitude, longitude 36.2" in whole
    words = ["build", "-o", "map.nc", "--terrain", "dem.tif", "--highest", 620]
    box = ["--south", 36.21, "--north", 36.24, "--west", 275.61]
    output = run(*words, *box, "--east", -84.35)
    assert "900 of them outside of the area needed" in output
    refused = run(*words, *box[:2], "--north", 36.28, *box[4:], "--east", -84.305, code=2)
    assert "of the area needed, 36.2" in refused


@pytest.mark.long
def test_a_density_in_another_unit_is_asked_about():
    write_hills("dem.tif", 8.0)
    words = ["build", "-o", "map.nc", "--terrain", "dem.tif", "--highest", 620]
    output = run(*words, "--density", 2.67)
    assert (
        "Warning: --density 2.67 kg/m³ is unusual (500 to 4000 is usual; is it in g/cm³? then"
        in output
    )
    assert "then give 2670)" in output
    output = run(*words, "--water-density", 1.03)
    assert "Warning: --water-density 1.03 kg/m³ is unusual" in output and "give 1030)" in output
    assert "Warning" not in run(*words, "--density", 2000)


def test_a_lowest_height_above_the_ground_instead_of_the_ellipsoid_is_refused():
    """Before anything is drawn: where the highest ground is, and what is allowed."""
    write_hills("dem.tif", 8.0)
    words = ["build", "-o", "map.nc", "--terrain", "dem.tif", "--lowest"]
    output = run(*words, 150, code=2)
    assert "--lowest 150 lies 70 m below the highest ground of the terrain (220 m at" in output
    assert "at least 228 m is allowed. Heights are above the ellipsoid" in output
    output = run(*words, 225, "--south", 36.201, "--north", 36.21, code=2)
    assert "only 5 m above" in output and "outside of the map's bounds): at least 228 m" in output
    assert not Path("map.nc").exists()


def write_dem(path, void=None):
    """A hill of 500 m on a plain of 300 m, every 12 arc seconds; two cells are voids."""
    step = 12.0 / 3600.0
    lat, lon = 46.0 + step * np.arange(60)[::-1, None], 8.0 + step * np.arange(80)
    height = 300.0 + 500.0 * np.exp(-(((lat - 46.1) / 0.03) ** 2) - ((lon - 8.13) / 0.04) ** 2)
    if void is not None:
        height[30, 40:42] = void
    head = f"ncols 80\nnrows 60\nxllcenter 8.0\nyllcenter 46.0\ncellsize {step}"
    np.savetxt(path, height, "%.8g", header=head, comments="")


@pytest.mark.long
@thinned("void", [32767, -3.4e38, 9999, -500], every=4)
def test_voids_that_the_file_does_not_declare(void, tmp_path):
    """Usual marks are recognised, and the note names the option by which others are declared."""
    write_dem("dem.asc", void)
    words = ["build", "--terrain", "dem.asc", "-o", "map.nc", "--height-spacing", 300]
    if void == -500:
        words += ["--void", "-500", "--void", 77]
    output = run(*words)
    assert "2 voids filled" in output
    assert ("declare others with --void VALUE" in output) == (void != -500)
    assert netCDF4.Dataset("map.nc").history.endswith("--void -500.0 --void 77.0") == (void == -500)


def test_a_void_that_is_no_usual_mark_is_refused_with_the_option(tmp_path):
    write_dem("dem.asc", 12345)
    output = run("build", "--terrain", "dem.asc", "-o", "map.nc", code=2)
    assert "with --void VALUE of 'ggbench map build'" in output


@pytest.mark.long
def test_the_clearance_decides_where_a_map_begins(tmp_path):
    """At most so high above the highest ground; a note is about a flight of that clearance."""
    write_dem("dem.asc")
    words = ["build", "--terrain", "dem.asc", "-o", "map.nc", "--height-spacing", 300]
    lowest = {}
    for clearance in (None, 300, 400):
        output = run(*words, *([] if clearance is None else ["--clearance", clearance]))
        lowest[clearance] = float(netCDF4.Dataset("map.nc")["height"][0])
        assert f"a flight {clearance or 200} m above the ground is inside the map over" in output
        assert f"lowest_m = {lowest[clearance]:g} for terrain-following flights" in output
    assert lowest[None] == lowest[400] > lowest[300]
    assert lowest[300] == pytest.approx(1100.0, abs=2.0)  # 300 m above 800 m
    for wrong in ("0", "-3", "nan"):
        assert "--clearance" in run(*words, "--clearance", wrong, code=2)
