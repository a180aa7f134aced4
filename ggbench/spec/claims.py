"""What a source claims beyond errors of position and velocity: numbers to be judged."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from .case import CaseName, Title
from .quantities import Duration
from .tables import Section

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
