"""Files are written whole or not at all."""

from __future__ import annotations

import contextlib
import stat
from pathlib import Path

import pytest

from ggbench.errors import GGBenchError
from ggbench.files.writing import asked_to_end, written_whole


def test_a_file_takes_its_place_when_it_is_whole(tmp_path):
    """Its folder is made, nothing else is left, and whoever may read the folder may read it."""
    path = tmp_path / "new" / "map.nc"
    with written_whole(path, GGBenchError) as temporary:
        temporary.write_text("half of it")
        assert not path.exists()
    assert path.read_text() == "half of it"
    assert [*path.parent.iterdir()] == [path]
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError("wrong")])
def test_what_ends_on_the_way_leaves_what_was_there(tmp_path, error):
    path = tmp_path / "map.nc"
    path.write_text("old")
    with pytest.raises(type(error) if isinstance(error, Exception) else error):  # noqa: SIM117
        with written_whole(path, GGBenchError) as temporary:
            temporary.write_text("half")
            raise error
    assert path.read_text() == "old"
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.parametrize(("asked_before", "kept"), [(False, "old"), (True, "new")])
def test_an_interrupt_that_a_library_swallows_ends_the_file(tmp_path, asked_before, kept):
    """As netCDF4 may; but what is written after a request to end, such as a summary, is whole."""
    path = tmp_path / "map.nc"
    path.write_text("old")
    try:
        if asked_before:
            asked_to_end.set()
        with (
            contextlib.suppress(KeyboardInterrupt),
            written_whole(path, GGBenchError) as temporary,
        ):
            temporary.write_text("new")
            asked_to_end.set()
    finally:
        asked_to_end.clear()
    assert path.read_text() == kept
    assert [*tmp_path.iterdir()] == [path]


def test_what_cannot_be_written_is_said(tmp_path):
    """What it is, where, and why; as the error that was asked for."""
    (tmp_path / "file").write_text("")

    class OwnError(GGBenchError):
        pass

    path = tmp_path / "file" / "map.nc"
    with pytest.raises(OwnError, match=r"cannot write the map .*map\.nc: (Not a dir|File exists)"):  # noqa: SIM117
        with written_whole(Path(path), OwnError, "the map "):
            pass
