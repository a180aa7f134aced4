"""Map files that are written and read, and their limits."""

from __future__ import annotations

import dataclasses
import math
import shutil
import tracemalloc

import netCDF4
import numpy as np
import pytest
import xarray
from small_maps import SHAPE, some_map
from thinning import thinned

from ggbench.gravity.field import Field
from ggbench.gravity.gradient_map import GradientMap, MapError
from ggbench.maps import checks, netcdf, netcdf_reader
from ggbench.maps.recipe import read, write


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "whole.nc"
    netcdf.write(path, some_map())
    return path


@pytest.fixture
def file(whole, tmp_path):
    return shutil.copy(whole, tmp_path / "map.nc")


def assert_same(one: GradientMap, other: GradientMap) -> None:
    np.testing.assert_array_equal(one.tensor, other.tensor)
    np.testing.assert_array_equal(one.gravity_disturbance, other.gravity_disturbance)
    for name in ("latitude0", "longitude0", "height0", "latitude_step", "longitude_step"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-13)
    assert one.height_step == other.height_step
    assert one.provenance == other.provenance


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_what_is_written_is_read(tmp_path, dtype):
    path = tmp_path / "new folder" / "map.nc"
    written = some_map(np.dtype(dtype).type)
    netcdf.write(path, written, dtype)
    assert_same(read(path), written)
    assert [entry.name for entry in path.parent.iterdir()] == ["map.nc"]


def test_the_same_map_is_the_same_bytes(whole, tmp_path):
    again = tmp_path / "again.nc"
    netcdf.write(again, some_map())
    assert again.read_bytes() == whole.read_bytes()
    other = dataclasses.replace(some_map(), height0=2501.0)
    netcdf.write(again, other)
    assert again.read_bytes() != whole.read_bytes()


def test_others_can_read_it_and_see_what_it_is(whole):
    expected = some_map()
    with xarray.open_dataset(whole) as data:
        assert data.attrs["Conventions"] == "CF-1.11"
        assert "normal field of WGS84 removed" in data.attrs["comment"]
        assert data["height"].attrs["standard_name"] == "height_above_reference_ellipsoid"
        assert data["latitude"].attrs["units"] == "degrees_north"
        assert data["crs"].attrs["semi_major_axis"] == 6378137.0
        for index, name in enumerate(("ee", "en", "eu", "nn", "nu", "uu")):
            component = data[f"gradient_{name}"]
            assert component.attrs["units"] == "1e-9 s-2"
            assert component.attrs["grid_mapping"] == "crs"
            component = component.transpose("latitude", "longitude", "height")
            np.testing.assert_array_equal(component, expected.tensor[..., index])
        point = data["disturbance_u"].sel(
            latitude=33.04, longitude=107.6, height=2750.0, method="nearest"
        )
        assert float(point) == expected.gravity_disturbance[4, 5, 2, 2]


def test_xarray_may_rewrite_it_in_another_order(whole, tmp_path):
    """Another order of dimensions, latitudes from north to south, heights from above."""
    other = tmp_path / "other.nc"
    with xarray.open_dataset(whole) as data:
        turned = data.transpose("longitude", "height", "latitude")
        turned.isel(latitude=slice(None, None, -1), height=slice(None, None, -1)).to_netcdf(other)
    assert_same(read(other), some_map())
    cropped, expected = (read(p, (33.031, 33.032, 107.6, 107.62)) for p in (other, whole))
    assert_same(cropped, expected)


def test_a_crop_serves_the_region_as_the_whole_map_does(tmp_path):
    """Of a smooth field: the spline's ends, a few nodes from the region, are not felt in it."""
    shape = (60, 70, 5)
    grid = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"))
    smooth = 30.0 * np.sin(0.3 * grid[0]) * np.cos(0.25 * grid[1]) * np.exp(-0.05 * grid[2])
    large = dataclasses.replace(
        some_map(),
        tensor=smooth[..., None] * np.array([1.0, 1.0, 1.0, -0.5, 1.0, -0.5]),
        gravity_disturbance=np.repeat(1e-5 * smooth[..., None], 3, -1),
    )
    path = tmp_path / "large.nc"
    netcdf.write(path, large)
    cropped = read(path, (33.2, 33.3, 108.0, 108.2))
    assert cropped.tensor.size < 0.2 * large.tensor.size
    places = (np.radians([33.203, 33.298]), np.radians([108.01, 108.197]), np.array([2500, 2700.0]))
    whole, part = (Field.from_map(m).tensor(*places) for m in (large, cropped))
    assert np.abs(part - whole).max() < 1e-3


@thinned("side", range(4), every=2)
def test_a_crop_keeps_nodes_beyond_each_of_its_sides(side, tmp_path):
    """At every side of a region the field, of six nodes a wave, is that of the whole map to 2 %.

    Where a spline ended there, it would be a tenth off.
    """
    grid = np.stack(np.meshgrid(*map(np.arange, (60, 70, 5)), indexing="ij"))
    rough = 10.0 * np.sin(grid[0] + 0.4) * np.cos(grid[1] + 0.1)
    large = dataclasses.replace(
        some_map(),
        tensor=rough[..., None] * [1.0, 1.0, 1.0, 1.0, 1.0, -2.0],
        gravity_disturbance=np.repeat(1e-5 * rough[..., None], 3, -1),
    )
    path = tmp_path / "large.nc"
    netcdf.write(path, large)
    region = (33.205, 33.305, 108.01, 108.21)  # between nodes: at one, every spline is right
    cropped = read(path, region)
    along = np.linspace(*region[2:], 90) if side < 2 else np.linspace(*region[:2], 90)
    across = np.full(90, region[side])
    places = (across, along) if side < 2 else (along, across)
    whole, part = (
        Field.from_map(m).tensor(*np.radians(places), 2500.0)[:, 0] for m in (large, cropped)
    )
    assert np.abs(part - whole).max() < 0.02 * np.abs(rough).max()


