"""``make frameworks``: measure every framework and write ``reports/frameworks.md``."""

from __future__ import annotations

import importlib.metadata
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from jinja2 import Template

from ggbench.errors import GGBenchError
from ggbench.files import written_whole

from .packages import FRAMEWORKS, OTHERS, Framework

PAGE = Path("reports") / "frameworks.md"
TEMPLATE = Path(__file__).with_name("frameworks.md.j2")
SAME = 1e-6
"""Difference [prior σ] up to which two answers are the same."""


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


def rows() -> list[list[str]]:
    """Return the cells of the table, a row for each estimator."""
    found = []
    for framework in FRAMEWORKS:
        print(framework.label, flush=True)
        held = measured(framework)
        same = held["difference"]
        lines = len(Path(framework.adapter).read_text(encoding="utf-8").splitlines())
        version = importlib.metadata.version(framework.distributions[0])
        found.append(
            [
                f"{framework.name} {version}",
                f"`{framework.label}`",
                f"{same:.0e}" + ("" if same <= SAME else " (other points)"),
                f"{held['ms']:.3g}",
                f"{held['first_ms']:.0f}",
                f"{held['memory_mb']:.0f}",
                f"{size_mb(framework):.3g}",
                str(lines),
                held["contract"],
                held["wide"],
                held["indefinite"],
                held["nan"],
                licence(framework),
            ]
        )
    return found


HEAD = [
    "package", "estimator", "largest difference [prior σ]", "ms/run", "first run [ms]",
    "memory [MB]", "installation [MB]", "lines of adapter", "contract", "wide prior",
    "indefinite prior", "NaN measured", "licence",
]  # fmt: skip


PROPERTIES = [
    "package", "estimator", "singular Q", "missing channels", "R of each epoch",
    "robust loss per channel",
]  # fmt: skip


def table(head: list[str], body: list[list[str]]) -> str:
    """Return a table in markdown."""
    lines = [head, ["---"] * len(head), *body]
    return "\n".join("|" + "|".join(line) + "|" for line in lines)


def page() -> str:
    """Return the text of the page."""
    body = rows()
    names = list(dict.fromkeys(framework.name for framework in FRAMEWORKS))
    same = [row[1] for row in body if "other" not in row[2]]
    timed = {row[1]: float(row[3]) for row in body if "ekf" in row[1]}
    order = sorted(timed, key=lambda label: timed[label])
    properties = [
        [f.name, f"`{f.label}`", f.singular, f.missing, f.noise, f.loss] for f in FRAMEWORKS
    ]
    template = Template(TEMPLATE.read_text(encoding="utf-8"), keep_trailing_newline=True)
    return template.render(
        frameworks=len(names),
        same=len(same),
        rows=len(body),
        limit=f"{SAME:g}",
        fastest=order[0],
        least_ms=f"{timed[order[0]]:.3g}",
        slowest=order[-1],
        most_ms=f"{timed[order[-1]]:.3g}",
        measured=table(HEAD, body),
        properties=table(PROPERTIES, properties),
        others=table(["package", "reason"], [list(row) for row in OTHERS]),
    )


if __name__ == "__main__":
    with written_whole(PAGE, GGBenchError) as temporary:
        temporary.write_text(page(), encoding="utf-8")
    print(f"Wrote {PAGE}")
