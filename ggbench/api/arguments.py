"""Validation of arguments of the Python interface."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

from ..errors import GGBenchError
from ..spec.case import CaseSpec


class ArgumentError(GGBenchError):
    """A function was called with an invalid argument."""


def listed(items: Any, kind: Any, name: str) -> list[Any]:
    """Return one object of a type, or a sequence of them, as a list.

    Raises
    ------
    ArgumentError
        If the value is neither an object of this type nor a sequence of them.
    """
    if isinstance(items, kind):
        return [items]
    if not isinstance(items, Sequence) or not all(isinstance(item, kind) for item in items):
        allowed = {str: "texts", CaseSpec: "cases"}.get(kind, "texts or estimators")
        raise ArgumentError(f"{name} must be a list of {allowed}, and is {items!r}")
    return list(items)


def whole(name: str, value: Any, least: int, most: int) -> int:
    """Return the value as an integer; raise ArgumentError unless ``least`` ≤ value ≤ ``most``."""
    try:
        number = operator.index(value)
    except TypeError:
        raise ArgumentError(f"{name} is {value!r} and must be a whole number") from None
    if not least <= number <= most:
        raise ArgumentError(f"{name} is {number} and must lie between {least} and {most}")
    return number


def number(name: str, value: Any) -> float:
    """Return the value as a float, or raise ArgumentError if it is no number."""
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ArgumentError(f"{name} is {value!r} and must be a number") from None


def kind(value: Any) -> str:
    """Return the type of a value in words, for a message."""
    return f"an object of type {type(value).__name__}"
