"""Numbers and names as the report says them."""

from __future__ import annotations

from ggbench.figures.numbers import short
from ggbench.matchability.information import Instrument

from . import design
from .association import Spread

TITLES = {region.name: region.title for region in design.REGIONS}
_KINDS = {"tensor": "six components", "uu": "Γ_UU alone", "gravity": "a gravimeter"}


def value(spread: Spread, i: int, signed: bool = False) -> str:
    """Return the number of an index with its interval."""
    return with_interval(
        float(spread.value[i]),
        float(spread.low[i]),
        float(spread.high[i]),
        "+.2f" if signed else "",
    )


def with_interval(value: float, low: float, high: float, digits: str = "") -> str:
    """Return a number and the ends of its interval."""
    digits = digits or ".2f"
    return f"{value:{digits}} ({low:{digits}} to {high:{digits}})"


def percent(share: float) -> str:
    """Return a share."""
    return f"{short(100.0 * share)} %"


def share(found: tuple[float, float, float]) -> str:
    """Return a share with its interval."""
    middle, low, high = found
    return f"{percent(middle)} ({percent(low)} to {percent(high)})"


def listed(parts: list[str], last: str = "and") -> str:
    """Return a list in words."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} {last} {parts[-1]}"


def instrument(what: Instrument) -> str:
    """Return an instrument in words."""
    return f"{_KINDS[what.kind]} of {what.noise:g} {what.unit}"
