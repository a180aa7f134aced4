"""Terrains that the package carries, as sources of maps: their field, its bounds, its errors."""

from __future__ import annotations

import dataclasses
import io
import math

import numpy as np
import pytest
from refusals import refused
from shipped_fields import TERRAINS, disturbing_field
from terrain_fields import terrain_field

from ggbench.gravity.field import Field
from ggbench.gravity.gradient_map import MapError
from ggbench.gravity.terrain import Terrain, TerrainError
from ggbench.maps import package_data, shipped_parts
from ggbench.maps.recipe import MapRecipe, build
from ggbench.maps.shipped import SOURCES, ShippedSource
from ggbench.maps.shipped_parts import ShippedTerrain

STEP = 3.0 / 3600.0


@pytest.fixture(scope="module")
def summit() -> Terrain:
    """The highest ground of the shipped terrain, 9 km around it: cheap enough for a test."""
    whole = SOURCES["jacksboro"].parts[0].terrain()
    row, column = np.unravel_index(whole.height_m.argmax(), whole.height_m.shape)
    row = min(max(row - 60, 0), whole.height_m.shape[0] - 120)
    column = min(max(column - 60, 0), whole.height_m.shape[1] - 120)
    return dataclasses.replace(
        whole,
        south_deg=float(whole.latitudes_deg[row]),
        west_deg=float(whole.longitudes_deg[column]),
        height_m=whole.height_m[row : row + 120, column : column + 120],
    )


@pytest.fixture
def small_terrain(summit, monkeypatch) -> Terrain:
    """The same in the place of the whole terrain, whose field takes ten seconds."""
    monkeypatch.setattr(ShippedTerrain, "terrain", lambda _: summit)
    return summit


