"""Nothing is lost: processes killed at any moment, full disks, dead and endless estimators."""

from __future__ import annotations

import os
import random
import re
import resource
import shlex
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd
import psutil
import pytest
from campaigns import COMMAND, assert_equal, ran
from problems import SMALL

from ggbench.cli import main
from ggbench.results import Results

DEADLINE_S = 240.0


def command(folder: Path, *options: str) -> list[str]:
    return [COMMAND, "run", "small.toml", "-s", "5", "-o", str(folder), *options]


def finish(cwd: Path, arguments: list[str], **options) -> subprocess.CompletedProcess:
    return subprocess.run(
        arguments, cwd=cwd, capture_output=True, text=True, timeout=DEADLINE_S, **options
    )


def stored(folder: Path) -> int:
    """Number of records in a folder that another process writes, 0 if there is none yet."""
    try:
        with sqlite3.connect(f"{(folder / 'records.sqlite').as_uri()}?mode=ro", uri=True) as found:
            return found.execute("SELECT count(*) FROM records").fetchone()[0]
    except sqlite3.Error:
        return 0


def kill_parent(process: subprocess.Popen, moment: random.Random) -> None:
    process.kill()


def kill_group(process: subprocess.Popen, moment: random.Random) -> None:
    os.killpg(process.pid, signal.SIGKILL)


def interrupt(process: subprocess.Popen, moment: random.Random) -> None:
    os.killpg(process.pid, signal.SIGINT)


def kill_worker_then_parent(process: subprocess.Popen, moment: random.Random) -> None:
    """Kill a worker, let the campaign go on for a moment, then kill that too."""
    workers = psutil.Process(process.pid).children()
    if workers:
        moment.choice(workers).kill()
    time.sleep(moment.uniform(0.0, 0.6))
    process.kill()


@pytest.fixture
def started() -> Iterator[Callable[..., subprocess.Popen]]:
    """Start commands, none of which outlives the test."""
    processes = []

    def start(cwd: Path, arguments: list[str]) -> subprocess.Popen:
        processes.append(
            subprocess.Popen(
                arguments, cwd=cwd, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
                start_new_session=True,
            )
        )  # fmt: skip
        return processes[-1]

    yield start
    for process in processes:
        with psutil_gone():
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


class psutil_gone:
    """Ignore that a process has ended already."""

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind, *rest) -> bool:
        return kind is not None and issubclass(kind, (ProcessLookupError, psutil.Error))


def test_two_thousand_runs_interrupted_ten_times(tmp_path, started):
    """A campaign killed and interrupted ten times at random moments ends as an undisturbed one.

    500 runs of two cases with two estimators. The moments (seeded) fall anywhere between two
    records; the ways alternate. What was stored before a kill is there after it.
    """
    (tmp_path / "small.toml").write_text(SMALL)
    moment = random.Random(9)
    ways = [kill_parent, kill_group, kill_worker_then_parent, interrupt, kill_parent] * 2
    run = command(tmp_path / "out", "-n", "500", "-j", "2")
    interruptions, held = 0, 0
    for way in ways:
        process = started(tmp_path, run)
        target = held + moment.randint(1, 60)
        deadline = time.monotonic() + DEADLINE_S
        while stored(tmp_path / "out") < target:
            assert process.poll() is None, process.stderr.read()
            assert time.monotonic() < deadline
            time.sleep(0.01)
        time.sleep(moment.uniform(0.0, 0.05))
        way(process, moment)
        _, errors = process.communicate(timeout=DEADLINE_S)
        assert process.returncode in (-signal.SIGKILL, 130), errors
        assert "Traceback" not in errors
        interruptions += 1
        assert stored(tmp_path / "out") >= target
        held = stored(tmp_path / "out")
    assert interruptions == 10
    assert held < 2000, "the campaign was over before it was interrupted ten times"
    done = finish(tmp_path, run)
    assert (done.returncode, done.stderr) == (0, "")
    disturbed = Results(tmp_path / "out")
    assert len(disturbed.table) == 2000
    assert_equal(disturbed, ran(tmp_path, "whole", ("ins", "ekf"), runs=500, jobs=2))


