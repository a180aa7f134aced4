"""The misprints of Wang et al. 2013, a test each: printed it is wrong, corrected right.

The judge of eqs. 5, 6 and 9 is the finite difference of the mechanization's rates; of eqs. 13 and
14, the moments that sigma points must have; of eq. 6's gravity term also Schuler's period. The
corrected forms stand here as textbooks print them, with radii that do not change with latitude;
that neglect is below 1 % of an entry's terms, and every tolerance says what it is.
"""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import JulierSigmaPoints
from frame_oracles import cross_matrix, difference, mechanization_jacobian, square
from oracles import points

from ggbench.gravity import ellipsoid
from ggbench.gravity.ellipsoid import EOTVOS, ROTATION_RATE
from ggbench.gravity.field import Field
from ggbench.numerics import rotations

POSITION = np.array([np.radians(33.5), np.radians(108.0), 10000.0])
VELOCITY = np.array([250.0, -120.0, 30.0])
C_NB = rotations.attitude_matrix(np.radians(115.0), np.radians(6.0), np.radians(-20.0))
FORCE_N = np.array([1.5, -2.0, 10.3])
RATE_B = np.array([0.02, -0.01, 0.03])

V_E, V_N, V_U = VELOCITY
SINE, COSINE, TANGENT = np.sin(POSITION[0]), np.cos(POSITION[0]), np.tan(POSITION[0])
R_M, R_N = np.array(ellipsoid.radii_of_curvature(POSITION[0])) + POSITION[2]  # with the height
OMEGA = ROTATION_RATE

DR, DV, PHI, GYRO, ACCELEROMETER = (slice(i, i + 3) for i in range(0, 15, 3))

# The paper's matrices that are right; which of them is which is a matter of the tests.
VELOCITY_TERMS = np.array(
    [
        [
            (V_N * TANGENT - V_U) / R_N,
            2 * OMEGA * SINE + V_E * TANGENT / R_N,
            -(2 * OMEGA * COSINE + V_E / R_N),
        ],
        [-2 * (OMEGA * SINE + V_E * TANGENT / R_N), -V_U / R_M, -V_N / R_M],
        [2 * (OMEGA * COSINE + V_E / R_N), 2 * V_N / R_M, 0.0],
    ]
)
FORCE_TERMS = cross_matrix(FORCE_N)


@pytest.fixture(scope="module")
def motion() -> np.ndarray:
    """F (15, 15) of the mechanization, in the paper's variables (δL, δλ, δh), by differences."""
    matrix, _ = mechanization_jacobian(POSITION, VELOCITY, C_NB, C_NB.T @ FORCE_N, RATE_B)
    return matrix


def test_eq5_attitude_from_north_velocity_has_a_minus(motion):
    """Flying north turns the level about west: F_φv(1,2) is −1/(R_M+h), not +."""
    printed, corrected = 1.0 / R_M, -1.0 / R_M
    true = motion[PHI, DV][0, 1]
    assert true == pytest.approx(corrected, rel=1e-6)
    assert abs(true - printed) > abs(corrected)
    np.testing.assert_allclose(
        motion[PHI, DV],
        [[0, corrected, 0], [1 / R_N, 0, 0], [TANGENT / R_N, 0, 0]],
        rtol=1e-6,
        atol=1e-15,
    )


def test_eq5_gyro_bias_enters_with_a_minus(motion):
    """With measured = true + ε and C̃_nb = (I − [φ×]) C_nb a bias tilts the platform by −C_nb ε."""
    np.testing.assert_allclose(motion[PHI, GYRO], -C_NB, rtol=0.0, atol=1e-8)
    assert np.abs(motion[PHI, GYRO] - C_NB).max() > 1.0


