"""``make frameworks``: measure every framework and write ``reports/frameworks.md``."""

from __future__ import annotations

import importlib.metadata
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Template

from ggbench.errors import GGBenchError
from ggbench.files import written_whole

from .packages import FRAMEWORKS, OTHERS, Framework

PAGE = Path("reports") / "frameworks.md"
TEMPLATE = Path(__file__).with_name("frameworks.md.j2")
SAME = 1e-4
"""Difference [prior σ] up to which two answers are the same: where searches end."""


def measured(framework: Framework) -> dict[str, Any]:
    """Return what a process of its own measures of an estimator, and its contract."""
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
    """Return what the files of a framework's distributions occupy [MB]."""
    total = 0
    for name in framework.distributions:
        for file in importlib.metadata.files(name) or ():
            path = Path(str(file.locate()))
            total += path.stat().st_size if path.is_file() else 0
    return total / 1e6


def licence(framework: Framework) -> str:
    """Return the licence that a framework's metadata state, in a few words."""
    held = importlib.metadata.metadata(framework.distributions[0])
    texts = [held.get("License-Expression"), held.get("License")]
    texts += [c.split("::")[-1].strip() for c in held.get_all("Classifier") or () if "License" in c]
    return next(
        (t.splitlines()[0] for t in texts if t and len(t.splitlines()[0]) < 40), "see package"
    )


def row(framework: Framework) -> dict[str, str]:
    """Return what is measured of an estimator, by the heads of the columns."""
    print(framework.label, flush=True)
    held = measured(framework)
    lines = len(Path(framework.adapter).read_text(encoding="utf-8").splitlines())
    same = held["difference"] <= SAME
    return {
        "package": f"{framework.name} {importlib.metadata.version(framework.distributions[0])}",
        "estimator": f"`{framework.label}`",
        "difference [prior σ]": f"{held['difference']:.0e}" + ("" if same else ", other points"),
        "contract": held["contract"],
        "ms/run": f"{held['ms']:.3g}",
        "first run [ms]": f"{held['first_ms']:.0f}",
        "memory [MB]": f"{held['memory_mb']:.0f}",
        "installation [MB]": f"{size_mb(framework):.3g}",
        "adapter [lines]": str(lines),
        "licence": licence(framework),
        "singular Q": framework.singular,
        "missing channels": framework.missing,
        "R of each epoch": framework.noise,
        "robust loss per channel": framework.loss,
        "wide prior": held["wide"],
        "indefinite prior": held["indefinite"],
        "NaN measured": held["nan"],
    }


MEASURED = (
    "package",
    "estimator",
    "difference [prior σ]",
    "contract",
    "ms/run",
    "first run [ms]",
    "installation [MB]",
    "adapter [lines]",
)
BEHAVIOUR = (
    "package",
    "singular Q",
    "missing channels",
    "R of each epoch",
    "robust loss per channel",
    "indefinite prior",
    "NaN measured",
    "licence",
)


def table(rows: list[dict[str, str]], head: tuple[str, ...]) -> str:
    """Return columns of the first estimator of each package in markdown."""
    first = {row["package"]: row for row in reversed(rows)}
    names = dict.fromkeys(row["package"] for row in rows)
    body = [[first[name][key] for key in head] for name in names]
    lines = [list(head), ["---"] * len(head), *body]
    return "\n".join("|" + "|".join(line) + "|" for line in lines)


def page(rows: list[dict[str, str]]) -> str:
    """Return the text of the page."""
    same = [row for row in rows if "other" not in row["difference [prior σ]"]]
    timed = {
        row["estimator"]: float(row["ms/run"]) for row in rows if row["estimator"].endswith("ekf`")
    }
    order = sorted(timed, key=lambda label: timed[label])
    template = Template(TEMPLATE.read_text(encoding="utf-8"), keep_trailing_newline=True)
    return template.render(
        frameworks=len({row["package"] for row in rows}),
        same=len(same),
        rows=len(rows),
        limit=f"{SAME:g}",
        fastest=order[0],
        least_ms=f"{timed[order[0]]:.3g}",
        slowest=order[-1],
        most_ms=f"{timed[order[-1]]:.3g}",
        measured=table(rows, MEASURED),
        behaviour=table(rows, BEHAVIOUR),
        others="; ".join(f"{name} ({reason})" for name, reason in OTHERS),
    )


if __name__ == "__main__":
    found = [row(framework) for framework in FRAMEWORKS]
    with written_whole(PAGE, GGBenchError) as temporary:
        temporary.write_text(page(found), encoding="utf-8")
    with written_whole(PAGE.with_suffix(".csv"), GGBenchError) as temporary:
        pd.DataFrame(found).to_csv(temporary, index=False)
    print(f"Wrote {PAGE} and {PAGE.with_suffix('.csv')}")
