"""Gravity that is felt, and that is added: what they leave of an INS without other errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from small_cases import QUIET, rough_map, small_flight

from ggbench.simulation.error_free_flight import Flight
from ggbench.simulation.runs import simulate


def flown(tmp_path: Path, **changes: object) -> tuple[Flight, np.ndarray]:
    """A flight over tens of mGal with the INS's errors (K, 9) in it."""
    felt = rough_map(tmp_path / "felt.nc", seed=1, rms=300.0)
    flight = small_flight(
        QUIET
        | {
            "field.source": felt,
            "field.gravity_disturbance": True,
            "initial_error.position_m": 1e-6,
            "initial_error.velocity_mps": 1e-7,
            "initial_error.attitude_arcmin": 1e-6,
        }
        | {key.replace("__", "."): value for key, value in changes.items()}
    )
    _, truth = simulate(flight, 1, 0)
    return flight, truth.error_state


def drift(disturbance: np.ndarray) -> np.ndarray:
    """Errors of position (K, 3) that an acceleration at the epochs, a second apart, leads to."""
    velocity = np.cumsum(disturbance, axis=0) - 0.5 * disturbance
    return np.cumsum(velocity, axis=0) - 0.5 * velocity


def test_what_is_added_where_it_is_felt_leaves_nothing(tmp_path):
    """A tenth of a millimetre after 20 s, of a decimetre without."""
    _, felt = flown(tmp_path)
    _, compensated = flown(tmp_path, model__field__compensate=True)
    assert np.abs(felt[-1, :3]).max() > 0.03
    assert np.abs(compensated[-1, :3]).max() < 1e-4


def test_a_wrong_map_leaves_the_difference_of_the_two(tmp_path):
    """δv' = δg of the estimators' map − δg of the true one."""
    other = rough_map(tmp_path / "other.nc", seed=2, rms=300.0)
    flight, errors = flown(tmp_path, model__field__compensate=True, model__field__source=other)
    place = flight.trajectory.positions[flight.epochs].T
    added, felt = (
        field.gravity_disturbance(*place) for field in (flight.model_field, flight.field)
    )
    expected = drift(added - felt)
    assert np.abs(expected[-1]).max() > 0.03
    np.testing.assert_allclose(
        errors[:, :3], expected, rtol=0.0, atol=0.1 * np.abs(expected[-1]).max()
    )
