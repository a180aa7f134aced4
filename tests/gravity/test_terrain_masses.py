"""The field of a terrain between its summits against prisms, bodies and Parker's series."""

import math
import threading

import numpy as np
import pytest
from choclo.prism import (
    gravity_e,
    gravity_ee,
    gravity_en,
    gravity_eu,
    gravity_n,
    gravity_nn,
    gravity_nu,
    gravity_u,
    gravity_uu,
)
from numba import njit
from terrain_fields import rough_terrain, terrain_field

from ggbench.files import writing
from ggbench.gravity.ellipsoid import EOTVOS, radii_of_curvature
from ggbench.gravity.parker import GRAVITATIONAL_CONSTANT, TerrainOptions
from ggbench.gravity.terrain import Terrain, TerrainError
from ggbench.gravity.terrain_masses import RATIOS, TerrainMasses

RATIO = 6.0


def points_above(masses, count, lowest, highest, seed=5, inner=0.1):
    """Points (N, 3) at random places of a terrain and heights above its ground [m]."""
    terrain, rng = masses.terrain, np.random.default_rng(seed)
    lat, lon = terrain.latitudes_deg, terrain.longitudes_deg
    share = rng.uniform(inner, 1.0 - inner, (2, count))
    latitude = np.radians(lat[0] + share[0] * np.ptp(lat))
    longitude = np.radians(lon[0] + share[1] * np.ptp(lon))
    height = masses.ground(latitude, longitude) + rng.uniform(lowest, highest, count)
    return np.stack([latitude, longitude, height], axis=-1)


@njit
def prism_sums(places, west, east, south, north, surface, base, above, below):
    """Nine components (N, 9) of prisms between a surface and a base, each in its point's plane."""
    out = np.zeros((places.shape[0], 9))
    for p in range(places.shape[0]):
        for j in range(surface.shape[0]):
            for i in range(surface.shape[1]):
                top = surface[j, i]
                if top == base:
                    continue
                density = above if top > base else -below
                box = (
                    west[p, j, i],
                    east[p, j, i],
                    south[p, j, i],
                    north[p, j, i],
                    min(top, base),
                    max(top, base),
                    density,
                )
                up = places[p]
                out[p, 0] += gravity_ee(0.0, 0.0, up, *box)
                out[p, 1] += gravity_en(0.0, 0.0, up, *box)
                out[p, 2] += gravity_eu(0.0, 0.0, up, *box)
                out[p, 3] += gravity_nn(0.0, 0.0, up, *box)
                out[p, 4] += gravity_nu(0.0, 0.0, up, *box)
                out[p, 5] += gravity_uu(0.0, 0.0, up, *box)
                out[p, 6] += gravity_e(0.0, 0.0, up, *box)
                out[p, 7] += gravity_n(0.0, 0.0, up, *box)
                out[p, 8] += gravity_u(0.0, 0.0, up, *box)
    return out


def direct(terrain, points, base=0.0, above=2670.0, below=2670.0):
    """Tensor [E] and vector [m/s²] of the terrain's cells as prisms, by choclo alone."""
    lat, lon = np.radians(terrain.latitudes_deg), np.radians(terrain.longitudes_deg)
    half_lat = 0.5 * math.radians(terrain.latitude_step_deg)
    half_lon = 0.5 * math.radians(terrain.longitude_step_deg)
    west, east, south, north = (np.empty((len(points), lat.size, lon.size)) for _ in range(4))
    for p, (latitude, longitude, _) in enumerate(points):
        meridian, prime_vertical = radii_of_curvature(latitude)
        parallel = prime_vertical * np.cos(lat)[:, np.newaxis]
        bend = 0.5 * prime_vertical * math.sin(latitude) * math.cos(latitude)
        middle = meridian * (lat - latitude)[:, np.newaxis] + bend * (lon - longitude) ** 2
        west[p], east[p] = (parallel * (lon - longitude + side) for side in (-half_lon, half_lon))
        south[p], north[p] = (middle + side * meridian for side in (-half_lat, half_lat))
    found = prism_sums(
        places=points[:, 2],
        west=west,
        east=east,
        south=south,
        north=north,
        surface=terrain.height_m.astype(float),
        base=base,
        above=above,
        below=below,
    )
    return found[:, :6] / EOTVOS, found[:, 6:]


