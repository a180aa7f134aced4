"""Tables of published claims other than errors of position and velocity."""

from __future__ import annotations

import re
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from . import quantities as q
from .case import CaseName
from .tables import Section, Several, Title

GravityQuantity = Literal[
    "east position",
    "north position",
    "up position",
    "east velocity",
    "north velocity",
    "up velocity",
    "pitch",
    "roll",
    "heading",
]
UNITS: dict[str, str] = {"position": "m", "velocity": "m/s"} | dict.fromkeys(
    ("pitch", "roll", "heading"), "\u2032"
)
"""Units of the quantities, by their last word; attitudes in minutes of arc."""


class ClaimSpec(Section):
    """``[[claim]]``: a published INS error that disappears if the gravity disturbance is known.

    The gravity disturbance is the only error source of this INS.
    """

    title: Title
    """The claim in words."""
    case: CaseName
    """Case with the gravity disturbance."""
    quantity: GravityQuantity
    """Kind of error; attitudes are in minutes of arc."""
    published: Annotated[float, Field(gt=0.0, lt=1e9)]
    """Published value, in m, m/s or ′."""
    until_s: q.Duration
    """Time to which the value refers."""

    @property
    def unit(self) -> str:
        """Unit of the published value."""
        return UNITS[self.quantity.rpartition(" ")[2]]


class ComparisonSpec(Section):
    """``[[comparison]]``: a published claim about two estimators, without a number.

    If the source does not state a parameter, the claim is tested at several values of this
    parameter. Each value replaces ``{}`` in the labels of the estimators.
    """

    title: Title
    """The claim in words."""
    case: CaseName
    """Case in which the claim is tested."""
    first: Title
    """Label of an estimator of the campaign; `{}` in it stands for one of `values`."""
    relation: Literal["larger", "smaller", "equal"]
    """Relation of the first estimator to the second."""
    quantity: Literal["error", "time"]
    """Compared quantity: the position error of each run, or the computing time of a run."""
    second: Title
    """Another estimator of the campaign."""
    values: Several[Title] = ("",)
    """Texts for `{}`: values of a parameter that the source does not state."""

    @model_validator(mode="after")
    def _uses_its_values(self) -> Self:
        if self.values != ("",) and "{}" not in self.first + self.second:
            raise ValueError(
                "values are given, but first and second contain no {}: put {} where each value is "
                "to be inserted"
            )
        return self

    def title_of(self, value: str) -> str:
        """Return the title, with the parameter that has ``value``: ``title (noise=1e-05)``."""
        if not value:
            return self.title
        name = re.search(r"(\w+=)\{\}", self.first + self.second)
        return f"{self.title} ({name[1] if name else ''}{value})"

    def labels(self, value: str) -> tuple[str, str]:
        """Return the labels of the two estimators with ``value`` in place of ``{}``."""
        return self.first.replace("{}", value), self.second.replace("{}", value)
