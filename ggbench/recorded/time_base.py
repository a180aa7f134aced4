"""Time base of a recorded flight: times of the INS samples, and assignment of measurements."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..trajectory.csv_text import rollover
from .columns import Columns

USUAL_GAP = 1.5
"""Default of the longest interval between two samples, in periods."""
_USUAL_TOLERANCE = 0.1
"""Default of the largest time between a measurement and its sample, in periods."""
_EXACT = 1e-6
"""Tolerance for times that lie exactly on samples, in periods."""
_LONGEST = 1e10
"""Largest time of a clock in seconds [s]; larger numbers are in a shorter unit."""
_SHORTER = (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
"""Shorter units of clocks, with their factors to seconds."""
_PERIOD_SLIP = 0.2
"""Largest relative difference between the median interval and the stated period."""


@dataclass(frozen=True)
class TimeBase:
    """Times of the INS samples on the INS clock: ``start`` + n ``dt`` [s], n = 0..``count``.

    ``tolerance`` is the largest time difference between a measurement and its INS sample [s].
    ``lost`` is the number of missing rows, which are interpolated. ``longest_gap`` is the longest
    interval between two successive rows with missing rows between them [s].
    """

    start: float
    dt: float
    count: int
    tolerance: float
    lost: int = 0
    longest_gap: float = 0.0

    @property
    def times(self) -> np.ndarray:
        """Times (count + 1,) of the samples since ``start`` [s]."""
        return self.dt * np.arange(self.count + 1)

    def samples_of(
        self, columns: Columns, times: np.ndarray, outside: Literal["refuse", "drop"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Assign measurements to INS samples; return the indices of the samples and of the rows.

        ``times`` (N,) are the times of the rows on the INS clock [s]. The first sample is the time
        of the prior and has no measurement. ``outside`` states whether measurements before or after
        the INS record are dropped.

        Raises FlightError if a measurement lies outside the INS record and is not dropped, or if no
        measurement remains. The error is also raised if a measurement lies too far from a sample,
        or if two measurements belong to the same sample.
        """
        since = times - self.start
        nearest = np.rint(since / self.dt).astype(np.int64)
        rows = np.arange(len(times))
        off = (nearest < 1) | (nearest > self.count)
        if off.any():
            if outside == "refuse":
                row = int(off.argmax())
                raise columns.error(
                    f"time {times[row]:.16g} s lies outside the record of the INS, which begins at "
                    f"{self.start:.16g} s (excluded) and ends at "
                    f"{self.start + self.dt * self.count:.16g} s; {np.count_nonzero(off)} of "
                    f"{len(times)} measurements are outside. Set clock_offset_s if the clocks "
                    'differ, or outside = "drop" to omit these measurements',
                    row,
                )
            nearest, rows, since = nearest[~off], rows[~off], since[~off]
            if not len(rows):
                raise columns.error(
                    "no measurement lies within the record of the INS: if the clocks differ, "
                    "correct the times of this file with clock_offset_s"
                )
        apart = np.abs(since - nearest * self.dt)
        if (apart > self.tolerance * (1.0 + _EXACT)).any():
            worst = int(apart.argmax())
            raise columns.error(
                f"time {times[rows[worst]]:.16g} s is {apart[worst]:.3g} s away from the nearest "
                f"sample of the INS; at most {self.tolerance:.3g} s is allowed: increase "
                "time_tolerance_s of the table of the INS (up to half a sample, "
                f"{0.5 * self.dt:.3g} s), or set clock_offset_s if the clocks differ",
                int(rows[worst]),
            )
        same = np.flatnonzero(np.diff(nearest) == 0)
        if len(same):
            raise columns.error(
                f"two measurements, at {times[rows[same[0]]]:.16g} s and "
                f"{times[rows[same[0] + 1]]:.16g} s, belong to the same sample of the INS",
                int(rows[same[0] + 1]),
            )
        return nearest, rows


