"""Estimators that print, leave processes running, or write where they must not."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from campaigns import DEADLINE_S, command, ran
from command import invoke
from problems import SMALL

from ggbench.campaign.captured_output import CapturedOutput
from ggbench.campaign.execution import ExecutionError
from ggbench.report import render
from ggbench.results.folder import Results

SECONDS = f"86397.{os.getpid()}"
"""That somebody sleeps: known among all processes, and to no other run of the tests."""
WILD = """
import contextlib, ctypes, os, stat, subprocess, sys, time
from dataclasses import dataclass
from typing import Literal
import numpy as np
from ggbench.problem import Estimate, Estimator

FLOOD = 400


@dataclass(frozen=True)
class Wild(Estimator):
    way: Literal["child", "own session", "orphan", "fork", "scribble", "flood", "escapes",
                 "native", "last words", "closed", "good"] = "good"
    fails: bool = False
    name = "wild"
    causality = "filter"

    def estimate(self, problem, rng):
        if self.way == "child":
            subprocess.Popen(["sleep", "SECONDS"])
        if self.way == "own session":
            subprocess.Popen(["sleep", "SECONDS"], start_new_session=True)
        if self.way == "orphan":
            subprocess.run("setsid sleep SECONDS & sleep 0.05", shell=True)
        if self.way == "fork" and os.fork() == 0:
            os.setsid()
            os.execlp("sleep", "sleep", "SECONDS")
        if self.way == "scribble":
            for name in range(3, 10_000):
                with contextlib.suppress(OSError):
                    if stat.S_ISSOCK(os.fstat(name).st_mode):
                        os.write(name, b"hello world, hello world, hello world!")
        if self.way == "flood":
            for _ in range(FLOOD):
                os.write(2, b"x" * 1_000_000)
        if self.way == "escapes":
            print("\\x1b[2J\\x1b]0;title\\x07", flush=True)
        if self.way == "native":
            libc = ctypes.CDLL(None)
            libc.printf(b"said by C\\n")
            subprocess.run(["echo", "said by a child"])
            print("said by Python", end="")
        if self.way == "last words":
            print("this is the end")
            os.abort()
        if self.way == "closed":
            os.closerange(1, 3)
        if self.fails:
            raise ArithmeticError("on purpose")
        cov = np.tile(problem.prior_cov, (problem.epochs, 1, 1))
        return Estimate(np.zeros((problem.epochs, problem.dimension)), cov, "filter")
""".replace("SECONDS", SECONDS)


def running() -> list[psutil.Process]:
    """The processes that the estimator has started and that have not ended."""
    found = []
    for process in psutil.process_iter(["cmdline"]):
        if SECONDS in (process.info["cmdline"] or []):
            found.append(process)
    return found


@pytest.fixture
def wild(tmp_path, monkeypatch) -> Iterator[Path]:
    """A folder with a scenario and an estimator that misbehaves; what that starts is ended."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "wild.py").write_text(WILD)
    yield tmp_path
    for process in running():
        process.kill()


def tried(folder: Path, *ways: str) -> Results:
    """The results of one run for each way to misbehave, and of the INS, in one worker process."""
    labels = (*(f"wild.py[{way}]" for way in ways), "ins")
    results = ran(folder, labels=labels, runs=1, jobs=1, cases=("base",))
    assert [r["status"] for r in results.records() if r["estimator"] == "ins"] == ["ok"]
    return results


@pytest.mark.long
def test_processes_left_running_end_and_are_told(wild):
    """They hold no campaign, whatever group or session they have fled to; their runs say so."""
    ways = ("child", "own session", "orphan", "fork")
    results = tried(wild, *(f"way={way}" for way in ways), "way=good")
    assert running() == []
    table = results.runs()
    assert (table["status"] == "ok").all()
    left = "left 1 process running; they were ended with the run"
    assert table["remark"].tolist() == [left] * 4 + [""] * 2
    render.write(results.folder, wild / "reports")
    remarks = next((wild / "reports").glob("*/data/remarks.csv")).read_text()
    assert f"wild[way=orphan],{left},1" in remarks


