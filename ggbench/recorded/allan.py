"""Noise of inertial sensors from the Allan deviation of a log at rest.

A sensor's noise is taken as white plus a first-order Gauss–Markov bias, which are the keys of
``[imu]``. Their Allan variance (IEEE Std 952-1997, annex C) is fitted to that of the log, the mean
over the three axes.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from ..spec.flight import FlightError
from . import columns as files
from .inertial import DELTAS, RATES
from .time_base import clocked

_FEWEST_SAMPLES = 1000
_LARGEST_JITTER = 0.5
"""Of a step, over the median step: beyond it there is a gap."""
_GRAVITY, _GRAVITY_SLIP = 9.80665, 0.5
"""Specific force at rest, and how far a mean may be from it [m/s²]."""
_MOST_MOTION = 0.5
"""How far the mean of a second may be from that of the log [m/s²]."""
_LONGEST = 9.0
"""Averages are of at most the log's duration over this."""
_FLICKER = 0.664
"""Least Allan deviation of flicker noise, over its coefficient (IEEE Std 952-1997, B)."""
_GAIN = 25.0
"""By how much a Gauss–Markov bias must lower chi-squared, to be seen at all."""


@dataclass(frozen=True)
class SensorNoise:
    """Noise of three equal sensors, in SI units.

    Attributes
    ----------
    white : root PSD of the white noise [unit/√Hz].
    bias : σ of the bias that changes, a Gauss–Markov process [unit]; 0 if none is seen.
    time : its correlation time [s]; ∞ if none is seen, the duration if it is not shorter.
    instability : least Allan deviation over 0.664 [unit]; no larger flicker noise is there.
    """

    white: float
    bias: float
    time: float
    instability: float


@dataclass(frozen=True)
class ImuNoise:
    """What a log at rest says of an IMU: period and duration [s], gyros [rad/s], forces [m/s²]."""

    period: float
    duration: float
    gyros: SensorNoise
    accelerometers: SensorNoise


def imu_noise(path: Path) -> ImuNoise:
    """Return the noise of the sensors of a log at rest.

    The file is CSV or netCDF with ``time_s`` and rates or increments, as of ``[imu_record]``.

    Raises FlightError if the file cannot be read, is short, has gaps, or is not at rest.
    """
    columns = files.read(path, (), (*RATES, *DELTAS))
    wanted = next((names for names in (RATES, DELTAS) if all(n in columns for n in names)), None)
    if wanted is None:
        raise FlightError(
            f"{path}: needs all of the columns {', '.join(RATES)}, or {', '.join(DELTAS)}"
        )
    times = clocked(columns, 0.0)
    if len(times) < _FEWEST_SAMPLES:
        raise FlightError(
            f"{path}: has {len(times)} samples; at least {_FEWEST_SAMPLES} are needed"
        )
    steps = np.diff(times)
    period = float(np.median(steps))
    if (np.abs(steps - period) > _LARGEST_JITTER * period).any():
        row = int(np.argmax(np.abs(steps - period) > _LARGEST_JITTER * period)) + 1
        raise columns.error(
            f"comes {steps[row - 1]:g} s after the row before, and the median step is {period:g} "
            "s: an Allan deviation needs samples without gaps",
            row,
        )
    period = float((times[-1] - times[0]) / (len(times) - 1))
    readings = columns.stacked(wanted) / (period if wanted is DELTAS else 1.0)
    _require_rest(path, readings[:, 3:], period)
    gyros, accelerometers = (_noise(readings[:, 3 * i : 3 * i + 3], period) for i in range(2))
    return ImuNoise(period, period * len(times), gyros, accelerometers)


