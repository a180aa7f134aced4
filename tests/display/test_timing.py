"""Time as a user reads it: on the wall, and of all processors together."""

from __future__ import annotations

import subprocess
import sys

import pytest

from ggbench.display.timing import Moment, duration
from ggbench.figures.numbers import counted

BUSY_S = 0.2
_BUSY = f"import time\nwhile time.process_time() < {BUSY_S}: pass"


def test_processor_time_of_workers_counts():
    """What processes used that this one has started and seen the end of is part of it."""
    start = Moment.now()
    subprocess.run([sys.executable, "-c", _BUSY], check=True)
    assert Moment.now().processor - start.processor >= BUSY_S


def test_both_times_are_told():
    now = Moment.now()
    told = now._replace(wall=now.wall - 100.0, processor=now.processor - 7200.0).since()
    assert told.startswith("100 s, and 2.0 h of processor time")


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0 s"), (599.0, "599 s"), (660.0, "11 min"), (7200.0, "2.0 h")]
)
def test_a_duration(seconds, text):
    assert duration(seconds) == text


@pytest.mark.parametrize(("count", "text"), [(0, "0 runs"), (1, "1 run"), (2, "2 runs")])
def test_one_is_singular(count, text):
    assert counted(count, "run") == text
