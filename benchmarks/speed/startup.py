"""How long the command takes to start, its compiled code being there already."""

from __future__ import annotations

import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from typing import Any

from . import environments, export

_ONE_RUN = ["run", export.SCENARIO, "--run", "0", "-c", export.CASE, "-e"]
COMMANDS = {
    f"ggbench {' '.join(words)}": words
    for words in (
        ["--help"],
        ["list"],
        ["validate", export.SCENARIO],
        [*_ONE_RUN, "ekf"],
        [*_ONE_RUN, "ekf"],
    )
}
CAMPAIGN_RUNS = 10_000
PAPERS_CASES = ("0.01E-1Hz", "0.001E-1Hz", "0.01E-0.2Hz")
BARE = "python -c pass"

COMMAND = "from ggbench.cli.main import main; main()"


def measure(rounds: int) -> dict[str, dict[str, float]]:
    """Return the best and the median wall time [s] of each command, run in turn after once each."""
    program = [sys.executable, "-c", COMMAND]
    commands = {BARE: [sys.executable, "-c", "pass"]}
    commands |= {name: [*program, *arguments] for name, arguments in COMMANDS.items()}
    times: dict[str, list[float]] = {name: [] for name in commands}
    for turn in range(rounds + 1):
        for name, command in commands.items():
            start = time.perf_counter()
            subprocess.run(
                command, check=True, env=environments.variables(), stdout=subprocess.DEVNULL
            )
            if turn:
                times[name].append(time.perf_counter() - start)
    return {
        name: {"best": min(found), "median": statistics.median(found)}
        for name, found in times.items()
    }


def campaign(runs: int, labels: Sequence[str]) -> dict[str, Any]:
    """Return the command of a campaign of the paper's cases with some estimators, and its time [s].

    From the start of the command to its end, on all processors: simulation, estimation, judgement,
    storage, tables.
    """
    words = ["run", export.SCENARIO, "-n", str(runs)]
    words += [word for case in PAPERS_CASES for word in ("-c", case)]
    words += [word for label in labels for word in ("-e", label)]
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        subprocess.run(
            [sys.executable, "-c", COMMAND, *words, "-o", folder],
            check=True, env=environments.variables(), stdout=subprocess.DEVNULL,
        )  # fmt: skip
        seconds = time.perf_counter() - start
    return {"command": f"ggbench {shlex.join(words)}", "seconds": seconds, "runs": runs}