@pytest.mark.long
def test_the_field_between_the_summits_is_that_of_prisms():
    terrain = rough_terrain(64, 1500.0)
    masses = TerrainMasses.of(terrain, continued=False)
    points = points_above(masses, 40, 30.0, 500.0)
    assert points[:, 2].min() < 0.5 * terrain.height_m.max()
    tensor, vector = masses.field(points, RATIO)
    expected, attraction = direct(terrain, points)
    rms = np.sqrt(np.mean(expected**2, axis=0))
    off = np.sqrt(np.mean((tensor - expected) ** 2, axis=0))
    assert (off < 1e-3 * rms.max()).all() and off.max() < 0.2
    assert np.abs(vector - attraction).max() < 5e-4 * np.abs(attraction).max()


def test_lines_alone_are_not_the_field_near_the_ground():
    """The negative control of the test above."""
    terrain = rough_terrain(64, 1500.0)
    masses = TerrainMasses.of(terrain, continued=False)
    points = points_above(masses, 10, 30.0, 100.0)
    coarse = masses.field(points, 0.5)[0]
    assert np.abs(coarse - masses.field(points, RATIO)[0]).max() > 5.0


@pytest.mark.long
def test_the_field_is_that_of_harmonica():
    """Another package's layer of prisms in one plane, at 200 points 30 to 500 m above ground."""
    harmonica = pytest.importorskip("harmonica")

    terrain = rough_terrain(160, 2500.0)
    masses = TerrainMasses.of(terrain, continued=False)
    points = points_above(masses, 200, 30.0, 500.0)
    lat, lon = np.radians(terrain.latitudes_deg), np.radians(terrain.longitudes_deg)
    meridian, prime_vertical = radii_of_curvature(lat.mean())
    parallel = prime_vertical * math.cos(lat.mean())
    layer = harmonica.prism_layer(
        (parallel * (lon - lon.mean()), meridian * (lat - lat.mean())),
        surface=terrain.height_m,
        reference=0.0,
        properties={"density": np.full(terrain.height_m.shape, 2670.0)},
    )
    places = parallel * (points[:, 1] - lon.mean()), meridian * (points[:, 0] - lat.mean())
    expected = np.stack(
        [
            sign * layer.prism_layer.gravity((*places, points[:, 2]), field=name, parallel=False)
            for name, sign in (
                ("g_ee", 1),
                ("g_en", 1),
                ("g_ez", -1),
                ("g_nn", 1),
                ("g_nz", -1),
                ("g_zz", 1),
            )
        ],
        axis=-1,
    )
    tensor, _ = masses.field(points, RATIO)
    rms = np.sqrt(np.mean(expected**2, axis=0))
    off = np.sqrt(np.mean((tensor - expected) ** 2, axis=0))
    assert (off < 5e-3 * rms).all() and off.max() < 1.0
    assert np.abs(tensor[:, [0, 3, 5]].sum(axis=1)).max() < 1e-6 * np.abs(tensor).max()


def on_axis_of_a_disk(radius, bottom, top, above):
    """UU [E] and U [m/s²] of a cylinder on its axis at a level (Blakely 1995, sec. 3.2)."""
    near, far = above - top, above - bottom
    factor = 2.0 * math.pi * GRAVITATIONAL_CONSTANT * 2670.0
    pull = factor * (top - bottom - (math.hypot(radius, far) - math.hypot(radius, near)))
    slope = factor * (far / math.hypot(radius, far) - near / math.hypot(radius, near))
    return slope / EOTVOS, -pull


