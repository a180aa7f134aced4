"""Table of the conditions of a scenario, from the keys of the cases."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable, Sequence

import pandas as pd

from ..figures.numbers import counted, span
from ..judging.situations import model_errors
from ..spec.case import CaseSpec
from ..spec.presets import grade_of
from .columns import significant
from .tables import code

_MOST_VALUES = 3
"""Largest number of values of a condition that are listed; more are given as a range."""
_NUMBER = re.compile(r"(\D*)(\d[\d.e+-]*)(\D*)")
_ABBREVIATED = {"gnss": "GNSS", "imu": "IMU", "field": "map"}
"""Names of tables in reports, if they differ from the keys."""
_IN_SOME = "in some cases: "
_VARIES = "varies by case"


def conditions(cases: Sequence[CaseSpec], shared: pd.DataFrame) -> pd.DataFrame:
    """Return a table with a row for each condition of the scenario.

    If a condition differs between cases, its row lists the different values or their range.

    Parameters
    ----------
    cases : cases of the scenario.
    shared : table of cases. The speed, height and duration of the flights and the required errors
        are taken from this table.
    """
    rows = [
        ("INS", _ins(cases)),
        ("Initial σ", _initial(cases)),
        ("Flight", _flight(shared)),
        ("Required error", _range(shared["required_m"], "m")),
        ("Gradiometer", _each(cases, gradiometer_conditions)),
        ("Other sensors", other_conditions(cases)),
        ("Map", _each(cases, map_conditions) + _gravity_disturbance(cases)),
        ("Wrongly modelled", _model_errors(cases)),
    ]
    relevant = [row for row in rows if row[1]]
    return pd.DataFrame(relevant, columns=["condition", "value"])


def _each(cases: Sequence[CaseSpec], text_of: Callable[[CaseSpec], Sequence[str]]) -> str:
    """Summarise the texts of all cases, part by part.

    A few different texts are listed; more are replaced by a range of numbers. A part that is "" in
    some cases ends with "or none". The result is "" if no case has a text.
    """
    texts = [text_of(case) for case in cases]
    parts = []
    for column in itertools.zip_longest(*filter(None, texts)):
        distinct = list(dict.fromkeys(filter(None, column)))
        if distinct:
            few = len(distinct) <= _MOST_VALUES
            part = " or ".join(distinct) if few else _range_of_texts(distinct)
            some = "" in column and part != _VARIES
            parts.append(f"{part} or none" if some else part)
    without = "" if all(texts) else "none or "
    return without + ", ".join(parts) if parts else ""


def _range_of_texts(texts: Sequence[str]) -> str:
    """Return the range of texts that differ only in one number, such as ``every 10 s``.

    For other texts the result is "varies by case".
    """
    matches = [_NUMBER.fullmatch(text) for text in texts]
    parts = [match.groups() for match in matches if match]
    if len(parts) < len(texts) or len({(before, after) for before, _, after in parts}) > 1:
        return _VARIES
    before, _, after = parts[0]
    numbers = sorted((number for _, number, _ in parts), key=float)
    return f"{before}{numbers[0]}–{numbers[-1]}{after}"


def _ins(cases: Sequence[CaseSpec]) -> str:
    imus = [case.side("truth").imu for case in cases]
    grades = dict.fromkeys(grade_of(imu.gyro_bias_deg_per_h) for imu in imus)
    return (
        f"{' or '.join(grades)} grade, gyros {_span(imu.gyro_bias_deg_per_h for imu in imus)} °/h, "
        f"{_span(imu.gyro_noise_deg_per_sqrt_h for imu in imus)} °/√h, accelerometers "
        f"{_span(imu.accelerometer_bias_ug for imu in imus)} µg, "
        f"{_span(imu.accelerometer_noise_ug_per_sqrt_hz for imu in imus)} µg/√Hz"
    )


def _initial(cases: Sequence[CaseSpec]) -> str:
    """Return the standard deviations per axis; height and heading only if they differ."""
    priors = [case.initial_error for case in cases]
    position = f"{_span(prior.position_m for prior in priors)} m"
    if any(prior.height_m is not None for prior in priors):
        position += f" (height {_span(prior.height_sigma_m for prior in priors)} m)"
    velocity = f"{_span(prior.velocity_mps for prior in priors)} m/s"
    attitude = f"{_span(prior.attitude_arcmin for prior in priors)}′"
    if any(prior.heading_arcmin is not None for prior in priors):
        attitude += f" (heading {_span(prior.heading_sigma_arcmin for prior in priors)}′)"
    return ", ".join([position, velocity, attitude])


def _span(values: Iterable[float]) -> str:
    """Return a value, or the least and the largest; two significant digits if below 100."""
    ordered = [float(f"{value:.2g}") if value < 100.0 else value for value in sorted(values)]
    return span(f"{ordered[0]:g}", f"{ordered[-1]:g}", separator="–")


def _flight(shared: pd.DataFrame) -> str:
    parts = (
        _range(shared["duration_s"] / 60.0, "min"),
        _range(shared["speed_mps"], "m/s"),
        f"height {_range(shared['height_m'], 'm')}",
    )
    return ", ".join(parts)


def gradiometer_conditions(case: CaseSpec) -> list[str]:
    """Return texts on the gradiometer: noise, period, channels, instrument and low-pass filter."""
    spec = case.side("truth").gradiometer
    if spec is None:
        return []
    noise = "noise of its disks"
    if spec.noise_eotvos is not None:
        noise = f"{spec.noise_eotvos:g} E"
    elif spec.noise_density_eotvos_per_sqrt_hz is not None:
        noise = f"{spec.noise_density_eotvos_per_sqrt_hz:g} E/√Hz"
    elif spec.coloured_noise is not None:
        noise = "coloured noise"
    if spec.readings == "measured":
        noise = "measured gradients"
    channels = "rotating disks" if spec.rotating else counted(len(spec.components), "component")
    low = f"low-pass {spec.filter_cutoff_hz:g} Hz" if spec.filter != "none" else ""
    return [noise, f"every {spec.period_s:g} s", channels, spec.instrument, low]


def other_conditions(cases: Sequence[CaseSpec]) -> str:
    """Return a text on all aiding sensors except the gradiometer.

    The text lists the sensors that all cases have, then those that only some cases have.
    """
    periods: dict[str, list[str]] = {}
    for case in cases:
        for spec in case.sensor.values():
            periods.setdefault(spec.in_words, []).append(f"{spec.period_s:g}")
    texts = {
        name: f"{name} every {' or '.join(dict.fromkeys(values))} s"
        for name, values in periods.items()
    }
    sensors_of_cases = [{spec.in_words for spec in case.sensor.values()} for case in cases]
    in_all = [name for name in texts if all(name in names for names in sensors_of_cases)]
    in_some = [name for name in texts if name not in in_all][:_MOST_VALUES]
    parts = [", ".join(texts[name] for name in in_all)] if in_all else []
    if in_some:
        parts.append(_IN_SOME + ", ".join(texts[name] for name in in_some))
    return "; ".join(parts)


def map_conditions(case: CaseSpec) -> list[str]:
    """Return texts on the map: its source and its quality."""
    true, assumed = case.side("truth").field, case.side("model").field
    if assumed.source == "normal":
        return ["normal field"]
    same = (assumed.source, assumed.error) == (true.source, true.error)
    quality = "exact" if same else "with errors"
    if case.measured_sensors():
        quality = "with its real errors"
    return [code(assumed.source), quality]


def _gravity_disturbance(cases: Sequence[CaseSpec]) -> str:
    """Return a remark if the true accelerometers measure the gravity disturbance, otherwise ""."""
    simulated = [case.side("truth").field.gravity_disturbance for case in cases]
    if not any(simulated):
        return ""
    return "; gravity disturbance " + ("simulated" if all(simulated) else "in some cases")


def _model_errors(cases: Sequence[CaseSpec]) -> str:
    """Return the wrongly modelled tables of the cases; "" if no case has any."""
    words = []
    for case in cases:
        names = [_ABBREVIATED.get(name, name) for name in model_errors(case)]
        words.append(" and ".join(names).replace("_", " ") or "none")
    distinct = [word for word in dict.fromkeys(words) if word != "none"]
    if len(distinct) + ("none" in words) > _MOST_VALUES:
        return _VARIES
    if not distinct:
        return ""
    return (_IN_SOME if "none" in words else "") + ", or ".join(distinct)


def _range(values: pd.Series, unit: str) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{span(significant(low, 3), significant(high, 3), separator='–')} {unit}"
