"""An INS that adds a map's gravity disturbance to normal gravity, and the F that knows of it."""

from __future__ import annotations

import numpy as np
import pytest
from error_free import closure
from frame_oracles import difference, metres
from oracles import dense_model
from small_cases import rough_map

from ggbench.gravity.field import Field
from ggbench.ins import error_model, strapdown
from ggbench.ins.known_gravity import NORMAL_GRAVITY, of_map
from ggbench.maps.recipe import read
from ggbench.trajectory.truth import Segment, fly

START = np.array([np.radians(33.55), np.radians(108.02), 10000.0])


@pytest.fixture(scope="module")
def field(tmp_path_factory) -> Field:
    """Gravity that changes by tens of mGal within the flight."""
    return Field.from_map(read(rough_map(tmp_path_factory.mktemp("map") / "rough.nc", rms=300.0)))


@pytest.fixture(scope="module")
def flown(field):
    """A minute over it, and the increments of accelerometers that feel it."""
    truth = fly(
        position=START,
        speed=150.0,
        heading=1.2,
        pitch=0.02,
        roll=0.0,
        segments=[Segment(30.0, turn_rate=np.radians(2.0)), Segment(30.0, acceleration=0.5)],
        dt=0.05,
    )
    middle = 0.5 * (truth.positions[1:] + truth.positions[:-1])
    felt = field.gravity_disturbance(*middle.T)
    assert np.ptp(felt, axis=0).max() > 1e-4
    increments = strapdown.error_free_increments(
        truth.positions, truth.velocities, truth.attitudes, felt, truth.dt
    )
    return truth, increments


def test_f_knows_how_the_maps_gravity_changes_with_the_position(field, flown):
    """All nine entries are the derivatives of the disturbance; nothing else changes."""
    truth, _ = flown
    force = np.array([1.0, 2.0, 9.0])
    for n in (0, 400, 1200):
        state = truth.positions[n], truth.velocities[n], truth.attitudes[n], force
        plain, added = np.empty((2, 15, 15))
        dense_model.system_matrix(*state, plain)
        dense_model.system_matrix(*state, added, of_map(field.disturbance_map))
        place = truth.positions[n]
        columns = [
            difference(lambda d, e=axis, p=place: field.gravity_disturbance(*(p + d * e)), step)
            for axis, step in zip(np.eye(3), (1e-7, 1e-7, 0.5), strict=True)
        ]
        slope = np.stack(columns, axis=-1)
        size = np.abs(slope).max(axis=0)
        assert (size > 0.0).all()
        np.testing.assert_allclose(
            (added - plain)[3:6, :3] / size, slope / size, rtol=0.0, atol=1e-6
        )
        added[3:6, :3] = plain[3:6, :3]
        np.testing.assert_array_equal(added, plain)


def test_an_ins_that_adds_what_is_felt_follows_the_truth(field, flown):
    """To a millimetre; one that adds nothing is metres off after a minute."""
    truth, increments = flown
    start = truth.positions[0], truth.velocities[0], truth.attitudes[0]
    off = {}
    for name, gravity in (("map", of_map(field.disturbance_map)), ("none", NORMAL_GRAVITY)):
        positions, _, _ = strapdown.navigate(*start, *increments, truth.dt, gravity=gravity)
        scale = np.array([6.4e6, 6.4e6 * np.cos(START[0]), 1.0])
        off[name] = np.abs((positions - truth.positions) * scale).max()
    assert off["map"] < 1e-3
    assert off["none"] > 0.1
    assert np.abs(closure(truth)[0]).max() < 1e-3


def test_errors_move_as_the_model_with_the_maps_gradient_says(field, flown):
    """300 m off in position alone: what F leaves unexplained is the field's curvature.

    Without the map's gradient in F ten times as much is left.
    """
    truth, increments = flown
    away = np.array([300.0 / 6.37e6, -200.0 / 5.3e6, 100.0])
    start = truth.positions[0] + away, truth.velocities[0], truth.attitudes[0]
    track = strapdown.navigate(*start, *increments, truth.dt, gravity=of_map(field.disturbance_map))
    error = np.zeros(15)
    error[:3] = metres(truth.positions[0]) @ away
    true = track[1][-1] - truth.velocities[-1]
    left = []
    for gravity in (of_map(field.disturbance_map), NORMAL_GRAVITY):
        matrices = dense_model.system_matrices(*track, increments[1], truth.dt, gravity)
        transition, _ = dense_model.transitions(
            matrices, track[0], np.array([len(matrices)]), truth.dt, error_model.noise_psd(0.0, 0.0)
        )
        left.append(np.abs((transition[0] @ error)[3:6] - true).max())
    print(left)
    assert left[0] < 0.1 * left[1]
