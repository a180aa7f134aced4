"""Command of ``make frameworks``: measurement of all frameworks, table and page."""

from __future__ import annotations

import importlib.metadata
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pandas as pd

from ggbench.errors import GGBenchError
from ggbench.files.writing import written_whole

from . import page
from .packages import FRAMEWORKS, Framework

REPORTS = Path("reports")


def measured(framework: Framework) -> dict[str, Any]:
    """Measure an estimator in a separate process; return the results and its contract checks."""
    command = [sys.executable, "-m", "frameworks.worker", framework.label, framework.reference]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    command = [str(Path(sys.executable).with_name("ggbench")), "check", framework.label]
    checked = subprocess.run(command, capture_output=True, text=True, check=False)
    found["contract"] = checked.stdout.strip().splitlines()[-1].split(" checks")[0]
    failed = [line for line in checked.stdout.splitlines() if line.startswith("FAILED")]
    if failed:
        found["contract"] += ": not " + ", ".join(line.split(": ")[1] for line in failed)
    return found


def size_mb(framework: Framework) -> float:
    """Return the total size of the files of a framework's distributions [MB]."""
    total = 0
    for name in framework.distributions:
        for file in importlib.metadata.files(name) or ():
            path = Path(str(file.locate()))
            total += path.stat().st_size if path.is_file() else 0
    return total / 1e6


def licence(framework: Framework) -> str:
    """Return the licence from a framework's metadata; "see package" without a short text."""
    held = importlib.metadata.metadata(framework.distributions[0])
    texts = [held.get("License-Expression"), held.get("License")]
    texts += [c.split("::")[-1].strip() for c in held.get_all("Classifier") or () if "License" in c]
    return next(
        (t.splitlines()[0] for t in texts if t and len(t.splitlines()[0]) < 40), "see package"
    )


def row(framework: Framework) -> dict[str, Any]:
    """Measure an estimator and return its table row, by column title."""
    print(framework.label, flush=True)
    held = measured(framework)
    lines = len(Path(framework.adapter).read_text(encoding="utf-8").splitlines())
    return {
        "package": f"{framework.name} {importlib.metadata.version(framework.distributions[0])}",
        "estimator": framework.label,
        "difference [prior σ]": held["difference"],
        "contract": held["contract"],
        "ms/run": held["ms"],
        "first run [ms]": held["first_ms"],
        "memory [MB]": held["memory_mb"],
        "installation [MB]": size_mb(framework),
        "adapter [lines]": lines,
        "licence": licence(framework),
        "singular Q": framework.singular,
        "missing channels": framework.missing,
        "R of each epoch": framework.noise,
        "robust loss per channel": framework.loss,
        "wide prior": held["wide"],
        "indefinite prior": held["indefinite"],
        "NaN measured": held["nan"],
    }


if __name__ == "__main__":
    path = REPORTS / page.FOLDER / page.TABLE
    path.parent.mkdir(exist_ok=True)
    with written_whole(path, GGBenchError) as temporary:
        rows = pd.DataFrame(map(row, FRAMEWORKS))
        rows.to_csv(temporary, index=False, float_format="%.4g")
    print(f"Wrote {path} and {page.write(REPORTS)}")