def inside(terrain: Terrain, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Latitudes and longitudes [rad] in the middle of a terrain, on no node."""
    return tuple(
        np.radians(axis.mean() + np.ptp(axis) * np.linspace(-0.213, 0.227, count))
        for axis in (terrain.latitudes_deg, terrain.longitudes_deg)
    )


def shipped(monkeypatch, **arrays: object) -> None:
    """Make a data file with arrays the terrain "hill" of the package."""
    file = io.BytesIO()
    np.savez(file, **arrays)
    monkeypatch.setitem(
        SOURCES, "hill", ShippedSource("a hill", 3000.0, (ShippedTerrain("hill.npz"),))
    )
    monkeypatch.setattr(package_data, "data_bytes", lambda _: file.getvalue())
    shipped_parts.shipped_terrain.cache_clear()


def hill(width_m: float, top_m: float, count: int = 121) -> np.ndarray:
    """Heights (count, count) of a Gaussian hill on the equator."""
    offsets = STEP * (np.arange(count) - count // 2)
    north, east = (np.radians(offsets) * radius for radius in (6335439.0, 6378137.0))
    return top_m * np.exp(-0.5 * (north[:, None] ** 2 + east**2) / width_m**2)


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.square(values).mean(axis=tuple(range(values.ndim - 1))))


def test_the_field_is_parkers_of_the_stored_terrain(small_terrain):
    """Nothing is lost between the data file and the series, and both parts come in geodetic ENU."""
    latitude, longitude = inside(small_terrain, 5)
    height = np.array([1200.0, 1500.0])
    tensor, vector = disturbing_field("jacksboro", latitude, longitude, height)
    expected, gravity = terrain_field(small_terrain, latitude, longitude, height)
    np.testing.assert_array_equal(tensor, expected)
    np.testing.assert_array_equal(vector, gravity)
    assert np.abs(tensor).max() > 20.0
    trace = tensor[..., [0, 3, 5]].sum(axis=-1)
    assert np.abs(trace).max() < 1e-6


@pytest.mark.long
def test_the_field_is_linear_in_the_density(small_terrain):
    """Ground of twice the density has twice the field; the default is 2670 kg/m³.

    To 1e-6, where the series ends.
    """
    latitude, longitude = inside(small_terrain, 5)
    height = np.array([1200.0])
    fields = {
        density: disturbing_field("jacksboro", latitude, longitude, height, density_kg_m3=density)
        for density in (1000.0, 2670.0)
    }
    plain = disturbing_field("jacksboro", latitude, longitude, height)
    for part in (0, 1):
        scale = np.abs(fields[2670.0][part]).max()
        np.testing.assert_allclose(
            fields[1000.0][part], fields[2670.0][part] / 2.67, rtol=0.0, atol=1e-6 * scale
        )
        np.testing.assert_array_equal(fields[2670.0][part], plain[part])


@pytest.mark.long
def test_a_spline_of_the_maps_spacing_stands_for_the_field(small_terrain):
    """At 1200 m, 124 m above the summit, a map of 0.05′ and 50 m errs by less than 0.05 E rms.

    The field varies by tens of E there. Between layers of nodes (1225 m) it errs no more.
    """
    latitude, longitude = inside(small_terrain, 9)
    bounds = np.degrees([latitude[[0, -1]], longitude[[0, -1]]]) + np.array([-0.008, 0.008])
    recipe = MapRecipe(
        "jacksboro", *bounds.ravel(), 1150.0, 1350.0, spacing_arcmin=0.05, height_spacing_m=50.0
    )
    field = Field.from_map(build(recipe))
    height = np.array([1200.0, 1225.0])
    where = np.meshgrid(latitude, longitude, height, indexing="ij")
    exact, gravity = disturbing_field("jacksboro", latitude, longitude, height)
    error = field.tensor(*where) - Field.normal().tensor(*where) - exact
    assert np.ptp(exact[..., 5]) > 30.0
    assert (rms(error) < 0.05).all(), rms(error)
    felt = field.gravity_disturbance(*where)
    assert (rms(felt - gravity) < 1e-3 * rms(gravity)[2]).all()


def test_a_smoothed_hill_is_a_wider_hill(monkeypatch):
    """A Gaussian hill smoothed by a Gaussian is the Gaussian hill with the squares of widths added.

    Its volume stays. So the smoothing is what it says, in degrees, in both directions.
    """
    smoothing_m, width, top = 800.0, 900.0, 500.0
    wide = math.hypot(width, smoothing_m)
    smoothing_deg = math.degrees(smoothing_m / 6356800.0)
    where = np.radians([-0.01, 0.0, 0.012]), np.radians([-0.02, 0.001]), np.array([1200.0])
    geometry = {
        "south_deg": -60 * STEP,
        "west_deg": -60 * STEP,
        "latitude_step_deg": STEP,
        "longitude_step_deg": STEP,
    }
    shipped(monkeypatch, **geometry, height_m=hill(width, top))
    smoothed = disturbing_field("hill", *where, relief_smoothing_deg=smoothing_deg)[0]
    rough = disturbing_field("hill", *where)[0]
    shipped(monkeypatch, **geometry, height_m=hill(wide, top * (width / wide) ** 2))
    expected = disturbing_field("hill", *where)[0]
    scale = np.abs(expected).max()
    assert np.abs(smoothed - expected).max() < 0.01 * scale
    assert np.abs(rough - expected).max() > 0.5 * scale


def test_the_rocky_mountains_are_where_they_belong():
    """The highest cell holds Longs Peak; at 5 km, half a kilometre above it, the field is rough."""
    terrain = SOURCES["rocky_mountains"].parts[0].terrain()
    row, column = np.unravel_index(terrain.height_m.argmax(), terrain.height_m.shape)
    summit = terrain.latitudes_deg[row], terrain.longitudes_deg[column]
    assert np.abs(np.subtract(summit, (40.2550, -105.6158))).max() < 0.5 * 0.00275
    where = [np.radians(axis[20:-20:4]) for axis in (terrain.latitudes_deg, terrain.longitudes_deg)]
    tensor, _ = disturbing_field("rocky_mountains", *where, [5000.0])
    assert 50.0 < tensor[..., 5].std() < 75.0
    assert np.abs(tensor[..., [0, 3, 5]].sum(axis=-1)).max() < 1e-6


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(TERRAINS))
def test_parkers_series_serves_the_lowest_height_of_a_terrain(name):
    """The clearance that is declared is enough: the series ends, and the field is finite."""
    limits = SOURCES[name].limits()
    middle = [[np.radians(np.mean(side))] for side in (limits.latitudes, limits.longitudes)]
    lowest, highest = limits.heights
    tensor, _ = disturbing_field(name, *middle, [lowest, highest])
    assert np.isfinite(tensor).all()


JACKSBORO = MapRecipe(
    source="jacksboro",
    south_deg=36.2,
    north_deg=36.3,
    west_deg=-84.3,
    east_deg=-84.2,
    min_height_m=1150.0,
    max_height_m=1300.0,
    spacing_arcmin=0.05,
    height_spacing_m=50.0,
)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"south_deg": 36.0}, r"south_deg = 36.0 is outside .* 'jacksboro': 36.16 to 36.4458"),
        ({"east_deg": -84.0}, r"east_deg = -84.0 is outside .*-84.4133 to -84.0783 is allowed"),
        ({"min_height_m": 1100.0}, r"min_height_m = 1100.0 is outside .*1126 to 3000"),
        ({"max_height_m": 3500.0}, r"max_height_m = 3500.0 is outside .*1126 to 3000"),
        ({"land_correction": False}, r"land_correction is not allowed for 'jacksboro'"),
        (
            {"spacing_arcmin": 0.2},
            r"spacing_arcmin = 0.2 is too wide .* highest ground \(at 1076 m\)",
        ),
        ({"height_spacing_m": 100.0}, r"height_spacing_m = 100.0 is too wide .*: at most 74 is"),
        (
            {"density_kg_m3": 2000.0, "source": "egm2008_qinling"},
            r"density_kg_m3 is not allowed .* for jacksboro",
        ),
        ({"relief_smoothing_deg": 2.0}, r"relief_smoothing_deg"),
        ({"source": "jacksborough"}, r"Unknown map source 'jacksborough'; allowed: .*jacksboro"),
    ],
)
def test_what_a_terrain_cannot_give_is_refused(change, words):
    """One sentence that names the key, what was found and what is allowed; at once."""
    with refused(MapError, words):
        build(dataclasses.replace(JACKSBORO, **change))


def test_positions_that_the_series_cannot_serve_are_refused(small_terrain):
    """A position beside the terrain, or within the ground, has an error, not a number."""
    latitude, longitude = inside(small_terrain, 3)
    for where in (
        (latitude + 0.1, longitude, np.array([1200.0])),
        (latitude, longitude, np.array([1000.0])),
    ):
        with pytest.raises(TerrainError):
            disturbing_field("jacksboro", *where)


@pytest.mark.parametrize(
    "arrays",
    [
        {"height_m": np.zeros((9, 9))},
        {
            "south_deg": 0.0,
            "west_deg": 0.0,
            "latitude_step_deg": STEP,
            "longitude_step_deg": STEP,
            "height_m": np.full((9, 9), np.nan),
        },
        {
            "south_deg": 0.0,
            "west_deg": "x",
            "latitude_step_deg": STEP,
            "longitude_step_deg": STEP,
            "height_m": np.zeros((9, 9)),
        },
    ],
    ids=["incomplete", "no numbers", "text"],
)
def test_a_damaged_data_file_is_named(arrays, monkeypatch):
    """An installation that lost data says which file, and what to do."""
    shipped(monkeypatch, **arrays)
    with refused(MapError, r"hill.npz"):
        SOURCES["hill"].limits()
