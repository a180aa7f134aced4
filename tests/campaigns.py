"""Campaigns on a small scenario: run, read back, compare without what clocks and memory say."""

from __future__ import annotations

import json
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from problems import SMALL

from ggbench.campaign import execution, running
from ggbench.campaign.campaign import Campaign
from ggbench.results.columns import BLANK, WINDOW_COLUMNS
from ggbench.results.folder import Results, write_tables
from ggbench.spec import scenario

DEADLINE_S = 240.0
COMMAND = str(Path(sys.executable).parent / "ggbench")
LABELS = ("ins", "ekf", "ukf[points=merwe]")
TIMINGS = ("seconds", "peak_memory_mb", "cold", "traceback")


def small(tmp_path: Path, text: str = SMALL) -> scenario.Scenario:
    path = tmp_path / "small.toml"
    path.write_text(text)
    return scenario.load(str(path))


def plan(tmp_path: Path, folder: str, labels: tuple[str, ...], **options: Any) -> Campaign:
    settings = {"runs": 3, "seed": 5, "assumptions": False} | options
    loaded = settings.pop("scenario", None) or small(tmp_path)
    return Campaign(loaded, "small.toml", labels, folder=tmp_path / folder, **settings)


def ran(
    tmp_path: Path, folder: str = "out", labels: tuple[str, ...] = LABELS, **options: Any
) -> Results:
    """The results of a campaign on the small scenario, run to its end."""
    jobs = options.pop("jobs", 0)
    work = plan(tmp_path, folder, labels, **options)
    store, _ = work.open()
    tasks = work.tasks(store)
    engine = (
        execution.in_processes(tasks, jobs, work.limit) if jobs else execution.in_process(tasks)
    )
    running.execute(engine, store, lambda batch: None)
    results = Results(work.folder, store)
    write_tables(results)
    return results


def failed(run: int = 0, **known: Any) -> dict[str, Any]:
    """The record of a run that has failed."""
    head = {"name": "a", "causality": "filter", "seed": 1, "status": "failed", "reason": "none"}
    return BLANK | head | {"run": run} | known


def finished(run: int = 0, **known: Any) -> dict[str, Any]:
    """The record of a run that has finished, with a metric of each window after the other."""
    numbers = {
        "seconds": 0.1,
        "bound": "filter",
        "map_evaluations": 20,
        "peak_memory_mb": 100.0,
        "diverged": False,
        "final_position_error_m": 2.0,
        "final_ins_error_m": 9.0,
        "required_m": 3.0,
        "converged_s": 4.0,
        "false_fix": False,
        "info": {"rounds": 3},
    }
    windows = {name: 1.0 + number / 7.0 for number, name in enumerate(WINDOW_COLUMNS)}
    return failed(run, status="ok", reason="") | numbers | windows | known


def records(results: Results) -> dict[tuple[str, str, int], dict[str, Any]]:
    """Records without what may differ between two equal campaigns: time and memory.

    Every NaN is the one object that the json module makes of it, and so equal to itself.
    """
    return {
        (r["case"], r["estimator"], r["run"]): json.loads(
            json.dumps({k: v for k, v in r.items() if k not in TIMINGS})
        )
        for r in results.records()
    }


def assert_equal(one: Results, other: Results) -> None:
    """Two folders hold the same bits: records, series, details and tables, timings aside."""
    expected = records(one)
    found = records(other)
    assert found.keys() == expected.keys()
    differing = {
        key: (found[key], record) for key, record in expected.items() if found[key] != record
    }
    assert not differing, next(iter(differing.items()))
    for case, label in {key[:2] for key in expected}:
        for read in (Results.series, lambda r, c, e: r.detail(c, e, 0)):
            assert np.array_equal(read(one, case, label), read(other, case, label), equal_nan=True)
    drop = ["seconds_per_run"]
    assert one.metrics().drop(columns=drop).equals(other.metrics().drop(columns=drop))
    assert one.pairs().equals(other.pairs())
    timed = ["recommended"]  # the cheapest of those recommended
    assert one.cases().drop(columns=timed).equals(other.cases().drop(columns=timed))


def command(folder: Path, *options: str) -> list[str]:
    return [COMMAND, "run", "small.toml", "-s", "5", "-o", str(folder), *options]


def finish(cwd: Path, arguments: list[str], **options) -> subprocess.CompletedProcess:
    options = {"timeout": DEADLINE_S} | options
    return subprocess.run(arguments, cwd=cwd, capture_output=True, text=True, **options)


def stored(folder: Path) -> int:
    """Number of records in a folder that another process writes, 0 if there is none yet."""
    try:
        with sqlite3.connect(f"{(folder / 'records.sqlite').as_uri()}?mode=ro", uri=True) as found:
            return found.execute("SELECT count(*) FROM records").fetchone()[0]
    except sqlite3.Error:
        return 0


DEADLY = """
import ctypes, os, signal, time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
import numpy as np
from ggbench.problem import Estimate, Estimator


@dataclass(frozen=True)
class Deadly(Estimator):
    way: Literal["exit", "segfault", "killed", "sleep", "wait", "raise", "none"] = "none"
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
            if self.way == "wait":
                Path("waiting").touch()
                while not Path("go").exists():
                    time.sleep(0.01)
            time.sleep(self.seconds)
        cov = np.tile(problem.prior_cov, (problem.epochs, 1, 1))
        return Estimate(np.zeros((problem.epochs, problem.dimension)), cov, "filter")
"""
