"""What a case of the library is an example of."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from ..spec.aiding import GnssSpec
from ..spec.case import CaseSpec
from ..spec.named_sensors import table_of

NARROW, WIDE = 0.2, 1.0
"""σ/ℓ up to which a prior is narrow, and from which on it is wide. Where Kalman filters cease to
find back is what the scenario ``nonlinearity`` is about."""
LONG_S = 1800.0
"""Duration from which a flight is called long [s]."""
NOTHING = "nothing"
SITUATIONS = {
    "plain": f"Narrow prior, right model (σ/ℓ below {NARROW:g}, or not known)",
    "between": f"A prior of the field's own scale (σ/ℓ of {NARROW:g} to {WIDE:g})",
    "wide": f"Wide prior (σ/ℓ of {WIDE:g} or more)",
    "scalar": "No gradiometer on board",
    "long": f"Long flight ({LONG_S / 60.0:g} min or more), narrow prior",
    "readings": "Outliers or gaps in the readings",
    "outage": "Satellite navigation that fails",
    "map": "A map that is not the field",
    "told": "A map that is not the field, its error told as biases that walk",
    "gravity": "Gravity that the mechanization does not know",
    "model": "Sensors, times or initial errors other than the estimators believe",
    NOTHING: "Aiding gains nothing",
}
_BIASES = "model.gradiometer.bias_eotvos"
_READINGS = ("outlier", "dropout", "noise_freedom")


def situation_of(case: CaseSpec, gained: str, correlation_m: float = math.nan) -> str:
    """Return the situation of a case: the first that fits, from its keys and from what came out.

    Parameters
    ----------
    case : the case.
    gained : what aiding gains, of :func:`ggbench.report.outcome.gain`.
    correlation_m : the field's correlation length along the track [m]; NaN where nobody knows it,
        and the prior is taken with the narrow ones.
    """
    if gained in ("nothing", "worse"):
        return NOTHING
    wrong = _set_apart(case)
    receivers = ["gnss", *(name for name, spec in case.sensor if isinstance(spec, GnssSpec))]
    if any(
        key.startswith(f"truth.{table_of(name)}.dropout") for key in wrong for name in receivers
    ):
        return "outage"
    if any(word in key for key in wrong for word in _READINGS):
        return "readings"
    wrong -= _OF_GRAVITY
    if any(key.split(".")[1] == "field" for key in wrong):
        return "told" if _BIASES in wrong else "map"
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
    """Return whether the estimators are told the truth's own model, in all that a case can say."""
    return not (_set_apart(case) - _OF_GRAVITY) and not _unknown_gravity(case)


_OF_GRAVITY = {
    "truth.field.gravity_disturbance", "truth.field.constant_disturbance_mgal",
    "model.field.compensate",
}  # fmt: skip
"""What the accelerometers feel and the mechanization adds, which is no part of the map."""


def _set_apart(case: CaseSpec) -> set[str]:
    """Return the keys by which truth or model differ from what both share."""
    changed = set(_set_keys(case.model_dump(exclude_defaults=True)))
    return {key for key in changed if key.split(".")[0] in ("truth", "model")}


def _unknown_gravity(case: CaseSpec) -> bool:
    """Return whether the truth's gravity is felt and nobody adds it."""
    return case.side("truth").field.gravity_disturbance and not case.model.field.compensate


def _set_keys(table: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Yield the dotted keys of nested tables that are set to anything."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _set_keys(value, f"{prefix}{key}.")
        elif value is not None:  # what is switched off, or set to zero, is set
            yield f"{prefix}{key}"
