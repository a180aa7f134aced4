"""Detection of the axes, unit and normal-field convention of a gradiometer record.

Measurements are compared with the map at the INS positions. The comparison is made for each of
eight conventions of the axes, with the units E and s⁻². The mean difference is subtracted.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..maps.survey_lines import CONVENTIONS, Turn, axes_in_words, turned
from ..problem import Problem, predict_along
from ..simulation.instruments import gradiometer_of
from ..spec.gradiometer import GradiometerSpec
from .flight import RecordedFlight
from .normal_field import normal_readings

_FITS = 0.5
"""Largest ratio of residual to signal of the map, both RMS, of a convention that fits."""
_BETTER = 0.5
"""Largest ratio of the residual of a better convention to that of the unchanged record."""
_SI = 1e9
"""Conversion factor from s⁻² to E."""
_SAME_MEAN = 3.0
"""Largest ratio of RMS with mean to RMS without mean, for a negligible mean."""
_FEWEST = 20
_DIRECTIONS = {
    "local-level": ("east", "north", "up", "west", "south", "down"),
    "strapdown": ("right", "forward", "up", "left", "back", "down"),
}
"""Names of the directions x, y, z of a mount, then of the opposite directions."""


class Convention(NamedTuple):
    """Convention of a gradiometer record.

    Attributes
    ----------
    turn : axis and sign in the record for each axis, by name of the axis.
    factor : conversion factor from the unit of the record to E.
    lacks : part that the record excludes, "the normal field" or "its mean"; "" for none.
    after : RMS difference [E] between the record, read in this convention, and the map. The mean
        difference of each channel is subtracted before the RMS is taken.
    before : RMS difference [E] between the unchanged record and the map. No mean is subtracted.
    """

    turn: Turn
    factor: float
    lacks: str
    after: float
    before: float


def gradient_convention(flight: RecordedFlight) -> Convention | None:
    """Return the convention with which a gradiometer record fits the map best, or None.

    The result is None unless this convention fits the map and at least halves the residual of the
    unchanged record. It is also None without a gradiometer, with a low-pass filter, or with
    too few measurements.
    """
    problem, spec = flight.problem, flight.spec.gradiometer
    if spec is None or spec.filter != "none" or problem.track is None:
        return None
    names, read, mapped, normal = _compared(problem, spec)
    if len(read) < _FEWEST:
        return None
    disturbing = mapped - normal
    signal = _rms(disturbing - disturbing.mean(axis=0))
    before = _rms(read - mapped)
    candidates: list[tuple[float, Turn, float]] = []
    for factor in (1.0, _SI):
        for turn in CONVENTIONS:
            expected = _turned(mapped, names, turn)
            if expected is not None:
                apart = factor * read - expected
                candidates.append((_rms(apart - apart.mean(axis=0)), turn, factor))
    after, turn, factor = min(candidates, key=lambda each: each[0])
    own = next(rms for rms, t, f in candidates if t is CONVENTIONS[0] and f == 1.0)
    if own <= after / _BETTER:  # as good as any: the axes are ours
        after, turn, factor = own, CONVENTIONS[0], 1.0
    expected, normal_turned = _turned(mapped, names, turn), _turned(normal, names, turn)
    assert expected is not None and normal_turned is not None
    means = {
        "": factor * read - expected,
        "the normal field": factor * read - (expected - normal_turned),
    }
    lacks = next(
        (words for words, apart in means.items() if _rms(apart) < _SAME_MEAN * max(after, 1e-12)),
        "its mean",
    )
    if after > _FITS * signal or after > _BETTER * before:
        return None
    return Convention(turn, factor, lacks, after, before)


def in_words(convention: Convention, instrument: str) -> str:
    """Return a convention in words, as part of a sentence.

    ``instrument`` is the mount of the gradiometer, for example ``strapdown``.
    """
    parts = []
    if convention.turn is not CONVENTIONS[0] and instrument in _DIRECTIONS:
        parts.append(f"in axes {axes_in_words(convention.turn, _DIRECTIONS[instrument])}")
    elif convention.turn is not CONVENTIONS[0]:
        reverse = [axis for axis, (_, sign) in convention.turn.items() if sign < 0]
        changes = ["x and y exchanged"] if convention.turn["x"][0] == "y" else []
        parts.append(f"with {' and '.join([*changes, *(f'{a} reversed' for a in reverse)])}")
    if convention.factor != 1.0:
        parts.append("as values in s⁻² (1 s⁻² = 1e9 E)")
    if convention.lacks == "the normal field":
        parts.append('as values of the disturbing field (readings = "disturbing")')
    elif convention.lacks:
        parts.append("with the mean difference of each channel removed")
    return " and ".join(parts)


def _compared(
    problem: Problem, spec: GradiometerSpec
) -> tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray]:
    """Return channel names, and measurements, total and normal field at the INS (N, g) [E]."""
    assert problem.track is not None
    own = [j for j, channel in enumerate(problem.channels) if channel.sensor == "gradiometer"]
    there = np.flatnonzero(problem.present[:, own].all(axis=1))
    instrument = gradiometer_of(spec)
    model = predict_along(problem.model, there, np.zeros((len(there), problem.dimension)))
    normal = normal_readings(
        spec.instrument,
        problem.track.positions[there],
        problem.times[there],
        problem.track.attitudes[there],
    )
    read = problem.measurements[there][:, own]
    return instrument.components, read, model[:, own], normal @ instrument.channels.T


def _turned(values: np.ndarray, names: tuple[str, ...], turn: Turn) -> np.ndarray | None:
    """Return channels (N, g) in other axes; None if a required channel is missing."""
    columns = []
    for name in names:
        other, sign = turned(name, turn)
        if other not in names:
            return None
        columns.append(sign * values[:, names.index(other)])
    return np.stack(columns, axis=-1)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
