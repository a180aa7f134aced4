"""Numbers for figures, tables and sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

LARGEST = 1e7
"""Largest error [m] and ratio that is written; the Earth's circumference is 4e7 m."""


def counted(count: int, noun: str) -> str:
    """Return a number with its noun: ``1 run``, ``2 runs``."""
    return f"{count} {noun if count == 1 else f'{noun}s'}"


def some(texts: Sequence[str], most: int = 6) -> str:
    """Return texts of the first few items, the best, and the number of the others."""
    more = len(texts) - most
    return ", ".join(texts[:most]) + (f" and {more} more" if more > 0 else "")


def short(value: float) -> str:
    """Return a number with at most three digits, for cells and sentences."""
    if value == 0.0 or not 1e-3 <= abs(value) < 1e5:
        return f"{value:.1e}" if value else "0"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{digits}f}" if digits else f"{value:.0f}"


def span(first: str, last: str, *, separator: str = " to ") -> str:
    """Return the range of two shown numbers; equal ones as one number."""
    return first if first == last else f"{first}{separator}{last}"


def limited(value: float, text: str) -> str:
    """Return the text of an error [m] or ratio; ``>1e7`` if it is beyond :data:`LARGEST`."""
    return f">1e{math.log10(LARGEST):.0f}" if LARGEST < value < math.inf else text
