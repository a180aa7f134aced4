"""Shipped regions: harmonic fields, gradients of gravity, made of whole data."""

from __future__ import annotations

import fnmatch
import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from field_derivatives import derivatives_at
from shipped_fields import REGIONS, disturbing_field
from thinning import thinned

from ggbench.gravity.ellipsoid import EOTVOS
from ggbench.gravity.gradient_map import MapError
from ggbench.maps.package_data import data_arrays, data_bytes
from ggbench.maps.recipe import MapRecipe, checked
from ggbench.maps.shipped import SOURCES

ROOT = Path(__file__).parents[2]
MOST_BYTES = 500_000
SHIFT = math.radians(0.02)
DAILY = ("egm2008_south_china_sea",)
"""Of the region from the surface of the sea up."""
FILES = sorted({name for source in SOURCES.values() for name in source.files if "/" not in name})
"""Of regions and terrains; those of surveys lie in a folder with a README of its own."""


def extent_deg(source: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return from and to of the latitudes and of the longitudes of a source [deg]."""
    limits = SOURCES[source].limits()
    return limits.latitudes, limits.longitudes


def inner_axes(source: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Latitudes and longitudes [rad] from bound to bound of what a source gives."""
    south_north, west_east = extent_deg(source)
    return np.radians(np.linspace(*south_north, count)), np.radians(np.linspace(*west_east, count))


def rms_uu(source: str, height: float) -> float:
    """Return the rms of the disturbing Γ_UU [E] about its mean over a source's whole extent."""
    tensor, _ = disturbing_field(source, *inner_axes(source, 60), [height])
    return float(tensor[..., 5].std())


# --- the field -------------------------------------------------------------------------------


@thinned("source", REGIONS)
def test_the_trace_vanishes_from_the_lowest_height_up(source):
    heights = [REGIONS[source].lowest_m, 1e4, SOURCES[source].highest_m]
    tensor, _ = disturbing_field(source, *inner_axes(source, 15), heights)
    assert np.isfinite(tensor).all()
    assert np.abs(tensor[..., [0, 3, 5]].sum(axis=-1)).max() < 1e-9


@pytest.mark.parametrize(
    "source",
    [pytest.param(source, marks=() if source in DAILY else pytest.mark.long) for source in REGIONS],
)
def test_the_tensor_is_the_gradient_of_gravity_and_free_of_curl(source):
    """To 0.3 % of its rms, at the lowest height and at 10 km; so are third derivatives.

    The rest is the convergence of the meridians, which the residual knows only band by band. As a
    control, the tensor of a place 0.02° away is no gradient of the gravity here.
    """
    rng = np.random.default_rng(3)
    (south, north), (west, east) = extent_deg(source)
    for height in (REGIONS[source].lowest_m, 1e4):
        errors, sizes, curls, thirds, elsewhere = [], [], [], [], []
        for _ in range(4):
            latitude, longitude = np.radians(
                rng.uniform([south + 0.1, west + 0.1], [north - 0.1, east - 0.1])
            )
            tensor, d_vector, d_tensor = derivatives_at(source, latitude, longitude, height, 50.0)
            other, _, _ = derivatives_at(source, latitude, longitude + SHIFT, height, 50.0)
            errors.append(d_vector / EOTVOS - tensor)
            elsewhere.append(d_vector / EOTVOS - other)
            sizes.append(tensor)
            curls.append(d_tensor - np.swapaxes(d_tensor, 1, 2))
            thirds.append(d_tensor)
        antisymmetric = np.subtract(errors, np.swapaxes(errors, 1, 2))
        print(
            f"{source} at {height:g} m: tensor {np.std(errors) / np.std(sizes):.1e}, curl "
            f"{np.std(antisymmetric) / np.std(sizes):.1e}, third derivatives "
            f"{np.std(curls) / np.std(thirds):.1e} of their rms"
        )
        assert np.std(errors) < 3e-3 * np.std(sizes)
        assert np.std(antisymmetric) < 3e-3 * np.std(sizes)
        assert np.std(curls) < 3e-3 * np.std(thirds)
        assert np.std(elsewhere) > 1e-2 * np.std(sizes)


@pytest.mark.long
def test_the_regions_differ_in_character():
    """At 10 km: the plains are weak, the Alps strong; the trench decays least with height."""
    at_ten = {name: rms_uu(name, 1e4) for name in REGIONS}
    print({name: round(value, 1) for name, value in at_ten.items()})
    plains = at_ten.pop("egm2008_great_plains")
    assert plains < 5.0 < 8.0 < min(at_ten.values())
    assert at_ten["egm2008_mariana"] > at_ten["egm2008_alps"] > at_ten["egm2008_qinling"]
    decay = {name: rms_uu(name, 5e3) / at_ten[name] for name in ("egm2008_alps", "egm2008_mariana")}
    assert decay["egm2008_alps"] > 1.5 > 1.4 > decay["egm2008_mariana"]


# --- heights and bounds ----------------------------------------------------------------------


@pytest.mark.parametrize("source", REGIONS)
def test_heights_outside_of_what_a_region_gives_are_refused(source):
    (south, _), (west, _) = extent_deg(source)
    low, high = REGIONS[source].lowest_m, SOURCES[source].highest_m
    bounds = (south, south + 0.5, west, west + 0.5)
    spacings = {"spacing_arcmin": 0.3, "height_spacing_m": 400.0}
    assert checked(MapRecipe(source, *bounds, low, low + 4000.0, **spacings)).source == source
    allowed = re.escape(f"{low:g} to {high:g} is allowed")
    for heights in ((low - 1.0, high), (low, high + 1.0)):
        with pytest.raises(MapError, match=allowed):
            checked(MapRecipe(source, *bounds, *heights, **spacings))


@pytest.mark.parametrize("source", ["egm2008_alps", "egm2008_great_plains"])
def test_a_map_of_land_begins_above_its_ground(source):
    """Half a kilometre and more above the highest cell of the relief."""
    (south, north), (west, east) = extent_deg(source)
    relief = data_arrays(REGIONS[source].topography, ("lat", "lon", "z"))
    rows = (relief["lat"] > south) & (relief["lat"] < north)
    columns = (relief["lon"] > west) & (relief["lon"] < east)
    highest = relief["z"][np.ix_(rows, columns)].max()
    assert REGIONS[source].lowest_m > highest + 500.0


# --- the data files --------------------------------------------------------------------------


@pytest.mark.parametrize("source", REGIONS)
def test_the_relief_covers_the_geoid(source):
    """Nodes of 2.5′, none of them beyond the relief, which would be extrapolated there."""
    files = REGIONS[source]
    geoid = data_arrays(files.file, ("lat0", "lon0", "step", "N_1e4m"))
    relief = data_arrays(files.topography, ("lat", "lon", "z"))
    assert geoid["N_1e4m"].dtype == np.int32 and relief["z"].dtype == np.int16
    assert geoid["step"] == pytest.approx(2.5 / 60.0)
    for first, count, axis in zip(
        (geoid["lat0"], geoid["lon0"]), geoid["N_1e4m"].shape, ("lat", "lon"), strict=True
    ):
        nodes = relief[axis].astype(float)
        assert nodes[0] <= first and first + (count - 1) * geoid["step"] <= nodes[-1]
        np.testing.assert_allclose(np.diff(nodes), np.diff(nodes).mean(), atol=1e-5)


@pytest.mark.parametrize("name", FILES)
def test_a_data_file_is_small_installed_and_documented(name):
    package = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    patterns = package["package-data"]["ggbench.scenarios"]
    assert any(fnmatch.fnmatch(f"data/{name}", pattern) for pattern in patterns)
    assert len(data_bytes(name)) <= MOST_BYTES
    assert f"`{name}`" in (ROOT / "scenarios/data/README.md").read_text()
