"""What a run's record says of the machine."""

from __future__ import annotations

import platform
import resource
from types import SimpleNamespace

import pytest

from ggbench.campaign.records import peak_memory_mb


@pytest.mark.parametrize(
    ("system", "reported"),
    [("Linux", 300 * 2**10), ("FreeBSD", 300 * 2**10), ("Darwin", 300 * 2**20)],
)
def test_memory_is_in_one_unit_whatever_the_system_counts_in(system, reported, monkeypatch):
    """300 MiB are 300 MiB, where the kernel reports KiB and where it reports bytes."""
    monkeypatch.setattr(platform, "system", lambda: system)
    monkeypatch.setattr(resource, "getrusage", lambda who: SimpleNamespace(ru_maxrss=reported))
    assert peak_memory_mb() == 300.0


def test_memory_is_that_of_a_process_with_numpy_and_numba():
    """On the system at hand, whichever it is: neither kilobytes nor terabytes."""
    assert 30.0 < peak_memory_mb() < 30_000.0
