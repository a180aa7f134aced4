"""A full disk ends every command with a sentence, and what is killed leaves nothing for good.

Writers are stopped by a limit of the file size (RLIMIT_FSIZE), which any user can set. The command
is run on a small tmpfs where the test may mount one.
"""

from __future__ import annotations

import contextlib
import os
import re
import resource
import signal
import subprocess
import time
from importlib.resources import files
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from campaigns import COMMAND
from command import invoke
from matplotlib.figure import Figure
from small_cases import blank_map

from ggbench.cli.tables import write_csv
from ggbench.errors import GGBenchError
from ggbench.figures.style import save
from ggbench.files.writing import written_whole
from ggbench.maps import netcdf
from ggbench.recorded.columns import write_text
from ggbench.report import html_page
from ggbench.results.database import StoreError
from ggbench.results.store import Store

_LIMIT = 16384
_NUMBERS = np.random.default_rng(1).normal(size=(4000, 3))
_DEADLINE_S = 240.0
_DEM = str(files("ggbench.scenarios") / "data" / "jacksboro_dem_3arcsec.npz")
_BUILD = ["map", "build", "--terrain", _DEM]


@contextlib.contextmanager
def small_files():
    """Let no file grow beyond 16 kB: a write fails as it does on a full disk, by another errno."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (_LIMIT, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


def a_map():
    """A map whose field does not compress."""
    found = blank_map()
    found.tensor[:] = np.random.default_rng(1).normal(size=found.tensor.shape)
    return found


def a_figure():
    figure = Figure()
    figure.subplots().plot(_NUMBERS[:, 0])
    return figure


def a_page(path, monkeypatch):
    monkeypatch.setattr(html_page, "text", lambda *_: "x" * 100_000)
    monkeypatch.setattr(html_page, "_figures", lambda *_: None)
    html_page.write(None, None, path, "")


WRITERS = {
    "m.nc": lambda path, _: netcdf.write(path, a_map()),
    "figure.png": lambda path, _: save(a_figure(), path),
    "page.html": a_page,
    "table.csv": lambda path, _: write_csv(pd.DataFrame(_NUMBERS), path),
    "flight.csv": lambda path, _: write_text(path, "x" * 100_000),
}
SAYING_SIZES = ("m.nc", "page.html")


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_for_which_there_is_no_space_is_a_sentence(name, tmp_path, monkeypatch):
    """The old file is kept, and nothing is left of the new one."""
    path = tmp_path / name
    WRITERS[name](path, monkeypatch)  # all that is loaded, made and compiled at the first use
    before = path.read_bytes()
    listed = sorted(item.name for item in tmp_path.iterdir())
    with small_files(), pytest.raises(GGBenchError) as raised:
        WRITERS[name](path, monkeypatch)
    sentence = str(raised.value)
    assert sentence.startswith("cannot write ")
    assert f"{name}: the file is larger than the file system" in sentence
    assert (" MB are free" in sentence) == (name in SAYING_SIZES)
    assert path.read_bytes() == before
    assert sorted(item.name for item in tmp_path.iterdir()) == listed


def test_a_table_of_results_for_which_there_is_no_space_is_a_sentence(tmp_path):
    """Parquet and CSV in a results folder."""
    store = Store(tmp_path / "out", create=True)
    with contextlib.closing(store), small_files():
        with pytest.raises(StoreError, match=r"cannot write .*runs\.parquet: the file is larger"):
            store.write("runs.parquet", bytes(100_000))
        assert not [*store.folder.glob("*.par*")]


def test_a_size_that_cannot_fit_is_refused_before_it_is_computed(tmp_path):
    said = r"no space left on the disk: it needs up to 1e\+12 MB, and .* MB are free"
    with pytest.raises(GGBenchError, match=said):  # noqa: SIM117
        with written_whole(tmp_path / "m.nc", GGBenchError, size=10**18):
            raise AssertionError
    assert [*tmp_path.iterdir()] == []


def test_another_error_of_a_library_passes_through(tmp_path):
    """The look whether there is space left is none at the error itself."""
    with pytest.raises(RuntimeError, match="HDF error"):  # noqa: SIM117
        with written_whole(tmp_path / "m.nc", GGBenchError):
            raise RuntimeError("HDF error")
    assert [*tmp_path.iterdir()] == []


def behind_progress(errors: str) -> str:
    """Return the last line of an output in which lines of progress alone stand before it."""
    *progress, last = errors.splitlines()
    assert all(re.fullmatch(r"\d+ of \d+ layers, about .+ left", line) for line in progress)
    return last


@pytest.fixture
def small_disk(tmp_path):
    """A disk of 2 MB; the test is skipped where none may be mounted."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", folder]
    try:
        if subprocess.run(mount, capture_output=True, check=False).returncode:
            pytest.skip("no tmpfs may be mounted here")
    except FileNotFoundError:
        pytest.skip("there is no mount here")
    yield folder
    subprocess.run(["umount", "-l", folder], check=True)


