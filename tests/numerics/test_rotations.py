"""Sines, cosines and rotations without the C library."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ggbench.numerics import rotations


def test_sine_and_cosine_of_a_latitude():
    """Equal to the C library's from pole to pole, to two units in the last place of one."""
    for latitude in np.radians(np.linspace(-90.0, 90.0, 721)):
        ours = rotations.sine_cosine(latitude)
        np.testing.assert_allclose(
            ours, (np.sin(latitude), np.cos(latitude)), rtol=0.0, atol=4.5e-16
        )
    assert rotations.sine_cosine(1e-9)[0] == pytest.approx(1e-9, rel=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.3, 1.0, 1.57])
def test_small_turns_are_rotations(angle):
    """exp([v×]) up to a quarter turn, as scipy has it by quaternions."""
    for axis in np.random.default_rng(1).normal(size=(20, 3)):
        vector = angle * axis / np.linalg.norm(axis)
        ours = np.reshape(rotations.small_turn(*vector), (3, 3))
        np.testing.assert_allclose(
            ours, Rotation.from_rotvec(vector).as_matrix(), rtol=0.0, atol=1e-15
        )


@pytest.mark.parametrize("angle", [1.58, 1.6, 3.0, 6.0])
def test_large_turns_are_rotations(angle):
    """Beyond the series' reach, too."""
    for axis in np.random.default_rng(2).normal(size=(20, 3)):
        vector = angle * axis / np.linalg.norm(axis)
        ours = np.empty((3, 3))
        rotations.rotation_matrix(vector, ours)
        np.testing.assert_allclose(
            ours, Rotation.from_rotvec(vector).as_matrix(), rtol=0.0, atol=2e-15
        )


@pytest.mark.parametrize("angle", [1e-9, 1e-3, 0.3, 1.5, 2.5])
def test_the_left_jacobian_is_the_derivative_of_a_rotation(angle):
    """exp([(v + δ)×]) = exp([(J δ)×]) exp([v×]): by central differences, to their 1e-9."""
    step = 1e-5
    for axis in np.random.default_rng(3).normal(size=(20, 3)):
        vector = angle * axis / np.linalg.norm(axis)
        jacobian = np.reshape(rotations.left_jacobian(*vector), (3, 3))
        numeric = np.empty((3, 3))
        for i in range(3):
            ends = [
                Rotation.from_rotvec(vector + side * step * np.eye(3)[i]) for side in (1.0, -1.0)
            ]
            numeric[:, i] = (ends[0] * ends[1].inv()).as_rotvec() / (2.0 * step)
        np.testing.assert_allclose(jacobian, numeric, atol=1e-9)


@pytest.mark.parametrize("angle", [2.0, 2.8, 3.14])
def test_the_series_reach_half_a_turn(angle):
    """An attitude error below π, as h may be asked for: to 1e-12, by the closed forms."""
    for axis in np.random.default_rng(4).normal(size=(20, 3)):
        axis /= np.linalg.norm(axis)
        vector = angle * axis
        turn = np.reshape(rotations.small_turn(*vector), (3, 3))
        np.testing.assert_allclose(
            turn, Rotation.from_rotvec(vector).as_matrix(), rtol=0.0, atol=1e-12
        )
        cross = np.cross(axis, np.eye(3), axisb=0, axisc=0)
        exact = (
            np.eye(3)
            + (1.0 - np.cos(angle)) / angle * cross
            + (1.0 - np.sin(angle) / angle) * cross @ cross
        )
        jacobian = np.reshape(rotations.left_jacobian(*vector), (3, 3))
        np.testing.assert_allclose(jacobian, exact, rtol=0.0, atol=3e-14)
