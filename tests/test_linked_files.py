"""netCDF files that take values from other files are refused; others of the same form are read."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from ggbench.errors import GGBenchError
from ggbench.exchange import containers
from ggbench.gravity.terrain_files import read_terrain
from ggbench.linked_files import require_own_values
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


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("way", REASONS)
def test_values_of_another_file_are_refused(reader, way, tmp_path):
    with pytest.raises(GGBenchError, match=f"takes values from another file, by {REASONS[way]}"):
        READERS[reader](write(tmp_path / "a.nc", way))


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
    with pytest.raises(GGBenchError, match=f"It takes values .* by {REASONS[way]}"):
        require_own_values(path, GGBenchError, "It")


@pytest.mark.parametrize("reader", ["terrain", "gravity"])
def test_own_values_are_read(reader, tmp_path):
    READERS[reader](write(tmp_path / "a.nc", "own"))
    with pytest.raises(GGBenchError, match=r"cannot read It: .*directory"):
        require_own_values(tmp_path, GGBenchError, "It")