def in_child(action: Callable[[], None]) -> int:
    """Do something in a forked process; return how it ended, as subprocess does."""
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            action()
            code = 0
        except SystemExit as end:
            code = end.code or 0
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def killed_at_write(number: int, arguments: list[str]) -> int:
    """Run the command in a child that kills itself before its write ``number``; its exit code.

    Writes are: opening a file to write, renaming and removing one, making a folder, and every
    statement that reaches the database.
    """

    def run() -> None:
        left = number

        def tick(*_: object) -> None:
            nonlocal left
            left -= 1
            if left < 0:
                os.kill(os.getpid(), signal.SIGKILL)

        def connect(*arguments: object, **options: object) -> sqlite3.Connection:
            connection = plain_connect(*arguments, **options)
            connection.set_trace_callback(tick)
            return connection

        def watch(event: str, values: tuple) -> None:
            if event in ("os.rename", "os.remove", "os.mkdir") or (
                event == "open" and isinstance(values[2], int) and values[2] & os.O_ACCMODE
            ):
                tick()

        plain_connect, sqlite3.connect = sqlite3.connect, connect
        sys.addaudithook(watch)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.__stdout__.fileno())
        main(arguments, prog_name="ggbench")

    return in_child(run)


@pytest.mark.parametrize("options", [(), ("--fresh",)])
def test_a_power_cut_between_any_two_writes(options, tmp_path, monkeypatch):
    """Killed before its first write, its second, ...: every time the same command completes it.

    With --fresh the folder holds results of another seed, which are discarded on the way.
    """
    (tmp_path / "small.toml").write_text(SMALL)
    monkeypatch.chdir(tmp_path)
    whole = ran(tmp_path, "whole", ("ins", "ekf"), runs=2)
    run = ["run", "small.toml", "-s", "5", "-n", "2", "-j", "0"]
    number, code = len(options), -signal.SIGKILL
    while code != 0:
        folder = tmp_path / f"out{number}"
        if options:
            ran(tmp_path, folder.name, ("ins",), runs=1, seed=6).store.close()
        code = killed_at_write(number, [*run, "-o", str(folder), *options])
        assert code in (0, -signal.SIGKILL), f"ended with {code} at write {number}"
        if code:
            assert killed_at_write(10**9, [*run, "-o", str(folder)]) == 0
        assert_equal(Results(folder), whole)
        assert not list(folder.glob(".*.part"))
        number += 3  # every third write, to be quick; the offsets differ between the two forms
    assert number > 40


def test_a_full_disk(tmp_path):
    """When nothing more can be written, a sentence says so; what is stored stays.

    A limit on the size of files stands for the disk: the system refuses to let them grow.
    """
    (tmp_path / "small.toml").write_text(SMALL)
    run = command(tmp_path / "out", "-n", "200", "-j", "2")

    def small_disk() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, 400_000))

    done = finish(tmp_path, run, preexec_fn=small_disk)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert re.match(r"ggbench: cannot write .*out.*: .*the same command goes on", line)
    held = stored(tmp_path / "out")
    assert 0 < held < 800
    done = finish(tmp_path, run)
    assert (done.returncode, done.stderr) == (0, "")
    assert_equal(
        Results(tmp_path / "out"), ran(tmp_path, "whole", ("ins", "ekf"), runs=200, jobs=2)
    )


DEADLY = """
import ctypes, os, signal, time
from dataclasses import dataclass
from typing import Literal
import numpy as np
from ggbench.problem import Estimate, Estimator


@dataclass(frozen=True)
class Deadly(Estimator):
    way: Literal["exit", "segfault", "killed", "sleep", "raise", "none"] = "none"
    seconds: float = 0.0
    name = "deadly"
    causality = "filter"

    def estimate(self, problem, rng):
        if problem.measurements[0, 0] > THRESHOLD:
            if self.way == "exit":
                os._exit(7)
            if self.way == "segfault":
                ctypes.string_at(0)
            if self.way == "killed":
                os.kill(os.getpid(), signal.SIGKILL)
            if self.way == "raise":
                np.linalg.cholesky(-np.eye(2))
            time.sleep(self.seconds)
        cov = np.tile(problem.prior_cov, (problem.epochs, 1, 1))
        return Estimate(np.zeros((problem.epochs, problem.dimension)), cov, "filter")
"""


@pytest.fixture
def deadly(tmp_path) -> Path:
    """A folder with a scenario and an estimator that goes wrong in the upper half of its runs."""
    (tmp_path / "small.toml").write_text(SMALL)
    results = ran(tmp_path, "probe", ("ins",), runs=4)
    from ggbench import runner, simulation

    flight = runner.flight_of(results.scenario.cases[0])
    first = sorted(simulation.simulate(flight, 5, run)[0].measurements[0, 0] for run in range(4))
    text = DEADLY.replace("THRESHOLD", repr(float(first[1] + first[2]) / 2.0))
    (tmp_path / "deadly.py").write_text(text)
    return tmp_path


