"""How long the command takes to start, its compiled code being there already."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time

from . import environments, export

COMMANDS = {
    "ggbench --help": ["--help"],
    f"ggbench run {export.SCENARIO} --run 0 -c {export.CASE} -e ekf": [
        "run", export.SCENARIO, "--run", "0", "-c", export.CASE, "-e", "ekf",
    ],
}  # fmt: skip
BARE = "python -c pass"


def measure(rounds: int) -> dict[str, dict[str, float]]:
    """Return the best and the median wall time [s] of each command, run in turn after once each."""
    program = [sys.executable, "-c", "from ggbench.cli import main; main()"]
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
