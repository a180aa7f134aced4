"""The same campaign on a Dask cluster: the same bits, whatever happens to its workers."""

from __future__ import annotations

import contextlib
import shlex
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import psutil
import pytest
from campaigns import COMMAND, DEADLINE_S, DEADLY, assert_equal, command, stored
from problems import SMALL

from ggbench.results.folder import Results

if TYPE_CHECKING:
    from distributed import LocalCluster

DASK = str(Path(sys.executable).parent / "dask")


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    """A scheduler on this machine with two workers, each a process of its own."""
    from distributed import LocalCluster  # slow, and not for all processes

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as running:
        yield running


def start(cwd, address: str, *options: str) -> subprocess.Popen:
    run = [COMMAND, "run", "small.toml", "-s", "5", "-o", "out", "--cluster", address, *options]
    return subprocess.Popen(run, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.long
def test_results_are_those_of_one_process_though_a_worker_is_killed(cluster, tmp_path):
    """100 runs of two cases on two workers, one of them killed on the way: bit for bit the serial.

    The serial ones are run in one process, without a worker.
    """
    (tmp_path / "small.toml").write_text(SMALL)
    serial = command(tmp_path / "serial", "-n", "100", "-j", "0")
    subprocess.run(serial, cwd=tmp_path, check=True, capture_output=True)
    process = start(tmp_path, cluster.scheduler_address, "-n", "100")
    deadline = time.monotonic() + DEADLINE_S
    while stored(tmp_path / "out") < 20:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    victim = psutil.Process(next(iter(cluster.workers.values())).pid)
    victim.kill()
    held = stored(tmp_path / "out")
    output, errors = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0, errors
    assert held < 400, "the campaign was over before the worker was killed"
    assert "400 of 400 runs" in output
    assert_equal(Results(tmp_path / "out"), Results(tmp_path / "serial"))


@pytest.mark.long
def test_deaths_and_time_limits_are_records_there_too(cluster, tmp_path):
    """An estimator that kills its process, or never ends, does no harm to the cluster."""
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "deadly.py").write_text(DEADLY.replace("THRESHOLD", "-1e9"))
    path = tmp_path / "deadly.py"
    process = start(
        tmp_path,
        cluster.scheduler_address,
        *shlex.split("-n 1 -c base --time-limit 20"),
        *("-e", f"{path}[way=exit]"),
        *("-e", f"{path}[way=sleep,seconds=1000]"),
        *("-e", "ekf"),
    )
    _, errors = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 1, errors  # every run of two estimators failed
    table = Results(tmp_path / "out").runs()
    assert table["reason"].tolist() == [
        "its process ended with exit code 7, twice",
        "over its time limit of 20 s",
        "",
    ]


@pytest.mark.long
def test_no_scheduler_has_its_sentence(tmp_path):
    """An address where nothing answers, or that is none, ends with one line and exit code 2."""
    (tmp_path / "small.toml").write_text(SMALL)
    for address, sentence in (
        ("tcp://127.0.0.1:9", "no Dask scheduler answers at tcp://127.0.0.1:9: Connection refused"),
        ("nonsense://x", "'nonsense://x' is no address of a Dask scheduler"),
    ):
        process = start(tmp_path, address, "-n", "1")
        _, errors = process.communicate(timeout=DEADLINE_S)
        assert process.returncode == 2
        (line,) = errors.splitlines()
        assert line.startswith(f"ggbench: {sentence}")


@pytest.fixture
def scheduler() -> Iterator[tuple[subprocess.Popen, str]]:
    """A scheduler in a process of its own, without any worker, and its address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [DASK, "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + DEADLINE_S
    while True:
        with contextlib.suppress(OSError):
            socket.create_connection(("127.0.0.1", port)).close()
            break
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.1)
    yield process, f"tcp://127.0.0.1:{port}"
    process.kill()
    process.wait()


def line_of(process: subprocess.Popen, said: str) -> str:
    """Return the first line of the output that says something."""
    for line in process.stdout:
        if said in line:
            return line
    raise AssertionError(process.stderr.read())


@pytest.mark.long
def test_a_scheduler_without_workers_is_said_until_one_comes(scheduler, tmp_path):
    (tmp_path / "small.toml").write_text(SMALL)
    _, address = scheduler
    process = start(tmp_path, address, "-n", "3", "-c", "base", "-e", "ekf")
    line = line_of(process, "waiting")
    assert f"waiting for workers: the scheduler at {address} has none" in line
    assert f"'dask worker {address} --nthreads 1' starts one" in line
    worker = [DASK, "worker", address, "--nthreads", "1", "--no-dashboard"]
    helper = subprocess.Popen(
        worker, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        assert "3 of 3 runs on 1 worker" in line_of(process, "3 of 3")
        _, errors = process.communicate(timeout=DEADLINE_S)
        assert (process.returncode, errors) == (0, "")
    finally:
        helper.terminate()
        helper.wait()


@pytest.mark.long
def test_a_scheduler_that_is_killed_has_its_sentence_alone(scheduler, tmp_path):
    """Without the tracebacks that Dask logs."""
    (tmp_path / "small.toml").write_text(SMALL)
    running, address = scheduler
    process = start(tmp_path, address, "-n", "3", "-c", "base", "-e", "ekf")
    line_of(process, "waiting")
    running.kill()
    _, errors = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 2
    (line,) = errors.splitlines()
    assert line == (
        f"ggbench: the connection to the Dask scheduler at {address} broke; "
        "the same command resumes the campaign"
    )