def test_eq6_titles_of_velocity_and_force_matrices_are_exchanged(motion):
    """What is printed as F_vφ multiplies δv, and what is printed as F_vv multiplies φ."""
    np.testing.assert_allclose(motion[DV, DV], VELOCITY_TERMS, rtol=1e-6, atol=1e-13)
    np.testing.assert_allclose(motion[DV, PHI], FORCE_TERMS, rtol=0.0, atol=1e-7)
    assert np.abs(motion[DV, DV] - FORCE_TERMS).max() > 1.0
    assert np.abs(motion[DV, PHI] - VELOCITY_TERMS).max() > 1.0


def test_eq6_latitude_term_has_the_vertical_velocity(motion):
    """F_vr(1,1) ends in 2 ω_ie v_U sin L; with v_E it would be twenty times the real term."""
    common = 2 * OMEGA * V_N * COSINE + V_E * V_N / (R_N * COSINE**2)
    printed = common + 2 * OMEGA * V_E * SINE
    corrected = common + 2 * OMEGA * V_U * SINE
    true = motion[DV, DR][0, 0]
    assert true == pytest.approx(corrected, rel=2e-3)  # radii that change with latitude: 1e-3
    assert abs(true - printed) > 0.5 * abs(corrected)


def test_eq6_height_term_has_opposite_signs(motion):
    """F_vr(1,3) is (v_E v_U − v_E v_N tan L)/(R_N+h)²: up and north have one sign each."""
    printed = -(V_E * V_U + V_E * V_N * TANGENT) / R_N**2
    corrected = (V_E * V_U - V_E * V_N * TANGENT) / R_N**2
    true = motion[DV, DR][0, 2]
    assert true == pytest.approx(corrected, rel=1e-5)
    assert abs(true - printed) > 0.5 * abs(corrected)


def test_eq6_gravity_gradient_acts_on_the_vertical_row_only(motion):
    """In a local level with vertical normal gravity, F_vgr = −∂γ/∂(L, h) in the third row.

    The full tensor would add g/R again, which the tilt f × φ already carries.
    """
    tensor, slope = np.empty(6), np.empty((6, 3))
    points.normal_gradient(POSITION[0], POSITION[2], tensor, slope)
    printed = square(tensor) * EOTVOS @ np.diag([R_M, R_N, 1.0])
    _, d_latitude, d_height = ellipsoid.normal_gravity(POSITION[0], POSITION[2])
    # Groves (2013), eq. (2.140): above the ellipsoid normal gravity points -8.08e-9 h sin 2L north.
    north = -8.08e-9 * np.array(
        [2.0 * POSITION[2] * np.cos(2.0 * POSITION[0]), 0.0, np.sin(2.0 * POSITION[0])]
    )
    corrected = np.array([[0, 0, 0], north, [-d_latitude, 0, -d_height]])
    kinematic = np.array(
        [
            [
                2 * OMEGA * (V_N * COSINE + V_U * SINE) + V_E * V_N / (R_N * COSINE**2),
                0.0,
                (V_E * V_U - V_E * V_N * TANGENT) / R_N**2,
            ],
            [
                -2 * OMEGA * V_E * COSINE - V_E**2 / (R_N * COSINE**2),
                0.0,
                V_E**2 * TANGENT / R_N**2 + V_N * V_U / R_M**2,
            ],
            [-2 * OMEGA * V_E * SINE, 0.0, -(V_E**2) / R_N**2 - V_N**2 / R_M**2],
        ]
    )
    true = motion[DV, DR] - kinematic
    # In metres of displacement, where all entries have the unit of a gradient: to 1 E of 3000 E.
    metre = np.diag([1.0 / R_M, 1.0 / (R_N * COSINE), 1.0])
    np.testing.assert_allclose(true @ metre, corrected @ metre, rtol=0.0, atol=1.0 * EOTVOS)
    assert np.abs((true - printed) @ metre).max() > 1000.0 * EOTVOS


