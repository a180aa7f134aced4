"""Measured readings in place of simulated ones."""

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
    """Return the readings (G, g) [E] that were measured at the true positions (G, 3).

    NaN where one is missing; None of a case whose readings are simulated. A survey delivers the
    disturbing field: the normal field's gradient at the surveyed position, which its processing
    took away, is added again.

    Raises
    ------
    GGBenchError
        If the survey lines have other components, or samples at other times.
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
    """Return by how much measured gravity (G,) is off a field, by the gravimeter [mGal].

    NaN where a reading is missing. It takes the place of simulated noise.

    Parameters
    ----------
    case : the case.
    field : the true field.
    positions : true ones (G, 3) at which each sensor is read.

    Raises
    ------
    GGBenchError
        If the survey lines have no gravity, or samples at other times.
    """
    errors = {}
    for name in case.measured_sensors():
        if name != "gradiometer":
            gravity = -MGAL * field.gravity_disturbance(*positions[name].T)[:, 2]
            period = case.sensor[name].period_s
            errors[name] = _on_line(case, name, period, (DISTURBANCE,))[:, 0] - gravity
    return errors


def _on_line(case: CaseSpec, sensor: str, period: float, columns: Sequence[str]) -> np.ndarray:
    """Return the readings of a sensor on the line of a case, (G, columns)."""
    flown = case.trajectory
    try:
        return flown.survey_line().measured(columns, flown.middle_s, period, sensor)
    except TrajectoryError as error:
        raise TrajectoryError(f"survey lines {flown.file}: {error}") from None