@pytest.mark.parametrize(
    ("way", "reason"),
    [
        ("exit", "its process ended with exit code 7, twice"),
        ("segfault", "its process was killed by SIGSEGV, twice"),
        ("killed", "its process was killed by SIGKILL, twice"),
        ("raise", "LinAlgError: Matrix is not positive definite"),
    ],
)
def test_a_worker_that_dies_is_a_record(way, reason, deadly):
    """A run that takes its process with it is a record; all other runs are as if it were not."""
    label = f"deadly.py[way={way}]"
    run = command(deadly / "out", "-n", "4", "-j", "2", "-c", "base", "-e", "ekf", "-e", label)
    done = finish(deadly, run)
    assert done.returncode == 0, done.stderr
    assert "2 runs failed: 'ggbench show" in done.stdout
    results = Results(deadly / "out")
    table = results.table.set_index(["estimator", "run"])
    assert (table.loc["ekf", "status"] == "ok").all()
    failed = table[table["status"] != "ok"]
    assert len(failed) == 2
    assert set(failed["reason"]) == {reason}
    assert len(pd.read_csv(deadly / "out" / "failures.csv")) == 2
    undisturbed = ran(deadly, "whole", ("ekf",), runs=4, cases=("base",))
    assert [r for r in results.records() if r["estimator"] == "ekf"] != []
    for run_number in range(4):
        assert (results.series_of("base", "ekf", run_number)
                == undisturbed.series_of("base", "ekf", run_number))[:, :3].all()  # fmt: skip

    repeat = finish(deadly, [str(Path(COMMAND)), *shlex.split(failed["command"].iloc[0])[1:]])
    ends = {"exit": 7, "segfault": -signal.SIGSEGV, "killed": -signal.SIGKILL, "raise": 1}
    assert repeat.returncode == ends[way]
    if way == "raise":
        assert "LinAlgError" in repeat.stdout and "deadly.py" in repeat.stdout
        shown = finish(deadly, [COMMAND, "show", "out"])
        assert "LinAlgError" in shown.stdout
        assert failed["command"].iloc[0] in shown.stdout


def test_a_run_over_its_time_limit_is_a_record(deadly):
    """A run that takes too long is killed and is a record; a higher limit gives it another try."""
    label = "deadly.py[way=sleep,seconds=8]"
    run = command(deadly / "out", "-n", "4", "-j", "2", "-c", "base", "-e", label, "-e", "ekf")
    done = finish(deadly, [*run, "--time-limit", "3"])
    assert done.returncode == 0, done.stderr
    table = Results(deadly / "out").table
    assert (table.loc[table["estimator"] == "ekf", "status"] == "ok").all()
    failed = table[table["status"] != "ok"]
    assert set(failed["reason"]) == {"over its time limit of 3 s"}
    assert len(failed) == 2
    # The same command has nothing left to do, another limit has.
    done = finish(deadly, [*run, "--time-limit", "3"])
    assert "runs to do" not in done.stdout
    done = finish(deadly, [*run, "--time-limit", "100"])
    assert "2 runs to do" in done.stdout
    assert (Results(deadly / "out").table["status"] == "ok").all()


def test_no_process_is_left_behind(deadly, started):
    """When a campaign is killed in the middle of an endless run, its workers end too."""
    label = "deadly.py[way=sleep,seconds=100000]"
    process = started(deadly, command(deadly / "out", "-n", "4", "-j", "2", "-e", label))
    deadline = time.monotonic() + DEADLINE_S
    while stored(deadly / "out") < 4:  # the four that do not sleep
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
    workers = psutil.Process(process.pid).children()
    assert len(workers) == 2
    process.kill()
    _, alive = psutil.wait_procs(workers, timeout=20.0)
    assert not alive


ODD = """
import os, subprocess, warnings
from dataclasses import dataclass
from typing import Literal
import numpy as np
from ggbench.problem import Estimate, Estimator


class Mute(Exception):
    def __str__(self):
        raise RuntimeError("no text")


@dataclass(frozen=True)
class Odd(Estimator):
    way: Literal["good", "fork", "spoil", "speechless", "surrogate", "talkative", "loud",
                 "children"] = "good"
    name = "odd"
    causality = "filter"

    def estimate(self, problem, rng):
        if self.way == "fork":
            os.fork()
        if self.way == "spoil":
            np.seterr(all="raise")
            warnings.simplefilter("error")
            os.chdir("/")
        if self.way == "speechless":
            raise Mute
        if self.way == "surrogate":
            raise ValueError("bad \\udc80 name \\x1b[31m")
        if self.way == "talkative":
            raise ValueError("x" * 10_000_000)
        if self.way == "loud":
            print("RACKET")
        if self.way == "children":
            subprocess.Popen(["sleep", "97531"])
        np.exp(-1e4)
        assert os.path.exists("small.toml")
        cov = np.tile(problem.prior_cov, (problem.epochs, 1, 1))
        return Estimate(np.zeros((problem.epochs, problem.dimension)), cov, "filter")
"""