def test_eq6_full_tensor_would_break_schulers_period():
    """At rest the tilt alone makes the 84-minute oscillation; with the full tensor, 60 minutes."""
    gamma, _, _ = ellipsoid.normal_gravity(POSITION[0], 0.0)
    place = np.array([POSITION[0], 0.0, 0.0])
    matrix, _ = mechanization_jacobian(
        place, np.zeros(3), np.eye(3), np.array([0.0, 0.0, gamma]), np.zeros(3)
    )
    north, east = ellipsoid.radii_of_curvature(place[0])
    tensor, slope = np.empty(6), np.empty((6, 3))
    points.normal_gradient(place[0], 0.0, tensor, slope)
    full = matrix.copy()
    displacement = np.array([[0.0, east * np.cos(place[0]), 0.0], [north, 0.0, 0.0], [0, 0, 1.0]])
    full[DV, DR] = square(tensor) * EOTVOS @ displacement

    def minutes(f: np.ndarray) -> float:
        """Period of the north channel (δL, δv_N, φ_E) [min]."""
        channel = f[np.ix_([0, 4, 6], [0, 4, 6])]
        return 2.0 * np.pi / np.abs(np.linalg.eigvals(channel).imag).max() / 60.0

    assert minutes(matrix) == pytest.approx(84.4, abs=0.3)
    assert minutes(full) == pytest.approx(84.4 / np.sqrt(2.0), abs=0.3)


def test_eq6_displacement_of_latitude_and_longitude_is_not_diagonal(wang):
    """If the mechanization adds a map's disturbance, ∂δg/∂(L, λ, h) = Γ D with D as in physics.

    δL moves north and δλ east, by (R_M+h) and (R_N+h) cos L; the printed diagonal R_M, R_N, 1 moves
    δL east. To 2 % of the largest entry (spline, turning axes); the printed is off by half.
    """
    place = POSITION + np.array([0.0, np.radians(0.3), 0.0])
    step = (1e-6, 1e-6, 10.0)
    true = np.stack(
        [
            difference(
                lambda d, axis=axis: wang.field.gravity_disturbance(*(place + d * np.eye(3)[axis])),
                step[axis],
            )
            for axis in range(3)
        ],
        axis=-1,
    )
    disturbing = square(wang.field.tensor(*place) - Field.normal().tensor(*place)) * EOTVOS
    corrected = disturbing @ np.array([[0, R_N * COSINE, 0], [R_M, 0, 0], [0, 0, 1.0]])
    printed = disturbing @ np.diag([R_M, R_N, 1.0])
    metre = np.array([1.0 / R_M, 1.0 / (R_N * COSINE), 1.0])
    scale = np.abs(disturbing).max()
    assert np.abs((true - corrected) * metre).max() < 0.02 * scale
    assert np.abs((true - printed) * metre).max() > 0.5 * scale


def test_eq9_noise_blocks():
    """w_a drives δv' through C_nb, w_g drives φ' through −C_nb; neither drives any other block.

    Shifted by one block row in either direction G contradicts the mechanization.
    """

    def rates(force_error: np.ndarray, rate_error: np.ndarray) -> np.ndarray:
        position, velocity, attitude = np.empty((3, 3))
        points.position_rate(POSITION, VELOCITY, position)
        force = C_NB @ (C_NB.T @ FORCE_N + force_error)
        points.velocity_rate(POSITION, VELOCITY, force, velocity)
        points.attitude_rate(POSITION, VELOCITY, C_NB, RATE_B + rate_error, attitude)
        return np.concatenate([position, velocity, -attitude])  # φ' is minus the excess turn

    nothing = np.zeros(3)
    true = np.zeros((9, 9))  # driven by the paper's W = (0, w_a, w_g)
    for axis in range(3):
        unit = np.eye(3)[axis]
        true[:, 3 + axis] = difference(lambda d, u=unit: rates(d * u, nothing), 1e-2)
        true[:, 6 + axis] = difference(lambda d, u=unit: rates(nothing, d * u), 1e-2)
    corrected = np.zeros((9, 9))
    corrected[DV, DV], corrected[PHI, PHI] = C_NB, -C_NB
    np.testing.assert_allclose(true, corrected, rtol=0.0, atol=1e-10)
    for shift in (-3, 3):
        assert np.abs(true - np.roll(corrected, shift, axis=0)).max() > 0.5


