"""Reduction of time-variable coefficients of ICGEM (gfct, trnd, acos, asin) to an epoch.

The value of a coefficient G (C or S) at the time t, with the value G(t0) of ``gfct``, is

G(t) = G(t0) + trnd (t − t0) + Σ acos cos(2π (t − t0)/p) + asin sin(2π (t − t0)/p)

Here trnd, acos and asin are not functions, but the values of the lines with these keywords.

The time t, the reference epoch t0 and the period p are in years (Ince et al., Earth System Science
Data 11 (2019) 647). In the format icgem2.0 each line has an interval of validity t0 to t1. Only
lines whose interval contains the epoch are used. In the older format each ``gfct`` line has the
reference epoch t0.
"""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..gravity.gradient_map import MapError

_VARYING = re.compile(rb"^[ \t]*(gfct|trnd|dot|acos|asin)\b[^\n]*", re.MULTILINE)
_TREND = ("trnd", "dot")  # dot is an older trnd


@dataclass
class _Coefficient:
    """C and S at a reference time [years], and time-variable terms (word, C, S, period [years])."""

    time: float
    values: tuple[float, float]
    terms: list[tuple[str, float, float, float]] = field(default_factory=list)

    def at(self, time: float) -> tuple[float, float]:
        """Return C and S at a time [years]."""
        since, (cosine, sine) = time - self.time, self.values
        for word, c, s, period in self.terms:
            factor = since
            if word not in _TREND:
                turn = math.cos if word == "acos" else math.sin
                factor = turn(math.tau * since / period)
            cosine, sine = cosine + factor * c, sine + factor * s
        return cosine, sine


def static(path: Path, body: bytes, intervals: bool, epoch: datetime.date | None) -> bytes:
    """Return the lines of a file's coefficients, reduced to an epoch.

    ``body`` contains the lines below the header of a file. ``intervals`` states whether the lines
    have an interval of validity (icgem2.0).

    Raises MapError if coefficients are time-variable and no epoch is given; if an epoch is given
    for static coefficients; if a line cannot be read; if the epoch lies outside all intervals.
    """
    lines = [match[0].decode("latin-1") for match in _VARYING.finditer(body)]
    if not lines:
        if epoch is not None:
            raise MapError(f"{path} is constant in time: remove --epoch.")
        return body
    if epoch is None:
        words = sorted({line.split()[0] for line in lines})
        raise MapError(
            f"{path}: the coefficients vary with time (lines {', '.join(words)}): give the date "
            "of the map, for example --epoch 2024-05-01."
        )
    time = _year(datetime.datetime.combine(epoch, datetime.time()))
    by_place = _coefficients(path, lines, intervals, time)
    rows = [
        f"gfc {n} {m} {c:.17e} {s:.17e}"
        for (n, m), coefficient in by_place.items()
        for c, s in [coefficient.at(time)]
    ]
    return _VARYING.sub(b"", body) + "\n".join(["", *rows, ""]).encode()


def _coefficients(
    path: Path, lines: Sequence[str], intervals: bool, time: float
) -> dict[tuple[int, int], _Coefficient]:
    """Return the coefficients, by degree and order, whose interval contains a time [years]."""
    by_place: dict[tuple[int, int], _Coefficient] = {}
    outside: set[tuple[int, int]] = set()
    parsed = [_parsed(path, line, intervals) for line in lines]
    for word, place, values, dates, _ in parsed:
        if word != "gfct":
            continue
        if intervals and not dates[0] <= time < dates[1]:
            outside.add(place)
        elif place in by_place:
            raise MapError(f"{path} has gfct of degree {place[0]}, order {place[1]} twice.")
        else:
            by_place[place] = _Coefficient(dates[0], values)
    for place in sorted(outside - by_place.keys()):
        raise MapError(
            f"{path}: no gfct line of degree {place[0]}, order {place[1]} has an interval that "
            "contains the epoch: choose another --epoch."
        )
    for word, place, values, dates, period in parsed:
        if word == "gfct" or (intervals and not dates[0] <= time < dates[1]):
            continue
        if place not in by_place:
            raise MapError(
                f"{path}: {word} of degree {place[0]}, order {place[1]} has no line gfct."
            )
        by_place[place].terms.append((word, *values, period))
    return by_place


def _parsed(
    path: Path, line: str, intervals: bool
) -> tuple[str, tuple[int, int], tuple[float, float], list[float], float]:
    """Return word, degree and order, C and S, dates [years] and period [years] of a line."""
    word, *cells = line.split()
    try:
        place, values = (int(cells[0]), int(cells[1])), (_number(cells[2]), _number(cells[3]))
        rest, period = cells[4:], 0.0
        if word in ("acos", "asin"):
            period = _number(rest.pop())
        count = 2 if intervals else int(word == "gfct")
        dates = [_year(_date(cell)) for cell in rest[len(rest) - count :]] if count else []
        if len(dates) != count or not (period > 0.0 or word not in ("acos", "asin")):
            raise ValueError
    except (ValueError, IndexError):
        expected = "t0 and t1" if intervals else "t0 (gfct)"
        raise MapError(
            f"{path}: the line {line.strip()[:60]!r} cannot be read: expected are degree, order, "
            f"C, S, {expected} as yyyymmdd, and a period in years (acos, asin)."
        ) from None
    return word, place, values, dates, period


def _number(cell: str) -> float:
    return float(cell.lower().replace("d", "e"))


def _date(cell: str) -> datetime.datetime:
    """Return the date of ``yyyymmdd`` or ``yyyymmdd.hhmm``."""
    day, _, clock = cell.partition(".")
    time = f"{clock:0<4}"[:4]
    return datetime.datetime.strptime(day + time, "%Y%m%d%H%M")


def _year(date: datetime.datetime) -> float:
    """Return a date as a decimal year."""
    start, end = datetime.datetime(date.year, 1, 1), datetime.datetime(date.year + 1, 1, 1)
    return date.year + (date - start) / (end - start)
