"""The same campaign on a Dask cluster: the same bits, whatever happens to its workers."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import psutil
import pytest
from campaigns import COMMAND, DEADLINE_S, DEADLY, assert_equal, command, stored
from problems import SMALL

from ggbench.results.folder import Results

if TYPE_CHECKING:
    from distributed import LocalCluster


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
        tmp_path, cluster.scheduler_address, "-n", "1", "-c", "base", "--time-limit", "20",
        "-e", f"{path}[way=exit]", "-e", f"{path}[way=sleep,seconds=1000]", "-e", "ekf",
    )  # fmt: skip
    _, errors = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 1, errors  # every run of two estimators failed
    table = Results(tmp_path / "out").runs()
    assert table["reason"].tolist() == [
        "its process ended with exit code 7, twice", "over its time limit of 20 s", "",
    ]  # fmt: skip


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
