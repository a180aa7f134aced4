"""Noise parameters of inertial sensors from the Allan deviation of a static log.

The noise model is white noise plus a first-order Gauss–Markov bias, as in ``[imu]``. The Allan
variance of this model (IEEE Std 952-1997, annex C) is fitted to the Allan variance of the log,
averaged over the three axes.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from ..gravity.ellipsoid import ROTATION_RATE
from ..spec.flight import FlightError
from . import columns as files
from .inertial import DELTAS, RATES, force_hint
from .time_base import USUAL_GAP, clocked, missing_rows

_FEWEST_SAMPLES = 1000
_MOST_LOST = 3
"""Largest number of consecutive missing samples that are skipped; a longer gap ends a piece."""
_MOST_LOST_SHARE = 0.1
"""Largest allowed fraction of missing samples."""
_SLOWEST = 0.5
"""Median step from which on the unit of times is doubtful [s]; all IMUs are faster."""
_GRAVITY, _GRAVITY_SLIP = 9.80665, 0.5
"""Specific force at rest, and largest deviation of a mean from it [m/s²]."""
_LARGEST_FORCE = 1000.0
"""Largest possible specific force of a sample [m/s²]; also the limit of angular rates [rad/s]."""
_EARTH_SLIP = 0.05
"""Largest relative deviation of a mean angular rate that is identified as the Earth rate."""
_MOST_MOTION = 0.5
"""Largest deviation of the mean over one second from the mean of a log at rest [m/s²]."""
_LONGEST = 9.0
"""Smallest ratio of the duration of a log to the averaging time."""
_FLICKER = 0.664
"""Ratio of the minimum Allan deviation of flicker noise to its coefficient B (IEEE Std 952)."""
_GAIN = 25.0
"""Smallest decrease of chi-squared for which a Gauss–Markov bias counts as detected."""


@dataclass(frozen=True)
class SensorNoise:
    """Noise parameters of three equal sensors, in SI units.

    Attributes
    ----------
    white : root PSD of the white noise [unit/√Hz].
    bias : standard deviation of the Gauss–Markov bias [unit]; 0 if no bias was detected.
    time : correlation time of the bias [s], at most the duration of the log; ∞ without a bias.
    instability : least Allan deviation divided by 0.664 [unit], an upper limit of flicker noise.
    """

    white: float
    bias: float
    time: float
    instability: float


@dataclass(frozen=True)
class ImuNoise:
    """Noise parameters of an IMU, from a static log.

    Attributes
    ----------
    period, duration : interval and total duration of the samples that are used [s].
    gyros, accelerometers : noise parameters; the units are rad/s and m/s².
    remarks : remarks on jitter of the times, on gaps and on missing samples.
    doubts : warnings about the unit of the angular rates.
    """

    period: float
    duration: float
    gyros: SensorNoise
    accelerometers: SensorNoise
    remarks: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


def imu_noise(path: Path, names: str | Mapping[str, str] | None = None) -> ImuNoise:
    """Return the noise parameters of an IMU from a static log.

    The file is CSV or netCDF with ``time_s`` and rates or increments, as in ``[imu_record]``.
    ``names`` maps standard column names to those of the file. It may also be the name of a preset,
    see :func:`.column_names.find`. Gaps of up to three missing samples are skipped. If there are
    longer gaps, only the longest piece between them is used.

    Raises FlightError if the file cannot be read, is too short, has too many gaps, or the IMU was
    not at rest.
    """
    columns = files.read(path, (), (*RATES, *DELTAS), names=names)
    quantities = next(
        (names for names in (RATES, DELTAS) if all(n in columns for n in names)), None
    )
    if quantities is None:
        raise FlightError(
            f"{path}: needs all columns {', '.join(RATES)}, or {', '.join(DELTAS)}; name other "
            "columns with --column or --preset"
        )
    if columns.rows > 1:
        _require_seconds(columns, columns["time_s"])
    times = clocked(columns, 0.0)
    if len(times) < _FEWEST_SAMPLES:
        raise FlightError(
            f"{path}: has {len(times)} samples; at least {_FEWEST_SAMPLES} are needed"
        )
    if quantities is RATES:
        _require_possible(columns)
    readings, period, remarks = _evenly(columns, times, columns.stacked(quantities))
    if quantities is DELTAS:
        readings = readings / period
    _require_rest(path, readings[:, 3:], period, quantities is DELTAS)
    try:
        gyros, accelerometers = (_noise(readings[:, 3 * i : 3 * i + 3], period) for i in range(2))
    except FlightError as error:
        raise columns.error(str(error)) from None
    doubts = tuple(_gyro_doubts(readings[:, :3]))
    return ImuNoise(period, period * len(readings), gyros, accelerometers, remarks, doubts)


def _require_possible(columns: files.Columns) -> None:
    """Raise FlightError if a row has impossible values, such as codes for missing values.

    Rows are checked only if the median specific force is that of rest. Otherwise the unit is wrong,
    and :func:`_require_rest` raises another error.
    """
    usual = float(np.median(np.linalg.norm(columns.stacked(RATES[3:]), axis=1)))
    if abs(usual - _GRAVITY) <= _GRAVITY_SLIP:
        columns.require_within(dict.fromkeys(RATES, (-_LARGEST_FORCE, _LARGEST_FORCE)))


def _require_seconds(columns: files.Columns, times: np.ndarray) -> None:
    """Raise FlightError if the times of a log are not in seconds, as their steps indicate."""
    step = float(np.median(np.diff(times)))
    if step < _SLOWEST or columns.states_unit("time_s"):
        return
    units = [("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)]
    unit, factor = next((u, f) for u, f in units if f * step < _SLOWEST or f == units[-1][1])
    raise columns.error(
        f"the median interval of its samples is {step:.6g} s, too long for an IMU: state the unit "
        f"of the times. With --column 'time_s=time_s [{unit}]' the interval is "
        f"{factor * step:.3g} s; if the times are in seconds, give [s]"
    )


def _evenly(
    columns: files.Columns, times: np.ndarray, readings: np.ndarray
) -> tuple[np.ndarray, float, tuple[str, ...]]:
    """Return measurements (n, 6) without long gaps, their period [s], and remarks.

    Gaps of up to three missing samples are skipped: the samples before and after a gap follow each
    other. They are not interpolated, because interpolated samples have less noise. Of the pieces
    between longer gaps the longest is used.

    Raises FlightError if too many samples are missing, or the longest piece is too short.
    """
    steps = np.diff(times)
    usual = float(np.median(steps))
    missing_at = missing_rows(steps, _MOST_LOST)
    if steps.max() > USUAL_GAP * usual and not missing_at.any():
        remark = (
            f"times jitter by up to {np.abs(steps - usual).max():.3g} s: a constant interval is "
            "assumed"
        )
        return readings, float((times[-1] - times[0]) / len(steps)), (remark,)
    ends = np.flatnonzero(missing_at > _MOST_LOST) + 1
    pieces = np.split(np.arange(len(times)), ends)
    rows = max(pieces, key=len)
    remarks = []
    if len(pieces) > 1:
        remarks.append(
            f"{len(pieces) - 1} gap{'s' if len(pieces) > 2 else ''} of up to {steps.max():.6g} s: "
            f"only the longest gap-free piece is used, from {times[rows[0]]:.10g} s to "
            f"{times[rows[-1]]:.10g} s"
        )
    if len(rows) < _FEWEST_SAMPLES:
        raise columns.error(
            f"its longest part without gaps has {len(rows)} samples; an Allan deviation needs at "
            f"least {_FEWEST_SAMPLES}"
        )
    missing = missing_at[rows[:-1]]
    if missing.sum() > _MOST_LOST_SHARE * len(rows):
        row = int(rows[np.argmax(missing > 0)]) + 1
        raise columns.error(
            f"comes {steps[row - 1]:g} s after the row before (median step {usual:g} s), and "
            f"{missing.sum() / len(rows):.0%} of the samples are missing: for an Allan deviation "
            f"at most {_MOST_LOST_SHARE:.0%} may be missing",
            row,
        )
    if missing.any():
        remarks.append(f"{missing.sum()} missing samples are skipped")
    period = float((times[rows[-1]] - times[rows[0]]) / (len(rows) - 1 + missing.sum()))
    return readings[rows], period, tuple(remarks)


def _gyro_doubts(rates: np.ndarray) -> Iterator[str]:
    """Yield a warning if the mean angular rate (N, 3) is the Earth rate in deg/s or deg/h.

    At rest, gyros with a small bias measure the Earth rate.
    """
    rate = float(np.linalg.norm(rates.mean(axis=0)))
    for unit, factor in (("deg/s", math.degrees(1.0)), ("deg/h", math.degrees(3600.0))):
        if abs(rate / (factor * ROTATION_RATE) - 1.0) < _EARTH_SLIP:
            yield (
                f"the mean angular rate is {rate:.4g} rad/s, which is the Earth's rotation in "
                f"{unit}: state the unit, as in --column "
                f"'angular_rate_x_radps=angular_rate_x_radps [{unit}]'"
            )


def _require_rest(path: Path, forces: np.ndarray, period: float, increments: bool) -> None:
    """Raise FlightError if specific forces (N, 3) are not those of a log at rest."""
    mean = forces.mean(axis=0)
    size = float(np.linalg.norm(mean))
    if abs(size - _GRAVITY) > _GRAVITY_SLIP:
        raise FlightError(
            f"{path}: the mean specific force is {size:.4g} m/s², but at rest it is "
            f"{_GRAVITY:.4g} m/s²: check the unit{force_hint(size, period, increments)}"
        )
    second = max(round(1.0 / period), 1)
    count = len(forces) // second
    means = forces[: count * second].reshape(count, second, 3).mean(axis=1)
    worst = float(np.linalg.norm(means - mean, axis=1).max())
    if worst > _MOST_MOTION:
        raise FlightError(
            f"{path}: is not at rest: the mean specific force over one second deviates by "
            f"{worst:.2g} m/s²; cut the log to the part at rest"
        )


def _noise(readings: np.ndarray, period: float) -> SensorNoise:
    """Return the noise of three sensors from their readings (N, 3).

    Raises FlightError if the readings of an axis are constant or not finite.
    """
    if (readings == readings[0]).all(axis=0).any():
        axes = ", ".join("xyz"[n] for n in np.flatnonzero((readings == readings[0]).all(axis=0)))
        raise FlightError(
            f"the measurements of the gyros or accelerometers are constant on axis {axes}: their "
            "noise cannot be estimated"
        )
    duration = period * len(readings)
    taus, deviations = _allan(readings, period)
    if not (np.isfinite(deviations).all() and (deviations > 0.0).all()):
        raise FlightError(
            "the Allan deviation of the gyros or accelerometers is zero or not finite: check for "
            "constant or missing measurements"
        )
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
    best = min(fits, key=lambda fit: float(fit.cost))
    if 2.0 * (alone.cost - best.cost) < _GAIN:
        return SensorNoise(float(np.exp(alone.x[0])), 0.0, math.inf, lowest / _FLICKER)
    fitted_white, bias, time = np.exp(best.x).tolist()
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
    """Return the Allan variance (n,) of white noise plus a first-order Gauss–Markov process.

    ``parameters`` are the natural logarithms of root PSD, standard deviation and correlation time.
    ``taus`` (n,) are averaging times [s].
    """
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
