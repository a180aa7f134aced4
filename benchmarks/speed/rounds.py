"""Rounds of timing of many implementations, each in a separate process."""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from . import environments


@dataclass(frozen=True)
class Entry:
    """Implementation to be measured.

    Attributes
    ----------
    key : name for :mod:`.worker`.
    title : name on the page.
    family : ``ekf``, ``ukf`` or ``batch``; the means within a family must agree.
    environment : optional environment of the implementation; empty for the present environment.
    """

    key: str
    title: str
    family: str
    environment: str = ""


@dataclass
class Measured:
    """Results of an implementation.

    ``turns`` contains one result per round. It is empty if the implementation was not timed; then
    ``refusal`` states the reason.
    """

    entry: Entry
    refusal: str = ""
    difference: float = float("nan")
    first_call: float = float("nan")
    peak: float = float("nan")
    versions: dict[str, str] = field(default_factory=dict)
    turns: list[dict[str, Any]] = field(default_factory=list)

    def rows(self) -> list[dict[str, Any]]:
        """Return the rows of the table of rounds."""
        return [
            {
                "family": self.entry.family,
                "implementation": self.entry.title,
                "round": number,
                "processor_ms_per_run": 1e3 * turn["cpu_seconds"] / turn["runs"],
                "wall_ms_per_run": 1e3 * turn["seconds"] / turn["runs"],
            }
            for number, turn in enumerate(self.turns, start=1)
        ]

    def row(self) -> dict[str, Any]:
        """Return the row of the table of implementations."""
        return {
            "family": self.entry.family,
            "implementation": self.entry.title,
            "largest_difference_prior_sd": self.difference,
            "first_call_s": self.first_call,
            "peak_memory_mb": self.peak / 1e6,
            "not_timed_because": self.refusal,
        }


class Died(Exception):
    """The process of an implementation ended without an answer."""


class _Process:
    """Worker process; requests and answers are lines of JSON."""

    def __init__(self, entry: Entry, problem: Path, folder: Path) -> None:
        python = environments.python_of(entry.environment, folder)
        name = "".join(c if c.isalnum() else "-" for c in entry.key)
        self.means = folder / f"{name}.npy"
        self.log = folder / f"{name}.log"
        with self.log.open("w") as log:
            self._process = subprocess.Popen(
                [python, "-m", "speed.worker", entry.key, str(problem), str(self.means)],
                env=environments.variables(),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )

    def answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            self._process.wait()
            said = self.log.read_text().strip().splitlines() or ["no message"]
            raise Died(said[-1])
        found: dict[str, Any] = json.loads(line)
        return found

    def ask(self, seconds: float) -> dict[str, Any]:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # answer() then raises Died
            self._process.stdin.write(json.dumps({"seconds": seconds}) + "\n")
            self._process.stdin.flush()
        return self.answer()

    def stop(self) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        self._process.wait()


def plain(error: Exception) -> str:
    """Return the message of an error, without its class and the folders of this machine."""
    said = re.sub(r"^[\w.]*(Error|Exception): ", "", str(error))
    return said.replace(f"{Path.cwd()}/", "").replace(f"{Path.home()}/", "~/").rstrip(".")


def disagreement(difference: float, allowed: float) -> str:
    """Return the reason for not timing an implementation; empty if its means agree."""
    if difference <= allowed:
        return ""
    return f"its means differ by {difference:.1e} prior σ; at most {allowed:.0e} is allowed"


def measure(
    entries: list[Entry],
    problem: Path,
    folder: Path,
    scale: np.ndarray,
    tolerances: dict[str, float],
    rounds: int,
    seconds: float,
) -> list[Measured]:
    """Return the results of all implementations; each round times those with correct means.

    Parameters
    ----------
    entries : implementations; the first of each family is the reference of the means.
    problem : file of the problem.
    folder : folder of the optional environments, and of the means and messages of the processes.
    scale : (n,) standard deviations of the prior.
    tolerances : largest allowed difference of the means for each family [prior σ].
    rounds : number of rounds.
    seconds : least time of each implementation in a round [s].
    """
    found, running = [Measured(entry) for entry in entries], []
    references: dict[str, np.ndarray] = {}
    try:
        for item in found:
            family = item.entry.family
            print(f"preparing {item.entry.key}", file=sys.stderr)
            try:
                process = _Process(item.entry, problem, folder)
                running.append((item, process))
                ready = process.answer()
            except (environments.EnvironmentFailed, Died) as error:
                item.refusal = plain(error)
                continue
            item.first_call, item.versions = ready["first_call"], ready["versions"]
            item.peak = ready["peak"]
            means = np.load(process.means)
            expected = references.setdefault(family, means)
            item.difference = float(np.abs((means - expected) / scale).max())
            item.refusal = disagreement(item.difference, tolerances[family])
        for turn in range(rounds):
            print(f"round {turn + 1} of {rounds}", file=sys.stderr)
            for item, process in running:
                if not item.refusal:
                    try:
                        item.turns.append(process.ask(seconds))
                    except Died as error:
                        item.refusal, item.turns = f"its process ended: {plain(error)}", []
    finally:
        for _, process in running:
            process.stop()
    return found
