"""Warnings about a recorded flight: large innovations, clocks, reference track."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..problem import Problem
from ..sensors.aiding import position_error
from ..spec.aiding import RecordedGnss
from ..spec.named_sensors import table_of
from .corrected import Residuals
from .flight import RecordedFlight

MOST_NIS = 10.0
"""Mean NIS over the expected one beyond which the records contradict one another."""
_FARTHEST = 30
"""Largest offset of a clock that is tried [s]; GPS was ahead of UTC by 18 s from 2017 on."""
_BLOCK = 300.0
"""Time over which the INS's error is taken as a polynomial [s]."""
_BETTER = 0.5
"""Residual over that without an offset from which on an offset is named."""
_FEWEST = 20
"""Readings below which no offset is looked for."""


class ClockFit(NamedTuple):
    """The offset of a receiver's clock that fits the INS best.

    ``offset`` [s] is to be added to its times; ``after`` and ``before`` are RMS residuals with it
    and without, in ``unit``.
    """

    offset: int
    after: float
    before: float
    unit: str


def nis_ratio(problem: Problem, found: Residuals) -> float:
    """Return the mean NIS of a filter over that of a consistent one; NaN of other estimators."""
    counts = problem.present.sum(axis=1)
    if not found.innovations or not counts.any():
        return np.nan
    return float(np.nanmean(found.nis) / counts[counts > 0].mean())


def suspicions(flight: RecordedFlight, residuals: dict[str, Residuals]) -> Iterator[str]:
    """Yield a sentence for each thing that is suspicious, with likely causes.

    ``residuals`` are what the readings say to each estimator, by its label.
    """
    ratios = {label: nis_ratio(flight.problem, found) for label, found in residuals.items()}
    beyond = {label: ratio for label, ratio in ratios.items() if ratio > MOST_NIS}
    for label, ratio in beyond.items():
        yield (
            f"{label}: the mean NIS is {ratio:.3g} times the expected one, so the records "
            "contradict one another or the tables' noise is far too small; likely causes are units "
            "(degrees for radians, knots for m/s), axes or frames, and clocks (18 s is GPS - UTC)"
        )
    for name, table in flight.spec.sensor.items() if beyond else ():
        if isinstance(table, RecordedGnss) and (fit := clock_fit(flight.problem, name)):
            yield (
                f"{table_of(name)}.clock_offset_s = {table.clock_offset_s + fit.offset:g} fits the "
                f"INS best: residuals of {fit.after:.3g} {fit.unit} in place of "
                f"{fit.before:.3g} {fit.unit} with {table.clock_offset_s:g}"
            )


def clock_fit(problem: Problem, sensor: str) -> ClockFit | None:
    """Return the offset in whole seconds that fits a receiver's readings to the INS best.

    Of its velocities if it has them, else of its positions; less what the INS's error makes of
    them in five minutes. None if no offset is clearly better than none, as in straight flight.
    """
    own = [j for j, channel in enumerate(problem.channels) if channel.sensor == sensor]
    velocities = [j for j in own if problem.channels[j].name.startswith("velocity")]
    chosen = velocities or own
    there = problem.present[:, chosen].all(axis=1)
    times = problem.times
    reach = min(_FARTHEST, int((times[-1] - times[0]) / 4.0))
    inside = there & (times >= times[0] + reach) & (times <= times[-1] - reach)
    epochs = np.flatnonzero(inside)
    if len(epochs) < _FEWEST or problem.track is None:
        return None
    read = problem.measurements[epochs][:, chosen]
    rms = {
        offset: _residual(problem, epochs, read, offset, bool(velocities))
        for offset in range(-reach, reach + 1)
    }
    best = min(rms, key=lambda offset: rms[offset])
    if best == 0 or rms[best] > _BETTER * rms[0]:
        return None
    return ClockFit(best, rms[best], rms[0], "m/s" if velocities else "m")


def _residual(
    problem: Problem, epochs: np.ndarray, read: np.ndarray, offset: float, velocities: bool
) -> float:
    """Return the RMS of readings (G, 3) less what the INS indicates ``offset`` seconds later."""
    assert problem.track is not None
    track, times = problem.track, problem.times[epochs]
    indicated = track.velocities if velocities else track.positions
    later = [np.interp(times + offset, problem.times, column) for column in indicated.T]
    found = np.stack(later, axis=-1)
    if velocities:
        apart, degree = read - found, 1
    else:
        apart, degree = read + position_error(track.positions[epochs], found), 2
    blocks = np.array_split(np.arange(len(times)), int((times[-1] - times[0]) // _BLOCK) + 1)
    squares = 0.0
    for block in blocks:
        basis = np.vander((times[block] - times[block].mean()) / _BLOCK, degree + 1)
        fitted = np.linalg.lstsq(basis, apart[block], rcond=None)[0]
        squares += float(np.sum((apart[block] - basis @ fitted) ** 2))
    return float(np.sqrt(squares / len(times)))
