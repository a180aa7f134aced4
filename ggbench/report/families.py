"""Estimators of a campaign that differ in one number alone: what that number makes of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, TypeGuard

from ..estimator_spec import EstimatorSpec
from .league import STANDARD

PARTICLES = "particles"
"""The parameter that says how many particles an estimator has."""
LINE = 3
"""Values of a parameter that make a line in a figure."""


class Family(NamedTuple):
    """Estimators that differ in one parameter.

    Attributes
    ----------
    title : what their labels say without it.
    labels : of the estimators, by value.
    values : of the parameter, increasing.
    """

    title: str
    labels: tuple[str, ...]
    values: tuple[float, ...]


def families(estimators: Mapping[str, Any], parameter: str) -> list[Family]:
    """Return the families of a campaign that differ in a parameter, of two members or more.

    Parameters
    ----------
    estimators : label to what was run, as a manifest has it: its ``parameters`` are complete, so
        that a label which does not name the parameter has its default.
    parameter : its name. Only estimators that have it as a number are looked at.
    """
    found: dict[str, dict[float, str]] = {}
    for label, content in estimators.items():
        value = _settings(content).get(parameter)
        if _is_number(value):
            found.setdefault(str(EstimatorSpec.parse(label).without(parameter)), {}).setdefault(
                float(value), label
            )
    return [
        Family(title, *zip(*((held[value], value) for value in sorted(held)), strict=True))
        for title, held in found.items()
        if len(held) > 1
    ]


def parameters(estimators: Mapping[str, Any]) -> list[str]:
    """Return the parameters, of any estimator, that labels name, in order of appearance."""
    names = [
        name
        for label in estimators
        for name in EstimatorSpec.parse(label).parameters
        if _is_number(_settings(estimators[label]).get(name))
    ]
    return list(dict.fromkeys(names))


def lines(estimators: Mapping[str, Any], parameter: str) -> list[Family]:
    """Return the families that make a line: of :data:`LINE` values or more, all positive."""
    found = families(estimators, parameter)
    return [f for f in found if len(f.values) >= LINE and f.values[0] > 0.0]


def leaders(estimators: Mapping[str, Any], ranked: Iterable[str]) -> list[str]:
    """Return ranked labels without those that a better one stands for, of the same line."""
    left = list(ranked)
    for parameter in parameters(estimators):
        for family in lines(estimators, parameter):
            held = [label for label in left if label in family.labels]
            left = [label for label in left if label not in held[1:]]
    return left


def kinds(labels: Iterable[str], rows: Mapping[str, Any]) -> dict[tuple[str, str], list[str]]:
    """Return labels by their estimator's name and their causality, which ``rows`` have by label."""
    found: dict[tuple[str, str], list[str]] = {}
    for label in labels:
        found.setdefault((EstimatorSpec.parse(label).name, rows[label]["causality"]), []).append(
            label
        )
    return found


def plain_of(labels: Iterable[str]) -> str:
    """Return of variants of an estimator the plain one.

    That of the standard roster, or else the one that is asked for with the fewest parameters.
    """
    return min(
        labels,
        key=lambda label: (label not in STANDARD, len(EstimatorSpec.parse(label).parameters)),
    )


def of_the_best(estimators: Mapping[str, Any]) -> str:
    """Return what the caption of a figure adds that shows :func:`leaders` alone."""
    if len(leaders(estimators, estimators)) == len(estimators):
        return ""
    return "; of estimators that differ in one number, the best"


def _settings(content: Any) -> Mapping[str, Any]:
    held = content.get("parameters")
    return held if isinstance(held, Mapping) else {}


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)
