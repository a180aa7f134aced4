"""What a case of the library is an example of."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from ..spec.aiding import GnssSpec
from ..spec.case import CaseSpec
from ..spec.further import table_of

WIDE_M = 1000.0
"""σ of the initial position per axis from which a prior is called wide [m]."""
LONG_S = 1800.0
"""Duration from which a flight is called long [s]."""
NOTHING = "nothing"
SITUATIONS = {
    "plain": "Narrow prior, right model",
    "wide": f"Wide prior (σ of {WIDE_M / 1000.0:g} km per axis or more)",
    "long": f"Long flight ({LONG_S / 60.0:g} min or more)",
    "readings": "Outliers or gaps in the readings",
    "outage": "Satellite navigation that fails",
    "map": "A map that is not the field",
    "gravity": "Gravity that the mechanization does not know",
    "model": "Sensors, times or initial errors other than the estimators believe",
    NOTHING: "Aiding gains nothing",
}
_READINGS = ("outlier", "dropout")


def situation_of(case: CaseSpec, gained: str) -> str:
    """Return the situation of a case: the first that fits, from its keys and from what came out.

    Parameters
    ----------
    case : the case. gained : what aiding gains, of :func:`ggbench.report.opening.gain`.
    """
    if gained in ("nothing", "worse"):
        return NOTHING
    changed = set(_set_keys(case.model_dump(exclude_defaults=True)))
    wrong = {key for key in changed if key.split(".")[0] in ("truth", "model")}
    receivers = ["gnss", *(name for name, spec in case.further if isinstance(spec, GnssSpec))]
    if any(
        key.startswith(f"truth.{table_of(name)}.dropout") for key in wrong for name in receivers
    ):
        return "outage"
    if any(word in key for key in wrong for word in _READINGS):
        return "readings"
    # What the accelerometers feel and the mechanization adds is no part of the map.
    wrong -= {
        "truth.field.gravity_disturbance", "truth.field.constant_disturbance_mgal",
        "model.field.compensate",
    }  # fmt: skip
    if any(key.split(".")[1] == "field" for key in wrong):
        return "map"
    if case.side("truth").field.gravity_disturbance and not case.model.field.compensate:
        return "gravity"
    if case.initial_error.position_m >= WIDE_M:
        return "wide"
    if case.trajectory.duration_s >= LONG_S:
        return "long"
    return "model" if wrong else "plain"


def _set_keys(table: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Yield the dotted keys of nested tables that are set to anything."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _set_keys(value, f"{prefix}{key}.")
        elif value is not None:  # what is switched off, or set to zero, is set
            yield f"{prefix}{key}"
