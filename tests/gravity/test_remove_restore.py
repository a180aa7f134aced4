"""Remove, compute, restore: a field known to degree 540 comes back from any grid of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from random_harmonics import random_model
from scipy.interpolate import make_interp_spline
from shipped_fields import disturbing_field

from ggbench.gravity.ellipsoid import normal_gravity
from ggbench.gravity.harmonics import gravity_and_gradient, potential
from ggbench.gravity.remove_restore import GravityGrid, Residual
from ggbench.maps.recipe import MapError, MapRecipe, build, dataclasses

STEP = 5.0 / 60.0
SHAPE = (157, 181)
INNER = (
    np.radians(np.arange(31.0, 36.0, 0.25)),
    np.radians(np.arange(105.0, 112.0, 0.25)),
    np.array([5e3, 1e4]),
)


def grid_of(model, kind: str, height: float, south: float, shape=SHAPE) -> GravityGrid:
    """What a grid of this kind holds of a model, from the definitions of the quantities."""
    latitude, longitude = (
        np.radians(first + STEP * np.arange(count))
        for first, count in zip((south, 101.0), shape, strict=True)
    )
    disturbing = potential(model, latitude, longitude, [height])[:, :, 0]
    outwards = gravity_and_gradient(model, latitude, longitude, [height])[0][:, :, 0, 2]
    gamma, _, vertical = np.array([normal_gravity(a, height) for a in latitude]).T[:, :, np.newaxis]
    values = {
        "geoid": disturbing / gamma,  # Bruns
        "disturbance": -outwards,
        "anomaly": -outwards + vertical / gamma * disturbing,  # fundamental equation of geodesy
    }[kind]
    return GravityGrid(
        kind=kind,
        south_deg=south,
        west_deg=101.0,
        latitude_step_deg=STEP,
        longitude_step_deg=STEP,
        values=values,
        height_m=height,
    )


@pytest.fixture(scope="module")
def model():
    return random_model(540, 1)


@pytest.mark.parametrize(
    ("kind", "height"),
    [
        ("geoid", 0.0),
        pytest.param("disturbance", 0.0, marks=pytest.mark.long),
        pytest.param("anomaly", 0.0, marks=pytest.mark.long),
        pytest.param("anomaly", 3000.0, marks=pytest.mark.long),
    ],
)
def test_the_field_comes_back_from_a_grid(model, kind, height):
    """The part above degree 120, which the grid has to give: to 4e-3 of its rms per component."""
    low = model.between(2, 120)
    vector, tensor = gravity_and_gradient(low, *INNER)
    true_vector, true_tensor = gravity_and_gradient(model, *INNER)
    signal, vector_signal = (
        np.std(a, axis=(0, 1)) for a in (true_tensor - tensor, true_vector - vector)
    )
    Residual(grid_of(model, kind, height, 27.0), low).add_to(tensor, vector, *INNER)
    error = np.sqrt(np.mean((tensor - true_tensor) ** 2, axis=(0, 1)))
    vector_error = np.sqrt(np.mean((vector - true_vector) ** 2, axis=(0, 1)))
    print(f"{kind} at {height:g} m: rms errors of\n{error} E in\n{signal} E")
    assert (error < 4e-3 * signal).all()
    assert (vector_error < 2e-2 * vector_signal).all()


@pytest.mark.long
def test_a_grid_of_even_size_serves_as_well(model):
    low = model.between(2, 120)
    vector, tensor = gravity_and_gradient(low, *INNER)
    _, truth = gravity_and_gradient(model, *INNER)
    grid = grid_of(model, "geoid", 0.0, 27.0, (156, 180))
    Residual(grid, low).add_to(tensor, vector, *INNER)
    assert np.std(tensor - truth) < 2e-3 * np.std(truth)


@pytest.mark.long
@pytest.mark.parametrize("south", [-20.0, 55.0])
def test_anywhere_on_the_earth(model, south):
    """South of the equator and at high latitude, where meridians converge."""
    inner = (np.radians(np.arange(south + 4, south + 9, 0.5)), *INNER[1:])
    low = model.between(2, 120)
    vector, tensor = gravity_and_gradient(low, *inner)
    _, truth = gravity_and_gradient(model, *inner)
    signal = np.std(truth - tensor)
    Residual(grid_of(model, "disturbance", 0.0, south), low).add_to(tensor, vector, *inner)
    assert np.std(tensor - truth) < 1e-2 * signal


@pytest.mark.parametrize(
    ("kind", "height"),
    [("geoid", 0.0), ("disturbance", 2000.0), ("anomaly", 0.0), ("anomaly", 3000.0)],
)
def test_what_is_known_already_leaves_nothing(kind, height):
    """A grid of the coefficients' own field, from the definitions, adds nothing to it (1e-9).

    From 27° to 40° of latitude normal gravity changes by a thousandth.
    """
    known = random_model(20, 2)
    vector, tensor = (np.zeros((*map(len, INNER), width)) for width in (3, 6))
    Residual(grid_of(known, kind, height, 27.0), known).add_to(tensor, vector, *INNER)
    whole_vector, whole_tensor = gravity_and_gradient(known, *INNER)
    assert np.abs(vector).max() < 1e-9 * np.abs(whole_vector).max()
    assert np.abs(tensor).max() < 1e-7 * np.abs(whole_tensor).max()


@pytest.mark.parametrize("height", [0.0, 3000.0])
def test_the_field_of_waves_is_the_derivative_of_its_potential(height):
    """Derivatives of the gravity vector along height, by differences, are what the tensor says.

    EU and NU exactly, whatever the latitude; UU, which the tensor has from EE and NN, at the
    latitude whose convergence was taken, as far as the waves are harmonic on an ellipsoid: to 4e-3.
    """
    rng = np.random.default_rng(3)
    grid = GravityGrid(
        kind="disturbance",
        south_deg=30.0,
        west_deg=105.0,
        latitude_step_deg=0.25,
        longitude_step_deg=0.25,
        values=rng.normal(size=(25, 31)),
        height_m=height,
    )
    nothing = random_model(2, 1)
    residual = Residual(grid, nothing)
    latitude, longitude = np.radians([31.9, 32.7, 33.5]), np.radians([106.2, 108.0, 110.1])
    heights = 1e4 + np.array([-30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0])
    vector, tensor = residual.field(latitude, longitude, heights, latitude[1])
    weights = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 600.0
    slope = np.tensordot(vector, weights, axes=(2, 0)) / 1e-9
    size = np.abs(tensor).max()
    assert np.abs(slope[..., 0] - tensor[:, :, 3, 2]).max() < 1e-7 * size
    assert np.abs(slope[..., 1] - tensor[:, :, 3, 4]).max() < 1e-7 * size
    assert np.abs(slope[1, :, 2] - tensor[1, :, 3, 5]).max() < 4e-3 * size


def test_a_map_of_the_south_china_sea_serves_a_ship():
    """At the sea's surface, between nodes: interpolation costs less than 0.01 E rms."""
    source = "egm2008_south_china_sea"
    recipe = MapRecipe(
        source=source,
        south_deg=15.0,
        north_deg=16.5,
        west_deg=112.0,
        east_deg=114.0,
        min_height_m=0.0,
        max_height_m=4000.0,
        spacing_arcmin=1.25,
        height_spacing_m=1000.0,
    )
    built = build(recipe)
    nodes = [
        first + step * np.arange(count)
        for first, step, count in zip(
            (built.latitude0, built.longitude0, built.height0),
            (built.latitude_step, built.longitude_step, built.height_step),
            built.tensor.shape,
            strict=False,
        )
    ]
    rng = np.random.default_rng(4)
    points = [np.sort(rng.uniform(axis[0], axis[-1], 25)) for axis in nodes[:2]]
    points.append(np.array([0.0, 20.0, 500.0, 1500.0]))
    spline = built.tensor
    for axis, (at, wanted) in enumerate(zip(nodes, points, strict=True)):
        spline = make_interp_spline(at, spline, k=3, axis=axis)(wanted)
    direct, _ = disturbing_field(source, *points)
    rms = np.sqrt(np.mean((spline - direct) ** 2, axis=(0, 1)))
    print(f"rms [E] at {points[2]} m:\n{rms}\nof a field of {np.std(direct, axis=(0, 1))[0]}")
    assert rms.max() < 0.01
    assert np.std(direct[:, :, 0, 5]) > 5.0


