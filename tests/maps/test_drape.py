"""Maps whose layers follow the ground: their base, their fields, their files and the command."""

import dataclasses
import itertools
import json
import math
import shlex
from pathlib import Path

import numpy as np
import pytest
from command import invoke
from grids import write_grid
from random_harmonics import write_gfc
from terrain_fields import rough_terrain

from ggbench.gravity.ellipsoid import metres_per_radian
from ggbench.gravity.field import Field
from ggbench.gravity.gradient_map import MapError
from ggbench.gravity.harmonics import gravity_and_gradient
from ggbench.gravity.meridians import Area
from ggbench.gravity.parker import TerrainOptions
from ggbench.gravity.remove_restore import GravityGrid, Residual
from ggbench.gravity.terrain import Terrain
from ggbench.gravity.terrain_masses import TerrainMasses
from ggbench.maps import drape, netcdf_reader, read, write
from ggbench.maps.geoid import geoid_heights
from ggbench.maps.netcdf import Nodes
from ggbench.maps.nodes import GridRequest
from ggbench.maps.parts import HarmonicPart, ResidualPart, TerrainPart
from ggbench.maps.plan import Inputs, plan
from ggbench.maps.shipped_parts import COEFFICIENTS, disturbing_coefficients

RELIEF = 1500.0


def write_terrain(path, terrain):
    np.savez(
        path,
        south_deg=terrain.south_deg,
        west_deg=terrain.west_deg,
        latitude_step_deg=terrain.latitude_step_deg,
        longitude_step_deg=terrain.longitude_step_deg,
        height_m=terrain.height_m,
    )


def draped_nodes(terrain, lowest=60.0, spacing=4.0, count=14):
    latitude = terrain.south_deg + 0.01 + spacing / 3600.0 * np.arange(count)
    longitude = terrain.west_deg + 0.01 + spacing / 3600.0 * np.arange(count)
    base = drape.base_surface(terrain, 0.0, latitude, longitude)
    return Nodes(latitude, longitude, lowest + 40.0 * np.arange(6), base)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("drape")
    write_terrain(path / "dem.npz", rough_terrain(48, RELIEF))
    return path


def run(*words):
    done = invoke([str(word) for word in words], Path.cwd())
    return done.returncode, " ".join((done.stdout + done.stderr).split())


def build(folder, *words):
    return run(
        *("map", "build", "-o", folder / "map.nc"),
        *("--terrain", folder / "dem.npz", "--drape"),
        *shlex.split("--south 45.01 --north 45.025 --west 7.01 --east 7.025"),
        *shlex.split("--spacing-arcsec 4 --clearance-to 200"),
        *words,
    )


@pytest.mark.parametrize("spacing", [1.5, 4.0, 12.0])
def test_the_base_is_nowhere_below_the_ground_and_near_it(spacing):
    terrain = rough_terrain(48, RELIEF)
    nodes = draped_nodes(terrain, spacing=spacing, count=7)
    field = Field.from_map(
        nodes.map_of(np.zeros((*nodes.shape, 6)), np.zeros((*nodes.shape, 3)), "none")
    )
    rng = np.random.default_rng(4)
    low, high = field.lower, field.upper
    places = low + rng.uniform(0.0, 1.0, (4000, 3)) * (high - low)
    above = field.base(places) - TerrainMasses.of(terrain).ground(*places[:, :2].T)
    assert above.min() > -2.0  # of a wall between two cells, right at it
    slope = np.abs(np.diff(terrain.height_m, axis=0)).mean() / 92.6
    assert above.mean() < 3.0 * slope * (92.6 + 30.9 * spacing)