@pytest.mark.long
def test_processes_end_with_a_worker_that_is_killed(wild, started):
    """The command is killed in the middle of a run: what the estimator had started ends, too."""
    text = WILD.replace(
        "        if self.fails:",
        "        if self.way != 'good': time.sleep(1e6)\n        if self.fails:",
    )
    (wild / "wild.py").write_text(text)
    process = started(wild, command(wild / "out", "-n", "1", "-e", "wild.py[way=own session]"))
    deadline = time.monotonic() + DEADLINE_S
    while not running():
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
    process.kill()
    while running():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.long
def test_what_is_written_into_the_connection_is_a_failure(wild):
    """Bytes that are no results cost their own runs alone; the campaign goes on to its end."""
    (record, _) = tried(wild, "way=scribble").records()
    assert record["reason"].endswith("the estimator wrote to the socket for results, twice")


@pytest.mark.long
def test_a_flood_reaches_neither_screen_nor_disk(wild, capfd):
    """400 MB on standard error: a failure keeps their end, and how many they were."""
    flooded, failed, _ = tried(wild, "way=flood", "way=flood,fails=yes").records()
    assert capfd.readouterr() == ("", "")
    assert (flooded["status"], flooded["output"]) == ("ok", "")
    assert failed["output"].startswith("(400000000 bytes, ending with) xxx")
    assert len(failed["output"]) < 5000
    assert sum(file.stat().st_size for file in (wild / "out").iterdir()) < 1_000_000


@pytest.mark.long
def test_what_a_run_prints_belongs_to_it(wild, capfd):
    """By whomever it is printed; terminals are told nothing by it, and only failures keep it."""
    ways = ("way=native", "way=escapes,fails=yes", "way=native,fails=yes", "fails=yes")
    results = tried(wild, *ways, "way=last words")
    assert capfd.readouterr() == ("", "")
    quiet, escapes, native, silent, last, _ = (r["output"] for r in results.records())
    assert (quiet, silent) == ("", "")
    assert escapes == r"\x1b[2J\x1b]0;title\x07"
    assert sorted(native.splitlines()) == ["said by C", "said by Python", "said by a child"]
    assert last.startswith("this is the end")
    shown = invoke(["show", "out"], wild)
    assert "Output of the run: this is the end" in shown.stdout
    assert "\x1b" not in shown.stdout and "\x1b" not in capfd.readouterr().out


@pytest.mark.long
def test_an_estimator_may_close_its_output(wild):
    """Runs after it go on, and so does the worker."""
    assert (tried(wild, "way=closed", "way=closed,fails=no").runs()["status"] == "ok").all()


def test_workers_that_cannot_start_say_why(wild):
    """A worker's last words are part of the sentence: nothing else shows them."""
    (wild / "broken").mkdir()
    (wild / "broken" / "sitecustomize.py").write_text("raise SystemExit('no licence for this')")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(wild / "broken"))
        with pytest.raises(ExecutionError, match=r"during their start: .*no licence for this$"):
            ran(wild, labels=("ins",), runs=1, jobs=1)


@pytest.mark.parametrize("size", [1, 2, 3, 5, 7, 64])
def test_output_is_told_apart_however_it_arrives(size):
    """A seam between two runs is found wherever the pieces of the stream are cut."""
    seam = b"\0mark\0"
    stream = b"one" + seam + seam + b"\0mar three" + seam + b"four"
    reading, writing = os.pipe()
    printed = CapturedOutput(reading, seam)
    for start in range(0, len(stream), size):
        os.write(writing, stream[start : start + size])
        printed.read()
    os.close(writing)
    assert [printed.of_run() for _ in range(4)] == ["one", "", r"\x00mar three", "four"]
    assert printed.readable == []


def test_a_flood_is_not_kept_in_memory():
    """Of 40 MB only the end is held, and their number is told."""
    reading, writing = os.pipe()
    printed = CapturedOutput(reading, b"\0mark\0")

    def flood() -> None:
        for _ in range(40):
            os.write(writing, b"y" * 999_999 + b"\n")
        os.close(writing)

    thread = threading.Thread(target=flood)
    thread.start()
    most = 0
    while printed.readable:
        printed.read()
        most = max(most, len(printed._end))
    thread.join()
    assert most < 200_000
    text = printed.of_run()
    assert text.startswith("(40000000 bytes, ending with) yyy") and len(text) < 5000
