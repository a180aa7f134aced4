"""Access to netCDF files: one user error for any failure to read, and one thread at a time.

The libraries netCDF and HDF5 are not safe for threads ("Questions about thread-safety and
concurrent access", HDF5 documentation). Two threads that use them at the same time, even for
different files, cause a segmentation fault. Therefore a thread holds :data:`NETCDF_LOCK` while it
uses a file.

HDF5, the format of netCDF-4, can read values from other files of the computer in three ways:
external storage, virtual datasets and external links (HDF5 File Format Specification 3.0, IV.A.2.g,
h, i). netCDF follows them silently. This module detects them before it opens a file.
"""

from __future__ import annotations

import contextlib
import importlib
import mmap
import re
import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from ..errors import GGBenchError, reported, text_of
from .writing import reason_of

NETCDF_LOCK = threading.RLock()
"""Held while a thread opens, reads, writes or closes any netCDF file."""

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_LINK = re.compile(rb"\x01[\x08-\x1f]\x40", re.DOTALL)
"""First bytes of an external link message: version 1, flags, link type 64."""
_VIRTUAL = re.compile(rb"[\x04\x05]\x03")
"""Version and class of a data layout message of a virtual dataset; an address follows."""
_MOST_HEAPS = 1000
_LONGEST_NAME = 1 << 16


@contextlib.contextmanager
def netcdf_file(
    path: Path,
    error: type[GGBenchError],
    what: str,
    library: Literal["netCDF4", "xarray"] = "netCDF4",
    *,
    again: bool = False,
) -> Iterator[Any]:
    """Open a netCDF file for reading, hold the lock while it is open, and close it.

    Parameters
    ----------
    path : path of a netCDF-3 or netCDF-4 file.
    error : class of the error that is raised if the file links to data in another file, or if
        opening or reading it fails. It replaces any exception of the libraries; a
        :class:`.errors.GGBenchError` passes unchanged.
    what : name of the file in the error message.
    library : ``netCDF4`` yields a ``netCDF4.Dataset``; ``xarray`` yields an ``xarray.Dataset`` with
        missing values as NaN and times as numbers.
    again : whether an earlier call has searched the file for links to other files. If True,
        the search is omitted.
    """
    if not again:
        require_own_values(path, error, what)
    try:
        package = importlib.import_module(library)
        importlib.import_module("netCDF4")
    except ImportError as failure:
        raise error(
            f"{what} needs the package {failure.name or library} ({text_of(failure)}): pip "
            "install 'ggbench[terrain]'"
        ) from None
    with (
        NETCDF_LOCK,
        reported(error, f"{what} cannot be read as a netCDF file"),
        (
            package.open_dataset(path, engine="netcdf4", decode_times=False)
            if library == "xarray"
            else package.Dataset(path)
        ) as file,
    ):
        yield file


@contextlib.contextmanager
def new_netcdf_file(path: Path) -> Iterator[Any]:
    """Create a netCDF-4 file, yield its ``netCDF4.Dataset``, and close it.

    The function holds :data:`NETCDF_LOCK` only while it creates or closes the file. Hold it while
    you write.
    """
    import netCDF4

    with NETCDF_LOCK:
        file = netCDF4.Dataset(path, "w", format="NETCDF4")
    try:
        yield file
    finally:
        with NETCDF_LOCK:
            file.close()


def require_own_values(path: Path, error: type[GGBenchError], what: str) -> None:
    """Raise an error if a netCDF file takes values from another file.

    Parameters
    ----------
    path : path of the file; files other than HDF5 pass.
    error : class of the error that is raised, also if the file cannot be read.
    what : name of the file in the error message.
    """
    try:
        with path.open("rb") as file:
            if not path.stat().st_size:
                return
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                way = _way_out(content)
    except (OSError, ValueError) as failure:
        reason = reason_of(failure) if isinstance(failure, OSError) else str(failure)
        raise error(f"cannot read {what}: {reason}") from None
    if way:
        raise error(
            f"{what} refers to values in another file ({way}): copy all values into one file, for "
            "example with 'nccopy' or 'h5repack'"
        )


def _way_out(content: mmap.mmap) -> str:
    """Return in words the first reference to another file, or "" if there is none.

    The three kinds are external storage, virtual datasets and external links. Raise ValueError if
    the file has too many local heaps to search.
    """
    base = _base(content)
    if base < 0:
        return ""
    heaps = _addresses(content, b"HEAP", base)
    if len(heaps) > _MOST_HEAPS:
        raise ValueError(
            f"its {len(heaps)} groups are too many to search for values in other files (at most "
            f"{_MOST_HEAPS}): copy its variables into one file with fewer groups"
        )
    for address in heaps:
        for at in _places(content, address, 8):
            # An external file list: version 1, reserved, allocated and used slots, heap.
            version, allocated, used = struct.unpack("<LHH", content[at - 8 : at])
            if version == 1 and 0 < used <= allocated:
                return "external storage"
    if heaps := _addresses(content, b"GCOL", base):
        size = len(next(iter(heaps)))
        for head in _VIRTUAL.finditer(content):
            if content[head.end() : head.end() + size] in heaps:
                return "a virtual dataset"
    if any(_is_link(content, begin.end()) for begin in _LINK.finditer(content)):
        return "an external link"
    return ""


def _base(content: mmap.mmap) -> int:
    """Return the offset of the HDF5 superblock: 0, 512, 1024, 2048, ...; −1 if there is none."""
    at = 0
    while at < len(content):
        if content[at : at + len(_SIGNATURE)] == _SIGNATURE:
            return at
        at = max(512, 2 * at)
    return -1


def _addresses(content: mmap.mmap, mark: bytes, base: int) -> set[bytes]:
    """Return the addresses of all structures with a signature ``mark``, relative to ``base``.

    The addresses are encoded as in the file: little-endian bytes of the width that it uses.
    """
    size = content[base + (13 if content[base + 8] < 2 else 9)]  # of superblocks 0 and 1, else 2, 3
    places = (at - base for at in _places(content, mark, base))
    return {at.to_bytes(size, "little") for at in places if at < 256**size}


def _places(content: mmap.mmap, pattern: bytes, first: int = 0) -> Iterator[int]:
    at = content.find(pattern, first)
    while at >= 0:
        yield at
        at = content.find(pattern, at + 1)


def _is_link(content: mmap.mmap, at: int) -> bool:
    """Return whether the bytes at ``at``, after the link type, are those of an external link.

    They must contain the name of the link, the path of a file and the path of an object in it.
    """
    flags = content[at - 2]
    at += 8 * bool(flags & 4) + bool(flags & 16)
    width = 1 << (flags & 3)
    size = int.from_bytes(content[at : at + width], "little")
    at += width + size
    if not 0 < size < _LONGEST_NAME or at + 2 > len(content):
        return False
    length = int.from_bytes(content[at : at + 2], "little")
    value = content[at + 2 : at + 2 + length]
    if not (len(value) == length > 4 and value[:1] == b"\0" and value.endswith(b"\0")):
        return False
    names = value[1:-1].decode(errors="replace").split("\0")
    return len(names) == 2 and all(name.isprintable() and "\ufffd" not in name for name in names)
