"""Gradient maps: the field is harmonic and consistent, agrees with known values, is kept safely."""

from __future__ import annotations

import dataclasses
import importlib.resources
import math
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from field_derivatives import SYMMETRIC, ecef_axes
from scipy.interpolate import make_interp_spline
from shipped_fields import REGIONS, disturbing_field
from thinning import thinned

from ggbench.gravity import ellipsoid
from ggbench.gravity.gradient_map import GradientMap, MapError
from ggbench.gravity.harmonics import (
    HarmonicCoefficients,
    gravity_and_gradient,
    potential,
    without_normal_field,
)
from ggbench.maps import recipe
from ggbench.maps.recipe import MapRecipe, build, load_or_build
from ggbench.maps.shipped import SOURCES
from ggbench.numerics.cache import CACHE_VARIABLE

SOURCE = "egm2008_qinling"
RECIPE = MapRecipe(
    source=SOURCE,
    south_deg=32.5,
    north_deg=34.5,
    west_deg=107.0,
    east_deg=110.0,
    min_height_m=8500.0,
    max_height_m=11500.0,
)
SMALL = MapRecipe(
    source=SOURCE,
    south_deg=33.4,
    north_deg=33.6,
    west_deg=108.0,
    east_deg=108.2,
    min_height_m=9000.0,
    max_height_m=11000.0,
)


@pytest.fixture(scope="module")
def qinling() -> GradientMap:
    return build(RECIPE)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    return tmp_path / "maps"


def random_coefficients(degree: int, seed: int) -> HarmonicCoefficients:
    """Coefficients with a spectrum like the Earth's (Kaula's rule)."""
    n = np.maximum(np.arange(degree + 1), 2)[:, np.newaxis]
    cosine, sine = (
        np.random.default_rng(seed).normal(size=(2, degree + 1, degree + 1)) * 1e-5 / n**2
    )
    lower = np.tril(np.ones((degree + 1, degree + 1)))
    sine[:, 0] = 0.0
    return HarmonicCoefficients(ellipsoid.GM, 6.3781e6, cosine * lower, sine * lower)


# --- spherical harmonics ---------------------------------------------------------------------


def test_normal_field_as_a_series_has_its_known_gradient():
    cosine = np.zeros((13, 13))
    cosine[0, 0] = 1.0
    n = np.arange(2, 13, 2)
    cosine[n, 0] = -ellipsoid.EVEN_ZONALS / np.sqrt(2 * n + 1)
    coefficients = HarmonicCoefficients(
        ellipsoid.GM, ellipsoid.SEMI_MAJOR_AXIS, cosine, np.zeros_like(cosine)
    )
    _, tensor = gravity_and_gradient(coefficients, [math.radians(33.5)], [1.9], [0.0, 1e4])
    ground, high = tensor[0, 0]
    known = [-1532.4116159, 0.0, 0.0, -1535.8771315, -5.0342655, 3068.2887474]
    np.testing.assert_allclose(high, known, atol=1e-7)
    np.testing.assert_allclose(
        ground, [-1539.63404, 0.0, 0.0, -1543.12688, -5.05148, 3082.76092], atol=1e-5
    )
    disturbing = without_normal_field(coefficients)
    assert np.abs(disturbing.cosine).max() < 1e-20


