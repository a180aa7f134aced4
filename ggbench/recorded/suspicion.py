"""Warnings about recorded flights: large innovations, clock offsets, reference track."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter
from scipy.stats import chi2

from ..problem import Problem, predict_along
from ..sensors.aiding import position_error
from ..spec.aiding import RecordedGnss
from ..spec.named_sensors import table_of
from .conventions import gradient_convention, in_words
from .corrected import Residuals
from .flight import RecordedFlight

MOST_NIS = 10.0
"""Ratio of mean NIS to its expected value, above which records contradict each other."""
_FARTHEST = 30
"""Largest tested clock offset [s]; since 2017 GPS time minus UTC is 18 s."""
_BLOCK = 300.0
"""Time over which the INS error is approximated by a polynomial [s]."""
_BETTER = 0.5
"""Largest ratio of residuals with and without a clock offset, for a warning."""
_MOST_MEDIAN = 3.0
"""Largest ratio of median NIS to its expected value, for a filter that fits most measurements."""
_RARE = 1e-6
"""Probability of exceeding the limit of the NIS at one epoch."""
_ROBUST = ("gate=", "loss=")
"""Options in the labels of filters that reject or down-weight outliers."""
_MOST_OUTLIERS = 0.4
"""Largest ratio of rejected measurements to epochs that outliers can explain."""
_WINDOW, _MAD, _ISOLATED = 7, 0.6745, 10.0
"""Window of the running median [epochs]; median of |N(0, 1)|; limit for an outlier [σ]."""
_FEWEST = 20
"""Smallest number of measurements for a clock-offset test."""


class ClockFit(NamedTuple):
    """Clock offset of a receiver that fits the INS best.

    ``offset`` [s] must be added to the receiver's times. ``before`` is the RMS residual
    without the offset, and ``after`` the RMS residual with it. Both are in ``unit``.
    """

    offset: int
    after: float
    before: float
    unit: str


def nis_ratio(problem: Problem, differences: Residuals) -> float:
    """Return the mean NIS of a filter divided by its nominal value; NaN for other estimators."""
    counts = problem.present.sum(axis=1)
    if not differences.innovations or not counts.any():
        return np.nan
    return float(np.nanmean(differences.nis) / counts[counts > 0].mean())


def median_nis_ratio(problem: Problem, differences: Residuals) -> float:
    """Return the median ratio of a filter's NIS to its nominal median; NaN for other estimators.

    The nominal median is that of the chi-squared distribution. A few outliers hardly change the
    result.
    """
    counts = problem.present.sum(axis=1)
    some = np.isfinite(differences.nis) & (counts > 0)
    if not differences.innovations or not some.any():
        return np.nan
    return float(np.median(differences.nis[some] / chi2.median(counts[some])))


def remarks(
    flight: RecordedFlight,
    residuals: Mapping[str, Residuals],
    rejected: Mapping[str, int] = MappingProxyType({}),
) -> Iterator[str]:
    """Yield a remark on each robust filter whose mean NIS is too large only because of outliers.

    ``residuals`` has the residuals or innovations of each estimator, by label. ``rejected`` has the
    number of measurements that filters with a gate have rejected, by label.
    """
    for label, differences in residuals.items():
        if _rejects_most(flight.problem, rejected.get(label, 0)):
            continue
        if nis_ratio(flight.problem, differences) > MOST_NIS and _is_robust(label):
            median = median_nis_ratio(flight.problem, differences)
            if median < _MOST_MEDIAN:
                count, every = _beyond(flight.problem, differences)
                yield (
                    f"{label}: {count} of {every} measurements rejected or down-weighted; the "
                    f"median NIS is {median:.2g} times the expected value"
                )


def suspicions(
    flight: RecordedFlight,
    residuals: Mapping[str, Residuals],
    rejected: Mapping[str, int] = MappingProxyType({}),
) -> Iterator[str]:
    """Yield a warning for each suspected fault of the records, with likely causes.

    ``residuals`` has the residuals or innovations of each estimator, by label. ``rejected`` has the
    number of measurements that filters with a gate have rejected, by label.
    """
    problem = flight.problem
    for label, count in rejected.items():
        if _rejects_most(problem, count):
            yield (
                f"{label}: {count} of {problem.epochs} measurements rejected. Check the gate, the "
                "probability of accepting a correct measurement (usually 0.99). If the gate is "
                "right, the records are inconsistent"
            )
    beyond = {
        label: differences
        for label, differences in residuals.items()
        if nis_ratio(problem, differences) > MOST_NIS
        and not (_is_robust(label) and median_nis_ratio(problem, differences) < _MOST_MEDIAN)
    }
    if not beyond:
        return
    explanations = [*_explanations(flight)]
    # A turn that the clock puts elsewhere has steps that look like outliers.
    isolated = 0 if explanations else isolated_outliers(problem)
    outliers = 0 < isolated <= _MOST_OUTLIERS * problem.epochs
    for label, differences in beyond.items():
        ratio, median = nis_ratio(problem, differences), median_nis_ratio(problem, differences)
        few = median < _MOST_MEDIAN
        if few or outliers:
            count = _beyond(problem, differences)[0] if few else isolated
            yield (
                f"{label}: {count} of {problem.epochs} measurements are outliers (mean NIS "
                f"{ratio:.3g} times the expected value, median {median:.3g}); try a filter that "
                "rejects them, as ekf[gate=0.99], or down-weights them, as ekf[loss=cauchy]"
            )
            continue
        yield (
            f"{label}: the mean NIS is {ratio:.3g} times the expected value: the records are "
            "inconsistent or the noise in the tables is far too small; likely causes are units "
            "(degrees for radians, knots for m/s), axes or frames, and clocks (18 s is GPS - UTC)"
        )
    yield from explanations


def _explanations(flight: RecordedFlight) -> Iterator[str]:
    """Yield a sentence for each convention or clock offset that fits the records much better."""
    if convention := gradient_convention(flight):
        assert flight.spec.gradiometer is not None  # it has a convention
        words = in_words(convention, flight.spec.gradiometer.instrument)
        if words:
            yield (
                f"the gradiometer measurements fit the map better {words}: residuals of "
                f"{convention.after:.3g} E in place of {convention.before:.3g} E"
            )
    for name, table in flight.spec.sensor.items():
        if isinstance(table, RecordedGnss) and (fit := clock_fit(flight.problem, name)):
            yield (
                f"{table_of(name)}.clock_offset_s = {table.clock_offset_s + fit.offset:g} fits the "
                f"INS best: residuals of {fit.after:.3g} {fit.unit} in place of "
                f"{fit.before:.3g} {fit.unit} with {table.clock_offset_s:g}"
            )


def _rejects_most(problem: Problem, count: int) -> bool:
    """Return whether a filter rejects more measurements than can be outliers."""
    return count > _MOST_OUTLIERS * problem.epochs


def _is_robust(label: str) -> bool:
    """Return whether an estimator's label has an option that rejects or down-weights outliers."""
    return any(word in label for word in _ROBUST)


