"""What a source claims beyond errors of position and velocity: numbers to be judged."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from .case import CaseName, Title
from .quantities import Duration
from .tables import Listed, Section

GravityQuantity = Literal[
    "east position", "north position", "up position",
    "east velocity", "north velocity", "up velocity",
    "pitch", "roll", "heading",
]  # fmt: skip
UNITS: dict[str, str] = {"position": "m", "velocity": "m/s"} | dict.fromkeys(
    ("pitch", "roll", "heading"), "\u2032"
)
"""Units of the quantities, by their last word; attitudes in minutes of arc."""


class ClaimSpec(Section):
    """``[[claim]]``: what knowing the gravity disturbance of a case is said to be worth.

    An error that it causes, and that therefore disappears: the response of the INS to it alone.
    """

    title: Title
    case: CaseName
    quantity: GravityQuantity
    published: Annotated[float, Field(gt=0.0, lt=1e9)]
    until_s: Duration

    @property
    def unit(self) -> str:
        """The unit of the published number."""
        return UNITS[self.quantity.rpartition(" ")[2]]


class ComparisonSpec(Section):
    """``[[comparison]]``: what a source says of two estimators without a number.

    At each value of something that the source leaves open: ``{}`` in the labels stands for it.
    """

    title: Title
    case: CaseName
    first: Title
    relation: Literal["larger", "smaller", "equal"]
    quantity: Literal["error", "time"]
    second: Title
    values: Annotated[Listed[Title], Field(min_length=1)] = ("",)

    @model_validator(mode="after")
    def _uses_its_values(self) -> Self:
        if self.values != ("",) and "{}" not in self.first + self.second:
            raise ValueError("values need a {} in first or second, which stands for them")
        return self

    def labels(self, value: str) -> tuple[str, str]:
        """Return the labels of the two estimators at a value."""
        return self.first.replace("{}", value), self.second.replace("{}", value)