@pytest.mark.parametrize("latitude_deg", [-89.9, -47.3, 0.0, 33.5, 71.0])
def test_gravity_and_gradient_are_differences_of_the_potential(latitude_deg):
    coefficients = random_coefficients(60, seed=4)
    longitude, height, step = 0.7, 8000.0, 500.0
    latitude = math.radians(latitude_deg)
    # Along a straight line the second difference of the potential needs no frame: u'Gu.
    home = ecef_axes(latitude, longitude)
    vector, six = gravity_and_gradient(coefficients, [latitude], [longitude], [height])
    _, prime_vertical = ellipsoid.radii_of_curvature(latitude)
    flattening = np.array([1.0, 1.0, 1.0 - ellipsoid.ECCENTRICITY_SQUARED])
    origin = (prime_vertical * flattening + height) * home[:, 2]

    def potential_at(point):
        rho = math.hypot(point[0], point[1])
        # Bowring's iteration back to geodetic coordinates.
        lat = math.atan2(point[2], rho * (1.0 - ellipsoid.ECCENTRICITY_SQUARED))
        for _ in range(8):
            _, radius = ellipsoid.radii_of_curvature(lat)
            shift = ellipsoid.ECCENTRICITY_SQUARED * radius * math.sin(lat)
            lat = math.atan2(point[2] + shift, rho)
        h = rho * math.cos(lat) + point[2] * math.sin(lat)
        h -= radius * (1.0 - ellipsoid.ECCENTRICITY_SQUARED * math.sin(lat) ** 2)
        lon = math.atan2(point[1], point[0])
        return potential(coefficients, [lat], [lon], [h])[0, 0, 0]

    tensor = six[0, 0, 0][SYMMETRIC]
    for direction in np.random.default_rng(1).normal(size=(4, 3)):
        direction /= np.linalg.norm(direction)
        before, here, after = (
            potential_at(origin + s * step * home @ direction) for s in (-1, 0, 1)
        )
        slope = direction @ vector[0, 0, 0]
        curvature = direction @ tensor @ direction
        assert (after - before) / (2 * step) == pytest.approx(
            slope, abs=1e-4 * np.abs(vector).max()
        )
        assert (after - 2 * here + before) / step**2 / ellipsoid.EOTVOS == pytest.approx(
            curvature, abs=2e-3 * np.abs(tensor).max()
        )


def test_the_pole_is_a_point_like_any_other():
    coefficients = random_coefficients(120, seed=5)
    longitudes = np.array([0.0, 1.0, 2.5])
    at_pole = potential(coefficients, [math.pi / 2], longitudes, [0.0])
    assert np.ptp(at_pole) < 1e-9 * np.abs(at_pole).max()
    vector, tensor = gravity_and_gradient(coefficients, [math.pi / 2], longitudes, [0.0])
    # Axes turn with the longitude; the Earth-fixed tensor does not.
    fixed = [
        ecef_axes(math.pi / 2, lon) @ six[SYMMETRIC] @ ecef_axes(math.pi / 2, lon).T
        for lon, six in zip(longitudes, tensor[0, :, 0], strict=True)
    ]
    np.testing.assert_allclose(fixed[1:], [fixed[0]] * 2, atol=1e-9 * np.abs(tensor).max())
    assert np.isfinite(vector).all()


# --- the field of the source -----------------------------------------------------------------


def test_known_profile_of_the_vertical_gradient():
    """A reference profile, given to 0.1 E, which the map meets as declared and not otherwise.

    It was in all likelihood made with the same relief: a guard of the steps and of the relief's
    place and spacing, no validation of EGM2008. A relief of point samples every 6' is 2.6 E off.
    """
    known = [-3.8, -3.0, -3.7, -4.4, -3.5, -2.2, -1.8, -0.4, 4.4, 12.1, 21.1, 28.6, 31.5, 29.3]
    longitude = np.radians(108.0 + np.arange(len(known)) * 2.5 / 60.0)

    def difference(**options):
        tensor, _ = disturbing_field(SOURCE, [math.radians(33.5)], longitude, [1e4], **options)
        return tensor[0, :, 0, 5] - known

    as_declared, smoothed, uncorrected = (
        difference(**options)
        for options in ({}, {"relief_smoothing_deg": 0.06}, {"land_correction": False})
    )
    rms = [math.sqrt(np.mean(d**2)) for d in (as_declared, smoothed, uncorrected)]
    print(f"rms as declared, smoothed, uncorrected [E]: {rms}; max {np.abs(as_declared).max()}")
    assert rms[0] < 0.1
    assert np.abs(as_declared).max() < 0.2
    assert rms[1] > 0.5
    assert rms[2] > 3.0


