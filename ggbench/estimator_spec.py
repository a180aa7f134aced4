"""Text form of an estimator with parameters.

Users write ``ukf[points=merwe,alpha=0.1]``. This text is stored with every run and shown in tables
and figures. Only this module parses it.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Self

_FORM = re.compile(r"\s*([^\[\]]+?)\s*(?:\[([^\[\]]*)\])?\s*")


@dataclass(frozen=True)
class EstimatorSpec:
    """An estimator's name and the parameters that differ from its defaults.

    Attributes
    ----------
    name : the registered name, or the path of a Python file.
    parameters : values as texts, by name of the parameter.
    """

    name: str
    parameters: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse a text ``NAME`` or ``NAME[parameter=value,...]``.

        Raises
        ------
        ValueError
            If the text has another form, or names a parameter twice.
        """
        match = _FORM.fullmatch(text)
        if not match:
            raise ValueError(
                f"'{text}' does not name an estimator; write NAME or NAME[parameter=value,...]"
            )
        parameters: dict[str, str] = {}
        for item in filter(None, (part.strip() for part in (match[2] or "").split(","))):
            key, equals, value = (part.strip() for part in item.partition("="))
            if not equals:
                raise ValueError(f"{match[1]}: '{item}' is not of the form parameter=value")
            if key in parameters:
                raise ValueError(f"{match[1]}: parameter '{key}' is given twice")
            parameters[key] = value
        return cls(match[1], MappingProxyType(parameters))

    @classmethod
    def changed(cls, name: str, values: Mapping[str, Any], defaults: Mapping[str, Any]) -> Self:
        """Return the spec with those parameter values that differ from their defaults."""
        texts = {key: _text(value) for key, value in values.items() if value != defaults[key]}
        return cls(name, MappingProxyType(texts))

    @property
    def listed(self) -> str:
        """Parameters as text, ``points=merwe,alpha=0.1``; empty if all have their defaults."""
        return ",".join(f"{key}={value}" for key, value in self.parameters.items())

    def without(self, *keys: str) -> EstimatorSpec:
        """Return the spec without the parameters ``keys``."""
        remaining = {key: text for key, text in self.parameters.items() if key not in keys}
        return EstimatorSpec(self.name, MappingProxyType(remaining))

    def __str__(self) -> str:
        return f"{self.name}[{self.listed}]" if self.parameters else self.name


def _text(value: Any) -> str:
    """Return a parameter's value as a user writes it: ``3`` and not ``3.0``, ``false``."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        short = f"{value:g}"
        return short if float(short) == value else repr(value)
    return str(value)


def shown_names(names: Mapping[str, str]) -> dict[str, str]:
    """Return the name shown in tables for each label.

    Parameters
    ----------
    names : name of the estimator class by label, ``{"my/file.py[gain=2]": "mine"}``.

    Returns
    -------
    Shown name by label: the class name with the parameters (``mine[gain=2]``), or the label itself
    if two labels would have the same shown name.
    """
    own_names = {
        label: str(EstimatorSpec(name, EstimatorSpec.parse(label).parameters))
        for label, name in names.items()
    }
    counts = Counter(own_names.values())
    return {label: own if counts[own] == 1 else label for label, own in own_names.items()}
