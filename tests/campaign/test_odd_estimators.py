"""Estimators that die, never end or spoil their process: records, and nobody else's harm."""

from __future__ import annotations

import shlex
import signal
import time
from pathlib import Path

import pandas as pd
import psutil
import pytest
from campaigns import COMMAND, DEADLINE_S, DEADLY, command, finish, ran, stored
from command import invoke
from problems import SMALL

from ggbench.campaign import flights
from ggbench.results.folder import Results
from ggbench.simulation.runs import simulate


@pytest.fixture
def deadly(tmp_path) -> Path:
    """A folder with a scenario and an estimator that goes wrong in the upper half of its runs."""
    (tmp_path / "small.toml").write_text(SMALL)
    results = ran(tmp_path, "probe", ("ins",), runs=4)
    flight = flights.flight_of(results.scenario.cases[0])
    first = sorted(simulate(flight, 5, run)[0].measurements[0, 0] for run in range(4))
    text = DEADLY.replace("THRESHOLD", repr(float(first[1] + first[2]) / 2.0))
    (tmp_path / "deadly.py").write_text(text)
    return tmp_path


DEATHS = {
    "exit": ("its process ended with exit code 7, twice", 7),
    "segfault": ("its process was killed by SIGSEGV, twice", -signal.SIGSEGV),
    "killed": ("its process was killed by SIGKILL, twice", -signal.SIGKILL),
    "raise": ("LinAlgError: Matrix is not positive definite", 1),
}


@pytest.mark.long
def test_a_run_that_dies_is_a_record(deadly):
    """A run that takes its process with it is a record; all other runs are as if it were not."""
    labels = [word for way in DEATHS for word in ("-e", f"deadly.py[way={way}]")]
    run = command(deadly / "out", "-n", "4", "-j", "2", "-c", "base", "-e", "ekf", *labels)
    done = finish(deadly, run)
    assert done.returncode == 0, done.stderr
    assert "8 runs failed: 'ggbench show" in done.stdout
    results = Results(deadly / "out")
    table = results.runs().set_index(["estimator", "run"])
    assert (table.loc["ekf", "status"] == "ok").all()
    failed = table[table["status"] != "ok"]
    assert len(pd.read_csv(deadly / "out" / "failures.csv")) == len(failed)
    for way, (reason, _) in DEATHS.items():
        assert failed.loc[f"deadly.py[way={way}]", "reason"].tolist() == [reason] * 2
    undisturbed = ran(deadly, "whole", ("ekf",), runs=4, cases=("base",))
    assert [r for r in results.records() if r["estimator"] == "ekf"] != []
    for run_number in range(4):
        assert (
            results.series_of("base", "ekf", run_number)
            == undisturbed.series_of("base", "ekf", run_number)
        )[:, :3].all()

    for way, (_, end) in DEATHS.items():
        alone = failed.loc[f"deadly.py[way={way}]", "command"].iloc[0]
        repeat = finish(deadly, [COMMAND, *shlex.split(alone)[1:]])
        assert repeat.returncode == end
    assert "LinAlgError" in repeat.stdout and "deadly.py" in repeat.stdout
    shown = invoke(["show", "out"], deadly)
    assert "LinAlgError" in shown.stdout
    assert alone in shown.stdout


@pytest.mark.long
def test_a_run_over_its_time_limit_is_a_record(deadly):
    """A run that takes too long is killed and is a record; a higher limit gives it another try."""
    label = "deadly.py[way=wait]"
    run = command(deadly / "out", "-n", "4", "-j", "2", "-c", "base", "-e", label, "-e", "ins")
    done = finish(deadly, [*run, "--time-limit", "10"])
    assert done.returncode == 0, done.stderr
    table = Results(deadly / "out").runs()
    assert (table.loc[table["estimator"] == "ins", "status"] == "ok").all()
    failed = table[table["status"] != "ok"]
    assert set(failed["reason"]) == {"over its time limit of 10 s"}
    assert len(failed) == 2
    # The same command has nothing left to do, another limit has.
    done = finish(deadly, [*run, "--time-limit", "10"])
    assert "runs to do" not in done.stdout
    (deadly / "go").touch()
    done = finish(deadly, [*run, "--time-limit", "100"])
    assert "2 runs to do" in done.stdout
    assert (Results(deadly / "out").runs()["status"] == "ok").all()


@pytest.mark.long
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
    _, alive = psutil.wait_procs(workers, timeout=DEADLINE_S)
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


@pytest.mark.long
def test_an_estimator_leaves_the_others_alone(odd):
    """Whatever one does to its process, all runs have their results, and the others' are good.

    It forks and both return, changes how NumPy, warnings and paths behave, prints, or leaves
    processes behind.
    """
    ways = [f"odd.py[way={way}]" for way in ("fork", "spoil", "loud", "children")]
    labels = [word for label in (*ways, "odd.py", "ekf") for word in ("-e", label)]
    done = finish(odd, command(odd / "out", "-n", "4", "-j", "2", *labels))
    assert (done.returncode, done.stderr) == (1, "")
    assert "All runs of odd.py[way=spoil] failed." in done.stdout  # by its own warnings
    assert "RACKET" not in done.stdout
    table = Results(odd / "out").runs()
    assert len(table) == 4 * 2 * 6
    assert (table.loc[~table["estimator"].isin(ways), "status"] == "ok").all()
    assert not [p for p in psutil.process_iter(["cmdline"]) if "97531" in (p.info["cmdline"] or [])]


@pytest.mark.long
def test_what_an_exception_says_can_be_stored_and_shown(odd):
    """Exceptions without a text, with one that is no Unicode, or without end: records, tables.

    The exit code says that no run succeeded.
    """
    reasons = {
        "speechless": "Mute: (message not available: str() failed)",
        "surrogate": r"ValueError: bad \udc80 name \x1b[31m",
        "talkative": "ValueError: xxx",
    }
    labels = [word for way in reasons for word in ("-e", f"odd.py[way={way}]")]
    done = finish(odd, command(odd / "out", "-n", "1", "-j", "1", "-c", "base", *labels))
    assert (done.returncode, done.stderr) == (1, "")
    for record, reason in zip(Results(odd / "out").records(), reasons.values(), strict=True):
        assert record["reason"].startswith(reason) and len(record["reason"]) < 5000
    assert invoke(["show", "out"], odd).returncode == 0


@pytest.mark.long
def test_time_that_a_campaign_was_stopped_is_not_a_runs(deadly, started):
    """Ctrl-Z in the middle of a run, for longer than the limit, does not make it too slow."""
    label = "deadly.py[way=wait]"
    run = command(deadly / "out", "-n", "4", "-j", "1", "-c", "base", "-e", label)
    process = started(deadly, [*run, "--time-limit", "15"])
    while not (deadly / "waiting").exists():
        time.sleep(0.05)
        assert process.poll() is None
    everyone = [psutil.Process(process.pid), *psutil.Process(process.pid).children()]
    for one in everyone:
        one.suspend()
    time.sleep(16.0)
    (deadly / "go").touch()
    for one in everyone:
        one.resume()
    process.communicate(timeout=DEADLINE_S)
    assert (Results(deadly / "out").runs()["status"] == "ok").all()


@pytest.mark.long
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
    assert (deadly / "out" / "metrics.csv").exists()


@pytest.mark.long
def test_each_worker_has_one_blas_thread(tmp_path, monkeypatch):
    """Workers run with one BLAS thread each, whatever the environment says."""
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
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
