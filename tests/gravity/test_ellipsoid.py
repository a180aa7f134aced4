"""WGS84: shape, normal gravity and normal gradient, against independent sources."""

from __future__ import annotations

import boule
import numpy as np
import pytest
from frame_oracles import difference, ecef, local_axes, metres, square, third_derivatives
from oracles import points
from oracles.normal_gravity import closed_form_gravity

from ggbench.gravity import ellipsoid

LATITUDES_DEG = np.linspace(-90.0, 90.0, 37)
ELLIPSOID = boule.WGS84


def positions(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack(
        [
            np.radians(rng.uniform(-80.0, 80.0, count)),
            np.radians(rng.uniform(-180.0, 180.0, count)),
            rng.uniform(0.0, 50e3, count),
        ],
        axis=-1,
    )


def gradient(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    value, derivative = np.empty(6), np.empty((6, 3))
    points.normal_gradient(position[0], position[2], value, derivative)
    return value, derivative


def displaced(position: np.ndarray, enu: np.ndarray) -> np.ndarray:
    """Geodetic coordinates after a small displacement [m], linear at ``position``."""
    return position + np.linalg.solve(metres(position), enu)


def test_prime_vertical_radius_is_that_of_boule():
    """A parallel has the radius R_N cos L."""
    ours = [ellipsoid.radii_of_curvature(np.radians(d))[1] for d in LATITUDES_DEG]
    theirs = ELLIPSOID.prime_vertical_radius(np.sin(np.radians(LATITUDES_DEG)))
    np.testing.assert_allclose(ours, theirs, rtol=1e-12)


@pytest.mark.parametrize("height", [0.0, 10e3])
def test_radii_are_metres_per_radian_on_the_ground(height):
    """Moving by dL and dλ moves a point of boule's ellipsoid by (R_M+h) dL and (R_N+h) cos L dλ."""
    for degrees in np.linspace(-85.0, 85.0, 18):

        def point(d_latitude: float, d_longitude: float, degrees=degrees) -> np.ndarray:
            return np.array(
                ELLIPSOID.geodetic_to_cartesian(
                    (np.degrees(d_longitude), degrees + np.degrees(d_latitude), height)
                )
            )

        meridian, prime_vertical = ellipsoid.radii_of_curvature(np.radians(degrees))
        along_north = np.linalg.norm(difference(lambda d: point(d, 0.0), 1e-2))
        along_east = np.linalg.norm(difference(lambda d: point(0.0, d), 1e-2))
        assert meridian + height == pytest.approx(along_north, rel=1e-12)
        assert (prime_vertical + height) * np.cos(np.radians(degrees)) == pytest.approx(
            along_east, rel=1e-12
        )


def test_latitude_derivatives_of_the_radii():
    """The ellipsoid flattens towards the poles at the rate that F assumes."""
    for latitude in np.radians(np.linspace(-85.0, 85.0, 18)):
        numeric = difference(lambda d, at=latitude: ellipsoid.radii_of_curvature(at + d), 1e-2)
        # Rounding of a radius, 1e-9 m, over the step.
        found = ellipsoid.radii_derivatives_of(np.sin(latitude), np.cos(latitude))
        np.testing.assert_allclose(found, numeric, rtol=1e-10, atol=1e-6)


def test_normal_gravity_on_the_ellipsoid_is_somiglianas():
    """Gravity on the ellipsoid, equator and poles included, is boule's closed form."""
    ours = [ellipsoid.normal_gravity(np.radians(d), 0.0)[0] for d in LATITUDES_DEG]
    theirs = ELLIPSOID.normal_gravity(
        (None, LATITUDES_DEG, np.zeros_like(LATITUDES_DEG)), si_units=True
    )
    np.testing.assert_allclose(ours, theirs, rtol=1e-12)


@pytest.mark.parametrize("height", [1e3, 10e3, 100e3])
def test_normal_gravity_at_altitude_is_the_whole_vector(height):
    """γ is |grad U| of boule's potential.

    boule's own normal gravity is the component along the normal of the *confocal* ellipsoid, short
    by 1e-10 at 10 km; the other component is the finite difference of its potential along that
    ellipsoid (which needs few digits: it enters squared).
    """
    heights = np.full_like(LATITUDES_DEG, height)
    place = (None, LATITUDES_DEG, heights)
    _, reduced, u = ELLIPSOID.geodetic_to_ellipsoidal_harmonic(place)
    along = ELLIPSOID.normal_gravity(place, si_units=True)
    slope = difference(
        lambda d: ELLIPSOID.normal_gravity_potential(
            (None, reduced + np.degrees(d), u), coordinate_system="ellipsoidal harmonic"
        ),
        2e-2,
    )
    across = slope / np.hypot(u, ELLIPSOID.linear_eccentricity * np.sin(np.radians(reduced)))
    ours = [ellipsoid.normal_gravity(np.radians(d), height)[0] for d in LATITUDES_DEG]
    np.testing.assert_allclose(ours, np.hypot(along, across), rtol=1e-12)


@pytest.mark.parametrize("height", [0.0, 5e3, 50e3])
def test_normal_gravity_points_to_the_equator_above_the_ellipsoid(height):
    """Both parts against the closed form, to 1e-11 m/s²; at 5 km and 45° 4 mGal are horizontal."""
    for latitude in np.radians(LATITUDES_DEG[1:-1]):
        found = ellipsoid.normal_gravity_vector_of(np.sin(latitude), np.cos(latitude), height)
        np.testing.assert_allclose(
            found, closed_form_gravity(latitude, height), rtol=0.0, atol=1e-11
        )
        rule = -8.08e-9 * height * np.sin(2.0 * latitude)
        assert found[0] == pytest.approx(rule, rel=0.02, abs=1e-11)
    at_45 = ellipsoid.normal_gravity_vector_of(np.sqrt(0.5), np.sqrt(0.5), 5e3)
    assert at_45[0] == pytest.approx(-4.04e-5, rel=0.01)


def test_slopes_of_both_parts_of_normal_gravity():
    """By central differences of the closed form, which has 12 digits."""
    for latitude, _, height in positions(20, seed=1):
        found = ellipsoid.normal_gravity_slopes_of(np.sin(latitude), np.cos(latitude), height)
        along_latitude, along_height = (
            (np.array(closed_form_gravity(*ahead)) - closed_form_gravity(*behind)) / step
            for ahead, behind, step in (
                ((latitude + 1e-3, height), (latitude - 1e-3, height), 2e-3),
                ((latitude, height + 1e3), (latitude, height - 1e3), 2e3),
            )
        )
        expected = [along_latitude[0], along_height[0], along_latitude[1], along_height[1]]
        rounding = 1e-12 / np.array([5e-4, 1e3, 5e-4, 1e3])
        assert (np.abs(found - np.array(expected)) < 1e-5 * np.abs(expected) + rounding).all()


def test_derivatives_of_normal_gravity():
    """∂γ/∂L and ∂γ/∂h are the slopes of γ, the instability of the vertical channel included."""
    for latitude, _, height in positions(50, seed=1):
        _, d_latitude, d_height = ellipsoid.normal_gravity(latitude, height)
        along_latitude = difference(
            lambda d, p=(latitude, height): ellipsoid.normal_gravity(p[0] + d, p[1])[0], 1e-2
        )
        along_height = difference(
            lambda d, p=(latitude, height): ellipsoid.normal_gravity(p[0], p[1] + d)[0], 1e4
        )
        assert d_latitude == pytest.approx(along_latitude, rel=1e-9, abs=1e-12)
        assert d_height == pytest.approx(along_height, rel=1e-9)
        assert -3.12e-6 < d_height < -2.9e-6


@pytest.mark.parametrize(
    ("height", "expected", "digits"),
    [
        (10e3, [-1532.4116159, 0.0, 0.0, -1535.8771315, -5.0342655, 3068.2887474], 6e-8),
        (0.0, [-1539.63404, 0.0, 0.0, -1543.12688, -5.05148, 3082.76092], 6e-6),
    ],
)
def test_normal_gradient_check_values(height, expected, digits):
    """Values of an independent computation at 33.5° N, in geodetic axes, to their last digit."""
    value, _ = gradient(np.array([np.radians(33.5), 0.0, height]))
    np.testing.assert_allclose(value, expected, rtol=0.0, atol=digits)


def test_normal_gradient_is_the_hessian_of_boules_potential():
    """The tensor is made of the second derivatives of the closed-form gravitational potential.

    The closed form loses ten digits to cancellation, and a second difference over 60 km more: what
    remains is good to 1e-3 E, a millionth of the tensor.
    """
    step = 20e3
    for position in positions(10, seed=2):
        position[2] += 70e3  # the outermost points of the difference stay above the ellipsoid
        axes, centre = local_axes(position[0], position[1]), ecef(position)

        def potential(enu: np.ndarray, axes=axes, centre=centre) -> float:
            return ELLIPSOID.normal_gravitational_potential(
                tuple(centre + axes @ enu), coordinate_system="cartesian"
            )

        hessian = [
            [
                difference(
                    lambda a, i=i, j=j: difference(
                        lambda b: potential(a * np.eye(3)[i] + b * np.eye(3)[j]), step
                    ),
                    step,
                )
                for j in range(3)
            ]
            for i in range(3)
        ]
        value, _ = gradient(position)
        np.testing.assert_allclose(
            square(value), np.array(hessian) / ellipsoid.EOTVOS, rtol=0.0, atol=1e-3
        )


def test_normal_gradient_is_trace_free():
    """Outside the masses the gravitational potential is harmonic; so is the field's slope."""
    for position in positions(50, seed=3):
        value, derivative = gradient(position)
        assert abs(np.trace(square(value))) < 1e-12 * np.abs(value).max()
        traces = derivative[0] + derivative[3] + derivative[5]
        assert np.abs(traces).max() < 1e-12 * np.abs(derivative).max()


def test_normal_gradient_derivative():
    """The derivative is the change of the components over a metre east, north and up."""
    for position in positions(50, seed=4):
        _, derivative = gradient(position)
        numeric = np.stack(
            [
                difference(
                    lambda d, axis=axis, at=position: gradient(displaced(at, d * np.eye(3)[axis]))[
                        0
                    ],
                    5e3,
                )
                for axis in range(3)
            ],
            axis=-1,
        )
        # The largest derivative is 1e-3 E/m.
        np.testing.assert_allclose(derivative, numeric, rtol=0.0, atol=1e-11)


def test_normal_gradient_is_curl_free():
    """Third derivatives of a potential are symmetric in all three indices."""
    for position in positions(50, seed=5):
        value, derivative = gradient(position)
        third = third_derivatives(value, derivative, position)
        for order in ((0, 2, 1), (2, 1, 0), (1, 2, 0)):
            np.testing.assert_allclose(
                third, third.transpose(order), rtol=0.0, atol=1e-11 * np.abs(third).max()
            )
        # The test has power: in axes that move with the point the numbers are not symmetric.
        moving = np.stack([square(column) for column in derivative.T], axis=-1)
        assert np.abs(moving - moving.transpose(0, 2, 1)).max() > 0.1 * np.abs(third).max()