def clocked(columns: Columns, offset: float) -> np.ndarray:
    """Return the times (N,) of a file's rows on the INS clock [s].

    ``offset`` [s] is added to the times in the file.

    Raises FlightError if the times do not increase, or are too large to be in seconds.
    """
    times = columns["time_s"]
    off = np.abs(times) > _LONGEST
    if off.any():
        row = int(off.argmax())
        size = abs(float(times[row]))
        unit = next((u for u, factor in _SHORTER if factor * size < _LONGEST), "")
        hint = f': if it is in {unit}, give columns = {{ time_s = "time_s [{unit}]" }}'
        raise columns.error(
            f"time_s is {times[row]:g} and must lie between {-_LONGEST:g} and {_LONGEST:g} s"
            f"{hint if unit else ''}",
            row,
        )
    steps = np.diff(times)
    if (steps <= 0.0).any():
        row = int((steps <= 0.0).argmax()) + 1
        kind = (
            "occurs twice" if steps[row - 1] == 0.0 else "is less than the time of the row before"
        )
        raise columns.error(
            f"time {times[row]:.16g} s {kind}"
            + ("" if steps[row - 1] == 0.0 else f", {times[row - 1]:.16g} s")
            + f"; times must increase{rollover(times[row - 1], times[row])}",
            row,
        )
    return np.asarray(times + offset)


def require_period(
    columns: Columns, times: np.ndarray, period: float, rows: str, table: str
) -> float:
    """Return the median interval of times (N,) [s].

    Raise FlightError if the median differs from the stated ``period`` [s] by more than a fifth of
    the period. ``rows`` and ``table`` are words for the message: the rows of the file, and the
    table that states the period.
    """
    usual = float(np.median(np.diff(times)))
    if abs(usual - period) > _PERIOD_SLIP * period:
        raise columns.error(
            f"its {rows} are {usual:.6g} s apart (median), but {table}.period_s is {period:g} s; "
            "time_s must be in seconds"
        )
    return usual


def time_base(
    columns: Columns,
    times: np.ndarray,
    dt: float,
    max_gap: float | None,
    tolerance: float | None,
    before: int = 0,
) -> tuple[TimeBase, bool]:
    """Return the time base of an INS record, and whether the rows lie exactly on the samples.

    Rows that do not lie on the samples must be interpolated.

    Parameters
    ----------
    columns : columns of the file.
    times : (N,) times of the rows [s].
    dt : interval of the samples [s].
    max_gap : longest allowed interval between two rows [s]. None: 1.5 times the larger of ``dt``
        and the median interval.
    tolerance : largest allowed time difference between a measurement and its sample [s], limited to
        0.5 ``dt``. None: 0.1 ``dt``.
    before : number of samples before the first row; 1 for increments, whose rows are at the ends of
        their intervals.

    Raises
    ------
    FlightError
        If an interval is longer than ``max_gap``; if the median interval differs from ``dt`` by
        more than a fifth; if there are fewer than three rows.
    """
    if len(times) < 3:
        raise columns.error(f"has {len(times)} rows; a record of an INS needs at least 3")
    steps = np.diff(times)
    usual = require_period(columns, times, dt, "rows", "imu")
    longest = USUAL_GAP * max(dt, usual) if max_gap is None else max_gap
    if steps.max() > longest:
        row = int(steps.argmax()) + 1
        raise columns.error(
            f"there is a gap of {steps.max():.6g} s before time {times[row]:.16g} s; at most "
            f"{longest:.6g} s (max_gap_s) is allowed, because the INS is interpolated across gaps",
            row,
        )
    start = float(times[0]) - before * dt
    count = round((float(times[-1]) - start) / dt)
    allowed = min(_USUAL_TOLERANCE * dt if tolerance is None else tolerance, 0.5 * dt)
    exact = len(times) == count + 1 - before and bool(
        np.abs(times - start - dt * np.arange(before, count + 1)).max() <= _EXACT * dt
    )
    if not exact:
        # Nothing is extrapolated: the last sample lies within the record.
        count = int(np.floor((float(times[-1]) - start) / dt + _EXACT))
    missing = missing_rows(steps)
    longest = float(steps[missing > 0].max(initial=0.0))
    return TimeBase(start, dt, count, allowed, int(missing.sum()), longest), exact


def missing_rows(steps: np.ndarray, most: int = 1) -> np.ndarray:
    """Return the number (N,) of missing rows in each of the N intervals of a record.

    An interval may be long only because its times jitter. Then short intervals compensate it. If
    short intervals compensate most of the long ones, the result is zero for all intervals.

    Parameters
    ----------
    steps : (N,) intervals [s].
    most : largest number of rows that jitter can make appear missing in an interval. If an interval
        seems to lack more rows, the cause is not jitter.
    """
    usual = float(np.median(steps))
    missing = np.where(steps > USUAL_GAP * usual, np.rint(steps / usual) - 1.0, 0.0)
    surplus = float(steps.sum() / usual - len(steps))
    if surplus < 0.5 * missing.sum() and missing.max() <= most:
        missing[:] = 0.0
    return missing.astype(np.int64)