def _require_rest(path: Path, forces: np.ndarray, period: float) -> None:
    """Raise FlightError if specific forces (N, 3) are not those of a log at rest."""
    mean = forces.mean(axis=0)
    size = float(np.linalg.norm(mean))
    if abs(size - _GRAVITY) > _GRAVITY_SLIP:
        raise FlightError(
            f"{path}: the mean specific force is {size:.4g} m/s², and at rest it is "
            f"{_GRAVITY:.4g} m/s²: is it in other units?"
        )
    second = max(round(1.0 / period), 1)
    count = len(forces) // second
    means = forces[: count * second].reshape(count, second, 3).mean(axis=1)
    worst = float(np.linalg.norm(means - mean, axis=1).max())
    if worst > _MOST_MOTION:
        raise FlightError(
            f"{path}: is not at rest: the mean specific force of a second is off by "
            f"{worst:.2g} m/s²; cut the log to where the IMU lies still"
        )


def _noise(readings: np.ndarray, period: float) -> SensorNoise:
    """Return the noise of three sensors from their readings (N, 3)."""
    duration = period * len(readings)
    taus, deviations = _allan(readings, period)
    # Overlapping averages of three axes: about so many are independent.
    weights = np.sqrt(2.0 * 3.0 * (duration / taus - 1.0))
    white = float(np.exp(np.mean(np.log(deviations[:3] * np.sqrt(taus[:3])))))
    lowest = float(deviations.min())

    def residuals(parameters: np.ndarray) -> np.ndarray:
        return np.asarray(
            weights * (0.5 * np.log(_variance(parameters, taus)) - np.log(deviations))
        )

    alone = least_squares(lambda p: residuals(np.array([p[0], -80.0, 0.0])), [math.log(white)])
    limits = math.log(5.0 * period), math.log(duration)
    starts = (
        [math.log(white), math.log(lowest), math.log(taus[int(deviations.argmin())] * factor)]
        for factor in (1.0, 3.0)
    )
    fits = [
        least_squares(
            residuals,
            [w, b, min(max(t, limits[0] + 1e-6), limits[1] - 1e-6)],
            bounds=([-np.inf, -np.inf, limits[0]], [np.inf, np.inf, limits[1]]),
        )
        for w, b, t in starts
    ]
    found = min(fits, key=lambda fit: float(fit.cost))
    if 2.0 * (alone.cost - found.cost) < _GAIN:
        return SensorNoise(float(np.exp(alone.x[0])), 0.0, math.inf, lowest / _FLICKER)
    fitted_white, bias, time = np.exp(found.x).tolist()
    return SensorNoise(fitted_white, bias, time, lowest / _FLICKER)


def _allan(readings: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Return averaging times (n,) [s] and overlapping Allan deviations (n,), mean of the axes."""
    tool = _allantools()
    longest = len(readings) / _LONGEST
    sizes = np.unique(np.geomspace(1.0, longest, 40).round().astype(int))
    variances = []
    for axis in range(3):
        taus, deviations, *_ = tool.oadev(
            readings[:, axis], rate=1.0 / period, data_type="freq", taus=sizes * period
        )
        variances.append(deviations**2)
    return np.asarray(taus), np.sqrt(np.mean(variances, axis=0))


def _variance(parameters: np.ndarray, taus: np.ndarray) -> np.ndarray:
    """Return the Allan variance (n,) of white noise and a Gauss–Markov process, of logarithms."""
    white, bias, time = np.exp(parameters)
    r = taus / time
    # 2 σ² (T/τ) [1 − (T/2τ)(3 − 4 e^(−τ/T) + e^(−2τ/T))]; for small r the bracket is r²/3 − r³/4.
    bracket = np.where(
        r < 1e-3,
        r**2 / 3.0 - r**3 / 4.0,
        1.0 - (3.0 - 4.0 * np.exp(-r) + np.exp(-2.0 * r)) / (2.0 * np.maximum(r, 1e-3)),
    )
    return np.asarray(white**2 / taus + 2.0 * bias**2 * bracket / r)


def _allantools() -> Any:
    try:
        return importlib.import_module("allantools")
    except ImportError as error:
        raise FlightError(
            f"an Allan deviation needs the package allantools ({error}): pip install "
            "'ggbench[allan]'"
        ) from None
