"""Classification of cases by situation, and comparison of assumed and true model."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from ..spec.aiding import GnssSpec
from ..spec.case import CaseSpec
from ..spec.named_sensors import table_of

NARROW, WIDE = 0.2, 1.0
"""Limits of σ/ℓ: a prior is narrow below the first, and wide from the second on."""
LONG_S = 1800.0
"""Least duration of a long flight [s]."""
SITUATIONS = {
    "measured": "Measurements of a real sensor",
    "plain": f"Narrow prior, right model (σ/ℓ below {NARROW:g}, or not known)",
    "between": f"Prior comparable to the correlation length (σ/ℓ of {NARROW:g} to {WIDE:g})",
    "wide": f"Wide prior (σ/ℓ of {WIDE:g} or more)",
    "scalar": "No gradiometer on board",
    "long": f"Long flight ({LONG_S / 60.0:g} min or more), narrow prior",
    "readings": "Outliers or gaps in the measurements",
    "outage": "Satellite navigation that fails",
    "map": "Map error that the model does not include",
    "modelled-map": "Map error, modelled as random-walk biases",
    "gravity": "Gravity disturbance that the mechanization does not compensate",
    "model": "Sensors, times or initial errors other than assumed",
}
_BIASES = "model.gradiometer.bias_eotvos"
_READINGS = ("outlier", "dropout", "noise_freedom")


def situation_of(case: CaseSpec, correlation_m: float = math.nan) -> str:
    """Return the situation of a case, a key of :data:`SITUATIONS`.

    The first situation that applies is returned. The order of the tests is "measured", "outage",
    "readings", "modelled-map" or "map", "gravity", "scalar", "wide" or "between", "long", "model",
    "plain".

    Parameters
    ----------
    case : the case.
    correlation_m : correlation length of the field along the track [m]. If it is NaN (unknown), the
        prior counts as narrow.
    """
    if case.measured_sensors():
        return "measured"
    wrong = set(_set_apart(case))
    receivers = [name for name, spec in case.sensor.items() if isinstance(spec, GnssSpec)]
    if any(
        key.startswith(f"truth.{table_of(name)}.dropout") for key in wrong for name in receivers
    ):
        return "outage"
    if any(word in key for key in wrong for word in _READINGS):
        return "readings"
    wrong -= _OF_GRAVITY
    if any(key.split(".")[1] == "field" for key in wrong):
        return "modelled-map" if _BIASES in wrong else "map"
    if _unknown_gravity(case):
        return "gravity"
    if case.gradiometer is None:
        return "scalar"
    width = case.initial_error.position_m / correlation_m
    if width >= NARROW:
        return "wide" if width >= WIDE else "between"
    if case.trajectory.duration_s >= LONG_S:
        return "long"
    return "model" if wrong else "plain"


def is_right_model(case: CaseSpec) -> bool:
    """Return whether the assumed model equals the true one in all keys of the case.

    Gaps at known times are no model errors. For measured data the truth is unknown, so the result
    is false. The result is also false for a filtered gradiometer with the treatment "delayed",
    because the filter colours the noise.
    """
    spec = case.gradiometer
    white = spec is not None and spec.filter != "none" and spec.filter_treatment == "delayed"
    if case.measured_sensors() or white:  # the noise behind a filter is coloured
        return False
    return all(map(_is_neutral, _set_apart(case))) and not _unknown_gravity(case)


def model_errors(case: CaseSpec) -> list[str]:
    """Return the sorted names of tables ("gradiometer", ...) in which truth and model differ.

    A gravity disturbance that is neither compensated nor modelled by states adds "gravity". Gaps at
    known times are no model errors.
    """
    values, differing = _set_apart(case), set()
    for key, value in values.items():
        side, _, own = key.partition(".")
        other = "model" if side == "truth" else "truth"
        if not _is_neutral(key) and values.get(f"{other}.{own}") != value:
            differing.add(own.split(".")[0])
    if _unknown_gravity(case) and "disturbance" not in differing:
        differing.add("gravity")
    return sorted(differing - {"disturbance"})


_OF_GRAVITY = {
    "truth.field.gravity_disturbance",
    "truth.field.constant_disturbance_mgal",
    "model.field.compensate",
}
"""Keys of the gravity disturbance and of its compensation, which do not change the map."""


def _is_neutral(key: str) -> bool:
    """Return whether a key of truth or model makes no model error, see :func:`model_errors`."""
    return key in _OF_GRAVITY or key.endswith(".dropouts_s")


def _set_apart(case: CaseSpec) -> dict[str, Any]:
    """Return the keys that are set in the tables ``truth`` and ``model`` of a case, with values."""
    tables = case.model_dump(include={"truth", "model"}, exclude_defaults=True)
    return dict(_set_keys(tables))


def _unknown_gravity(case: CaseSpec) -> bool:
    """Return whether the truth has a gravity disturbance that the model does not compensate."""
    return case.side("truth").field.gravity_disturbance and not case.model.field.compensate


def _set_keys(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted keys of nested tables whose values are not None, with these values."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _set_keys(value, f"{prefix}{key}.")
        elif value is not None:  # what is switched off, or set to zero, is set
            yield f"{prefix}{key}", value