@pytest.fixture
def odd(tmp_path) -> Path:
    """A folder with a scenario and an estimator that behaves oddly."""
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "odd.py").write_text(ODD)
    return tmp_path


@pytest.mark.parametrize("way", ["fork", "spoil", "loud", "children"])
def test_an_estimator_leaves_the_others_alone(way, odd):
    """Whatever one does to its process, all runs have their results, and the others' are good.

    It forks and both return, changes how NumPy, warnings and paths behave, prints, or leaves
    processes behind.
    """
    run = command(odd / "out", "-n", "4", "-j", "2", "-e", f"odd.py[way={way}]", "-e", "odd.py")
    done = finish(odd, [*run, "-e", "ekf"])
    assert done.returncode == 0, done.stderr
    assert "RACKET" not in done.stdout
    table = Results(odd / "out").table
    assert len(table) == 4 * 2 * 3
    assert (table.loc[table["estimator"] != f"odd.py[way={way}]", "status"] == "ok").all()
    assert not [p for p in psutil.process_iter(["cmdline"]) if "97531" in (p.info["cmdline"] or [])]


@pytest.mark.parametrize(
    ("way", "reason"),
    [
        ("speechless", "Mute: (its text cannot be made)"),
        ("surrogate", r"ValueError: bad \udc80 name \x1b[31m"),
        ("talkative", "ValueError: xxx"),
    ],
)
def test_what_an_exception_says_can_be_stored_and_shown(way, reason, odd):
    """Exceptions without a text, with one that is no Unicode, or without end: records, tables."""
    run = command(odd / "out", "-n", "1", "-j", "1", "-c", "base", "-e", f"odd.py[way={way}]")
    done = finish(odd, run)
    assert (done.returncode, done.stderr) == (0, "")
    (record,) = Results(odd / "out").records()
    assert record["reason"].startswith(reason) and len(record["reason"]) < 5000
    assert finish(odd, [COMMAND, "show", "out"]).returncode == 0


def test_time_that_a_campaign_was_stopped_is_not_a_runs(deadly, started):
    """Ctrl-Z in the middle of a run, for longer than the limit, does not make it too slow."""
    label = "deadly.py[way=sleep,seconds=2]"
    run = command(deadly / "out", "-n", "4", "-j", "1", "-c", "base", "-e", label)
    process = started(deadly, [*run, "--time-limit", "5"])
    while stored(deadly / "out") < 1:
        time.sleep(0.05)
        assert process.poll() is None
    everyone = [psutil.Process(process.pid), *psutil.Process(process.pid).children()]
    for one in everyone:
        one.suspend()
    time.sleep(7.0)
    for one in everyone:
        one.resume()
    process.communicate(timeout=DEADLINE_S)
    assert (Results(deadly / "out").table["status"] == "ok").all()


def test_a_request_to_end_is_an_interrupt(deadly, started):
    """SIGTERM, as a batch system sends it: what is finished is summed up, exit code 130."""
    label = "deadly.py[way=sleep,seconds=100000]"
    process = started(deadly, command(deadly / "out", "-n", "4", "-j", "2", "-e", label))
    while stored(deadly / "out") < 4:
        time.sleep(0.05)
        assert process.poll() is None
    process.terminate()
    _, errors = process.communicate(timeout=DEADLINE_S)
    assert (process.returncode, errors) == (130, "")
    assert (deadly / "out" / "summary.csv").exists()


def test_each_worker_has_one_blas_thread(tmp_path):
    """Workers run with one BLAS thread each, whatever the environment says."""
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "telling.py").write_text(
        DEADLY.replace("THRESHOLD", "1e9").replace(
            'cov, "filter")', 'cov, "filter", info={"env": dict(os.environ)})'
        )
    )
    ran(tmp_path, labels=(str(tmp_path / "telling.py"),), runs=1, jobs=1).store.close()
    for record in Results(tmp_path / "out").records():
        assert record["info"]["env"]["OPENBLAS_NUM_THREADS"] == "1"
        assert record["info"]["env"]["OMP_NUM_THREADS"] == "1"
