"""Numbers as figures, tables and sentences show them."""

from __future__ import annotations

import math
from collections.abc import Sequence

LARGEST = 1e7
"""Largest error [m] and ratio that is written; the Earth's circumference is 4e7 m."""


def counted(count: int, noun: str) -> str:
    """Return how many there are of what a noun names: ``1 run``, ``2 runs``."""
    return f"{count} {noun if count == 1 else f'{noun}s'}"


def some(texts: Sequence[str], most: int = 6) -> str:
    """Return what is said of the first few, the best, and of how many more it could be said."""
    more = len(texts) - most
    return ", ".join(texts[:most]) + (f" and {more} more" if more > 0 else "")


def short(value: float) -> str:
    """Return a number with three digits at most, as cells and sentences show it."""
    if value == 0.0 or not 1e-3 <= abs(value) < 1e5:
        return f"{value:.1e}" if value else "0"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{digits}f}" if digits else f"{value:.0f}"


def span(first: str, last: str, *, separator: str = " to ") -> str:
    """Return two numbers, as they are shown, as ends of a range; equal ones as one number."""
    return first if first == last else f"{first}{separator}{last}"


def limited(value: float, text: str) -> str:
    """Return the text of an error [m] or ratio; ``>1e7`` if it is beyond :data:`LARGEST`."""
    return f">1e{math.log10(LARGEST):.0f}" if LARGEST < value < math.inf else text
