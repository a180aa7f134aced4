"""Timing many implementations in turn, each in a process of its own."""

from __future__ import annotations

import contextlib
import json
import re
import statistics
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from . import environments


@dataclass(frozen=True)
class Entry:
    """An implementation that is measured.

    Attributes
    ----------
    key : how :mod:`.worker` names it.
    title : how the report names it.
    family : ``ekf``, ``ukf``, ``batch``, or how many particles: with whose results it must agree;
        empty: no results.
    environment : the optional environment it runs in; empty for the benchmark's own.
    """

    key: str
    title: str
    family: str
    environment: str = ""


@dataclass
class Measured:
    """What came out. Without ``turns`` it was not timed, and ``refusal`` says why."""

    entry: Entry
    refusal: str = ""
    difference: float | None = None
    first_call: float = float("nan")
    loaded: int = 0
    peak: int = 0
    versions: dict[str, str] = field(default_factory=dict)
    turns: list[dict[str, Any]] = field(default_factory=list)

    @property
    def seconds(self) -> list[float]:
        """Seconds per run in every round."""
        return [turn["seconds"] / turn["runs"] for turn in self.turns]

    @property
    def best(self) -> float:
        """The best round's seconds per run."""
        return min(self.seconds)

    @property
    def median(self) -> float:
        """The median of the rounds' seconds per run."""
        return statistics.median(self.seconds)

    @property
    def processor(self) -> float:
        """The best round's processor seconds per run, which other work on the machine leaves be."""
        return min(turn["cpu_seconds"] / turn["runs"] for turn in self.turns)

    @property
    def cores(self) -> float:
        """Processor seconds per second."""
        return sum(t["cpu_seconds"] for t in self.turns) / sum(t["seconds"] for t in self.turns)


Judge = Callable[[Entry, np.ndarray, np.ndarray], tuple[float, str]]
"""Of an entry, its means and its family's: how far they are apart, and what is wrong, if it is."""


def within(scale: np.ndarray, tolerances: dict[str, float]) -> Judge:
    """Return the judge of implementations that give the same numbers.

    Parameters
    ----------
    scale : standard deviations (n,) of the prior.
    tolerances : the largest difference of means, in these deviations, for each family.
    """

    def judge(entry: Entry, means: np.ndarray, expected: np.ndarray) -> tuple[float, str]:
        difference = float(np.abs((means - expected) / scale).max())
        allowed = tolerances[entry.family]
        if difference <= allowed:
            return difference, ""
        return difference, (
            f"its means differ by {difference:.1e} deviations of the prior, "
            f"{allowed:.0e} are allowed"
        )

    return judge


class Died(Exception):
    """The process of an implementation ended without an answer."""


class _Process:
    """A worker and the lines between it and us."""

    def __init__(self, entry: Entry, problem: Path, folder: Path) -> None:
        python = environments.python_of(entry.environment, folder)
        name = "".join(c if c.isalnum() else "-" for c in entry.key)
        self.means = folder / f"{name}.npy"
        self.log = folder / f"{name}.log"
        with self.log.open("w") as log:
            self._process = subprocess.Popen(
                [python, "-m", "speed.worker", entry.key, str(problem), str(self.means)],
                env=environments.variables(), stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=log, text=True,
            )  # fmt: skip

    def answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            self._process.wait()
            said = self.log.read_text().strip().splitlines() or ["it said nothing"]
            raise Died(said[-1])
        found: dict[str, Any] = json.loads(line)
        return found

    def ask(self, seconds: float) -> dict[str, Any]:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # there is no answer then, either
            self._process.stdin.write(json.dumps({"seconds": seconds}) + "\n")
            self._process.stdin.flush()
        return self.answer()

    def stop(self) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        self._process.wait()


def plain(error: Exception) -> str:
    """Return what an error says, without its class and the folders of this machine."""
    said = re.sub(r"^[\w.]*(Error|Exception): ", "", str(error))
    return said.replace(f"{Path.cwd()}/", "").replace(f"{Path.home()}/", "~/").rstrip(".")


def measure(
    entries: list[Entry],
    problem: Path,
    folder: Path,
    judge: Judge,
    rounds: int,
    seconds: float,
) -> list[Measured]:
    """Start every implementation, compare its means, and time those that agree in turn.

    Parameters
    ----------
    entries : the first of each family is the reference of its means.
    problem : the file that the problem is in.
    folder : where optional environments, means and what processes say are kept.
    judge : whether an implementation's means are those of its family.
    rounds, seconds : how often each is asked, and for how long.
    """
    found, running = [Measured(entry) for entry in entries], []
    references: dict[str, np.ndarray] = {}
    try:
        for item in found:
            entry = item.entry
            print(f"preparing {entry.title}", file=sys.stderr)
            try:
                process = _Process(entry, problem, folder)
                running.append((item, process))
                ready = process.answer()
            except (environments.EnvironmentFailed, Died) as error:
                item.refusal = plain(error)
                continue
            item.first_call, item.versions = ready["first_call"], ready["versions"]
            item.loaded, item.peak = ready["loaded"], ready["peak"]
            if entry.family:
                means = np.load(process.means)
                expected = references.setdefault(entry.family, means)
                item.difference, item.refusal = judge(entry, means, expected)
        for turn in range(rounds):
            print(f"round {turn + 1} of {rounds}", file=sys.stderr)
            for item, process in running:
                if not item.refusal:
                    try:
                        item.turns.append(process.ask(seconds))
                    except Died as error:
                        item.refusal, item.turns = f"it ended while timed: {plain(error)}", []
                        continue
                    item.peak = item.turns[-1]["peak"]
    finally:
        for _, process in running:
            process.stop()
    return found
