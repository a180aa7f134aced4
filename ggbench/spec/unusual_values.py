"""Remarks on unusual values: allowed, but far from real instruments and flights."""

from __future__ import annotations

import typing
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from .named_sensors import NamedSensors, table_of
from .quantities import Within
from .scenario import Scenario


def unusual_values(scenario: Scenario) -> list[str]:
    """Return a sentence for each unusual value of cases and assumptions, without duplicates."""
    cases_by_value: dict[tuple[str, float, str], list[str]] = {}
    for study, case in scenario.every_case():
        name = f"{study}/{case.name}" if study else case.name
        for key, value, usual in unusual_in(case):
            cases_by_value.setdefault((key, value, usual), []).append(name)
    return [
        f"{key} = {value:g} is unusual ({usual}), in case {names[0]}"
        + (f" and {len(names) - 1} more" if len(names) > 1 else "")
        for (key, value, usual), names in cases_by_value.items()
    ]


def limits_of(field: FieldInfo) -> Within | None:
    """Return the limits of a key of a table, or None if the key has no limits."""
    kinds = [*field.metadata, *_parts(field.annotation)]
    return next((kind for kind in kinds if isinstance(kind, Within)), None)


def unusual_in(table: BaseModel, prefix: str = "") -> Iterator[tuple[str, float, str]]:
    """Yield (dotted key, value, usual range in words) for each unusual value of a table.

    ``prefix`` is put before each dotted key.
    """
    for name, field in type(table).model_fields.items():
        value, key = getattr(table, name), prefix + name
        if isinstance(value, BaseModel):
            yield from unusual_in(value, f"{key}.")
        elif isinstance(value, NamedSensors):
            for sensor, item in value.items():
                yield from unusual_in(item, f"{prefix}{table_of(sensor)}.")
        elif isinstance(value, tuple):
            for i, item in enumerate(value):
                if isinstance(item, BaseModel):
                    yield from unusual_in(item, f"{key}[{i}].")
        elif isinstance(value, float) and (limits := limits_of(field)) is not None:
            usual = limits.usual_unless(value)
            if usual:
                yield key, value, usual


def _parts(annotation: Any) -> Iterator[Any]:
    """Yield an annotation and all annotations and metadata inside it."""
    yield annotation
    for inner in typing.get_args(annotation):
        yield from _parts(inner)