def test_longitudes_beyond_180_become_western_ones(tmp_path):
    path = tmp_path / "west.nc"
    netcdf.write(path, dataclasses.replace(some_map(), longitude0=math.radians(276.0)))
    assert math.degrees(read(path).longitude0) == pytest.approx(-84.0)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_rounding_is_no_trace(tmp_path, dtype):
    """A strong field in the precision of its file is a field; so is one of nothing."""
    path = tmp_path / "map.nc"
    for factor in (1500.0, 1e-3, 0.0):
        netcdf.write(
            path, dataclasses.replace(some_map(), tensor=factor * some_map().tensor), dtype
        )
        read(path)


def declared(path, count):
    """A file that declares count nodes on each axis, and holds no values."""
    spans = {"height": (0.0, 1e4), "latitude": (30.0, 40.0), "longitude": (100.0, 110.0)}
    with netCDF4.Dataset(path, "w") as data:
        for name, attributes in netcdf.AXES.items():
            data.createDimension(name, count)
            data.createVariable(name, "f8", (name,)).setncatts(attributes)
            data[name][:] = np.linspace(*spans[name], count)
        for name, attributes in netcdf.variables().items():
            data.createVariable(name, "f4", tuple(spans), zlib=True).setncatts(attributes)


def test_a_map_too_large_for_memory_is_refused(tmp_path):
    """Before memory is taken for it: with its size in bytes and what is allowed."""
    path = tmp_path / "huge.nc"
    declared(path, 4000)
    assert path.stat().st_size < 1e6
    for reading, limit in (
        (read, "20000000 .1.44 GB."),
        (netcdf_reader.read_layers, "10{10} .720"),
    ):
        tracemalloc.start()
        with pytest.raises(MapError, match=rf"4000 x 4000\), 4.61e\+03 GB in memory; .* {limit}"):
            reading(path)
        assert tracemalloc.get_traced_memory()[1] < 10e6
        tracemalloc.stop()


def test_a_layer_or_an_axis_too_large_is_refused(file, monkeypatch):
    monkeypatch.setattr(checks, "MOST_NODES_READ", 80)
    with pytest.raises(MapError, match=r"a layer of .*map.nc has 99 nodes .*at most 80 "):
        netcdf_reader.read_layers(file)
    monkeypatch.setattr(checks, "MOST_ON_AXIS", 10)
    with pytest.raises(MapError, match="longitude has 11 values; at most 10 can be read"):
        read(file)


def test_a_map_is_written_to_a_netcdf_file_alone(tmp_path):
    with pytest.raises(MapError, match=r"must be named \*\.nc"):
        write(tmp_path / "map.npz", some_map())


def test_words_of_a_stranger_are_harmless(tmp_path):
    """No escape of a terminal, no other direction of writing, no megabytes; the rest stays."""
    words = "\x1b[31m\x9bred \x07 \u202eback\u2028 Eötvös, 北 "
    for text, shown in (
        (words, "�[31m�red � �back� Eötvös, 北"),
        ("x" * 10**7, "x" * 4000 + "… (10000000 characters)"),
    ):
        write(tmp_path / "map.nc", dataclasses.replace(some_map(), provenance=text))
        assert read(tmp_path / "map.nc").provenance == shown
    assert len(netcdf_reader.read_layers(tmp_path / "map.nc")[1]["source"]) < 4100


def test_nothing_is_left_of_a_map_that_could_not_be_finished(tmp_path):
    nodes = netcdf.Nodes(*(np.arange(5.0) for _ in range(3)))

    def layers(bad):
        for _ in range(4):
            yield np.zeros((5, 5, 6)), np.zeros((5, 5, 3))
        if bad is not None:
            yield np.full((5, 5, 6), bad), np.zeros((5, 5, 3))

    path = tmp_path / "map.nc"
    path.write_bytes(b"what was there before")
    for bad, message in ((np.nan, "not finite"), (None, "4 layers were computed")):
        with pytest.raises(MapError, match=message):
            netcdf.write_layers(path, nodes, layers(bad), {})
    with pytest.raises(MapError, match="cannot write the map"):
        netcdf.write_layers(path / "below" / "map.nc", nodes, layers(0.0), {})
    assert path.read_bytes() == b"what was there before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_map_may_cross_the_date_line_and_be_cut_there(tmp_path):
    """However its longitudes are written, with a jump or without, and its bounds are given."""
    path, jumping = tmp_path / "map.nc", tmp_path / "jumping.nc"
    wide = {
        k: np.tile(getattr(some_map(), k), (1, 3, 1, 1)) for k in ("tensor", "gravity_disturbance")
    }
    there = dataclasses.replace(some_map(), longitude0=math.radians(179.8), **wide)
    write(path, there)
    shutil.copy(path, jumping)
    with netCDF4.Dataset(jumping, "a") as file:
        longitude = file.variables["longitude"][:]
        file.variables["longitude"][:] = (longitude + 180.0) % 360.0 - 180.0
    assert_same(read(jumping), read(path))
    area = (33.03, 33.05, 179.99, -179.99)
    assert_same(read(path, area), read(path, (33.03, 33.05, 179.99, 180.01)))
    assert read(path, area).tensor.shape[1] < 3 * SHAPE[1]
    nodes, _, _ = netcdf_reader.read_layers(jumping)
    np.testing.assert_allclose(nodes.longitude_deg, 179.8 + 0.02 * np.arange(3 * SHAPE[1]))
