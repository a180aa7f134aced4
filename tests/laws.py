"""What statistical tests share: where a law of chance has nearly all of its probability."""

from __future__ import annotations

from typing import Any

ALARM = 1e-4
"""Probability of a false alarm of a statement that names no other."""


def likely(value: float, law: Any, alarm: float = ALARM) -> bool:
    """Whether a value lies where a law (of scipy.stats) has all but ``alarm`` of itself."""
    return bool(law.ppf(0.5 * alarm) <= value <= law.ppf(1.0 - 0.5 * alarm))
