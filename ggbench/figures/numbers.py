"""Text form of numbers for figures, tables and sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

LARGEST = 1e7
"""Largest error [m] and ratio that is written; the Earth's circumference is 4e7 m."""


def counted(count: int, noun: str) -> str:
    """Return a count with its noun: ``1 run``, ``2 runs``."""
    return f"{count} {noun if count == 1 else f'{noun}s'}"


def some(texts: Sequence[str], most: int = 6) -> str:
    """Join the first ``most`` texts, and append the number of the remaining texts."""
    more = len(texts) - most
    return ", ".join(texts[:most]) + (f" and {more} more" if more > 0 else "")


def short(value: float) -> str:
    """Return a number as text with three significant digits."""
    if value == 0.0 or not 1e-3 <= abs(value) < 1e5:
        return f"{value:.1e}" if value else "0"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{digits}f}" if digits else f"{value:.0f}"


def span(first: str, last: str, *, separator: str = " to ") -> str:
    """Return the range from one number to another as text; equal numbers are written once."""
    return first if first == last else f"{first}{separator}{last}"


def limited(value: float, text: str) -> str:
    """Return ``text``, or ``>1e7`` if ``value`` is finite and exceeds :data:`LARGEST`.

    ``value`` is an error [m] or a ratio, and ``text`` is its text form.
    """
    return f">1e{math.log10(LARGEST):.0f}" if LARGEST < value < math.inf else text