def test_layers_are_the_field_at_their_heights_above_the_base():
    terrain = rough_terrain(48, RELIEF)
    nodes, masses = draped_nodes(terrain), TerrainMasses.of(terrain)
    layers = list(drape.summed([drape.DrapedTerrain(masses, 6.0)], nodes))
    points = drape.points_of(nodes, float(nodes.height_m[2]))
    tensor, vector = masses.field(points, 6.0)
    assert layers[2][0].reshape(-1, 6) == pytest.approx(tensor)
    assert layers[2][1].reshape(-1, 3) == pytest.approx(vector)
    heights = points[:, 2].reshape(nodes.shape[:2])
    assert np.ptp(heights) > 100.0 and heights.min() < terrain.height_m.max()


def test_harmonics_on_draped_layers_are_those_at_their_points():
    terrain = rough_terrain(48, RELIEF)
    nodes, coefficients = draped_nodes(terrain), disturbing_coefficients(COEFFICIENTS)
    found = list(drape.summed([HarmonicPart(coefficients)], nodes))
    for row, column in ((0, 3), (9, 13)):
        height = nodes.base_m[row, column] + nodes.height_m
        vector, tensor = gravity_and_gradient(
            coefficients,
            np.radians(nodes.latitude_deg[[row]]),
            np.radians(nodes.longitude_deg[[column]]),
            height,
        )
        for layer, (each_tensor, each_vector) in enumerate(found):
            assert each_tensor[row, column] == pytest.approx(tensor[0, 0, layer], abs=1e-4)
            assert each_vector[row, column] == pytest.approx(vector[0, 0, layer], abs=1e-9)


def hills(count, step_deg, south, west, relief, seed=3):
    """Ground of 300 m up to 300 m and a relief more [m], of longer waves the higher."""
    rng = np.random.default_rng(seed)
    k = np.hypot(np.fft.fftfreq(count)[:, np.newaxis], np.fft.rfftfreq(count))
    k[0, 0] = 1.0
    shape = count, count
    waves = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(shape)) * k**-1.7, shape)
    heights = 300.0 + relief * (waves - waves.min()) / np.ptp(waves)
    return Terrain(south, west, step_deg, step_deg, heights, "hills")


def test_a_gravity_grid_on_draped_layers_is_that_at_their_points():
    """What a grid has beyond the harmonics, against level layers at the heights of two nodes."""
    terrain = rough_terrain(48, RELIEF)
    values = 2e-4 * np.random.default_rng(5).standard_normal((60, 60))
    grid = GravityGrid("disturbance", 43.5, 5.5, 0.05, 0.05, values)
    part = ResidualPart(Residual(grid, disturbing_coefficients(COEFFICIENTS), 0.5))
    nodes = draped_nodes(terrain)
    found = list(drape.summed([part], nodes))
    assert np.abs(found[0][0]).max() > 1.0
    for row, column in ((0, 3), (9, 13)):
        heights = nodes.base_m[row, column] + nodes.height_m
        level = part.layers(Nodes(nodes.latitude_deg, nodes.longitude_deg, heights))
        for (tensor, vector), (other, others) in zip(found, level, strict=True):
            assert tensor[row, column] == pytest.approx(other[row, column], abs=1e-4)
            assert vector[row, column] == pytest.approx(others[row, column], abs=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["disturbance", "geoid"])
