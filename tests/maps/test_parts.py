"""Sums of sources: whatever is in the harmonics is not counted again with the terrain."""

from __future__ import annotations

import functools
import math
from importlib.resources import files

import numpy as np
import pytest
from random_harmonics import random_model
from shipped_fields import REGIONS, disturbing_field

from ggbench.gravity.gradient_map import MapError
from ggbench.gravity.harmonics import gravity_and_gradient
from ggbench.gravity.parker import TerrainOptions
from ggbench.gravity.terrain import Terrain
from ggbench.gravity.terrain_files import read_terrain
from ggbench.maps.netcdf import Nodes
from ggbench.maps.parts import HarmonicPart, TerrainPart, smoothed, summed, terrain_about
from ggbench.maps.shipped_parts import disturbing_coefficients

STEP = 1.0 / 60.0
COUNT = 241
DEGREE = 360
"""Its wavelength is one degree; the terrain is four degrees wide."""
OPTIONS = TerrainOptions()
NODES = Nodes(np.arange(31, 33, 0.05), np.arange(101, 103, 0.05), np.array([4e3, 5e3, 6e3, 7e3]))
NORTH, EAST = np.meshgrid(*[STEP * np.arange(COUNT) - 2.0] * 2, indexing="ij")
X, Y = EAST * math.cos(math.radians(32.0)), NORTH  # in degrees of latitude
LONG = 700.0 * np.exp(-(X**2 + Y**2) / (2 * 0.6**2)) - 500.0 * np.exp(
    -((X - 0.5) ** 2 + (Y + 0.7) ** 2) / (2 * 0.6**2)
)
"""Hills wide enough to have nothing beyond degree 360."""
SHORT = 200.0 * np.sin(2 * np.pi * X / 0.25 + 0.3) * np.sin(2 * np.pi * Y / 0.3)
"""Waves of degree 1900."""


def terrain(heights: np.ndarray) -> Terrain:
    return Terrain(30.0, 100.0, STEP, STEP, heights, "made up")


