"""Wall-clock and processor times as text."""

from __future__ import annotations

import resource
import time
from typing import NamedTuple

from ..figures.numbers import short

_MINUTES_FROM_S = 600.0
COLD = "* first runs only, including loading and compilation; further runs take less"
"""Explanation of the star after a time."""


def duration(seconds: float) -> str:
    """Return a duration [s] as text; negative durations, after a clock change, are 0 s."""
    seconds = max(seconds, 0.0)
    if seconds < _MINUTES_FROM_S:
        return f"{seconds:.0f} s"
    if seconds < 5400.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"


class Moment(NamedTuple):
    """Wall-clock time, and processor time of this process and its ended children [s]."""

    wall: float
    processor: float

    @classmethod
    def now(cls) -> Moment:
        """Return the present moment."""
        usage = [resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return cls(time.monotonic(), sum(each.ru_utime + each.ru_stime for each in usage))

    def since(self) -> str:
        """Return the wall-clock and processor times elapsed since this moment, as text."""
        now = self.now()
        wall, processor = _text(now.wall - self.wall), _text(now.processor - self.processor)
        return f"{wall}, and {processor} of processor time"


def _text(seconds: float) -> str:
    return duration(seconds) if seconds >= _MINUTES_FROM_S else f"{short(max(seconds, 0.0))} s"