def test_a_draped_sum_with_a_grid_is_the_level_one_at_its_heights(kind, tmp_path):
    """By the command: EGM2008, a gravity grid or a geoid with land correction, and a terrain.

    Above the summits, where the map of level layers is another way to the same field: Parker's
    series in the place of prisms. Lower nodes than its floor are in the valleys.
    """
    write_terrain(tmp_path / "dem.npz", hills(144, 1 / 120, 45.0, 7.0, 900.0))
    write_terrain(tmp_path / "land.npz", hills(110, 0.05, 43.0, 5.0, 500.0))
    waves = hills(90, 0.05, 43.2, 5.2, 2.0, seed=8).height_m
    units = {"disturbance": ("mGal", 20.0 * (waves - waves.mean())), "geoid": ("m", waves - 250.0)}[
        kind
    ]
    write_grid(tmp_path / "grid.nc", kind, *units, 43.2, 5.2, 0.05)
    source = f"--terrain dem.npz --geoid-height 0 --{kind} grid.nc --terrain-from-degree 1000"
    if kind == "geoid":
        source += " --land-correction land.npz"
    area = "--south 45.52 --north 45.62 --west 7.52 --east 7.62 --spacing-arcmin 1"
    layers = {
        "low": "--drape --clearance-from 2500 --clearance-to 4000 --tolerance 0.05",
        "level": "--lowest 2700 --highest 5700 --height-spacing 300",
    }
    for name, words in layers.items():
        done = invoke(
            ["map", "build", "-o", f"{name}.nc", *shlex.split(f"{source} {area} {words}")],
            tmp_path,
        )
        assert done.returncode == 0, done.stderr
    low, level = read(tmp_path / "low.nc"), Field.from_map(read(tmp_path / "level.nc"))
    field = Field.from_map(low)
    axes = [
        first + step * np.arange(count)
        for first, step, count in zip(field.origin, field.step, low.tensor.shape[:3], strict=True)
    ]
    places = np.stack(field.over_nodes(*np.meshgrid(*axes, indexing="ij")), axis=-1)
    assert np.ptp(low.base) > 100.0 and level.covers(places, 0.0).all()
    expected = level.continued_tensor(places) - Field.normal().continued_tensor(places)
    rms = np.sqrt(np.mean(expected**2))
    assert rms > 2.0
    assert np.sqrt(np.mean((low.tensor - expected) ** 2)) < 0.01 * rms
    vectors = level.gravity_disturbance(*np.moveaxis(places, -1, 0))
    assert low.gravity_disturbance == pytest.approx(vectors, abs=5e-6)


@pytest.mark.long
def test_a_smooth_terrain_is_continued_below_its_summits():
    """Against its own columns, where a point is above its ground, but not above its summit."""
    degrees = np.arange(120) * 0.01
    heights = 900.0 + 500.0 * np.cos(2.0 * math.pi * degrees[:, np.newaxis] / 0.6) * np.cos(
        2.0 * math.pi * degrees / 0.8
    )
    terrain = Terrain(45.0, 7.0, 0.01, 0.01, heights, "smooth hills")
    part = TerrainPart(terrain, TerrainOptions(), dtype="float64")
    floor = float(heights.max()) + 1200.0
    axes = 45.4 + 0.02 * np.arange(10), 7.4 + 0.02 * np.arange(10)
    base = drape.base_surface(terrain, 0.0, *axes)
    nodes = Nodes(*axes, np.array([900.0, 1200.0, 1500.0, 1800.0]), base)
    found = list(drape.on_levels(drape.SmoothTerrain(part, floor), nodes, floor))
    points = drape.points_of(nodes, 900.0)
    assert points[:, 2].min() < heights.max() < floor
    expected, _ = TerrainMasses.of(terrain).field(points, 12.0)
    assert np.abs(expected).max() > 20.0
    assert found[0][0].reshape(-1, 6) == pytest.approx(expected, abs=0.8)  # cells are steps


def test_a_field_continued_downwards_has_no_trace():
    """As a map's reader demands: continued from far above, rounding counts a thousandfold."""
    terrain = hills(40, 1 / 30, 44.0, 6.0, 900.0)
    part = TerrainPart(terrain, TerrainOptions(), above_degree=400)
    axes = 44.65 + 0.02 * np.arange(4), 6.65 + 0.02 * np.arange(4)
    base = drape.base_surface(terrain, 0.0, *axes)
    nodes = Nodes(*axes, np.array([600.0, 900.0, 1200.0, 1500.0]), base)
    smooth = drape.SmoothTerrain.of(part, nodes)
    assert smooth.floor_m > nodes.base_m.min() + 1000.0
    tensor, _ = next(drape.on_levels(smooth, nodes, smooth.floor_m))
    assert np.abs(tensor).max() > 3.0
    assert np.abs(tensor[..., [0, 3, 5]].sum(axis=-1)).max() < 1e-6


