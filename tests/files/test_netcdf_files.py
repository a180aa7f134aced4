"""netCDF files with values of their own, and messages of bad ones."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest

from ggbench.errors import GGBenchError
from ggbench.exchange import containers
from ggbench.files.netcdf import require_own_values
from ggbench.gravity.terrain_files import read_terrain
from ggbench.maps.gravity_grid import read_grid
from ggbench.maps.recipe import read as read_map
from ggbench.recorded import columns

AXES = {"lat": 45.0 + 0.1 * np.arange(20), "lon": 7.0 + 0.1 * np.arange(24)}
VALUES = 400.0 + np.add.outer(10.0 * np.arange(20), 3.0 * np.arange(24))
READERS = {
    "terrain": read_terrain,
    "gravity": lambda path: read_grid(path, "anomaly"),
    "map": read_map,
    "record": lambda path: columns.read(path, ()),
    "estimates": containers.read,
}
REASONS = {
    "storage": "external storage",
    "virtual": "a virtual dataset",
    "link": "an external link",
    "group": "an external link",
}


def write(path: Path, way: str, libver: str = "earliest", **options: object) -> Path:
    """Write a grid whose values are in the file itself ("own") or in another one."""
    other = path.with_name("other.h5")
    with h5py.File(other, "w") as file:
        file["z"] = VALUES
    path.with_name("values.bin").write_bytes(VALUES.tobytes())
    with h5py.File(path, "w", libver=libver, **options) as file:
        for name, values in AXES.items():
            file.create_dataset(name, data=values).make_scale(name)
        if way == "own":
            file["z"] = VALUES
        elif way == "storage":
            place = [(str(path.with_name("values.bin")), 0, h5py.h5f.UNLIMITED)]
            file.create_dataset("z", VALUES.shape, "<f8", external=place)
        elif way == "virtual":
            layout = h5py.VirtualLayout(VALUES.shape, "<f8")
            layout[...] = h5py.VirtualSource(str(other), "z", shape=VALUES.shape)
            file.create_virtual_dataset("z", layout)
        elif way == "group":
            file.create_group("inner", track_order=True)["z"] = h5py.ExternalLink(str(other), "z")
        else:
            file["z"] = h5py.ExternalLink(str(other), "z")
        if way in ("own", "storage", "virtual"):
            for axis, name in enumerate(AXES):
                file["z"].dims[axis].attach_scale(file[name])
    return path


@pytest.mark.parametrize("way", ["own", *REASONS])
@pytest.mark.parametrize("form", [{"libver": "latest"}, {"userblock_size": 1024}, {"links": 40}])
def test_other_forms_of_the_file_are_searched(way, form, tmp_path):
    """Newer headers, a block before the file, many links; control: values of its own pass."""
    options = {key: value for key, value in form.items() if key != "links"}
    path = write(tmp_path / "a.nc", way, **options)
    with h5py.File(path, "a", **options) as file:
        for number in range(form.get("links", 0)):
            file[f"more-{number}"] = h5py.SoftLink("/lat")
    if way == "own":
        require_own_values(path, GGBenchError, "It")
        return
    with pytest.raises(GGBenchError, match=rf"It refers to values .* \({REASONS[way]}"):
        require_own_values(path, GGBenchError, "It")


@pytest.mark.parametrize("reader", ["terrain", "gravity"])
def test_own_values_are_read(reader, tmp_path):
    READERS[reader](write(tmp_path / "a.nc", "own"))


def damaged_values(path: Path) -> None:
    """Write a file that opens: its compressed values are damaged."""
    write(path, "own")
    with h5py.File(path, "a") as file:
        del file["z"]
        values = file.create_dataset("z", data=VALUES, chunks=VALUES.shape, compression="gzip")
        for axis, name in enumerate(AXES):
            values.dims[axis].attach_scale(file[name])
        chunk = values.id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    content[chunk.byte_offset : chunk.byte_offset + chunk.size] = b"\xff" * chunk.size
    path.write_bytes(content)


NO_NETCDF = r"a\.nc cannot be read as a netCDF file: "
BAD = {
    **{
        f"values by {way}": (partial(write, way=way), rf"refers to values in another file \({said}")
        for way, said in REASONS.items()
    },
    "text": (partial(Path.write_bytes, data=b"no file of any kind\n" * 40), NO_NETCDF),
    "zeros of version 4": (
        partial(Path.write_bytes, data=b"\x89HDF\r\n\x1a\n" + b"\0" * 5000),
        NO_NETCDF,
    ),
    "ones of version 3": (partial(Path.write_bytes, data=b"CDF\x01" + b"\xff" * 500), NO_NETCDF),
    "damaged values": (damaged_values, NO_NETCDF),
}
"""Writers of files and messages; maps and records are known by names before values are read."""


@pytest.mark.parametrize(
    ("kind", "reader"),
    [
        (kind, reader)
        for kind in BAD
        for reader in READERS
        if kind != "damaged values" or reader not in ("map", "record")
    ],
)
def test_every_reader_refuses_a_bad_file_alike(kind, reader, tmp_path):
    make, message = BAD[kind]
    make(tmp_path / "a.nc")
    with pytest.raises(GGBenchError, match=message) as refusal:
        READERS[reader](tmp_path / "a.nc")
    assert "\n" not in str(refusal.value)


def test_a_file_of_too_many_groups_is_refused(tmp_path, monkeypatch):
    path = write(tmp_path / "a.nc", "storage")
    monkeypatch.setattr("ggbench.files.netcdf._MOST_HEAPS", 0)
    with pytest.raises(GGBenchError, match=r"cannot read It: its \d+ groups are too many"):
        require_own_values(path, GGBenchError, "It")


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(GGBenchError, match=r"cannot read It: .*directory") as refusal:
        require_own_values(tmp_path, GGBenchError, "It")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("reader", ["terrain", "gravity"])
def test_a_package_that_is_not_installed_is_named(reader, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(GGBenchError, match=r"needs the package xarray .*ggbench\[terrain\]"):
        READERS[reader](write(tmp_path / "a.nc", "own"))
