"""Description of the benchmark machine."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import pandas as pd


def load() -> float:
    """Return the load average of the last minute."""
    return os.getloadavg()[0]


def processor() -> str:
    """Return the name of the processor."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def describe(load_before: float, versions: dict[str, str]) -> pd.DataFrame:
    """Return a table of ``property`` and ``value``: processor, load, system, versions."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    found = {
        "processor": f"{processor()} ({platform.machine()})",
        "cores": usable,
        "system": f"{platform.system()} {platform.release()}",
        "load_average_before": f"{load_before:.1f}",
        "load_average_after": f"{load():.1f}",
    } | versions
    return pd.DataFrame(found.items(), columns=["property", "value"])
