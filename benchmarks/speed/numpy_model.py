"""Measurement function h and Jacobian H in optimised NumPy, for the other packages.

h_k(x) = offset_k + g_k [reading_k(p_k − B_k x)]. p_k is the INS position, and B_k x is the position
error in metres. reading_k is the gradient tensor at the corrected position, in inertial axes. The
tensor is the sum of a map and the normal field (J2 to J12). The map is a uniform cubic B-spline in
latitude, longitude and height.

h evaluates the map with SciPy's NdBSpline. H would need four such calls; matrix products compute
the same sums faster. Scalars are Python floats with :mod:`math`, and one call can process many
states. The module uses no compiled code of ggbench.

Components are [xx, xy, xz, yy, yz, zz] in E; on the map, x is east, y is north and z is up.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.interpolate import NdBSpline

from .problem_file import Arrays

SEMI_MAJOR_AXIS = 6378137.0
FLATTENING = 1.0 / 298.257223563
E2 = FLATTENING * (2.0 - FLATTENING)
ROTATION_RATE = 7.292115e-5
GM = 3.986004418e14
PER_EOTVOS = 1e9

SQUARE = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
UPPER = np.array([0, 1, 2, 4, 5, 8])

# Uniform cubic B-spline: weights and their derivatives are these matrices times (1, t, t², t³).
WEIGHTS = np.array([[1, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1]]) / 6.0
SLOPES = np.array([[-1, 2, -1, 0], [0, -4, 3, 0], [1, 2, -3, 0], [0, 0, 1, 0]]) / 2.0


class NormalField:
    """Derivatives V_ij = ∂^(i+j) V / ∂r^i ∂s^j of the normal potential V.

    r is the geocentric radius, and s is the sine of the geocentric latitude.
    """

    def __init__(self, even_zonals: np.ndarray) -> None:
        self.degrees = np.arange(0, 2 * len(even_zonals) + 1, 2)
        self.powers = np.arange(self.degrees[-1] + 1)
        factors = GM * np.concatenate([[1.0], -even_zonals])
        legendre = np.zeros((4, len(self.degrees), len(self.powers)))
        radial = np.zeros((4, len(self.degrees)))
        for row, degree in enumerate(self.degrees):
            series = np.polynomial.Legendre.basis(degree).convert(kind=np.polynomial.Polynomial)
            for j in range(4):
                coefficients = series.deriv(j).coef
                legendre[j, row, : len(coefficients)] = coefficients
            for i in range(4):
                radial[i, row] = factors[row] * np.prod(-(degree + 1.0 + np.arange(i)))
        self.legendre, self.radial = legendre, radial

    def derivatives(self, orders: int, radius: float, sine: float) -> list[list[float]]:
        """Return V_ij at one point for i, j < orders."""
        legendre = self.legendre[:orders] @ sine**self.powers
        radial = self.radial[:orders] * (SEMI_MAJOR_AXIS / radius) ** self.degrees
        v: list[list[float]] = (radial @ legendre.T).tolist()
        return [[x * radius ** -(i + 1) for x in row] for i, row in enumerate(v)]

    def derivatives_at_all(self, orders: int, radius: np.ndarray, sine: np.ndarray) -> np.ndarray:
        """Return V_ij (orders, orders, N) at N points."""
        legendre = self.legendre[:orders] @ sine ** self.powers[:, None]
        radial = self.radial[:orders, :, None] * (SEMI_MAJOR_AXIS / radius) ** self.degrees[:, None]
        scale = radius ** -np.arange(1.0, orders + 1.0)[:, None]
        return np.asarray(np.einsum("idp,jdp->ijp", radial * scale[:, None], legendre))


def radii(xp: Any, latitude: Any) -> tuple[Any, Any]:
    """Return the meridian and the prime-vertical radius [m]; ``xp`` is math, numpy or jax.numpy."""
    w2 = 1.0 - E2 * xp.sin(latitude) ** 2
    prime_vertical = SEMI_MAJOR_AXIS / xp.sqrt(w2)
    return prime_vertical * (1.0 - E2) / w2, prime_vertical


def geocentric(xp: Any, latitude: Any, height: Any) -> tuple[Any, ...]:
    """Return r [m], and sine and cosine of the geocentric latitude and of ψ.

    ψ is the geodetic latitude minus the geocentric latitude.
    """
    sine, cosine = xp.sin(latitude), xp.cos(latitude)
    _, prime_vertical = radii(xp, latitude)
    equatorial = (prime_vertical + height) * cosine
    polar = (prime_vertical * (1.0 - E2) + height) * sine
    radius = xp.sqrt(equatorial * equatorial + polar * polar)
    s, c = polar / radius, equatorial / radius
    return radius, s, c, sine * c - cosine * s, cosine * c + sine * s


def normal_tensor(v: Any, r: Any, s: Any, c: Any, sin_psi: Any, cos_psi: Any) -> tuple[Any, ...]:
    """Return EE, NN, NU, UU [s⁻²] in geodetic axes."""
    ee = v[1][0] / r - s * v[0][1] / r**2
    nn = v[1][0] / r + (c * c * v[0][2] - s * v[0][1]) / r**2
    nu = c * (v[1][1] / r - v[0][1] / r**2)
    return ee, *turned(nn, nu, v[2][0], sin_psi, cos_psi)


def turned(nn: Any, nu: Any, uu: Any, sin_psi: Any, cos_psi: Any) -> tuple[Any, Any, Any]:
    """Rotate NN, NU, UU by ψ about the east axis."""
    sin2, cos2, cross = sin_psi * sin_psi, cos_psi * cos_psi, sin_psi * cos_psi
    return (
        cos2 * nn - 2.0 * cross * nu + sin2 * uu,
        cross * (nn - uu) + (cos2 - sin2) * nu,
        sin2 * nn + 2.0 * cross * nu + cos2 * uu,
    )


def normal_slopes(
    v: Any, r: float, s: float, c: float, sin_psi: float, cos_psi: float, d_r: float, d_phi: float
) -> tuple[float, float, float, float]:
    """Return the changes of EE, NN, NU, UU [s⁻²] for steps in r and in the geocentric latitude."""
    r2, r3 = r * r, r * r * r
    ee_r = v[2][0] / r - v[1][0] / r2 - s * v[1][1] / r2 + 2.0 * s * v[0][1] / r3
    nn_r = ee_r + c * c * (v[1][2] / r2 - 2.0 * v[0][2] / r3)
    nu_r = c * (v[2][1] / r - 2.0 * v[1][1] / r2 + 2.0 * v[0][1] / r3)
    ee_phi = c * (v[1][1] / r - v[0][1] / r2 - s * v[0][2] / r2)
    nn_phi = c * (v[1][1] / r + (c * c * v[0][3] - 3.0 * s * v[0][2] - v[0][1]) / r2)
    nu_phi = -s * (v[1][1] / r - v[0][1] / r2) + c * c * (v[1][2] / r - v[0][2] / r2)
    return ee_r * d_r + ee_phi * d_phi, *turned(
        nn_r * d_r + nn_phi * d_phi,
        nu_r * d_r + nu_phi * d_phi,
        v[3][0] * d_r + c * v[2][1] * d_phi,
        sin_psi,
        cos_psi,
    )


class NumpyModel:
    """Measurement function h and Jacobian H of one run."""

    def __init__(self, arrays: Arrays, run: int) -> None:
        self.references, self.rows = arrays.references[run], arrays.rows[run]
        self.offsets, self.gains = arrays.offsets[run], arrays.gains
        self.times, self.coefficients = arrays.reading_times, arrays.coefficients
        self.origin, self.step = arrays.origin.tolist(), arrays.step.tolist()
        self.cells = [size - 3 for size in arrays.coefficients.shape[:3]]
        self.lower = arrays.origin
        self.upper = arrays.origin + arrays.step * np.array(self.cells)
        knots = [
            origin + step * np.arange(-3.0, cells + 4.0)
            for origin, step, cells in zip(self.origin, self.step, self.cells, strict=True)
        ]
        self.map = NdBSpline(tuple(knots), arrays.coefficients, 3)
        self.normal = NormalField(arrays.even_zonals)

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return h (m,) [E] of one state (n,)."""
        latitude, longitude, height = self._position(k, x)
        point = np.array([latitude, longitude, height])
        tensor = self.map(np.minimum(np.maximum(point, self.lower), self.upper))
        place = geocentric(math, latitude, height)
        v = self.normal.derivatives(3, place[0], place[1])
        ee, nn, nu, uu = normal_tensor(v, *place)
        tensor += PER_EOTVOS * np.array([ee, 0.0, 0.0, nn, nu, uu])
        c_in = self._inertial(k, latitude, longitude)
        turned_tensor = c_in @ tensor[SQUARE] @ c_in.T
        return np.asarray(self.offsets[k] + self.gains[k] * turned_tensor.ravel()[UPPER])

    def predict_all(self, k: int, states: np.ndarray) -> np.ndarray:
        """Return h (N, m) [E] of N states (N, n) in one call."""
        east, north, up = self.rows[k] @ states.T
        latitude, longitude, height = self.references[k].tolist()
        meridian, prime_vertical = radii(math, latitude)
        positions = np.stack(
            [
                latitude - north / (meridian + height),
                longitude - east / ((prime_vertical + height) * math.cos(latitude)),
                height - up,
            ]
        )
        tensors = self.map(np.minimum(np.maximum(positions.T, self.lower), self.upper))
        count = len(states)
        place = geocentric(np, positions[0], positions[2])
        v = self.normal.derivatives_at_all(3, place[0], place[1])
        ee, nn, nu, uu = normal_tensor(v, *place)
        zero = np.zeros(count)
        tensors += PER_EOTVOS * np.stack([ee, zero, zero, nn, nu, uu], axis=-1)
        angle = positions[1] + ROTATION_RATE * self.times[k]
        sin_l, cos_l = np.sin(positions[0]), np.cos(positions[0])
        sin_a, cos_a = np.sin(angle), np.cos(angle)
        c_in = np.stack(
            [-sin_a, -sin_l * cos_a, cos_l * cos_a, cos_a, -sin_l * sin_a, cos_l * sin_a,
             zero, cos_l, sin_l], axis=-1,
        ).reshape(count, 3, 3)  # fmt: skip
        turned_tensors = c_in @ tensors[:, SQUARE] @ c_in.transpose(0, 2, 1)
        return np.asarray(
            self.offsets[k] + self.gains[k] * turned_tensors.reshape(count, 9)[:, UPPER]
        )

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return H (m, n) [E per unit of the state] at one state (n,)."""
        latitude, longitude, height = self._position(k, x)
        corner, powers, inside = self._cell(latitude, longitude, height)
        # (axis, weight or derivative, node)
        both = np.stack([WEIGHTS @ powers, SLOPES @ powers * inside]).transpose(2, 0, 1)
        found = both[0] @ self._corner(corner)
        found = both[1] @ found.reshape(2, 4, 24)
        found = both[2] @ found.reshape(2, 2, 4, 6)
        tensor = found[0, 0, 0]
        meridian, prime_vertical = radii(math, latitude)
        r_north, r_east = meridian + height, prime_vertical + height
        slope = np.empty((3, 6))  # per metre east, north, up; the axes follow the position
        slope[0] = found[0, 1, 0] / (self.step[1] * r_east * math.cos(latitude))
        slope[1] = found[1, 0, 0] / (self.step[0] * r_north)
        slope[2] = found[0, 0, 1] / self.step[2]

        place = geocentric(math, latitude, height)
        r, _, _, sin_psi, cos_psi = place
        v = self.normal.derivatives(4, place[0], place[1])
        ee, nn, nu, uu = normal_tensor(v, *place)
        tensor = tensor + PER_EOTVOS * np.array([ee, 0.0, 0.0, nn, nu, uu])
        for axis, d_r, d_phi, d_latitude in (
            (1, -sin_psi, cos_psi / r, 1.0 / r_north),
            (2, cos_psi, sin_psi / r, 0.0),
        ):
            d_psi = d_latitude - d_phi
            d_ee, d_nn, d_nu, d_uu = normal_slopes(v, *place, d_r, d_phi)
            slope[axis] += PER_EOTVOS * np.array(
                [
                    d_ee,
                    0.0,
                    0.0,
                    d_nn - 2.0 * nu * d_psi,
                    d_nu + (nn - uu) * d_psi,
                    d_uu + 2.0 * nu * d_psi,
                ]
            )

        square = tensor[SQUARE]
        change = slope[:, SQUARE]
        # The local-level axes rotate with the position: [φ×] Γ − Γ [φ×].
        tilt, azimuth, pitch = 1.0 / r_east, math.tan(latitude) / r_east, -1.0 / r_north
        east_turn = np.array([[0.0, -azimuth, tilt], [azimuth, 0.0, 0.0], [-tilt, 0.0, 0.0]])
        north_turn = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -pitch], [0.0, pitch, 0.0]])
        for axis, turn in ((0, east_turn), (1, north_turn)):
            half = turn @ square
            change[axis] += half + half.T
        c_in = self._inertial(k, latitude, longitude)
        columns = (c_in @ change @ c_in.T).reshape(3, 9)[:, UPPER]
        # Position errors of the state are metres at the reference position.
        reference_latitude, _, reference_height = self.references[k].tolist()
        meridian, prime_vertical = radii(math, reference_latitude)
        east = (prime_vertical + reference_height) * math.cos(reference_latitude)
        scale = [
            [-r_east * math.cos(latitude) / east],
            [-r_north / (meridian + reference_height)],
            [-1.0],
        ]
        return np.asarray(self.gains[k] * (columns * np.array(scale)).T @ self.rows[k])

    def _position(self, k: int, x: np.ndarray) -> tuple[float, float, float]:
        east, north, up = (self.rows[k] @ x).tolist()
        latitude, longitude, height = self.references[k].tolist()
        meridian, prime_vertical = radii(math, latitude)
        return (
            latitude - north / (meridian + height),
            longitude - east / ((prime_vertical + height) * math.cos(latitude)),
            height - up,
        )

    def _cell(self, *position: float) -> tuple[list[int], np.ndarray, list[float]]:
        """Return the first node of a cell, the powers 1, t, t², t³ (4, 3), and a mask of the axes.

        The mask is 1 for each axis along which the position is inside the map, else 0.
        """
        corner, fractions, inside = [], [], []
        for p, origin, step, cells in zip(
            position, self.origin, self.step, self.cells, strict=True
        ):
            u = (p - origin) / step
            clamped = min(max(u, 0.0), float(cells))
            cell = min(int(clamped), cells - 1)
            corner.append(cell)
            fractions.append(clamped - cell)
            inside.append(1.0 if u == clamped else 0.0)
        powers = np.array(
            [[1.0] * 3, fractions, [t * t for t in fractions], [t * t * t for t in fractions]]
        )
        return corner, powers, inside

    def _corner(self, corner: list[int]) -> np.ndarray:
        i, j, k = corner
        return self.coefficients[i : i + 4, j : j + 4, k : k + 4].reshape(4, 96)

    def _inertial(self, k: int, latitude: float, longitude: float) -> np.ndarray:
        """Return C_in (3, 3), which rotates local-level to inertial axes."""
        angle = longitude + ROTATION_RATE * float(self.times[k])
        sin_l, cos_l = math.sin(latitude), math.cos(latitude)
        sin_a, cos_a = math.sin(angle), math.cos(angle)
        return np.array(
            [
                [-sin_a, -sin_l * cos_a, cos_l * cos_a],
                [cos_a, -sin_l * sin_a, cos_l * sin_a],
                [0.0, cos_l, sin_l],
            ]
        )