def test_no_map_that_is_rebuilt_is_called_egm2008s(qinling):
    """What a map says of itself, and what is written about it: not a field that it is not."""
    assert qinling.provenance.startswith("rebuilt from the EGM2008 geoid")
    for name in REGIONS:
        assert re.search(
            r"rebuilt from the EGM2008 geoid.*; differs from the EGM2008 field by .* E",
            SOURCES[name].provenance,
        )
    root = Path(__file__).parents[2]
    written = [
        root / "README.md",
        *(root / "docs").glob("**/*.md"),
        *(root / "scenarios").rglob("*.[mt][do]*"),
    ]
    assert len(written) > 20
    for document in written:
        text = " ".join(document.read_text().split())
        assert not re.search(r"(?<!from )EGM2008('s)? (field|map)", text), document


def test_field_decays_upwards_and_is_continuous_across_bands():
    latitude = math.radians(33.0) + np.array([-1e-11, 1e-11])  # a tenth of a millimetre apart
    longitude = np.radians(np.linspace(107.0, 110.0, 30))
    tensor, _ = disturbing_field(SOURCE, latitude, longitude, [5e3, 1e4, 2e4])
    spread = tensor[0, :, :, 5].std(axis=0)
    assert spread[0] > 1.3 * spread[1] > 1.3**2 * spread[2]
    assert np.abs(np.diff(tensor, axis=0)).max() < 1e-5


def test_interpolation_at_the_default_spacing_costs_less_than_a_thousandth(qinling):
    """Cubic splines through the nodes against the field itself, off the nodes, about 10 km up."""
    axes = [
        first + step * np.arange(count)
        for first, step, count in zip(
            (qinling.latitude0, qinling.longitude0, qinling.height0),
            (qinling.latitude_step, qinling.longitude_step, qinling.height_step),
            qinling.tensor.shape,
            strict=False,
        )
    ]
    rng = np.random.default_rng(8)
    margins = (0.003, 0.003, 1500.0)
    counts = (15, 20, 1)
    points = [
        np.sort(rng.uniform(axis[0] + margin, axis[-1] - margin, count))
        for axis, margin, count in zip(axes, margins, counts, strict=True)
    ]
    points[2] = np.array([10000.0, 10250.0])
    spline = qinling.tensor
    for axis, (nodes, wanted) in enumerate(zip(axes, points, strict=True)):
        spline = make_interp_spline(nodes, spline, k=3, axis=axis)(wanted)
    direct, _ = disturbing_field(SOURCE, *points)
    rms = np.sqrt(np.mean((spline - direct) ** 2, axis=(0, 1)))
    print(f"rms at 10 km (between height nodes: second row) [E]:\n{rms}")
    assert rms.max() < 1e-3


def test_land_correction_matters_on_land():
    longitude = np.radians(np.linspace(108.0, 109.0, 20))
    corrected, plain = (
        disturbing_field(SOURCE, [math.radians(33.5)], longitude, [1e4], land_correction=land)[0]
        for land in (True, False)
    )
    assert 0.5 < (corrected - plain)[..., 5].std() < 6.0


def test_land_has_heights_and_the_sea_has_none():
    """What lies under water is no land that a geoid would have to be corrected for."""
    source = REGIONS["egm2008_south_china_sea"]
    geoid = source.grid()
    elevation = source.elevation(geoid, 0.0)
    assert elevation.shape == geoid.values.shape
    assert elevation.min() == 0.0 and elevation.max() > 1000.0
    assert 0.5 < np.mean(elevation == 0.0) < 0.95


def test_map_nodes_cover_the_bounds(qinling):
    assert qinling.tensor.shape == (97, 145, 7, 6)
    assert qinling.gravity_disturbance.shape == (97, 145, 7, 3)
    north = qinling.latitude0 + 96 * qinling.latitude_step
    assert math.degrees(north) == pytest.approx(34.5)
    # A node is what the field is there.
    place = (
        qinling.latitude0 + 40 * qinling.latitude_step,
        qinling.longitude0 + 70 * qinling.longitude_step,
        qinling.height0 + 3 * qinling.height_step,
    )
    tensor, vector = disturbing_field(SOURCE, *([x] for x in place))
    np.testing.assert_allclose(qinling.tensor[40, 70, 3], tensor[0, 0, 0], atol=1e-8)
    np.testing.assert_allclose(qinling.gravity_disturbance[40, 70, 3], vector[0, 0, 0], atol=1e-14)


