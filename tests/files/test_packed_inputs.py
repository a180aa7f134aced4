"""Packed inputs: what unpacks to more than is allowed is refused before it fills the memory."""

from __future__ import annotations

import gzip
import io
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import netCDF4
import numpy as np
import pytest

from ggbench.errors import GGBenchError
from ggbench.files import archives
from ggbench.gravity.terrain_files import read_terrain
from ggbench.maps import gravity_grid, survey_files
from ggbench.maps.gravity_model import read_model
from ggbench.recorded import columns
from ggbench.results.database import StoreError
from ggbench.results.store import Store
from ggbench.trajectory import survey_lines

ZEROS = 400_000
"""Bytes that pack to less than a hundredth."""
LIMIT = 100_000


def archive(**arrays: np.ndarray) -> bytes:
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    return content.getvalue()


def zipped(content: bytes) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as opened:
        opened.writestr("model.gfc", content)
    return packed.getvalue()


TEXT, GRID = b"0,0,0\n" * (ZEROS // 6), np.zeros((200, ZEROS // 1600))
BOMBS: dict[str, tuple[bytes, Callable[[Path], object]]] = {
    "a.csv.gz": (gzip.compress(TEXT), survey_files.read_lines),
    "a.xyz.gz": (gzip.compress(TEXT), survey_files.read_lines),
    "a.dat.gz": (gzip.compress(TEXT), survey_files.read_lines),
    "lines.csv.gz": (gzip.compress(TEXT), lambda path: survey_lines.read_lines(str(path))),
    "a.gfc.gz": (gzip.compress(TEXT), read_model),
    "a.gfc.zip": (zipped(TEXT), read_model),
    "model.npz": (archive(cs=GRID, gm=np.ones(1), r=np.ones(1)), read_model),
    "dem.npz": (archive(lat=GRID, lon=GRID, z=GRID), read_terrain),
    "geoid.npz": (
        archive(lat0=GRID, lon0=GRID, step=GRID, N_1e4m=GRID),
        lambda path: gravity_grid.read_grid(path, "geoid"),
    ),
}


@pytest.mark.parametrize("name", BOMBS)
def test_what_unpacks_to_too_much_is_refused(name, tmp_path, monkeypatch):
    """By its limit, which the sentence states; control: with a larger one it is not the reason."""
    content, read = BOMBS[name]
    assert len(content) < LIMIT / 10
    (tmp_path / name).write_bytes(content)
    with pytest.raises(GGBenchError) as error:
        read(tmp_path / name)
    assert "unpacks to" not in str(error.value)
    monkeypatch.setattr(archives, "MOST_TEXT", LIMIT)
    monkeypatch.setattr(archives, "MOST_ARRAYS", LIMIT)
    with pytest.raises(GGBenchError, match=r"unpacks to .*0\.1 (MB|are allowed)"):
        read(tmp_path / name)


def test_compressed_arrays_of_netcdf_are_refused_by_their_size(tmp_path, monkeypatch):
    """A grid of gravity and the record of a flight; control: they are read without the limit."""
    with netCDF4.Dataset(tmp_path / "a.nc", "w") as file:
        for name, count in (("lat", 40), ("lon", 50), ("time_s", ZEROS // 8)):
            file.createDimension(name, count)
            values = file.createVariable(name, "f8", (name,), zlib=True)
            values[:] = np.arange(count, dtype=float)
        file.createVariable("dg", "f8", ("lat", "lon"), zlib=True)[:] = 0.0
    columns.read(tmp_path / "a.nc", ())
    gravity_grid.read_grid(tmp_path / "a.nc", "anomaly")
    for module in (columns, gravity_grid):
        monkeypatch.setattr(module, "MOST_ARRAYS", LIMIT)
    with pytest.raises(GGBenchError, match="MB of columns; at most"):
        columns.read(tmp_path / "a.nc", ())
    with pytest.raises(GGBenchError, match="MB of arrays; at most"):
        gravity_grid.read_grid(tmp_path / "a.nc", "anomaly")


def test_the_arrays_of_a_results_folder_are_limited(tmp_path, monkeypatch):
    """A folder may come from anyone."""
    store = Store(tmp_path / "out", create=True)
    store.write_arrays("key", {"times": GRID})
    monkeypatch.setattr(archives, "MOST_ARRAYS", LIMIT)
    with pytest.raises(StoreError, match=r"the shared data of case base in .* unpacks to"):
        store.arrays("key", "base")
    store.close()


@pytest.mark.long
def test_memory_is_bounded(tmp_path):
    """A file of 2 MB that unpacks to 2 GB is refused within 500 MB, half of them imports."""
    with gzip.open(tmp_path / "a.csv.gz", "wb", compresslevel=1) as file:
        for _ in range(2000):
            file.write(bytes(1_000_000))
    code = (
        "import sys\n"
        "from pathlib import Path\n"
        "from ggbench.campaign.records import peak_memory_mb\n"
        "from ggbench.maps import survey_files\n"
        "try:\n    survey_files.read_lines(Path(sys.argv[1]))\n"
        "except Exception as error:\n    print(type(error).__name__, error)\n"
        "print(peak_memory_mb())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "a.csv.gz")],
        capture_output=True,
        text=True,
        check=True,
    )
    said, peak = done.stdout.strip().splitlines()
    assert said.startswith("MapError") and said.endswith("unpacks to more than 500 MB")
    assert float(peak) < 500.0


@pytest.mark.parametrize("name", ["a.csv", "a.xyz", "a.csv.gz", "a.dfn"])
@pytest.mark.parametrize(("content", "found"), [(b"h\xf6he", "the byte 0xf6"), (b"\0", "a null")])
def test_survey_text_of_other_bytes_is_refused(name, content, found, tmp_path):
    """Latin-1 and null bytes, with their line; control: UTF-8 is not the reason."""
    for text, expected in ((b"x,y\n1,2\n" + content, found), ("x,y\n1,höhe\n".encode(), "")):
        (tmp_path / name).write_bytes(gzip.compress(text) if name.endswith("gz") else text)
        read = tmp_path / name
        if name == "a.dfn":
            (tmp_path / "a.dat").write_bytes(b"1 2\n")
            read = tmp_path / "a.dat"
        with pytest.raises(GGBenchError) as error:
            survey_files.read_lines(read)
        assert ("line 3 has " + expected in str(error.value)) == bool(expected), error.value
