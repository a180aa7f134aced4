"""Readings that were measured, in place of simulated ones."""

from __future__ import annotations

import numpy as np

from ..gravity.field import Field
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
    spec, flown = case.gradiometer, case.trajectory
    if spec is None or spec.readings == "simulated":
        return None
    instrument, line = gradiometer_of(spec), flown.survey_line()
    try:
        disturbing = line.measured(instrument.components, flown.middle_s, spec.period_s)
    except TrajectoryError as error:
        raise TrajectoryError(f"survey lines {flown.file}: {error}") from None
    return np.asarray(disturbing + Field.normal().tensor(*positions.T) @ instrument.channels.T)