@functools.cache
def fields(
    level: float, long: bool, short: bool, above_degree: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Tensor (n_lat, n_lon, n_h, 6) and vector (..., 3) of a terrain, or of what is short in it."""
    part = TerrainPart(terrain(level + long * LONG + short * SHORT), OPTIONS, above_degree)
    tensors, vectors = zip(*part.layers(NODES), strict=True)
    return np.stack(tensors, axis=2), np.stack(vectors, axis=2)


def tensor(level: float, long: bool, short: bool, above_degree: int | None = None) -> np.ndarray:
    return fields(level, long, short, above_degree)[0]


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("level", [1200.0, -3000.0], ids=["land", "sea"])
@pytest.mark.long
def test_a_smooth_terrain_adds_nothing_to_the_harmonics(level):
    whole, residual = (tensor(level, True, False, degree) for degree in (None, DEGREE))
    print(f"{rms(residual):.3f} of {rms(whole):.3f} E are left")
    assert rms(residual) < 0.02 * rms(whole)


@pytest.mark.long
def test_gravity_of_a_smooth_terrain_is_not_counted_twice():
    """What holds for the tensor holds for the gravity disturbance, the plate under it included."""
    whole, residual = (fields(1200.0, True, False, degree)[1] for degree in (None, DEGREE))
    assert rms(whole[..., 2]) > 1e-3  # more than 100 mGal, of a kilometre of rock
    assert rms(residual) < 0.02 * np.std(whole[..., 2])


@pytest.mark.long
def test_a_rough_terrain_adds_its_whole_field():
    whole = tensor(1200.0, False, True) - tensor(1200.0, False, False)
    residual = tensor(1200.0, False, True, DEGREE)
    assert rms(whole) > 5.0
    assert rms(residual - whole) < 1e-3 * rms(whole)


@pytest.mark.long
def test_harmonics_with_the_long_waves_and_the_rest_of_the_terrain_are_the_whole():
    """The harmonics of this Earth hold what its long waves attract; the terrain adds the rest."""
    held_by_harmonics, whole = (tensor(1200.0, True, short) for short in (False, True))
    found = held_by_harmonics + tensor(1200.0, True, True, DEGREE)
    twice = held_by_harmonics + whole
    error = rms(found - whole)
    print(f"{error:.3f} E of {rms(whole):.2f} E; counted twice: {rms(twice - whole):.2f} E")
    assert error < 0.01 * rms(whole)
    assert error < 0.02 * rms(twice - whole)


def test_a_wave_is_halved_at_the_degree_whatever_its_direction_and_latitude():
    """Waves of half, all and twice the degree, in degrees of arc on the sphere."""
    latitude = 60.0
    north = STEP * np.arange(COUNT)
    for along in ("north", "east"):
        for factor, low, high in ((0.5, 0.999, 1.001), (1.0, 0.48, 0.52), (2.0, 0.0, 1e-3)):
            wavelength = 360.0 / (factor * DEGREE)
            arc = north if along == "north" else north * math.cos(math.radians(latitude))
            # Even about both edges, as the mirrored terrain is: a whole number of half waves.
            halves = max(1, round(2.0 * (arc[-1] + arc[1] - arc[0]) / wavelength))
            wave = np.cos(np.pi * halves * (np.arange(COUNT) + 0.5) / COUNT)
            scale = halves * wavelength / (2.0 * (arc[-1] + arc[1] - arc[0]))
            heights = (
                100.0
                * (wave[:, None] if along == "north" else wave[None])
                * np.ones((COUNT, COUNT))
            )
            ground = Terrain(latitude - 2.0, 100.0, STEP, STEP, 500.0 + heights, "wave")
            passed = smoothed(ground, round(DEGREE * scale), OPTIONS).height_m - 500.0
            middle = passed[COUNT // 2 - 3 : COUNT // 2 + 4]
            amplitude = np.sum(middle * heights[:7] if along == "east" else passed * heights)
            amplitude /= np.sum(heights[:7] ** 2 if along == "east" else heights**2)
            assert low <= amplitude <= high, (along, factor, amplitude)


def test_a_wave_of_low_degree_is_halved_where_the_sphere_has_it():
    """Degree n is the wavelength of 360° / (n + 1/2), as n (n + 1) is the square of its number.

    At degree 20 half a degree matters: counted as 360° / 20 the wave would keep 0.4.
    """
    degree, count = 20, 200
    step = 2.0 * 360.0 / (degree + 0.5) / count  # two waves
    wave = np.cos(4.0 * np.pi * (np.arange(count) + 0.5) / count)[:, None] * np.ones((1, count))
    ground = Terrain(20.0, 100.0, step, step, 500.0 + 100.0 * wave, "wave")
    passed = smoothed(ground, degree, OPTIONS).height_m - 500.0
    assert np.sum(passed * wave) / np.sum(100.0 * wave**2) == pytest.approx(0.5, abs=0.02)


def test_smoothing_keeps_the_mass_of_land_and_sea():
    """At a coast: mean of rock and of what water lacks against rock."""
    heights = 1500.0 * np.sin(2 * np.pi * X / 0.4) + 300.0
    sea = 1.0 - OPTIONS.water_density / OPTIONS.density

    def mass(h):
        return np.where(h < 0, sea * h, h).mean()

    after = smoothed(terrain(heights), DEGREE, OPTIONS).height_m
    assert mass(after) == pytest.approx(mass(heights), rel=1e-9)
    assert np.ptp(after) < 0.05 * np.ptp(heights)


def test_a_terrain_smaller_than_the_wavelength_is_refused():
    with pytest.raises(MapError, match=r"is 3\.39° wide, .* wavelength of degree 60 \(6°\)"):
        smoothed(terrain(LONG), 60, OPTIONS)


@pytest.mark.parametrize("density", [0.0, 900.0, OPTIONS.water_density])
def test_ground_must_be_heavier_than_water_to_be_smoothed(density):
    with pytest.raises(MapError, match="must be above --water-density"):
        smoothed(terrain(LONG), DEGREE, TerrainOptions(density=density))


@pytest.mark.long
def test_terrain_explains_what_egm2008_has_beyond_degree_120():
    """Real data, two ways: the residual terrain against EGM2008's geoid, over the Qinling.

    All six components agree in sign and size; what differs is density and isostasy.
    """
    nodes = Nodes(np.arange(33.0, 34.0, 0.1), np.arange(107.0, 109.0, 0.1), np.array([10e3]))
    axes = (np.radians(nodes.latitude_deg), np.radians(nodes.longitude_deg), nodes.height_m)
    source = REGIONS["egm2008_qinling"]
    harmonics = disturbing_coefficients(source.coefficients)
    geoid, _ = disturbing_field("egm2008_qinling", *axes)
    beyond = (geoid - gravity_and_gradient(harmonics, *axes)[1])[:, :, 0]
    relief = read_terrain(files("ggbench.scenarios") / "data" / source.topography)
    residual, _ = next(TerrainPart(relief, OPTIONS, 120).layers(nodes))
    for component in range(6):
        pair = beyond[..., component].ravel(), residual[..., component].ravel()
        correlation = np.corrcoef(*pair)[0, 1]
        ratio = rms(pair[1]) / rms(pair[0])
        print(f"component {component}: correlation {correlation:.3f}, size {ratio:.2f}")
        assert correlation > 0.9
        assert 0.8 < ratio < 1.7


@pytest.mark.long
def test_of_a_terrain_too_wide_for_a_plane_what_lies_around_the_map_is_used():
    """A hill in a plain of 16 by 20 degrees is worth the same as in one of four."""
    hill = 800.0 * np.exp(-(X**2 + Y**2) / (2 * 0.2**2))
    small = Terrain(30.0, 100.0, STEP, STEP, 500.0 + hill, "small")
    wide = np.full((16 * 60 + 1, 20 * 60 + 1), 500.0)
    wide[6 * 60 : 6 * 60 + 241, 8 * 60 : 8 * 60 + 241] = small.height_m
    nodes = Nodes(np.arange(31.5, 32.5, 0.1), np.arange(101.5, 102.5, 0.1), np.array([9e3]))
    fields = [
        next(TerrainPart(ground, OPTIONS).layers(nodes))[0]
        for ground in (small, Terrain(24.0, 92.0, STEP, STEP, wide, "wide"))
    ]
    assert rms(fields[0]) > 5.0
    assert rms(fields[1] - fields[0]) < 0.02 * rms(fields[0])


def test_what_lies_around_the_map_is_as_wide_to_the_east_as_to_the_north():
    """In degrees of arc: at 60° of latitude twice as many degrees of longitude are kept."""
    wide = Terrain(53.0, 85.0, 0.1, 0.1, np.zeros((141, 301)), "wide")
    kept = terrain_about(
        wide, Nodes(np.array([59.0, 61.0]), np.array([99.0, 101.0]), np.array([9e3]))
    )
    assert (kept.latitudes_deg[0], kept.latitudes_deg[-1]) == pytest.approx((54.5, 65.5), abs=0.11)
    assert (kept.longitudes_deg[0], kept.longitudes_deg[-1]) == pytest.approx((89, 111), abs=0.11)


@pytest.mark.parametrize(("south", "north"), [(40.0, 41.0), (89.0, 90.0), (-90.0, -89.0)])
def test_harmonics_on_dense_nodes_are_those_of_direct_synthesis(south, north):
    """Between the nodes on which they are computed a spline of degree 5 serves, to 1e-5 E.

    At a pole, beyond which there are no nodes, every node is computed.
    """
    model = random_model(180, 2)
    latitude = np.linspace(south, north, 101)
    nodes = Nodes(latitude, np.arange(7, 8.5, 0.01), np.array([0.0, 500.0, 1e3]))
    (tensor, vector), *_ = HarmonicPart(model).layers(nodes)
    direct_vector, direct = gravity_and_gradient(
        model, np.radians(nodes.latitude_deg), np.radians(nodes.longitude_deg), [0.0]
    )
    assert tensor.shape == (nodes.latitude_deg.size, nodes.longitude_deg.size, 6)
    print(f"{np.abs(tensor - direct[:, :, 0]).max():.1e} E of {direct.std():.1f} E")
    assert np.abs(tensor - direct[:, :, 0]).max() < 1e-5
    assert np.abs(vector - direct_vector[:, :, 0]).max() < 1e-10


def test_a_sum_is_the_sum_of_its_parts_layer_by_layer():
    parts = [HarmonicPart(random_model(20, seed)) for seed in (1, 2)]
    layers = list(summed(parts, NODES))
    assert len(layers) == NODES.height_m.size
    alone = [list(part.layers(NODES)) for part in parts]
    for index, (tensor, vector) in enumerate(layers):
        np.testing.assert_allclose(tensor, alone[0][index][0] + alone[1][index][0])
        np.testing.assert_allclose(vector, alone[0][index][1] + alone[1][index][1])
