"""Reader of survey lines with measured gradients or gravity, from CSV files.

The first line of the file names the columns. All columns except these are ignored:

- line, kind: name and kind of the survey line,
- time_s, latitude_deg, longitude_deg, height_m: time and position, height above the ellipsoid,
- xx or xx_eotvos, and so on: tensor components in axes east, north, up,
- disturbance or disturbance_mgal: gravity disturbance.

A row is a sample. The rows of a survey line are consecutive, at a constant interval. Measurements
exclude the normal field. An empty cell is a missing measurement. A row in which all gradients are
zero is refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ..files.archives import gunzipped
from ..files.writing import content_of
from ..maps.survey_lines import DISTURBANCE, zero_rows
from ..sensors.gradiometer.instrument import COMPONENTS, DIFFERENCES
from .csv_text import CsvText, status_of
from .manoeuvres import Array, TrajectoryError
from .track import Track, TrackLimits, part_of, track_of
from .track_file import FEWEST_ROWS

_PLACES = ("time_s", "latitude_deg", "longitude_deg", "height_m")
_READINGS = {
    **{name: name for name in (*COMPONENTS, *DIFFERENCES, DISTURBANCE)},
    **{f"{name}_eotvos": name for name in (*COMPONENTS, *DIFFERENCES)},
    f"{DISTURBANCE}_mgal": DISTURBANCE,
}
"""Component of each column of measurements, by name of the column."""
_WANTED = (
    f"line, kind, {', '.join(_PLACES)}, and the measured columns of "
    f"{', '.join(dict.fromkeys(_READINGS.values()))}"
)
_TIMING = 1e-3
"""Largest deviation of a duration from a multiple of the interval [s]."""
_JITTER = 0.05
"""Largest deviation of a sample from a constant interval [intervals]."""
_MOST_NAMED = 12
_LARGEST = {"gradient": 1e5, DISTURBANCE: 2000.0}
"""Largest possible magnitude of gradients [E] and gravity disturbances [mGal]."""
_MARKS = (-9999.0, -9999.9, -9999.99, -9999.999, -99999.0, -999999.0, -32768.0)
"""Common codes for missing values."""


@dataclass(frozen=True)
class SurveyLine:
    """One line of a survey.

    Attributes
    ----------
    name, kind : name and kind of the line, as in the file.
    row : number of the text line with the first sample, counted from 1 in the file.
    places : columns (N,) of times and positions, by name: time_s, latitude_deg, longitude_deg,
        height_m.
    readings : measurements (N,), by component: gradients of the disturbing field, ENU [E], and
        gravity disturbance [mGal]; NaN where missing.
    """

    name: str
    kind: str
    row: int
    places: Mapping[str, Array]
    readings: Mapping[str, Array]

    @property
    def interval(self) -> float:
        """Median time between two samples [s]; clock deviations would affect the mean."""
        return float(np.round(np.median(np.diff(self.places["time_s"])), 6))

    def at_one_interval(self) -> SurveyLine:
        """Return the line with times at a constant interval, without clock deviations.

        Raises TrajectoryError if the interval of the samples is not constant.
        """
        times, interval = self.places["time_s"], self.interval
        even = times[0] + interval * np.arange(len(times))
        off = np.abs(times - even)
        if not interval > 0.0 or off.max() > _JITTER * interval:
            n = int(np.argmax(off > _JITTER * interval))
            raise TrajectoryError(
                f"line {self.row + n}: time_s is {times[n]:.10g}, but the samples of line "
                f"{self.name} must come every {interval:g} s; fill gaps with rows without "
                "measurements"
            )
        return replace(self, places={**self.places, "time_s": even})

    def middle(self, duration: float | None) -> slice:
        """Return the slice of the samples in the middle part of the line.

        ``duration`` [s] is the length of the middle part. If it is None, the slice contains all
        samples.

        Raises TrajectoryError if the line is shorter than the duration, or if the duration is not a
        multiple of the interval.
        """
        count = len(self.places["time_s"]) - 1
        if duration is None:
            return slice(0, count + 1)
        steps = round(duration / self.interval)
        if abs(steps * self.interval - duration) > _TIMING:
            raise TrajectoryError(
                f"middle_s is {duration:g} and must be a multiple of the interval of the samples, "
                f"{self.interval:g} s"
            )
        if steps > count:
            raise TrajectoryError(
                f"line {self.name} lasts {count * self.interval:g} s, but middle_s is {duration:g}"
            )
        first = (count - steps) // 2
        return slice(first, first + steps + 1)

    def track(self, limits: TrackLimits, duration: float | None) -> Track:
        """Return the track of the middle part of the line.

        The smoothing given by ``limits`` is applied to the whole line. ``duration`` [s] is the
        length of the middle part, as in :meth:`middle`.
        """
        whole = track_of(dict(self.places), lambda n: f"line {self.row + n}", limits)
        part, times = self.middle(duration), self.places["time_s"]
        return part_of(whole, times[part.start] - times[0], times[part.stop - 1] - times[0])

    def measured(
        self, components: Sequence[str], duration: float | None, period: float, sensor: str
    ) -> Array:
        """Return the measurements of the middle part of the line, one per ``period`` [s].

        The array (G, m) has G measurement times and m components. ``duration`` is the argument of
        :meth:`middle`. The first measurement is one period after the start of the middle part.
        Missing measurements are NaN. ``sensor`` is the name of the sensor's table in the scenario
        file, for messages.

        Raises TrajectoryError if a component is missing in the file, or if the samples are not at
        multiples of the period.
        """
        for name in components:
            if name not in self.readings:
                raise TrajectoryError(
                    f"has no column {name}, which [{sensor}] needs; its columns: "
                    f"{', '.join(self.readings)}"
                )
        stride = round(period / self.interval)
        if stride < 1 or abs(stride * self.interval - period) > _TIMING:
            raise TrajectoryError(
                f"has a sample every {self.interval:g} s, but {sensor}.period_s is {period:g} "
                "and must be a multiple"
            )
        part = self.middle(duration)
        read = np.stack([self.readings[name] for name in components], axis=-1)
        return np.asarray(read[part][stride::stride])


def read_lines(file: str) -> Mapping[str, SurveyLine]:
    """Return the survey lines of a CSV file, plain or packed with gzip, by name.

    Raises TrajectoryError if the file is invalid; the message states the file, the line, the value
    and the allowed values.
    """
    status = status_of(file, "survey lines")
    try:
        return _read_lines(file, status.st_mtime_ns, status.st_size)
    except TrajectoryError as error:
        raise TrajectoryError(f"survey lines {file}: {error}") from None


@lru_cache(maxsize=4)
def _read_lines(file: str, time: int, size: int) -> Mapping[str, SurveyLine]:
    text = CsvText.of(_unpacked(Path(file)), _WANTED, ("line", "kind", *_PLACES))
    for name in ("line", "kind", *_PLACES):
        if text.names.count(name) != 1:
            raise TrajectoryError(
                f"line {text.line} must name a column {name} once; expected: {_WANTED}"
            )
    components = {_READINGS[name]: at for at, name in enumerate(text.names) if name in _READINGS}
    if not components:
        raise TrajectoryError(
            f"line {text.line} names no column of measurements; expected: {_WANTED}"
        )
    columns = {name: text.names.index(name) for name in _PLACES} | components
    numbers = text.numbers(columns, may_be_empty=frozenset(components))
    for key in components:
        _require_possible(text.first, key, numbers[key])
    _require_no_row_of_zeros(text.first, {key: numbers[key] for key in components})
    cells = [row.split(text.separator) for row in text.rows]
    names, kinds = (
        [row[text.names.index(key)].strip() for row in cells] for key in ("line", "kind")
    )
    lines: dict[str, SurveyLine] = {}
    starts = [n for n in range(len(names)) if n == 0 or names[n] != names[n - 1]]
    for start, stop in zip(starts, [*starts[1:], len(names)], strict=True):
        name, row = names[start], text.first + start
        if name in lines:
            raise TrajectoryError(f"line {row}: the rows of {name} are not consecutive")
        if stop - start < FEWEST_ROWS:
            raise TrajectoryError(
                f"line {row}: {name} has {stop - start} rows; a line needs at least {FEWEST_ROWS}"
            )
        places = {key: numbers[key][start:stop] for key in _PLACES}
        readings = {key: numbers[key][start:stop] for key in components}
        lines[name] = SurveyLine(name, kinds[start], row, places, readings)
    return lines


def _require_possible(first: int, name: str, values: Array) -> None:
    """Raise TrajectoryError if a measurement is a code for a missing value, or is impossible.

    ``first`` is the line number of the first sample.
    """
    limit = _LARGEST[DISTURBANCE if name == DISTURBANCE else "gradient"]
    off = np.isin(values, _MARKS) | (np.abs(values) > limit)
    if off.any():
        n = int(off.argmax())
        raise TrajectoryError(
            f"line {first + n}: {name} is {values[n]:g}, a code for missing values or impossible "
            f"({off.sum()} such rows): leave the cells of missing measurements empty; measurements "
            f"must lie between {-limit:g} and {limit:g}"
        )


def _require_no_row_of_zeros(first: int, readings: Mapping[str, Array]) -> None:
    """Raise TrajectoryError if all gradients of a sample, at least two, are exactly 0.

    Such a row marks missing values. ``first`` is the line number of the first sample.
    """
    gradients = [name for name in readings if name != DISTURBANCE]
    if not gradients:
        return
    zeros = zero_rows(np.column_stack([readings[name] for name in gradients]))
    if zeros.any():
        raise TrajectoryError(
            f"line {first + int(zeros.argmax())}: {', '.join(gradients)} are all 0, in "
            f"{zeros.sum()} of {len(zeros)} rows; leave the cells of missing measurements empty"
        )


def _unpacked(file: Path) -> bytes:
    """Return the content of a file, which may be packed."""
    content = content_of(file, TrajectoryError)
    return gunzipped(content, TrajectoryError, "it") if content[:2] == b"\x1f\x8b" else content


def line_named(file: str, name: str) -> SurveyLine:
    """Return one survey line of a file, with its times corrected to a constant interval.

    Positions and measurements are unchanged.

    Raises TrajectoryError if the file is invalid or does not contain the line. The error is also
    raised if a time deviates by more than 5 % of the interval, for example at a gap.
    """
    lines = read_lines(file)
    if name not in lines:
        named = ", ".join([*lines][:_MOST_NAMED])
        more = f" and {len(lines) - _MOST_NAMED} more" if len(lines) > _MOST_NAMED else ""
        raise TrajectoryError(
            f"survey lines {file}: there is no line '{name}'; its lines: {named}{more}"
        )
    try:
        return lines[name].at_one_interval()
    except TrajectoryError as error:
        raise TrajectoryError(f"survey lines {file}: {error}") from None