def _beyond(problem: Problem, differences: Residuals) -> tuple[int, int]:
    """Return the numbers of epochs with an improbably large NIS and of epochs with any NIS."""
    counts = problem.present.sum(axis=1)
    some = np.isfinite(differences.nis) & (counts > 0)
    limits = chi2.isf(_RARE, counts[some])
    return int((differences.nis[some] > limits).sum()), int(some.sum())


def isolated_outliers(problem: Problem) -> int:
    """Return the number of epochs with an isolated outlier.

    An outlier differs from the measurements before and after it. Measurements are compared with the
    INS, whose error changes slowly. For each channel the deviation from a running median is divided
    by a standard deviation. The divisor is the larger of two standard deviations. One is the
    assumed noise, the other is estimated from the median absolute deviation.
    """
    there = problem.present
    every = np.arange(problem.epochs)
    predicted = predict_along(problem.model, every, np.zeros((problem.epochs, problem.dimension)))
    isolated = np.zeros(problem.epochs, dtype=bool)
    for j in range(there.shape[1]):
        rows = np.flatnonzero(there[:, j])
        if len(rows) < _FEWEST:
            continue
        apart = problem.measurements[rows, j] - predicted[rows, j]
        local = np.abs(apart - median_filter(apart, _WINDOW, mode="nearest"))
        noise = np.sqrt([problem.noise_of(int(k))[j, j] for k in rows])
        scale = np.maximum(float(np.median(local)) / _MAD, noise)
        isolated[rows] |= local > _ISOLATED * scale
    return int(isolated.sum())


def clock_fit(problem: Problem, sensor: str) -> ClockFit | None:
    """Return the clock offset in whole seconds with which a receiver fits the INS best.

    Velocities are compared if available, else positions. The slow INS error is removed by a
    polynomial over five minutes. The result is None if no offset is clearly better than zero, as in
    straight flight.
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
    """Return the RMS of measurements (G, 3) minus the INS solution ``offset`` seconds later.

    A polynomial over each block of five minutes is removed.
    """
    assert problem.track is not None
    track, times = problem.track, problem.times[epochs]
    indicated = track.velocities if velocities else track.positions
    later = [np.interp(times + offset, problem.times, column) for column in indicated.T]
    positions = np.stack(later, axis=-1)
    if velocities:
        apart, degree = read - positions, 1
    else:
        apart, degree = read + position_error(track.positions[epochs], positions), 2
    blocks = np.array_split(np.arange(len(times)), int((times[-1] - times[0]) // _BLOCK) + 1)
    squares = 0.0
    for block in blocks:
        basis = np.vander((times[block] - times[block].mean()) / _BLOCK, degree + 1)
        fitted = np.linalg.lstsq(basis, apart[block], rcond=None)[0]
        squares += float(np.sum((apart[block] - basis @ fitted) ** 2))
    return float(np.sqrt(squares / len(times)))
