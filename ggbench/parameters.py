"""Parameters of estimators: the fields of a frozen dataclass, with types, limits and defaults.

A limit is part of the type of a field, ``Annotated[int, Field(ge=1)]``. Limits are checked when an
estimator is created, and are printed with the parameters.
"""

from __future__ import annotations

import types
import typing
from collections.abc import Mapping
from dataclasses import MISSING, fields
from functools import cache
from typing import Annotated, Any, NamedTuple

from pydantic import Field, TypeAdapter, ValidationError

AtLeastOne = Annotated[int, Field(ge=1)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]

_WORDS = {int: "a whole number", float: "a number", bool: "true or false", str: "a text"}
_LIMITS = {
    "ge": "at least {:g}",
    "gt": "more than {:g}",
    "le": "at most {:.10g}",
    "lt": "less than {:.10g}",
}


_adapter = cache(TypeAdapter[Any])


class Parameter(NamedTuple):
    """Type and default of a parameter; the default is ``MISSING`` if there is none."""

    annotation: Any
    default: Any

    def allowed(self) -> str:
        """Return the allowed values, in words."""
        return _described(self.annotation)

    def validate(self, value: object) -> Any:
        """Return a value, which may be given as text, converted to the type of the parameter.

        Raises
        ------
        ValueError
            If the value cannot be converted or is beyond a limit.
        """
        return _adapter(self.annotation).validate_python(value)


@cache
def parameters_of(cls: type) -> Mapping[str, Parameter]:
    """Return an estimator class's parameters by name: its own, then the common ones."""
    hints = typing.get_type_hints(cls, include_extras=True)
    ordered = sorted(fields(cls), key=lambda item: bool(item.kw_only))
    return {item.name: Parameter(hints[item.name], item.default) for item in ordered}


def require_valid(estimator: Any) -> None:
    """Raise ValueError if a parameter of an estimator is beyond its limits."""
    cls: type = type(estimator)
    for name, parameter in parameters_of(cls).items():
        if parameter.default is MISSING:
            continue
        value = getattr(estimator, name)
        try:
            parameter.validate(value)
        except ValidationError:
            raise ValueError(
                f"{estimator.name}: parameter '{name}' is '{value}' and must be "
                f"{parameter.allowed()}"
            ) from None


def _described(annotation: Any) -> str:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Annotated:
        kind, *extras = arguments
        constraints = [item for extra in extras for item in getattr(extra, "metadata", ())]
        finite = any(getattr(item, "allow_inf_nan", None) is False for item in constraints)
        limits = [
            words.format(getattr(item, name))
            for name, words in _LIMITS.items()
            for item in constraints
            if hasattr(item, name)
        ]
        return ", ".join(["a finite number" if finite else _described(kind), *limits])
    if origin is typing.Literal:
        return " | ".join(str(choice) for choice in arguments)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_described(one) for one in arguments if one is not type(None))
    return _WORDS.get(annotation) or str(getattr(annotation, "__name__", annotation))
