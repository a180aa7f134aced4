"""What of a scenario is allowed and yet odd: values far from what instruments and flights are."""

from __future__ import annotations

import typing
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from .case import CaseSpec
from .further import Named
from .quantities import Within
from .scenario import Scenario


def oddities(scenario: Scenario) -> list[str]:
    """Return a sentence for each odd value of the scenario's cases and studies, each value once."""
    cases = [("", case) for case in scenario.cases]
    cases += [(f"{study.name}/", case) for study in scenario.assumptions for case in study.cases]
    found: dict[tuple[str, float, str], list[str]] = {}
    for study, case in cases:
        for key, value, usual in odd_values(case):
            found.setdefault((key, value, usual), []).append(study + case.name)
    return [
        f"{key} = {value:g} is odd ({usual}), in case {names[0]}"
        + (f" and {len(names) - 1} more" if len(names) > 1 else "")
        for (key, value, usual), names in found.items()
    ]


def odd_values(case: CaseSpec) -> Iterator[tuple[str, float, str]]:
    """Yield the dotted key of each odd value of a case, the value, and what is usual."""
    yield from _odd(case, "")


def limits_of(field: FieldInfo) -> Within | None:
    """Return the limits of a key of a table, if it is a number that has them."""
    kinds = [*field.metadata, *_parts(field.annotation)]
    return next((kind for kind in kinds if isinstance(kind, Within)), None)


def _odd(table: BaseModel, prefix: str) -> Iterator[tuple[str, float, str]]:
    for name, field in type(table).model_fields.items():
        value, key = getattr(table, name), prefix + name
        if isinstance(value, BaseModel):
            yield from _odd(value, f"{key}.")
        elif isinstance(value, Named):
            for sensor, item in value:
                yield from _odd(item, f"{key}.{sensor}.")
        elif isinstance(value, tuple):
            for i, item in enumerate(value):
                if isinstance(item, BaseModel):
                    yield from _odd(item, f"{key}[{i}].")
        elif isinstance(value, float) and (limits := limits_of(field)) is not None:
            usual = limits.oddity(value)
            if usual:
                yield key, value, usual


def _parts(annotation: Any) -> Iterator[Any]:
    """Yield what an annotation is made of, metadata included."""
    yield annotation
    for inner in typing.get_args(annotation):
        yield from _parts(inner)
