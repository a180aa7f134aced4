"""Spherical harmonic synthesis against SHTOOLS, from degree 120 to 2190, and near the poles."""

from __future__ import annotations

import dataclasses
import math
from importlib.resources import files

import numpy as np
import pytest
from frame_oracles import local_axes, square
from random_harmonics import random_model

from ggbench.gravity import ellipsoid
from ggbench.gravity.harmonics import HarmonicCoefficients, gravity_and_gradient, potential
from ggbench.maps.gravity_model import read_model
from ggbench.maps.shipped_parts import COEFFICIENTS, disturbing_coefficients


def shipped_model() -> HarmonicCoefficients:
    folder = files("ggbench.scenarios") / "data" / "egm2008_degree120.npz"
    return read_model(folder).coefficients


def geodetic(radius: float, geocentric: float) -> tuple[float, float]:
    """Geodetic latitude and height of a point given by radius and geocentric latitude."""
    rho, z = radius * math.cos(geocentric), radius * math.sin(geocentric)
    latitude = geocentric
    for _ in range(20):
        _, prime_vertical = ellipsoid.radii_of_curvature(latitude)
        shift = ellipsoid.ECCENTRICITY_SQUARED * prime_vertical * math.sin(latitude)
        latitude = math.atan2(z + shift, rho)
    flattened = prime_vertical * (1.0 - ellipsoid.ECCENTRICITY_SQUARED * math.sin(latitude) ** 2)
    return latitude, rho * math.cos(latitude) + z * math.sin(latitude) - flattened


@pytest.mark.parametrize(
    "model",
    [
        pytest.param(shipped_model(), id="120"),
        pytest.param(random_model(400, 3), id="400", marks=pytest.mark.long),
    ],
)
def test_gravity_and_gradient_agree_with_shtools(model):
    """On a sphere 10 km above the reference radius, at latitudes from pole to pole."""
    import pyshtools  # slow, and not for all processes

    a, degree = model.radius + 10e3, model.degree
    cosine = model.cosine.copy()
    cosine[0, 0] = 1.0  # SHTOOLS takes it for granted
    model = dataclasses.replace(model, cosine=cosine)
    cilm = np.stack([model.cosine, model.sine])
    arguments = {"a": a, "f": 0.0, "lmax": degree, "sampling": 2}
    vxx, vyy, vzz, vxy, vxz, vyz = pyshtools.gravmag.MakeGravGradGridDH(
        cilm, model.gm, model.radius, **arguments
    )  # x north, y west, z up
    up, south, east, *_ = pyshtools.gravmag.MakeGravGridDH(
        cilm, model.gm, model.radius, **arguments
    )
    errors, sizes = [], []
    for i in np.linspace(2, len(vxx) - 3, 9).astype(int):
        for j in (0, len(vxx) // 3):
            geocentric = math.pi / 2 - math.pi * i / len(vxx)
            longitude = 2.0 * math.pi * j / vxx.shape[1]
            latitude, height = geodetic(a, geocentric)
            vector, tensor = gravity_and_gradient(model, [latitude], [longitude], [height])
            turn = local_axes(geocentric, longitude).T @ local_axes(latitude, longitude)
            gradient = turn @ square(tensor[0, 0, 0]) @ turn.T * ellipsoid.EOTVOS
            expected = np.array(
                [
                    [vyy[i, j], -vxy[i, j], -vyz[i, j]],
                    [-vxy[i, j], vxx[i, j], vxz[i, j]],
                    [-vyz[i, j], vxz[i, j], vzz[i, j]],
                ]
            )
            gravity = np.array([east[i, j], -south[i, j], up[i, j]])
            np.testing.assert_allclose(turn @ vector[0, 0, 0], gravity, rtol=0, atol=1e-11)
            errors.append(gradient - expected)
            sizes.append(expected - np.diag([-1.0, -1.0, 2.0]) * model.gm / a**3)
    # Relative to the disturbing part, without the 3000 E of the monopole.
    relative = np.std(errors) / np.std(sizes)
    print(f"tensor, degree {degree}: {relative:.1e} of the disturbing part")
    assert relative < 1e-9


@pytest.mark.long
@pytest.mark.parametrize("latitude_deg", [0.0, 68.0, 89.5])
def test_degree_2190_is_summed_without_underflow(latitude_deg):
    """Towards the poles sectorial functions fall below 1e-308 before they grow with the degree.

    The oracle are Legendre functions of Holmes and Featherstone, of SHTOOLS, point by point.
    """
    import pyshtools

    degree = 2190
    model = random_model(degree, 11)
    # Coefficients that grow with the degree, so that the highest ones weigh the most.
    growth = np.maximum(np.arange(degree + 1), 1)[:, np.newaxis] ** 3.0
    cosine, sine = model.cosine * growth, model.sine * growth
    model = HarmonicCoefficients(model.gm, model.radius, cosine, sine)
    latitude, height = geodetic(model.radius, math.radians(latitude_deg))
    longitude = 0.6
    p = np.zeros((degree + 1, degree + 1))
    p[np.tril_indices(degree + 1)] = pyshtools.legendre.PlmBar(
        degree, math.sin(math.radians(latitude_deg))
    )
    m = np.arange(degree + 1)
    terms = (cosine * np.cos(m * longitude) + sine * np.sin(m * longitude)) * p
    expected = model.gm / model.radius * terms.sum()
    found = potential(model, [latitude], [longitude], [height])[0, 0, 0]
    scale = model.gm / model.radius * np.sqrt((terms**2).sum())
    assert abs(found - expected) < 1e-9 * scale


@pytest.mark.long
def test_many_circles_are_the_same_as_few():
    """Synthesis goes block by block: where a block ends must not matter."""
    model = random_model(300, 5)
    latitude = np.radians(np.linspace(-40.0, 60.0, 60))
    height = np.linspace(0.0, 2e4, 60)
    _, together = gravity_and_gradient(model, latitude, [0.3], height)
    _, alone = gravity_and_gradient(model, latitude[-1:], [0.3], height[-1:])
    np.testing.assert_allclose(together[-1, :, -1], alone[0, :, 0], rtol=1e-12, atol=1e-12)


def test_bands_of_degrees_add_up():
    model = disturbing_coefficients(COEFFICIENTS)
    place = ([0.5], [1.9], [1e4])
    whole, low, high = (
        gravity_and_gradient(part, *place)[1]
        for part in (model, model.between(2, 60), model.between(61, 120))
    )
    np.testing.assert_allclose(low + high, whole, atol=1e-10)
    assert np.abs(high).max() > 0.5