# --- the cache -------------------------------------------------------------------------------


def assert_same(one: GradientMap, other: GradientMap) -> None:
    for field in dataclasses.fields(one):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))
        assert type(getattr(one, field.name)) is type(getattr(other, field.name))


def test_cached_map_equals_the_built_one(cache, monkeypatch):
    built = load_or_build(SMALL)
    assert len(list(cache.glob("*.nc"))) == 1
    monkeypatch.setattr(recipe, "build", lambda recipe: pytest.fail("the cache was not used"))
    assert_same(load_or_build(SMALL), built)


@thinned("damage", ["truncated", "overwritten", "empty", "foreign", "another map"])
def test_damaged_cache_file_is_rebuilt(cache, damage):
    built = load_or_build(SMALL)
    (file,) = cache.glob("*.nc")
    content = file.read_bytes()
    if damage == "foreign":
        np.savez(file.with_suffix(".npz"), tensor=np.zeros(3))
        file.with_suffix(".npz").replace(file)
    elif damage == "another map":
        recipe.write(file, build(dataclasses.replace(SMALL, land_correction=False)))
    else:
        middle = len(content) // 2
        file.write_bytes(
            {
                "truncated": content[:middle],
                "overwritten": b"not a map" * 1000,
                "empty": b"",
            }[damage]
        )
    assert_same(load_or_build(SMALL), built)
    assert [entry.read_bytes() for entry in cache.glob("*.nc")] == [content]


@pytest.mark.long
@pytest.mark.parametrize("seed", range(4))
def test_a_flipped_bit_anywhere_in_the_cache_changes_no_map(cache, seed, monkeypatch):
    """Values, axes, attributes and the file's own structure."""
    built = load_or_build(SMALL)
    monkeypatch.setattr(recipe, "build", lambda _: built)
    (file,) = cache.glob("*.nc")
    content = file.read_bytes()
    rng = np.random.default_rng(seed)
    # Half of the places within the first and last kilobytes, where the structure is.
    places = np.concatenate((rng.integers(len(content), size=10), rng.integers(-6000, 6000, 30)))
    rebuilt = 0
    for place in places:
        damaged = bytearray(content)
        damaged[place] ^= 1 << rng.integers(8)
        file.write_bytes(damaged)
        assert_same(load_or_build(SMALL), built)
        rebuilt += file.read_bytes() == content
    assert rebuilt > 5  # other bits are those of no value


def test_another_recipe_is_another_file(cache):
    changes = [{}, {"land_correction": False}, {"relief_smoothing_deg": 0.06}]
    gradient_maps = [load_or_build(dataclasses.replace(SMALL, **change)) for change in changes]
    assert len(list(cache.glob("*.nc"))) == 3
    # Each says of itself which it is.
    notes = ["relief not smoothed", "without land correction", "relief smoothed by 0.06 deg"]
    for gradient_map, note in zip(gradient_maps, notes, strict=True):
        assert gradient_map.provenance.endswith(note)


def test_other_code_or_data_make_another_file(monkeypatch):
    """A cached map is used only with the sources of the rooms that made it, and the very data."""
    before = recipe.content_key(SMALL)
    with monkeypatch.context() as patch:
        patch.setattr(recipe, "rooms_hash", lambda *rooms: f"other {rooms}")
        assert recipe.content_key(SMALL) != before
    with monkeypatch.context() as patch:
        patch.setattr(recipe, "data_bytes", lambda name: b"other data")
        assert recipe.content_key(SMALL) != before
    assert recipe.content_key(SMALL) == before
    assert {"numerics", "gravity", "maps"} <= set(recipe.MAP_ROOMS)


