"""A map is read in one thread while another writes: the libraries never run in both at a time."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from ggbench.gravity.gradient_map import GradientMap
from ggbench.maps import netcdf, netcdf_reader

COPY = """
import contextlib, sys
from pathlib import Path
from ggbench.files import netcdf as netcdf_files
if "unlocked" in sys.argv:
    netcdf_files.NETCDF_LOCK = contextlib.nullcontext()
from ggbench.maps import netcdf, netcdf_reader
source, copy = map(Path, sys.argv[1:3])
for _ in range(3):
    nodes, attributes, layers = netcdf_reader.read_layers(source)
    netcdf.write_layers(copy, nodes, layers, attributes, "float64")
"""
"""Copies a map three times. Layers are read ahead in a thread while the main thread writes."""


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    rng = np.random.default_rng(0)
    tensor = rng.standard_normal((30, 30, 24, 6))
    tensor[..., 5] = -tensor[..., 0] - tensor[..., 3]
    disturbance = 1e-5 * rng.standard_normal((30, 30, 24, 3))
    path = tmp_path_factory.mktemp("map") / "map.nc"
    gradient_map = GradientMap(
        latitude0=0.7,
        longitude0=0.2,
        height0=100.0,
        latitude_step=1e-4,
        longitude_step=1e-4,
        height_step=100.0,
        tensor=tensor,
        gravity_disturbance=disturbance,
        provenance="noise",
    )
    netcdf.write(path, gradient_map)
    return path


def copied(source, copy, *options):
    return subprocess.run(
        [sys.executable, "-c", COPY, str(source), str(copy), *options],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.long
def test_a_map_is_copied_while_it_is_read(source, tmp_path):
    copy = tmp_path / "copy.nc"
    done = copied(source, copy)
    assert done.returncode == 0, done.stderr
    one, other = netcdf_reader.read(copy), netcdf_reader.read(source)
    np.testing.assert_array_equal(one.tensor, other.tensor)
    np.testing.assert_array_equal(one.gravity_disturbance, other.gravity_disturbance)


@pytest.mark.long
def test_without_the_lock_the_copy_fails(source, tmp_path):
    """The control of the test above: 8 of 8 such copies ended in a crash or an error of HDF5."""
    assert any(copied(source, tmp_path / "copy.nc", "unlocked").returncode for _ in range(5))
