"""Parameters of which a spread is tested every time, and the rest is left to the long tests."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest


def thinned(
    names: str | tuple[str, ...],
    values: Iterable[Any],
    *,
    every: int = 3,
    ids: Callable[[Any], str] | None = None,
) -> pytest.MarkDecorator:
    """Parametrize a test; the first of ``every`` few values is quick, the others are long."""
    several = not isinstance(names, str) or "," in names
    parameters = []
    for number, value in enumerate(values):
        marks = [pytest.mark.long] if number % every else []
        if isinstance(value, ParameterSet):
            parameters.append(
                pytest.param(*value.values, marks=[*value.marks, *marks], id=value.id)
            )
        else:
            parameters.append(pytest.param(*(value if several else (value,)), marks=marks))
    return pytest.mark.parametrize(names, parameters, ids=ids)


ParameterSet = type(pytest.param())
