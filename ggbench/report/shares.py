"""Shares of runs and median times as sentences and tables have them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ..figures.numbers import short

SUCCESS = ("success_share", "success_lo", "success_hi")
"""Columns of the summary: share of success, and its 95 % interval."""


def percent(share: float) -> str:
    """Return a share in percent, its digits such that none and all are not claimed wrongly."""
    value = 100.0 * share
    if 0.0 < value < 1.0 or 99.0 < value < 100.0:
        return f"{value:.1f} %"
    return f"{value:.0f} %"


def share(row: Mapping[str, Any], *columns: str) -> str:
    """Return a share with its interval, from the columns of a row that have them."""
    value, low, high = (percent(row[column]) for column in columns)
    return f"{value} [{low}, {high}]"


def median_time(row: Mapping[str, Any], *columns: str) -> str:
    """Return a median time [s] with its interval if it has one, – where there is none."""
    value, low, high = (row[column] for column in columns)
    if math.isnan(value):
        return "–"
    return short(value) if math.isnan(low) else f"{short(value)} [{short(low)}, {short(high)}]"