@pytest.mark.long
def test_only_the_short_waves_of_a_terrain_are_added_to_harmonics(tmp_path):
    """High above the ground, on a level base, a draped map is a level one."""
    write_gfc(tmp_path / "model.gfc", 240)
    rng = np.random.default_rng(3)
    k = np.hypot(np.fft.fftfreq(90)[:, np.newaxis], np.fft.rfftfreq(90))
    k[0, 0] = 1.0
    waves = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((90, 90))) * k**-1.5, (90, 90))
    heights = 600.0 + 400.0 * waves / np.abs(waves).max()
    terrain = Terrain(44.0, 6.0, 1 / 30, 1 / 30, heights, "wide ground")
    write_terrain(tmp_path / "dem.npz", terrain)
    inputs = Inputs(terrain=tmp_path / "dem.npz", coefficients=tmp_path / "model.gfc")
    box = GridRequest(45.2, 45.8, 7.2, 7.8, spacing_deg=0.06, height_spacing_m=1000.0)
    high = dataclasses.replace(box, lowest_m=9000.0, highest_m=12000.0)
    level = list(plan(inputs, high, "test").layers())
    over = dataclasses.replace(inputs, drape=(4000.0, 7000.0))
    made = plan(over, box, "test")
    flat = np.full(made.nodes.shape[:2], 5000.0)
    nodes = dataclasses.replace(made.nodes, base_m=flat)
    for (tensor, vector), (other, others) in zip(
        drape.summed(made.parts, nodes), level, strict=True
    ):
        assert tensor == pytest.approx(other, abs=0.2)
        assert vector == pytest.approx(others, abs=2e-6)
    assert np.abs(level[0][0]).max() > 3.0


def test_a_file_keeps_the_base(folder):
    code, output = build(folder, "--clearance-from", 80, "--geoid-height", 0)
    assert code == 0, output
    assert "m above a base surface" in output and "the error is at most" in output
    whole = read(folder / "map.nc")
    nodes, attributes, layers = netcdf_reader.read_layers(folder / "map.nc")
    assert whole.height0 == 80.0 and whole.base is not None
    assert nodes.base_m == pytest.approx(whole.base)
    history = attributes["history"].split()
    assert "--drape" in history and "True" not in history
    assert json.loads(attributes["parameters"])["columns_error_eotvos"] <= 0.5
    tensor, _ = next(layers)
    assert whole.tensor[:, :, 0] == pytest.approx(tensor)
    masses = TerrainMasses.of(rough_terrain(48, RELIEF))
    expected, _ = masses.field(drape.points_of(nodes, 80.0), 12.0)
    assert whole.tensor[:, :, 0].reshape(-1, 6) == pytest.approx(expected, abs=1.0)
    write(folder / "again.nc", whole)
    again = read(folder / "again.nc")
    assert again.base == pytest.approx(whole.base) and again.height0 == 80.0
    part = read(folder / "map.nc", Area(45.012, 45.018, 7.012, 7.016))
    row = round((math.degrees(part.latitude0) - 45.01) * 900)
    column = round((math.degrees(part.longitude0) - 7.01) * 900)
    shape = part.base.shape
    assert part.tensor.shape[:2] == shape < whole.base.shape
    assert part.base == pytest.approx(whole.base[row : row + shape[0], column : column + shape[1]])


def test_a_file_without_its_base_is_no_map(folder):
    import netCDF4

    assert build(folder)[0] == 0
    with netCDF4.Dataset(folder / "map.nc", "a") as file:
        file["base_height"][2, 3] = np.nan
    with pytest.raises(MapError, match="base_height must be heights"):
        read(folder / "map.nc")
    with netCDF4.Dataset(folder / "map.nc", "a") as file:
        file.renameVariable("base_height", "ground")
    with pytest.raises(MapError, match="lacks base_height"):
        read(folder / "map.nc")


