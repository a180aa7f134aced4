"""What a run's record says of the machine."""

from __future__ import annotations

import platform
import resource
import subprocess
import sys
from types import SimpleNamespace

import pytest

from ggbench.campaign.records import peak_memory_mb


@pytest.mark.parametrize(
    ("system", "reported"),
    [("FreeBSD", 300 * 2**10), ("Darwin", 300 * 2**20)],
)
def test_memory_is_in_one_unit_whatever_the_system_counts_in(system, reported, monkeypatch):
    """300 MiB are 300 MiB, where the kernel reports KiB and where it reports bytes."""
    monkeypatch.setattr(platform, "system", lambda: system)
    monkeypatch.setattr(resource, "getrusage", lambda who: SimpleNamespace(ru_maxrss=reported))
    assert peak_memory_mb() == 300.0


def test_memory_is_that_of_a_process_with_numpy_and_numba():
    """On the system at hand, whichever it is: neither kilobytes nor terabytes."""
    assert 30.0 < peak_memory_mb() < 30_000.0


@pytest.mark.long
@pytest.mark.skipif(platform.system() != "Linux", reason="getrusage(2) of Linux")
def test_memory_is_not_that_of_the_parent():
    """A parent of 1 GB starts a process of a quarter of it; control: getrusage says 1 GB."""
    code = (
        "import subprocess, sys\n"
        "held = bytearray(b'1') * 1_000_000_000\n"
        "print(subprocess.run([sys.executable, '-c', sys.argv[1]], capture_output=True, text=True,"
        " check=True).stdout)"
    )
    child = (
        "import resource\n"
        "from ggbench.campaign.records import peak_memory_mb\n"
        "print(peak_memory_mb(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, child], capture_output=True, text=True, check=True
    )
    own, counted = map(float, done.stdout.split())
    assert own < 600.0 and counted > 900.0
