"""Compiled sines, cosines and rotation matrices, for numbers and for vectors of runs.

A call of the C library prevents vector instructions in loops over points or runs. Therefore small
angles and latitudes use series without branches.
"""

from __future__ import annotations

import math

import numpy as np

from .kernels import compiled, inlined
from .vectors import like

Matrix = tuple[float, float, float, float, float, float, float, float, float]
"""A 3 by 3 matrix as nine numbers, row by row."""

_SERIES_BELOW = 2.5
"""Square of an angle up to which :func:`circular` is exact to rounding."""
_SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(12))
_COSINE = tuple((-1.0) ** k / math.factorial(2 * k + 2) for k in range(12))
_REST = tuple((-1.0) ** k / math.factorial(2 * k + 3) for k in range(12))


@inlined
def circular(square: float) -> tuple[float, float]:
    """Return sin(x)/x and (1 − cos x)/x² of an angle x, given its square.

    The error of the Taylor series is at rounding level for angles below π/2, and at most 1e-11
    below π.
    """
    sine = cosine = like(square, 0.0)
    for k in range(11, -1, -1):
        sine = sine * square + _SINE[k]
        cosine = cosine * square + _COSINE[k]
    return sine, cosine


@inlined
def sine_cosine(latitude: float) -> tuple[float, float]:
    """Return sine and cosine of a latitude [rad]."""
    half = 0.5 * latitude
    square = half * half
    ratio, versine = circular(square)
    sine, cosine = half * ratio, 1.0 - square * versine
    return 2.0 * sine * cosine, (cosine - sine) * (cosine + sine)


@inlined
def _rodrigues(x: float, y: float, z: float, a: float, b: float) -> Matrix:
    """Return I + a [v×] + b [v×]² of v = (x, y, z)."""
    return (
        1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y,
        b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x,
        b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y),
    )  # fmt: skip


@inlined
def small_turn(x: float, y: float, z: float) -> Matrix:
    """Return the rotation matrix exp([v×]) (Rodrigues) of the rotation vector v = (x, y, z).

    The accuracy is that of :func:`circular`.
    """
    a, b = circular(x * x + y * y + z * z)
    return _rodrigues(x, y, z, a, b)


@inlined
def left_jacobian(x: float, y: float, z: float) -> Matrix:
    """Return the left Jacobian J of the rotation vector v = (x, y, z).

    To first order in δ, exp([(v + δ)×]) = exp([(J δ)×]) exp([v×]). With θ = |v|, the Jacobian is

        J = I + (1 − cos θ)/θ² [v×] + (θ − sin θ)/θ³ [v×]².

    Both fractions are computed by series as in :func:`circular`.
    """
    square = x * x + y * y + z * z
    rest = like(square, 0.0)
    for k in range(11, -1, -1):
        rest = rest * square + _REST[k]
    _, versine = circular(square)
    return _rodrigues(x, y, z, versine, rest)


@inlined
def transpose(a: Matrix) -> Matrix:
    """Return the transpose of a 3 × 3 matrix, stored as nine numbers."""
    return a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8]


@inlined
def multiply(a: Matrix, b: Matrix) -> Matrix:
    """Return the product of two 3 × 3 matrices, stored as nine numbers."""
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
        a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
        a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
        a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
        a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
        a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
        a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
        a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )


@inlined
def fill(numbers: Matrix, out: np.ndarray) -> None:
    """Fill ``out`` (3, 3) with the nine numbers of a matrix, row by row."""
    out[0, 0], out[0, 1], out[0, 2] = numbers[0], numbers[1], numbers[2]
    out[1, 0], out[1, 1], out[1, 2] = numbers[3], numbers[4], numbers[5]
    out[2, 0], out[2, 1], out[2, 2] = numbers[6], numbers[7], numbers[8]


@compiled
def rotation_matrix(rotation_vector: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (3, 3) with the rotation matrix exp([v×]) of a rotation vector v (3,) [rad]."""
    x, y, z = rotation_vector[0], rotation_vector[1], rotation_vector[2]
    angle2 = x * x + y * y + z * z
    if angle2 < _SERIES_BELOW:
        fill(small_turn(x, y, z), out)
    else:
        angle = math.sqrt(angle2)
        fill(_rodrigues(x, y, z, math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2), out)


@compiled
def rotation_vector(matrix: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (3,) with the rotation vector [rad] of a rotation matrix (3, 3).

    The angle of the rotation must be less than π/2.
    """
    out[0] = 0.5 * (matrix[2, 1] - matrix[1, 2])
    out[1] = 0.5 * (matrix[0, 2] - matrix[2, 0])
    out[2] = 0.5 * (matrix[1, 0] - matrix[0, 1])
    sine = math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    if sine > 1e-5:
        cosine = 0.5 * (matrix[0, 0] + matrix[1, 1] + matrix[2, 2] - 1.0)
        out *= math.atan2(sine, cosine) / sine
    else:
        out *= 1.0 + sine * sine / 6.0


@compiled
def product(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (3, 3) with the product of two matrices (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@compiled
def attitude_matrix(heading: float, pitch: float, roll: float) -> np.ndarray:
    """Return the attitude matrix C_nb (3, 3), from body axes (right, forward, up) to ENU.

    Parameters
    ----------
    heading : angle clockwise from north [rad].
    pitch : angle, positive for nose up [rad].
    roll : angle, positive for right side down [rad].
    """
    sin_h, cos_h = math.sin(heading), math.cos(heading)
    sin_p, cos_p = math.sin(pitch), math.cos(pitch)
    sin_r, cos_r = math.sin(roll), math.cos(roll)
    return np.array(
        [
            [cos_h * cos_r + sin_h * sin_p * sin_r, sin_h * cos_p,
             cos_h * sin_r - sin_h * sin_p * cos_r],
            [-sin_h * cos_r + cos_h * sin_p * sin_r, cos_h * cos_p,
             -sin_h * sin_r - cos_h * sin_p * cos_r],
            [-cos_p * sin_r, sin_p, cos_p * cos_r],
        ]
    )  # fmt: skip


@compiled
def between(before: np.ndarray, after: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Interpolate between M pairs of rotation matrices at a constant angular rate.

    ``before`` (M, 3, 3) and ``after`` (M, 3, 3) contain the pairs. The result (M, 3, 3) is
    ``before`` for a ``share`` (M,) of 0, and ``after`` for a ``share`` of 1. The angle of rotation
    within a pair must be less than π/2.
    """
    out = np.empty_like(before)
    difference = np.empty((3, 3))
    vector = np.empty(3)
    for m in range(share.shape[0]):
        product(before[m].T, after[m], difference)
        rotation_vector(difference, vector)
        for i in range(3):
            vector[i] *= share[m]
        rotation_matrix(vector, difference)
        product(before[m], difference, out[m])
    return out
