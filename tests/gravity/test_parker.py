"""The field of a terrain against right-rectangular prisms, and what makes it a gravity field."""

import itertools
import math

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
from rasterio.warp import transform
from scipy.interpolate import RectBivariateSpline
from terrain_fields import terrain_field

from ggbench.gravity import parker
from ggbench.gravity.ellipsoid import EOTVOS, radii_of_curvature
from ggbench.gravity.parker import TerrainOptions, terrain_layers
from ggbench.gravity.terrain import Terrain, TerrainError
from ggbench.gravity.terrain_files import read_terrain
from ggbench.maps.package_data import data_bytes

G = 6.6743e-11
STEP_DEG = 4.0 / 3600.0
# Metres to the east and north of the middle, height, width [m]: a summit, hills, a basin.
HILLS = (
    (0, 0, 700, 1200),
    (2500, 2000, 400, 900),
    (-2500, -1500, 500, 1100),
    (1500, -2500, 300, 700),
)
BASIN = (-1500, 2500, -600, 900)


@njit
def prisms(points, x, y, surface, base, size, densities):
    """EE, EN, EU, NN, NU, UU [1/s²], E, N, U [m/s²] of prisms between a surface and its base."""
    out = np.zeros((points.shape[0], 9))
    for p in range(points.shape[0]):
        e, n, u = points[p]
        for j in range(y.size):
            for i in range(x.size):
                top = surface[j, i]
                if abs(top - base) < 1e-6:
                    continue
                box = (
                    x[i] - size / 2,
                    x[i] + size / 2,
                    y[j] - size / 2,
                    y[j] + size / 2,
                    min(top, base),
                    max(top, base),
                    densities[0] if top > base else -densities[1],
                )
                out[p, 0] += gravity_ee(e, n, u, *box)
                out[p, 1] += gravity_en(e, n, u, *box)
                out[p, 2] += gravity_eu(e, n, u, *box)
                out[p, 3] += gravity_nn(e, n, u, *box)
                out[p, 4] += gravity_nu(e, n, u, *box)
                out[p, 5] += gravity_uu(e, n, u, *box)
                out[p, 6] += gravity_e(e, n, u, *box)
                out[p, 7] += gravity_n(e, n, u, *box)
                out[p, 8] += gravity_u(e, n, u, *box)
    return out