def test_the_sea_map_is_refused_where_its_spacing_would_not_do():
    source = "egm2008_south_china_sea"
    fine = MapRecipe(
        source=source,
        south_deg=15.0,
        north_deg=16.0,
        west_deg=112.0,
        east_deg=113.0,
        min_height_m=0.0,
        max_height_m=9000.0,
    )
    for change, message in (
        ({"spacing_arcmin": 2.5}, r"a quarter of the height above sources at a depth of 9270 m"),
        ({"height_spacing_m": 2000.0}, r"1158\.75 .* above half the sources' depth of 9270 m"),
        ({"min_height_m": -10.0}, r"min_height_m = -10.0 .*: 0 to 30000 is allowed"),
        ({"south_deg": 11.0}, r"11\.5 to 22\.5 is allowed"),
    ):
        with pytest.raises(MapError, match=message):
            build(dataclasses.replace(fine, **change))


def test_low_and_high_sources_of_the_sea_are_consistent():
    """UU decreases with height as 1e4 m of upward continuation of these wavelengths must."""
    latitude, longitude = (
        np.radians(np.arange(14.0, 18.0, 0.1)),
        np.radians(np.arange(112, 116, 0.1)),
    )
    tensor, _ = disturbing_field("egm2008_south_china_sea", latitude, longitude, [0.0, 1e4])
    trace = tensor[..., [0, 3, 5]].sum(axis=-1)
    assert np.abs(trace).max() < 1e-9
    at_sea, high = tensor[..., 5].std(axis=(0, 1))
    assert math.exp(-2.0 * math.pi * 10.0 / 18.5) < high / at_sea < 0.9
