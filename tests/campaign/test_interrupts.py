"""Requests to end: the first lets finish what must be finished, the second does not."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import click
import psutil
import pytest
from campaigns import DEADLINE_S, DEADLY, command, plan, stored
from click.testing import CliRunner
from problems import SMALL

from ggbench.campaign import execution, worker
from ggbench.cli.commands import Commands
from ggbench.cli.interrupts import requests_to_end
from ggbench.files.writing import asked_to_end, written_together

STUBBORN = """
import pathlib, time
from dataclasses import dataclass
from ggbench.problem import Estimator


@dataclass(frozen=True)
class Stubborn(Estimator):
    name = "stubborn"
    causality = "filter"

    def estimate(self, problem, rng):
        while True:
            try:
                pathlib.Path("here").touch()
                time.sleep(0.01)
            except KeyboardInterrupt:
                pathlib.Path("swallowed").touch()
"""


def wait_for(happened: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not happened():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.long
@pytest.mark.parametrize("second", [signal.SIGINT, signal.SIGTERM])
def test_the_second_request_ends_what_swallows_the_first(second, tmp_path, started):
    """Whatever the command is at, and whatever became of the first request."""
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "stubborn.py").write_text(STUBBORN)
    process = started(tmp_path, command(tmp_path / "out", "-j", "0", "-e", "stubborn.py"))
    wait_for((tmp_path / "here").exists)
    process.send_signal(signal.SIGINT)
    wait_for((tmp_path / "swallowed").exists)
    process.send_signal(second)
    _, errors = process.communicate(timeout=DEADLINE_S)
    assert (process.returncode, errors) == (130, "Ended at once.\n")


@pytest.mark.long
@pytest.mark.parametrize(
    "signals",
    [(signal.SIGINT, signal.SIGINT), (signal.SIGINT, signal.SIGTERM)],
    ids=lambda signals: signals[1].name,
)
def test_two_requests_at_any_moments_leave_nothing_alive(signals, tmp_path, started):
    """In the middle of runs, while workers are ended, tables written, or the command ends."""
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "deadly.py").write_text(DEADLY.replace("THRESHOLD", "-1e9"))
    moment = random.Random(3)
    for number, longest in enumerate((0.05, 1.0)):
        folder = tmp_path / f"out{number}"
        label = "deadly.py[way=sleep,seconds=0.05]"
        process = started(tmp_path, command(folder, "-n", "500", "-j", "2", "-e", label))
        wait_for(lambda folder=folder: stored(folder) > 4)
        everyone = psutil.Process(process.pid).children(recursive=True)
        assert len(everyone) >= 2
        process.send_signal(signals[0])
        time.sleep(moment.uniform(0.0, longest))
        process.send_signal(signals[1])
        _, errors = process.communicate(timeout=DEADLINE_S)
        # Or by the signal itself, when Python has ended already and is only taken down.
        assert process.returncode in (130, -signals[1])
        assert errors in ("", "Interrupted.\n", "Ended at once.\n")
        _, alive = psutil.wait_procs(everyone, timeout=DEADLINE_S)
        assert not alive


@pytest.mark.long
def test_an_interrupt_while_workers_are_ended_ends_them_all(tmp_path, monkeypatch):
    """In a notebook, where the process lives on: the interrupt comes through, no worker stays."""
    work = plan(tmp_path, "out", ("ins",), runs=40)
    store, _ = work.open()
    results = execution.in_processes(work.tasks(store), 2, 60.0)
    others = psutil.Process().children()  # of other tests, or of Python
    next(results)
    workers = [child for child in psutil.Process().children() if child not in others]
    assert len(workers) == 2
    real, calls = worker.orphan_processes.kill_marked, []

    def interrupted(marks):
        calls.append(marks)
        if len(calls) < 3:
            raise KeyboardInterrupt
        real(marks)

    monkeypatch.setattr(worker.orphan_processes, "kill_marked", interrupted)
    with pytest.raises(KeyboardInterrupt):
        results.close()
    assert len(calls) == 3
    assert not [w for w in workers if w.is_running() and w.status() != psutil.STATUS_ZOMBIE]
    assert not worker.living_workers


def test_a_signal_that_is_ignored_stays_so():
    """After ``nohup`` the end of a terminal ends nothing; other handlers come back afterwards."""
    before = {each: signal.getsignal(each) for each in (signal.SIGHUP, signal.SIGINT)}
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with requests_to_end(130):
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            assert signal.getsignal(signal.SIGINT) is not before[signal.SIGINT]
        assert signal.getsignal(signal.SIGINT) is before[signal.SIGINT]
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


def started_as(name: str) -> subprocess.CompletedProcess[str]:
    """A process of this name that is interrupted while it imports the commands."""
    code = (
        "import os, signal, sys\n"
        "class Interrupting:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'click':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        f"sys.argv[0] = {name!r}\n"
        "sys.meta_path.insert(0, Interrupting())\n"
        "import ggbench.cli.main\n"
    )
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_an_interrupt_before_a_command_begins_is_a_sentence():
    """Exit code 130; control: a program that imports the package keeps Python's own way."""
    done = started_as("/usr/bin/ggbench")
    assert (done.returncode, done.stderr) == (130, "Interrupted.\n")
    assert "Traceback" in started_as("program").stderr


@pytest.mark.parametrize("way", ["returns", "exits", "fails"])
def test_a_command_that_swallows_an_interrupt_ends_with_130(way):
    """As libraries do in their callbacks; an exit code of its own stays."""

    @click.group(cls=Commands)
    def group() -> None:
        pass

    @group.command()
    def work() -> None:
        with contextlib.suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(5)
        if way != "returns":
            sys.exit(0 if way == "exits" else 3)

    done = CliRunner().invoke(group, ["work"])
    asked_to_end.clear()
    expected = (3, "") if way == "fails" else (130, "Interrupted.\n")
    assert (done.exit_code, done.stderr) == expected


def test_files_are_written_together_or_not_at_all(tmp_path):
    """An interrupt between two files leaves neither, and no folder that was not there."""

    def write(folder: Path, last: BaseException | None) -> None:
        with written_together(folder) as place:
            (place / "data").mkdir()
            (place / "data" / "one").write_text("new")
            if last:
                raise last
            (place / "two").write_text("new")

    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "two").write_text("old")
    for folder in ("old", "new"):
        with pytest.raises(KeyboardInterrupt):
            write(tmp_path / folder, KeyboardInterrupt())
    assert [path.name for path in tmp_path.rglob("*")] == ["old", "two"]
    assert (tmp_path / "old" / "two").read_text() == "old"
    write(tmp_path / "old", None)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["data", "old", "one", "two"]
    assert (tmp_path / "old" / "two").read_text() == "new"