@pytest.mark.parametrize("body", ["cylinder", "cone", "hemisphere"])
def test_bodies_of_revolution_have_their_field_on_the_axis(body):
    """The body is a stack of thin disks, and the terrain a grid of cells 4 m wide."""
    radius, step = 200.0, 4.0
    meridian, prime_vertical = radii_of_curvature(math.radians(30.0))
    steps = np.degrees([step / meridian, step / (prime_vertical * math.cos(math.radians(30.0)))])
    nodes = step * (np.arange(121) - 60)
    away = np.hypot(nodes, nodes[:, np.newaxis]) / radius
    share = {
        "cylinder": np.where(away < 1.0, 1.0, 0.0),
        "cone": np.maximum(1.0 - away, 0.0),
        "hemisphere": np.sqrt(np.maximum(1.0 - away**2, 0.0)),
    }[body]
    terrain = Terrain(30.0 - 60 * steps[0], 10.0 - 60 * steps[1], *steps, radius * share, body)
    masses = TerrainMasses.of(terrain, continued=False)
    levels = np.array([230.0, 300.0, 500.0])
    points = np.stack([np.full(3, math.radians(30.0)), np.full(3, math.radians(10.0)), levels], 1)
    tensor, vector = masses.field(points, RATIO)
    edges = np.linspace(0.0, radius, 2001)
    middles = 0.5 * (edges[1:] + edges[:-1])
    widths = {
        "cylinder": np.full(2000, radius),
        "cone": radius - middles,
        "hemisphere": np.sqrt(radius**2 - middles**2),
    }[body]
    expected = np.array(
        [
            np.sum(
                [
                    on_axis_of_a_disk(width, low, high, level)
                    for width, low, high in zip(widths, edges[:-1], edges[1:], strict=True)
                ],
                axis=0,
            )
            for level in levels
        ]
    )
    assert tensor[:, 5] == pytest.approx(expected[:, 0], rel=5e-3)
    assert vector[:, 2] == pytest.approx(expected[:, 1], rel=5e-3)
    assert tensor[:, 0] == pytest.approx(-0.5 * expected[:, 0], rel=5e-3)


@pytest.mark.long
def test_a_sea_lacks_mass_against_rock():
    heights = np.full((40, 40), 60.0)
    heights[10:30, 5:30] = -400.0
    terrain = Terrain(-20.0, 40.0, 1e-3, 1e-3, heights, "a lagoon")
    masses = TerrainMasses.of(terrain, TerrainOptions(2500.0, 1000.0), continued=False)
    points = points_above(masses, 12, 500.0, 700.0)
    tensor, _ = masses.field(points, RATIO)
    expected, _ = direct(terrain, points, 0.0, 2500.0, 1500.0)
    assert np.abs(expected).max() > 20.0
    assert np.abs(tensor - expected).max() < 0.05


def test_above_the_summits_the_masses_are_those_of_the_series():
    """The continuation beyond the edges, and the level ground behind it, included."""
    terrain = rough_terrain(48, 600.0)
    lat, lon = np.radians(terrain.latitudes_deg[8:-8:8]), np.radians(terrain.longitudes_deg[8:-8:8])
    height = terrain.height_m.max() + 600.0
    expected, gravity = (a[:, :, 0] for a in terrain_field(terrain, lat, lon, np.array([height])))
    points = np.array([(a, b, height) for a in lat for b in lon])
    tensor, vector = TerrainMasses.of(terrain).field(points, RATIO)
    off = tensor.reshape(expected.shape) - expected
    assert np.sqrt(np.mean(off**2)) < 2e-3 * np.abs(expected).max()
    assert np.abs(vector.reshape(gravity.shape) - gravity).max() < 1e-5
    alone = TerrainMasses.of(terrain, continued=False).field(points, RATIO)[0]
    assert np.abs(alone.reshape(expected.shape) - expected).max() > 5.0  # it is worth something