# Sigma points.

N = 15
LAMBDA = 3.0 - N


def paper_points(covariance: np.ndarray, second_sign: float) -> np.ndarray:
    """Offsets (2n+1, n) from the mean of eq. 13, (n+λ) P = 3 P under the root."""
    root = np.linalg.cholesky((N + LAMBDA) * covariance).T
    return np.concatenate([np.zeros((1, N)), root, second_sign * root])


def moments(points: np.ndarray, weights: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    mean = weights @ points
    return weights.sum(), mean, (weights * (points - mean).T) @ (points - mean)


@pytest.fixture(scope="module")
def covariance() -> np.ndarray:
    root = np.random.default_rng(1).normal(size=(N, N))
    return root @ root.T


CORRECTED_WEIGHTS = np.array([LAMBDA / (N + LAMBDA)] + [0.5 / (N + LAMBDA)] * 2 * N)


def test_eq13_second_half_of_the_points_has_a_minus(covariance):
    """Points on both sides of the mean have its mean and covariance; on one side, neither."""
    _, mean, spread = moments(paper_points(covariance, -1.0), CORRECTED_WEIGHTS)
    np.testing.assert_allclose(mean, 0.0, atol=1e-12)
    np.testing.assert_allclose(spread, covariance, atol=1e-11)
    _, mean, spread = moments(paper_points(covariance, +1.0), CORRECTED_WEIGHTS)
    assert np.abs(mean).max() > 1.0
    assert np.abs(spread - covariance).max() > 1.0


def test_eq13_range_is_n_plus_1_to_2n(covariance):
    """Taken literally, i = 1..2n for the second half replaces or repeats the first: n points more.

    Then the weights of eq. 14, corrected, no longer sum to one.
    """
    root = paper_points(covariance, -1.0)[1 : N + 1]
    literal = np.concatenate([np.zeros((1, N)), root, -root, -root])
    weights = np.concatenate([CORRECTED_WEIGHTS, CORRECTED_WEIGHTS[-N:]])
    total, mean, _ = moments(literal, weights)
    assert abs(total - 1.0) > 1.0
    assert np.abs(mean).max() > 1.0


def test_eq14_weights_of_the_outer_points_are_half_over_n_plus_lambda(covariance):
    """Weights sum to one and give back the covariance only as 1/(2(n+λ)); λ/(n+λ) gives −124."""
    points = paper_points(covariance, -1.0)
    total, _, spread = moments(points, CORRECTED_WEIGHTS)
    assert total == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(spread, covariance, atol=1e-11)
    total, _, spread = moments(points, np.full(2 * N + 1, LAMBDA / (N + LAMBDA)))
    assert total == pytest.approx(-124.0)
    assert np.diag(spread).max() < 0.0
    # What κ = 3 − n is for: the fourth moment of a Gaussian along each root, 3 σ⁴.
    along = np.linalg.solve(np.linalg.cholesky(covariance), points.T)
    np.testing.assert_allclose(CORRECTED_WEIGHTS @ (along**4).T, 3.0, rtol=1e-10)


def test_eq13_and_eq14_are_the_points_of_the_library(covariance):
    """The sigma points that the filter uses for κ = 3 − n are the corrected ones."""
    library = JulierSigmaPoints(N, kappa=LAMBDA)
    total, mean, spread = moments(
        library.sigma_points(np.zeros(N), covariance), np.asarray(library.Wm)
    )
    assert total == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(mean, 0.0, atol=1e-12)
    np.testing.assert_allclose(spread, covariance, atol=1e-11)
    assert library.Wm[0] == pytest.approx(LAMBDA / (N + LAMBDA))
    assert library.Wc[1] == pytest.approx(0.5 / (N + LAMBDA))
