"""Oracles for frames and for the mechanization, by finite differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from oracles import points

from ggbench.gravity import ellipsoid
from ggbench.numerics import rotations

# Central difference of sixth order: offsets in steps, and weights per step.
OFFSETS = np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
WEIGHTS = np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / 60.0


def difference(function: Callable[[float], np.ndarray], step: float) -> np.ndarray:
    """Derivative at 0 of a function of one number, exact for polynomials of degree 6."""
    return (
        sum(w * np.asarray(function(o * step)) for o, w in zip(OFFSETS, WEIGHTS, strict=True))
        / step
    )


def local_axes(latitude: float, longitude: float) -> np.ndarray:
    """C_en (3, 3): columns are east, north and up in Earth-fixed axes."""
    up = np.array(
        [
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        ]
    )
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    return np.stack([east, np.cross(up, east), up], axis=-1)


def ecef(position: np.ndarray) -> np.ndarray:
    """Earth-fixed Cartesian coordinates of (latitude, longitude, height)."""
    latitude, longitude, height = position
    up = local_axes(latitude, longitude)[:, 2]
    a2, b2 = (
        ellipsoid.SEMI_MAJOR_AXIS**2,
        (ellipsoid.SEMI_MAJOR_AXIS * (1.0 - ellipsoid.FLATTENING)) ** 2,
    )
    # The point of the ellipsoid whose normal is ``up``: gradient of x²/a² + y²/a² + z²/b² along it.
    scaled = up * np.array([a2, a2, b2])
    return scaled / np.sqrt(up @ scaled) + height * up


def metres(position: np.ndarray) -> np.ndarray:
    """(3, 3): displacement ENU [m] = metres @ (dL, dλ, dh), from the Cartesian coordinates."""
    columns = [
        difference(lambda d, axis=axis: ecef(position + d * np.eye(3)[axis]), step)
        for axis, step in enumerate((1e-2, 1e-2, 1e3))
    ]
    return local_axes(position[0], position[1]).T @ np.stack(columns, axis=-1)


def square(tensor: np.ndarray) -> np.ndarray:
    """Symmetric (3, 3) matrix of [xx, xy, xz, yy, yz, zz]."""
    return np.asarray(tensor)[np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])]


def third_derivatives(tensor: np.ndarray, derivative: np.ndarray, position: np.ndarray):
    """(3, 3, 3) third derivatives of the potential, in axes that do *not* move with the point.

    ``derivative`` (6, 3) is of the components in moving ENU axes, per metre east, north and up.
    """
    latitude, longitude, _ = position
    to_local = local_axes(latitude, longitude).T
    per_radian = metres(position)
    out = np.empty((3, 3, 3))
    for axis in range(3):
        d_latitude, d_longitude, _ = np.linalg.solve(per_radian, np.eye(3)[axis])
        turn = to_local @ (
            d_latitude * difference(lambda d: local_axes(latitude + d, longitude), 1e-2)
            + d_longitude * difference(lambda d: local_axes(latitude, longitude + d), 1e-2)
        )
        moved = turn @ square(tensor)
        out[:, :, axis] = square(derivative[:, axis]) + moved + moved.T
    return out


def cross_matrix(vector: np.ndarray) -> np.ndarray:
    """[v×]."""
    return np.cross(vector, np.eye(3), axisb=0, axisc=0)


def mechanization_jacobian(
    position: np.ndarray,
    velocity: np.ndarray,
    c_nb: np.ndarray,
    force: np.ndarray,
    rate: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """F (15, 15) in (δL, δλ, δh), δv, φ, ε, ∇ by finite differences of the mechanization's rates.

    The rates at an indicated state minus those at the true state, where indicated = true + error,
    C̃_nb = (I − [φ×]) C_nb and measured = true + bias. ``force`` and ``rate`` are f^b and ω_ib^b.

    Returns the matrix and an upper bound of its rounding error.
    """

    def rates(error: np.ndarray) -> np.ndarray:
        out = np.zeros((3, 3))
        here, moving = position + error[0:3], velocity + error[3:6]
        turn = np.empty((3, 3))
        rotations.rotation_matrix(-error[6:9], turn)
        attitude = turn @ c_nb
        points.position_rate(here, moving, out[0])
        points.velocity_rate(here, moving, attitude @ (force + error[12:15]), out[1])
        points.attitude_rate(here, moving, attitude, rate + error[9:12], out[2])
        # C_nb C̃_nbᵀ = exp([φ×]) = E, so E' = [ω×] E − E [ω̃×], whose skew part is [φ'×].
        skew = cross_matrix(true_rate) @ turn.T - turn.T @ cross_matrix(out[2])
        out[2] = 0.5 * np.array(
            [skew[2, 1] - skew[1, 2], skew[0, 2] - skew[2, 0], skew[1, 0] - skew[0, 1]]
        )
        return out.ravel()

    true_rate = np.zeros(3)
    points.attitude_rate(position, velocity, c_nb, rate, true_rate)
    steps = np.repeat([1e-3, 1.0, 1e-2, 1e-5, 1e-1], 3)
    steps[2] = 1e3
    jacobian = np.zeros((15, 15))
    for column in range(15):
        jacobian[:9, column] = difference(
            lambda d, c=column: rates(d * np.eye(15)[c]), steps[column]
        )
    # Numbers that are added up in a rate: v/R, gravity and specific force, angular rate.
    largest = np.repeat([1e-4, 10.0 + np.linalg.norm(force), 2e-3 + np.linalg.norm(rate)], 3)
    largest[2] = 300.0
    rounding = np.zeros((15, 15))
    rounding[:9] = 8.0 * np.finfo(float).eps * largest[:, None] / steps
    return jacobian, rounding