def test_the_tensor_is_the_gradient_of_the_vector_and_has_no_trace():
    masses = TerrainMasses.of(rough_terrain(48, 1500.0))
    points = points_above(masses, 6, 100.0, 300.0)
    bases = [columns.base for columns in masses.layers]
    assert points[:, 2].min() < max(bases) < points[:, 2].max()
    tensor, _ = masses.field(points, 12.0)
    assert np.abs(tensor[:, [0, 3, 5]].sum(axis=1)).max() < 1e-6 * np.abs(tensor).max()
    step = 2.0
    metres = np.array([(*radii_of_curvature(a), 1.0) for a in points[:, 0]])
    metres[:, 1] *= np.cos(points[:, 0])
    for axis, columns in ((1, (0, 1, 2)), (0, (1, 3, 4)), (2, (2, 4, 5))):
        moved = np.zeros((2, *points.shape))
        moved[0, :, axis], moved[1, :, axis] = step / metres[:, axis], -step / metres[:, axis]
        ahead, behind = (masses.field(points + each, 12.0)[1] for each in moved)
        slope = (ahead - behind) / (2.0 * step * EOTVOS)
        assert np.abs(slope - tensor[:, columns]).max() < 5e-3 * np.abs(tensor).max()


def test_the_tolerance_chooses_the_split():
    masses = TerrainMasses.of(rough_terrain(64, 2500.0))
    points = points_above(masses, 60, 30.0, 200.0)
    chosen = [masses.ratio_for(points, tolerance) for tolerance in (1e3, 1.0, 0.1, 1e-9)]
    ratios, errors = zip(*chosen, strict=True)
    assert ratios[0] == RATIOS[0] and ratios[-1] == RATIOS[-1]
    assert list(ratios) == sorted(ratios) and ratios[1] > ratios[0]
    assert errors[1] <= 1.0 and errors[2] <= 0.1 < errors[0]
    others = points_above(masses, 60, 30.0, 200.0, seed=6)
    off = masses.field(others, ratios[2])[0] - masses.field(others, 24.0)[0]
    assert np.abs(off).max() < 3.0 * 0.1


def test_points_in_the_ground_or_beyond_the_terrain_are_refused():
    terrain = rough_terrain(32, 1500.0)
    masses = TerrainMasses.of(terrain, geoid_height=50.0)
    points = points_above(masses, 3, 100.0, 100.0)
    masses.field(points, 2.0)
    points[1, 2] -= 103.5
    place = f"{math.degrees(points[1, 0]):.5f}° N"
    with pytest.raises(TerrainError, match=f"{place}.*lies 3.5 m below the ground"):
        masses.field(points, 2.0)
    points[1] = math.radians(terrain.south_deg - 1.0), points[1, 1], 9e3
    with pytest.raises(TerrainError, match="is not within"):
        masses.field(points, 2.0)
    with pytest.raises(TerrainError, match="finite"):
        TerrainMasses.of(terrain, geoid_height=math.nan)


def test_a_turn_of_longitude_and_the_geoid_change_nothing_else():
    terrain = rough_terrain(32, 1500.0)
    masses = TerrainMasses.of(terrain)
    points = points_above(masses, 4, 100.0, 300.0)
    expected = masses.field(points, 4.0)
    raised = TerrainMasses.of(terrain, geoid_height=48.0)
    found = raised.field(points + np.array([0.0, -math.tau, 48.0]), 4.0)
    for one, other in zip(expected, found, strict=True):
        assert one == pytest.approx(other, rel=1e-9, abs=1e-12 + 1e-9 * np.abs(one).max())


def test_a_process_that_is_asked_to_end_does_not_finish_a_layer(monkeypatch):
    masses = TerrainMasses.of(rough_terrain(32, 500.0))
    points = points_above(masses, 4, 100.0, 300.0)
    monkeypatch.setattr(writing, "asked_to_end", threading.Event())
    masses.field(points, 2.0)
    writing.asked_to_end.set()
    with pytest.raises(KeyboardInterrupt):
        masses.field(points, 2.0)