@pytest.mark.long
def test_show_draws_a_clearance(folder):
    assert build(folder)[0] == 0
    code, output = run(
        "map", "show", folder / "map.nc", "--clearance", 100, "-o", folder / "map.png"
    )
    assert code == 0 and (folder / "map.png").stat().st_size > 1000
    assert "clearance: 60 m to 200 m" in output and "base surface: " in output
    for words, said in (
        (("--height", 100), "give --clearance, 60 to 200 m"),
        (("--clearance", 900), "--clearance 900 is outside"),
    ):
        code, output = run("map", "show", folder / "map.nc", *words)
        assert code == 2 and said in output


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--lowest", 3000), "--lowest 3000 is a height above the ellipsoid"),
        (("--clearance", 300), "--clearance cannot be given with --clearance-from"),
        (("--clearance-from", 700), "below --clearance-to"),
        (("--clearance-from", 0), "below --clearance-to"),
        (("--tolerance", 0), "--tolerance 0 E must be positive"),
        (("--height-spacing", -5), "--height-spacing -5 must be positive"),
    ],
)
def test_what_does_not_go_with_a_drape_is_refused(folder, words, said):
    code, output = build(folder, *words)
    assert code == 2 and said in output


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--clearance-to", 300), "give --drape"),
        (("--tolerance", 1.0), "require --drape"),
        (("--beyond", "nothing"), "require --drape"),
        (("--lowest", 1000), "--drape builds a map whose layers follow the ground"),
    ],
)
def test_a_level_map_leads_to_the_drape(folder, words, said):
    words = "map", "build", "-o", folder / "level.nc", "--terrain", folder / "dem.npz", *words
    code, output = run(*words)
    assert code == 2 and said in output


def test_nothing_beyond_the_terrain_leaves_its_cells_alone(folder):
    assert build(folder, "--beyond", "nothing", "--geoid-height", 0)[0] == 0
    nodes, _, layers = netcdf_reader.read_layers(folder / "map.nc")
    alone = TerrainMasses.of(rough_terrain(48, RELIEF), continued=False)
    expected, _ = alone.field(drape.points_of(nodes, 60.0), 12.0)
    assert next(layers)[0].reshape(-1, 6) == pytest.approx(expected, abs=1.0)


def test_a_terrain_alone_is_draped_not_a_gravity_model(folder, tmp_path):
    write_gfc(tmp_path / "model.gfc", 60)
    code, output = run(
        *("map", "build", "-o", tmp_path / "m.nc"),
        *("--coefficients", tmp_path / "model.gfc"),
        *shlex.split("--drape --south 45 --north 46 --west 7 --east 8"),
    )
    assert code == 2 and "--drape requires --terrain" in output


def test_the_zero_level_of_a_draped_terrain_is_the_geoid(folder):
    """So that heights of its map are above the ellipsoid, as those of tracks are."""
    code, output = build(folder)
    assert code == 0 and "above sea level, which lies 5" in output
    geoid = json.loads(netcdf_reader.read_layers(folder / "map.nc")[1]["parameters"])
    assert geoid["geoid_height_m"] == pytest.approx(geoid_heights([45.0175], [7.0175])[0], abs=0.1)
    raised = read(folder / "map.nc").base
    assert build(folder, "--geoid-height", 0)[0] == 0
    level = read(folder / "map.nc").base
    assert raised - level == pytest.approx(geoid["geoid_height_m"], abs=1e-6)


def test_a_level_map_says_where_sea_level_is(folder):
    """Its heights are taken as above the ellipsoid, and a track's would not fit."""
    inputs = Inputs(terrain=folder / "dem.npz")
    (said,) = [each for each in plan(inputs, GridRequest(), "test").remarks if "sea" in each]
    height = geoid_heights([45.02], [7.02])[0]
    assert f"--geoid-height {height:.1f} (EGM2008" in said
    given = dataclasses.replace(inputs, geoid_height_m=0.0)
    assert not any("sea" in each for each in plan(given, GridRequest(), "test").remarks)