def prism_field(terrain, latitude_deg, longitude_deg, level, base, size, densities):
    """The field of prisms of a given size in PROJ's transverse Mercator plane, in ENU axes.

    They sample a cubic spline through the terrain, which is level, at ``base``, along its edges.
    """
    lat, lon = terrain.latitudes_deg, terrain.longitudes_deg
    plane = f"+proj=tmerc +lat_0={lat.mean()} +lon_0={lon.mean()} +ellps=WGS84 +type=crs"

    def to_plane(north, east):
        return np.array(transform("EPSG:4326", plane, east, north))

    corners = to_plane(lat[[0, 0, -1, -1]], lon[[0, -1, 0, -1]])
    x, y = (np.arange(c.min(), c.max(), size) for c in corners)
    grid_x, grid_y = np.meshgrid(x, y)
    east, north = map(np.array, transform(plane, "EPSG:4326", grid_x.ravel(), grid_y.ravel()))
    east = lon.mean() + (east - lon.mean() + 180.0) % 360.0 - 180.0
    surface = RectBivariateSpline(lat, lon, terrain.height_m).ev(
        np.clip(north, lat[0], lat[-1]), np.clip(east, lon[0], lon[-1])
    )
    at_north, at_east = (a.ravel() for a in np.meshgrid(latitude_deg, longitude_deg, indexing="ij"))
    here, there = to_plane(at_north, at_east), to_plane(at_north + 1e-4, at_east)
    points = np.column_stack((*here, np.full(at_north.size, level)))
    field = prisms(
        points=points,
        x=x,
        y=y,
        surface=surface.reshape(grid_x.shape),
        base=base,
        size=size,
        densities=np.array(densities),
    )

    turn = np.arctan2(*(there - here))  # from plane north to true north
    c, s, zero, one = np.cos(turn), np.sin(turn), np.zeros_like(turn), np.ones_like(turn)
    axes = np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)
    full = field[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    turned = (axes @ full @ axes.transpose(0, 2, 1))[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    vector = (axes @ field[:, 6:, np.newaxis])[..., 0]
    vector[:, 2] -= 2.0 * math.pi * G * densities[0] * base  # what is level reaches to infinity
    shape = (len(latitude_deg), len(longitude_deg), -1)
    return turned.reshape(shape) / EOTVOS, vector.reshape(shape)


def hills(latitude_deg, longitude_deg, *shapes, count=161):
    """A terrain of Gaussian hills, level with the zero level along its edges."""
    offsets = STEP_DEG * (np.arange(count) - count // 2)
    meridian, prime_vertical = radii_of_curvature(math.radians(latitude_deg))
    north = np.radians(offsets)[:, np.newaxis] * meridian
    east_step = STEP_DEG / math.cos(math.radians(latitude_deg))
    east = np.radians(offsets / math.cos(math.radians(latitude_deg))) * (
        prime_vertical * math.cos(math.radians(latitude_deg))
    )
    height = sum(
        top * np.exp(-0.5 * ((east - e) ** 2 + (north - n) ** 2) / width**2)
        for e, n, top, width in shapes
    )
    return Terrain(
        latitude_deg + offsets[0],
        longitude_deg + east_step * (0 - count // 2),
        STEP_DEG,
        east_step,
        height,
        "hills",
    )


def inside(terrain, count=4, share=0.3):
    """Latitudes and longitudes [deg] in the middle of a terrain, on no node."""
    return tuple(
        axis.mean() + share * np.linspace(-0.5, 0.47, count) * np.ptp(axis)
        for axis in (terrain.latitudes_deg, terrain.longitudes_deg)
    )


def rms(difference):
    return np.sqrt((difference**2).mean(axis=(0, 1)))


def assert_agrees_with_prisms(terrain, level, base, size, densities=(2670.0, 2670.0)):
    lat, lon = inside(terrain)
    tensor, vector = terrain_field(terrain, np.radians(lat), np.radians(lon), [level])
    expected, expected_vector = prism_field(
        terrain=terrain,
        latitude_deg=lat,
        longitude_deg=lon,
        level=level,
        base=base,
        size=size,
        densities=densities,
    )
    # The field is one that matters, and the difference is the 0.05 E that is asked for at most.
    assert rms(expected).min() > 5.0 and rms(expected).max() > 15.0
    assert rms(tensor[:, :, 0] - expected).max() < 0.05
    assert rms(vector[:, :, 0] - expected_vector).max() < 5e-8  # 0.005 mGal


@pytest.mark.long  # as the other tests with prisms, of which the compiler has much to do
@pytest.mark.parametrize("clearance", [300.0, 1500.0])
def test_hills_agree_with_prisms(clearance):
    terrain = hills(36.3, -84.2, *HILLS)
    assert_agrees_with_prisms(terrain, terrain.height_m.max() + clearance, 0.0, 75.0)


@pytest.mark.long
def test_hills_far_south_across_the_date_line_agree_with_prisms():
    terrain = hills(-75.0, 180.0, *HILLS)
    assert_agrees_with_prisms(terrain, terrain.height_m.max() + 600.0, 0.0, 90.0)


@pytest.mark.long
def test_land_and_sea_floor_agree_with_prisms():
    terrain = hills(36.3, -84.2, *HILLS, BASIN)
    level = terrain.height_m.max() + 600.0
    assert terrain.height_m.min() < -500.0
    assert_agrees_with_prisms(terrain, level, 0.0, 90.0, densities=(2670.0, 2670.0 - 1030.0))


@pytest.mark.long
@pytest.mark.parametrize(("clearance", "size"), [(300.0, 40.0), (1000.0, 80.0)])
def test_a_real_terrain_agrees_with_prisms(jacksboro, clearance, size):
    part = jacksboro.crop(36.17, 36.32, -84.33, -84.15)
    level = 400.0

    def fade(count):  # level along the edges, where the prisms know of no continuation
        inwards = np.minimum(np.arange(count), np.arange(count)[::-1])
        return np.sin(0.5 * np.pi * np.clip((inwards - 24.0) / 24.0, 0.0, 1.0)) ** 2

    faded = level + np.outer(*map(fade, part.height_m.shape)) * (part.height_m - level)
    terrain = Terrain(
        part.south_deg, part.west_deg, part.latitude_step_deg, part.longitude_step_deg, faded, "it"
    )
    assert_agrees_with_prisms(terrain, faded.max() + clearance, level, size)


@pytest.fixture(scope="module")
def jacksboro(tmp_path_factory):
    path = tmp_path_factory.mktemp("terrain") / "jacksboro.npz"
    path.write_bytes(data_bytes("jacksboro_dem_3arcsec.npz"))
    return read_terrain(path)


@pytest.fixture(scope="module")
def hilly():
    return hills(0.0, 20.0, *HILLS, BASIN, count=101)


def at_radians(terrain, **where):
    return tuple(np.radians(axis) for axis in inside(terrain, **where))


def test_tensor_is_the_gradient_of_the_vector(hilly):
    # On the equator, where parallels and meridians do not turn.
    lat, lon = at_radians(hilly, count=3)
    d = 20.0
    meridian, prime_vertical = radii_of_curvature(0.0)
    level = hilly.height_m.max() + 500.0
    tensor, _ = terrain_field(hilly, lat, lon, [level])

    def vector(east=0.0, north=0.0, up=0.0):
        where = (lat + north / meridian, lon + east / prime_vertical, [level - d, level + up])
        return terrain_field(hilly, *where)[1][:, :, 1]

    for axis, components in (("east", (0, 1, 2)), ("north", (1, 3, 4)), ("up", (2, 4, 5))):
        slope = (vector(**{axis: d}) - vector(**{axis: -0.999 * d})) / (1.999 * d) / EOTVOS
        assert np.abs(slope - tensor[:, :, 0][..., components]).max() < 0.1
    assert np.abs(tensor).max() > 30.0


def test_field_is_linear_in_the_densities(hilly):
    where = (*at_radians(hilly), [1500.0])
    single, double, dry, wet = (
        np.concatenate(terrain_field(hilly, *where, TerrainOptions(*densities)), axis=-1)
        for densities in ((1500.0, 500.0), (3000.0, 1000.0), (3000.0, 0.0), (0.0, 1000.0))
    )
    scale = np.abs(double).max(axis=(0, 1, 2))
    assert np.abs((double - 2.0 * single) / scale).max() < 1e-4
    assert np.abs((double - dry - wet) / scale).max() < 1e-4


@pytest.mark.parametrize(("ground", "density"), [(500.0, 2670.0), (-2000.0, 2670.0 - 1030.0)])
def test_level_ground_is_an_infinite_slab(ground, density):
    terrain = Terrain(36.0, -84.0, 0.01, 0.01, np.full((20, 30), ground), "level ground")
    tensor, vector = terrain_field(terrain, *at_radians(terrain), [900.0, 5000.0])
    assert np.abs(tensor).max() < 1e-9
    expected = np.array([0.0, 0.0, -2.0 * math.pi * G * density * ground])
    np.testing.assert_allclose(vector, np.broadcast_to(expected, vector.shape), atol=1e-15)


def test_height_counts_from_the_geoid(hilly):
    lat, lon = at_radians(hilly)
    plain = terrain_field(hilly, lat, lon, [1000.0])
    lifted = terrain_field(hilly, lat, lon, [970.0], geoid_height=-30.0)
    for one, other in zip(plain, lifted, strict=True):
        np.testing.assert_array_equal(one, other)


def test_low_orders_of_the_series_are_visibly_worse(hilly, monkeypatch):
    where = (*at_radians(hilly), [hilly.height_m.max() + 300.0])
    converged, _ = terrain_field(hilly, *where)
    monkeypatch.setattr(parker, "CONVERGED", math.inf)
    monkeypatch.setattr(parker, "FEWEST_ORDERS", 1)
    errors = [
        np.abs(terrain_field(hilly, *where, TerrainOptions(order=order))[0] - converged).max()
        for order in (1, 2, 4, 8)
    ]
    assert errors[0] > 10.0
    assert all(worse > 1.5 * better for worse, better in itertools.pairwise(errors))
    assert errors[-1] < 1.0


@pytest.mark.long
def test_series_sums_as_many_orders_as_it_takes(hilly):
    where = (*at_radians(hilly), [hilly.height_m.max() + 150.0])
    few, many = (terrain_field(hilly, *where, TerrainOptions(order=order))[0] for order in (6, 70))
    assert np.abs(few - many).max() < 0.01


def test_layers_one_by_one_are_the_field(hilly):
    lat, lon = at_radians(hilly, count=6)
    heights = [2000.0, 1000.0, 1300.0]
    tensor, vector = terrain_field(hilly, lat, lon, heights)
    for index, (layer, layer_vector) in enumerate(terrain_layers(hilly, lat, lon, heights)):
        assert layer.dtype == layer_vector.dtype == np.float32
        assert np.abs(layer - tensor[:, :, index]).max() < 1e-3
        assert np.abs(layer_vector - vector[:, :, index]).max() < 1e-9


@pytest.mark.long
def test_field_depends_neither_on_other_heights_nor_on_turns(jacksboro):
    # With a lower height asked for, the Fourier grid is finer.
    lat, lon = at_radians(jacksboro)
    alone, _ = terrain_field(jacksboro, lat, lon, [2000.0])
    among, _ = terrain_field(jacksboro, lat, lon + 2.0 * math.pi, [1300.0, 2000.0])
    assert np.abs(alone[:, :, 0] - among[:, :, 1]).max() < 0.01


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"latitude": [0.5]}, r"latitude 28\.6.* is not within hills: -0\.05.* to 0\.05"),
        ({"longitude": [-1.0]}, r"longitude .* is not within hills: 19\.9.* to 20\.0"),
        ({"latitude": [0.0, np.nan]}, "latitude must be one or more finite numbers"),
        ({"longitude": []}, "longitude must be one or more finite numbers"),
        ({"height": [[1000.0]]}, "height must be one or more finite numbers"),
        ({"height": [3000.0, 600.0]}, r"lies 1\d\d.* m below the highest ground of hills"),
        ({"height": [1500.0], "geoid_height": 1000.0}, "below the highest ground"),
        ({"geoid_height": math.nan}, "geoid_height = nan must be a finite number"),
        ({"height": [713.0]}, r"Fourier nodes.*or raise .* m above the highest ground"),
    ],
)
def test_impossible_positions_are_refused(hilly, change, message):
    where = {"latitude": [0.0], "longitude": [math.radians(20.0)], "height": [1000.0], **change}
    with pytest.raises(TerrainError, match=message):
        terrain_field(hilly, **where)


