"""Nothing is lost: processes killed at any moment, between any two writes, on a full disk."""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import re
import resource
import signal
import subprocess
import sys
import time

import power_cuts
import psutil
import pytest
from campaigns import DEADLINE_S, assert_equal, command, finish, ran, stored
from problems import SMALL

from ggbench.results.folder import Results


def kill_parent(process: subprocess.Popen, moment: random.Random) -> None:
    process.kill()


def kill_all(process: subprocess.Popen, moment: random.Random) -> None:
    """Kill the workers and their parent, in whatever order."""
    parent = psutil.Process(process.pid)
    everyone = [parent, *parent.children()]
    moment.shuffle(everyone)
    for each in everyone:
        with contextlib.suppress(psutil.NoSuchProcess):  # it may have ended with its parent
            each.kill()


def interrupt(process: subprocess.Popen, moment: random.Random) -> None:
    os.killpg(process.pid, signal.SIGINT)


def kill_worker_then_parent(process: subprocess.Popen, moment: random.Random) -> None:
    """Kill a worker, let the campaign go on for a moment, then kill that too."""
    workers = psutil.Process(process.pid).children()
    if workers:
        moment.choice(workers).kill()
    time.sleep(moment.uniform(0.0, 0.6))
    process.kill()


@pytest.mark.long
def test_runs_interrupted_many_times(tmp_path, started):
    """A campaign killed and interrupted at random moments ends as an undisturbed one.

    Two cases with two estimators. The moments (seeded) fall anywhere between two records; the ways
    alternate. What was stored before a kill is there after it.
    """
    (tmp_path / "small.toml").write_text(SMALL)
    runs, times, moment = 300, 6, random.Random(9)
    ways = itertools.cycle((kill_all, interrupt, kill_worker_then_parent, kill_parent, kill_parent))
    run = command(tmp_path / "out", "-n", f"{runs}", "-j", "2")
    held = 0
    for way in itertools.islice(ways, times):
        process = started(tmp_path, run)
        target = held + moment.randint(1, 30)
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
        assert stored(tmp_path / "out") >= target
        held = stored(tmp_path / "out")
    assert held < 4 * runs, "the campaign was over before it was interrupted so many times"
    done = finish(tmp_path, run)
    assert (done.returncode, done.stderr) == (0, "")
    disturbed = Results(tmp_path / "out")
    assert len(disturbed.runs()) == 4 * runs
    assert_equal(disturbed, ran(tmp_path, "whole", ("ins", "ekf"), runs=runs))


@pytest.mark.long
def test_kills_while_it_is_compiled(tmp_path, started, monkeypatch):
    """From an empty cache of compiled code, killed again and again: the same bits in the end.

    As of a campaign that finds all its code compiled. Engines lose their way in some of the runs,
    which makes metres of a last digit.
    """
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("GGBENCH_CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "small.toml").write_text(SMALL)
    engines = ("ekf", "ukf")
    options = ["-n", "300", "-j", "2", *(word for engine in engines for word in ("-e", engine))]
    moment = random.Random(4)
    for _ in range(6):
        process = started(tmp_path, command(tmp_path / "out", *options))
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=moment.uniform(1.0, 12.0))
        if process.poll() is None:
            kill_all(process, moment)
        process.communicate()
    for folder in ("out", "whole"):
        done = finish(tmp_path, command(tmp_path / folder, *options), timeout=None)
        assert done.returncode == 0
    assert_equal(Results(tmp_path / "out"), Results(tmp_path / "whole"))


@pytest.mark.long
@pytest.mark.parametrize(
    ("options", "stride"),
    [
        ((), 40),
        ((), 1),
        (("--fresh",), 1),
    ],
)
def test_a_power_cut_between_any_two_writes(options, stride, tmp_path):
    """Killed before its first write, a later one, ...: every time the same command completes it.

    With --fresh the folder holds results of another seed, which are discarded on the way.
    """
    done = subprocess.run(
        [sys.executable, power_cuts.__file__, str(stride), *options],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 40


@pytest.mark.long
def test_a_full_disk(tmp_path):
    """When nothing more can be written, a sentence says so; what is stored stays.

    A limit on the size of files stands for the disk: the system refuses to let them grow.
    """
    (tmp_path / "small.toml").write_text(SMALL)
    run = command(tmp_path / "out", "-n", "30", "-j", "0")

    def small_disk() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))

    # What measures coverage writes files, too.
    env = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE")}
    done = finish(tmp_path, run, preexec_fn=small_disk, env=env)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert re.match(r"ggbench: cannot write .*out.*: .*the same command resumes", line)
    held = stored(tmp_path / "out")
    assert 0 < held < 120
    done = finish(tmp_path, run)
    assert (done.returncode, done.stderr) == (0, "")
    assert_equal(Results(tmp_path / "out"), ran(tmp_path, "whole", ("ins", "ekf"), runs=30))