@pytest.mark.parametrize("over", [None, (60.0, 200.0)])
def test_a_map_near_the_edge_of_its_terrain_is_warned_of_what_lies_beyond(folder, over):
    terrain = rough_terrain(48, RELIEF)
    box = GridRequest(45.01, 45.02, 7.005, 7.03, spacing_deg=1 / 300, height_spacing_m=40.0)
    inputs = Inputs(terrain=folder / "dem.npz", drape=over)
    (said,) = [each for each in plan(inputs, box, "test").remarks if "edge of the terrain" in each]
    distance = math.radians(0.005 + 0.5 * 3 / 3600) * 6378137.0 * math.cos(math.radians(45.015))
    assert "the western edge" in said
    assert f"within {distance / 1e3:.2g} km" in said or "within 0.4" in said
    worth = 2.0 * 6.6743e-11 * 2670.0 * np.std(terrain.height_m) / distance * 1e9
    found = float(said.split("cause errors of ")[1].split(" E near")[0])
    assert found == pytest.approx(worth, rel=0.1)


def test_a_map_far_inside_its_terrain_is_not_warned(tmp_path):
    heights = 100.0 + 2.0 * np.sin(np.arange(80))[:, np.newaxis] * np.ones(80)
    write_terrain(tmp_path / "dem.npz", Terrain(45.0, 7.0, 0.01, 0.01, heights, "a plain"))
    box = GridRequest(45.38, 45.42, 7.38, 7.42)
    remarks = plan(Inputs(terrain=tmp_path / "dem.npz"), box, "test").remarks
    assert not any("edge of the terrain" in each for each in remarks)


def test_a_long_build_says_how_far_it_is(folder, monkeypatch):
    """By a clock on which each look takes six seconds."""
    clock = itertools.count(0.0, 6.0)
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    code, output = build(folder, "--clearance-from", 100)
    assert code == 0 and "2 of 4 layers, about 1" in output and "4 of 4 layers" not in output


@pytest.mark.long
def test_a_draped_map_is_free_of_trace_and_curl_between_its_nodes(folder):
    """At the default spacings, 60 m above rough ground: both within 1 % of the tensor's rms."""
    words = shlex.split(
        "--south 45.012 --north 45.022 --west 7.012 --east 7.022 --clearance-to 300"
    )
    dem = folder / "dem.npz"
    assert run("map", "build", "-o", folder / "m.nc", "--terrain", dem, "--drape", *words)[0] == 0
    field = Field.from_map(read(folder / "m.nc"))
    share = np.random.default_rng(1).uniform([0.15, 0.15, 0.1], [0.85, 0.85, 0.9], (300, 3))
    places = field.lower + share * (field.upper - field.lower)
    places = np.stack(field.over_nodes(*places.T), axis=-1)
    tensor = field.continued_tensor(places) - Field.normal().continued_tensor(places)
    whole = tensor[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    rms = np.sqrt(np.mean(whole**2))
    assert rms > 100.0
    north, east = metres_per_radian(places[0])
    gradient = np.empty((len(places), 3, 3))
    for axis, (column, metres) in enumerate(((1, east), (0, north), (2, 1.0))):
        step = np.zeros(3)
        step[column] = 0.5 / metres
        ahead, behind = (field.gravity_disturbance(*(places + s * step).T) for s in (1.0, -1.0))
        gradient[:, axis] = 1e9 * (ahead - behind)
    curl = gradient - np.swapaxes(gradient, 1, 2)
    assert np.sqrt(np.mean(np.trace(whole, axis1=1, axis2=2) ** 2)) < 0.01 * rms
    assert np.sqrt(np.mean(curl**2)) < 0.01 * rms
    assert np.sqrt(np.mean((gradient - whole) ** 2)) < 0.01 * rms