@pytest.mark.long
def test_a_height_at_which_the_series_is_too_long_is_refused():
    count = 12
    ground = 4000.0 * np.indices((count, count)).sum(axis=0) % 8000.0
    terrain = Terrain(36.0, -84.0, 1e-3, 1e-3, ground, "spikes")
    with pytest.raises(
        TerrainError, match=r"an error of .* E after 80 orders; .*highest ground of .*: raise it"
    ):
        terrain_field(terrain, *at_radians(terrain), [ground.max() + 10.0])


def test_a_terrain_too_wide_for_a_plane_is_refused():
    terrain = Terrain(-60.0, 0.0, 1.0, 1.0, np.zeros((120, 170)), "half a globe")
    with pytest.raises(TerrainError, match="half a globe is too wide for the plane"):
        terrain_field(terrain, [0.0], [1.0], [1000.0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"density": -1.0}, "density = -1.0 must lie between 0 and 10000"),
        ({"water_density": math.nan}, "water_density = nan must lie between"),
        ({"order": 5}, "order = 5 must be a whole number from 6 to 80"),
        ({"order": 7.5}, "order = 7.5 must be"),
    ],
)
def test_impossible_options_are_refused(options, message):
    with pytest.raises(TerrainError, match=message):
        TerrainOptions(**options)
