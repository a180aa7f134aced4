"""Measured survey data in place of simulated measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..gravity.field import Field
from ..maps.survey_lines import DISTURBANCE
from ..sensors.aiding import MGAL
from ..spec.case import CaseSpec
from ..trajectory.manoeuvres import TrajectoryError
from .instruments import gradiometer_of


def measured_readings(case: CaseSpec, positions: np.ndarray) -> np.ndarray | None:
    """Return the measured gradients (G, g) [E] at the true positions (G, 3).

    Missing values are NaN. The result is None if the case simulates measurements. A survey contains
    the disturbing field, so the normal gradient at the surveyed position is added.

    Raises
    ------
    GGBenchError
        If the survey lines lack components, or their samples have other times than the
        measurements.
    """
    spec = case.gradiometer
    if spec is None or spec.readings == "simulated":
        return None
    instrument = gradiometer_of(spec)
    disturbing = _on_line(case, "gradiometer", spec.period_s, instrument.components)
    return np.asarray(disturbing + Field.normal().tensor(*positions.T) @ instrument.channels.T)


def measured_errors(
    case: CaseSpec, field: Field, positions: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return the errors (G,) [mGal] of measured gravity against a field, by name of gravimeter.

    Missing values are NaN. The errors replace simulated noise.

    Parameters
    ----------
    case : the case.
    field : the true field.
    positions : by name of the sensor, the true positions (G, 3) of its measurements.

    Raises
    ------
    GGBenchError
        If the survey lines have no gravity, or their samples have other times than the
        measurements.
    """
    errors = {}
    for name in case.measured_sensors():
        if name != "gradiometer":
            gravity = -MGAL * field.gravity_disturbance(*positions[name].T)[:, 2]
            period = case.sensor[name].period_s
            errors[name] = _on_line(case, name, period, (DISTURBANCE,))[:, 0] - gravity
    return errors


def _on_line(case: CaseSpec, sensor: str, period: float, columns: Sequence[str]) -> np.ndarray:
    """Return the surveyed values (G, c) of c columns at the measurement times of a sensor."""
    flown = case.trajectory
    try:
        return flown.survey_line().measured(columns, flown.middle_s, period, sensor)
    except TrajectoryError as error:
        raise TrajectoryError(f"survey lines {flown.file}: {error}") from None
