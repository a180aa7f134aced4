"""Variants of the small scenario, and a small map: all that flies in milliseconds."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from problems import SMALL

from ggbench.block import ProblemBlock
from ggbench.gravity.degraded_map import MapDegradation, degrade
from ggbench.gravity.gradient_map import GradientMap
from ggbench.maps.recipe import write
from ggbench.simulation.error_free_flight import Flight, prepare
from ggbench.simulation.runs import Truth
from ggbench.spec import scenario
from ggbench.spec.case import CaseSpec
from ggbench.spec.sensors import FieldSpec, ModelField, TrueField

ROTATING = {
    "gradiometer.noise_eotvos": None,
    "gradiometer.rotating.baseline_m": 0.5,
    "gradiometer.rotating.rotation_hz": 0.5,
    "gradiometer.rotating.accelerometer_noise_ng_per_sqrt_hz": 1.0,
}
"""Changes that make the gradiometer one of three spinning disks; its noise is 28 E."""

ON_BOARD = {
    "gnss.period_s": 1.0,
    "gnss.position_noise_m": 5.0,
    "gnss.height_noise_m": 8.0,
    "gnss.velocity_noise_mps": 0.05,
    "velocity_log.period_s": 2.0,
    "velocity_log.noise_mps": 0.1,
    "velocity_log.bias_mps": 0.2,
    "velocity_log.bias_time_s": 30.0,
    "barometer.period_s": 0.5,
    "barometer.noise_m": 3.0,
    "barometer.bias_m": 5.0,
}
"""Changes that take a receiver, a log and a barometer on board; none of them needs a map."""

SEVERAL = {
    "sensor.stern.kind": "gnss",
    "sensor.stern.period_s": 2.0,
    "sensor.stern.position_noise_m": 2.0,
    "sensor.bow_2.kind": "gnss",
    "sensor.bow_2.period_s": 0.5,
    "sensor.bow_2.velocity_noise_mps": 0.1,
    "sensor.water_track.kind": "velocity_log",
    "sensor.water_track.period_s": 1.0,
    "sensor.water_track.noise_mps": 0.05,
    "sensor.water_track.bias_mps": 0.4,
    "sensor.water_track.bias_time_s": 20.0,
    "sensor.water_track.frame": "local-level",
    "sensor.sea_level.kind": "barometer",
    "sensor.sea_level.period_s": 1.5,
    "sensor.sea_level.noise_m": 1.0,
    "sensor.sea_level.bias_m": 2.0,
}
"""Changes that take two more receivers, a log and a barometer on board, in no order of names."""

GRAVIMETER = {
    "gravimeter.period_s": 1.5,
    "gravimeter.noise_mgal": 1.0,
    "gravimeter.bias_mgal": 0.5,
}

GNSS = {
    "gradiometer": None,
    "gnss.period_s": 1.0,
    "gnss.position_noise_m": 2.0,
    "gnss.velocity_noise_mps": 0.1,
}
"""A receiver without a gradiometer."""
ASKEW = {"trajectory.heading_deg": 37.0, "trajectory.roll_deg": 12.0, "trajectory.pitch_deg": 1.0}
"""Body axes that lie along no others."""
LEVEL = {"gradiometer.instrument": "local-level", "gradiometer.noise_eotvos": 1e-6}
"""An instrument held level, nearly without noise."""
CONSTANT = {
    "field": {"source": "normal", "gravity_disturbance": True},
    "truth.field.constant_disturbance_mgal": [10.0, 20.0, 30.0],
}
"""Gravity that the truth has and the INS does not compensate."""
STATES = {"model.disturbance.horizontal_mgal": 40.0, "model.disturbance.vertical_mgal": 20.0}
INTEGRATED = {
    "model.disturbance.integrate_gradients": True,
    "gradiometer.instrument": "local-level",
}
OUTLIERS = {"truth.gradiometer.outlier_share": 0.2, "truth.gradiometer.outlier_eotvos": 5.0}
TILT = {"truth.gradiometer.tilt_arcmin": 1.0, "truth.gradiometer.tilt_time_s": 5.0}

TINY = {
    "initial_error.position_m": 1e-3,
    "initial_error.velocity_mps": 1e-4,
    "initial_error.attitude_arcmin": 1e-3,
}


QUIET = TINY | {
    "imu.gyro_bias_deg_per_h": 0.0,
    "imu.accelerometer_bias_ug": 0.0,
    "imu.gyro_noise_deg_per_sqrt_h": 0.0,
    "imu.accelerometer_noise_ug_per_sqrt_hz": 0.0,
}
"""Changes that leave an INS with hardly any error."""


def small_case(changes: dict[str, Any] | None = None) -> CaseSpec:
    """The first case of the small scenario with dotted keys changed; None takes a key away."""
    document = tomllib.loads(SMALL)
    document["case"] = document["case"][:1]
    for key, value in (changes or {}).items():
        *tables, last = key.split(".")
        table = document
        for name in tables:
            table = table.setdefault(name, {})
        if value is None:
            table.pop(last)
        else:
            table[last] = value
    return scenario.parse(document, "small", "small").cases[0]


def small_flight(changes: dict[str, Any] | None = None) -> Flight:
    """The flight of :func:`small_case`."""
    return prepare(small_case(changes))


def blank_map(spacing_arcmin: float = 0.5, count: int = 40, layers: int = 6) -> GradientMap:
    """A map of nothing around the small scenario's flight: count x count nodes."""
    step = math.radians(spacing_arcmin / 60.0)
    shape = (count, count, layers)
    return GradientMap(
        latitude0=math.radians(33.5) - 0.5 * count * step,
        longitude0=math.radians(108.0) - 0.4 * count * step,
        height0=9500.0,
        latitude_step=step,
        longitude_step=step,
        height_step=200.0,
        tensor=np.zeros((*shape, 6)),
        gravity_disturbance=np.zeros((*shape, 3)),
        provenance="nothing",
    )


def rough_map(path: Path, seed: int = 1, rms: float = 10.0) -> str:
    """Write a map of a random harmonic field, of 10 E over 3 km, and return its path."""
    degradation = MapDegradation(correlated_noise_eotvos=rms, correlation_m=3000.0, seed=seed)
    write(path, degrade(blank_map(), degradation))
    return str(path)


def over_the_normal_field(case: CaseSpec) -> CaseSpec:
    """The case without any map."""
    return case.model_copy(
        update={
            "field": FieldSpec(source="normal"),
            "truth": case.truth.model_copy(update={"field": TrueField()}),
            "model": case.model.model_copy(update={"field": ModelField()}),
        }
    )


def residuals_at_the_truth(block: ProblemBlock, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """Sum of the squares (m,) that the truth leaves of each channel, over R; how many there are."""
    squares, count = np.zeros(block.measurements.shape[2]), np.zeros(block.measurements.shape[2])
    for run in range(block.runs):
        problem = block.problem(run)
        for k, there in enumerate(problem.present):
            predicted = problem.model.predict(k, truth.error_state[run, k])
            squares += (problem.measurements[k] - predicted) ** 2 / np.diag(problem.noise_cov)
            count += there
    return squares, count