def test_builders_at_the_same_time_leave_one_whole_file(cache):
    with ThreadPoolExecutor(4) as pool:
        several = list(pool.map(load_or_build, [SMALL] * 4))
    for one in several[1:]:
        assert_same(one, several[0])
    assert {entry.suffix for entry in cache.iterdir()} == {".nc", ".lock"}


def test_cache_that_cannot_be_written_is_not_fatal(tmp_path, monkeypatch):
    obstacle = tmp_path / "file"
    obstacle.write_text("a file where a folder should be")
    monkeypatch.setenv(CACHE_VARIABLE, str(obstacle))
    assert_same(load_or_build(SMALL), build(SMALL))


# --- errors a user can cause -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"source": "atlantis"},
            "Unknown map source 'atlantis'; allowed: east_victoria2023, egm2008_alps",
        ),
        ({"south_deg": 35.0}, "south_deg = 35.0 must be less than north_deg = 34.5"),
        ({"west_deg": 107.0, "east_deg": 107.0}, "west_deg = 107.0 must be less than east_deg"),
        ({"max_height_m": 8000.0}, "min_height_m = 8500.0 must be less than max_height_m"),
        ({"north_deg": math.nan}, "north_deg = nan"),
        ({"south_deg": 28.0}, r"south_deg = 28.0 is outside .*: 28\.5 to 38\.5 is allowed"),
        ({"east_deg": 115.0}, r"east_deg = 115.0 is outside .*: 102\.5 to 114\.5 is allowed"),
        ({"min_height_m": 500.0}, "min_height_m = 500.0 .*: 3000 to 30000 is allowed"),
        ({"max_height_m": 1e5}, "max_height_m = 100000.0 .*: 3000 to 30000 is allowed"),
        ({"spacing_arcmin": 2.5}, "spacing_arcmin = 2.5 is too wide .* at most 1.28 is allowed"),
        ({"spacing_arcmin": 0.0}, "spacing_arcmin = 0.0 must be positive"),
        ({"spacing_arcmin": 0.01}, "at most 5000000 in all are allowed"),
        ({"relief_smoothing_deg": -0.1}, "relief_smoothing_deg = -0.1 must lie between 0"),
        ({"relief_smoothing_deg": 1.5}, "relief_smoothing_deg = 1.5 must lie .* and 1"),
        ({"relief_smoothing_deg": math.nan}, "relief_smoothing_deg = nan must lie"),
        ({"height_spacing_m": math.inf}, "height_spacing_m = inf must be positive and finite"),
        ({"height_spacing_m": 2500.0}, "height_spacing_m = 2500.0 is too wide .* at most 2125"),
        ({"height_spacing_m": 2000.0}, r"\(97, 145, 3\) nodes .* at least 4"),
    ],
)
def test_impossible_recipe_is_refused_with_what_is_allowed(change, message):
    with pytest.raises(MapError, match=message):
        build(dataclasses.replace(RECIPE, **change))


@pytest.mark.parametrize("content", [None, b"", b"PK\x03\x04 not really an archive"])
def test_missing_or_damaged_data_file_is_named(tmp_path, monkeypatch, content):
    (tmp_path / "data").mkdir()
    name = REGIONS[SOURCE].file
    if content is not None:
        (tmp_path / "data" / name).write_bytes(content)
    monkeypatch.setattr(importlib.resources, "files", lambda package: tmp_path)
    with pytest.raises(MapError, match=f"Data file {name} .*(cannot be read|is damaged)"):
        load_or_build(RECIPE)


def test_a_recipe_counts_longitudes_in_any_turn():
    """The same map, kept at the same place."""
    here = dataclasses.replace(SMALL, east_deg=108.25)
    for west, east in ((-252.0, -251.75), (-252.0, 108.25), (108.0, -251.75)):
        turned = recipe.checked(dataclasses.replace(here, west_deg=west, east_deg=east))
        assert turned == here
        assert recipe.cached_path(turned) == recipe.cached_path(here)
    exchanged = dataclasses.replace(SMALL, west_deg=108.2, east_deg=108.0)
    with pytest.raises(MapError, match=r"west_deg = 108.2 must be less than east_deg = 108.0"):
        recipe.checked(exchanged)