@pytest.mark.parametrize(
    ("height_spacing", "needed"), [("5", "24.3"), pytest.param("25", "5.8", marks=pytest.mark.long)]
)
def test_a_map_on_a_full_disk(height_spacing, needed, small_disk, tmp_path):
    """A map that is too large from the start, and one that compression leaves too large."""
    bounds = ["--lowest", "1150", "--highest", "1250", "--spacing-arcsec", "5"]
    output = ["-o", str(small_disk / "m.nc"), "--height-spacing", height_spacing]
    done = invoke([*_BUILD, *output, *bounds], tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    refusal = behind_progress(done.stderr)
    assert refusal.startswith("ggbench: cannot write the map ")
    assert f"no space left on the disk: it needs up to {needed}" in refusal
    assert refusal.endswith(" MB are free")
    assert [*small_disk.iterdir()] == []


@pytest.mark.long
def test_a_full_disk_under_the_output_itself(tmp_path):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [COMMAND, "keys", "field"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    said = "ggbench: cannot write the output: no space left on the disk\n"
    assert (done.returncode, done.stderr) == (2, said)


def built_until_it_writes(tmp_path, started):
    """Start to build a map of some seconds; return its process once a file of it is there."""
    process = started(tmp_path, [COMMAND, *_BUILD, "-o", "m.nc"])
    end = time.monotonic() + _DEADLINE_S
    while not [*tmp_path.glob(".m.nc.*.tmp")]:
        assert process.poll() is None
        assert time.monotonic() < end
        time.sleep(0.01)
    return process


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
@pytest.mark.parametrize("twice", [False, True])
def test_a_request_to_end_removes_what_is_half_written(number, twice, tmp_path, started):
    if signal.getsignal(number) is signal.SIG_IGN:
        pytest.skip("the tests and their processes ignore this signal, as under nohup")
    process = built_until_it_writes(tmp_path, started)
    process.send_signal(number)
    if twice:
        process.send_signal(number)
    _, errors = process.communicate(timeout=_DEADLINE_S)
    assert process.returncode == 130
    last = behind_progress(errors)
    assert last in ({"Ended at once.", "Interrupted."} if twice else {"Interrupted."})
    assert [*tmp_path.iterdir()] == []


@pytest.mark.long
def test_the_next_build_removes_what_killed_ones_left(tmp_path, started):
    """Not what running processes write, nor what is written for another file."""
    process = built_until_it_writes(tmp_path, started)
    process.kill()
    process.wait()
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(f".m.nc.{process.pid}-")
    others = [tmp_path / f".m.nc.{os.getpid()}-abc.tmp", tmp_path / f".my.nc.{process.pid}-abc.tmp"]
    for file in others:
        file.touch()
    netcdf.write(tmp_path / "m.nc", blank_map())
    assert sorted(tmp_path.iterdir()) == sorted([*others, tmp_path / "m.nc"])
