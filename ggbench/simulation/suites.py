"""Sensor suites from the tables of a case: true or assumed sensors and prior."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from ..ins.strapdown import altimeter_gains
from ..spec.case import CaseSpec
from ..spec.sensors import AltimeterSpec, DisturbanceSpec, Side, TrueImu, TruthSpec
from .aiding import sensors_of_side
from .field_source import channel_errors
from .instruments import gradiometer_of, gravity_state, imu_of
from .sensor_suite import SensorSuite


def suite_of_case(case: CaseSpec, name: Literal["truth", "model"]) -> SensorSuite:
    """Return the true or assumed sensors and prior of a case.

    Raises
    ------
    MapError
        If the model needs the standard error of the map, but the map states none.
    """
    suite = suite_of(
        case.side(name),
        case.altimeter,
        truth=case.truth if name == "truth" else None,
        # Of both sides, so that the bound is that of an estimator which knows as much of it.
        disturbance=case.model.disturbance,
        compensates=case.model.field.compensate,
    )
    if name == "truth" or not case.model.field.standard_error:
        return suite
    assert suite.gradiometer is not None  # the scenario checks it
    error = channel_errors(case.side("model").field, suite.gradiometer.components)
    return replace(suite, map_error=error)


def suite_of(
    side: Side,
    altimeter: AltimeterSpec | None = None,
    truth: TruthSpec | None = None,
    disturbance: DisturbanceSpec | None = None,
    compensates: bool = False,
) -> SensorSuite:
    """Return the sensors and prior that tables describe.

    Parameters
    ----------
    side : tables of sensors and prior.
    altimeter : altimeter that damps the mechanization, or None.
    truth : further errors of the true sensors; None for assumed sensors.
    disturbance : table of the gravity disturbance unknown to the INS; None if it is no state.
    compensates : whether the mechanization adds the gravity disturbance of its map.

    Raises
    ------
    GGBenchError
        If gradients are integrated but the gradiometer does not measure the whole tensor.
    """
    damping = None
    if altimeter is not None:
        gains = altimeter_gains(altimeter.time_constant_s)
        damping = gains, altimeter.noise_m_per_sqrt_hz**2
    errors = TrueImu() if truth is None else truth.imu
    gradiometer = None if side.gradiometer is None else gradiometer_of(side.gradiometer)
    return SensorSuite(
        imu=imu_of(side.imu, errors),
        gradiometer=gradiometer,
        aiding=sensors_of_side(side, truth),
        initial_error=side.initial_error,
        altimeter=damping,
        disturbance=gravity_state(disturbance, gradiometer),
        compensates=compensates,
    )
