"""Packed files: gzip, zip, tar and NumPy archives, unpacked within limits.

Archives are untrusted. For damaged archives the libraries raise a dozen kinds of exceptions (a zip
header alone: BadZipFile, NotImplementedError, RuntimeError, OverflowError, struct.error, EOFError,
zlib.error). This module converts each exception to the caller's error class, with a message of one
sentence.
"""

from __future__ import annotations

import gzip
import io
import tarfile
import zipfile
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..errors import GGBenchError, line_of, reported
from .writing import MOST_TEXT

MOST_ARRAYS = 1_000_000_000
"""Largest unpacked size of the arrays in a file [bytes]."""
_PIECE = 1 << 20
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Allowed compression methods of zip files; all others are unpacked without a memory limit."""


def _unpacking(error: type[GGBenchError], what: str) -> AbstractContextManager[None]:
    """Return a context that converts exceptions of damaged files to ``error``."""
    return reported(error, f"{what} cannot be unpacked")


def gunzipped(content: bytes, error: type[GGBenchError], what: str) -> bytes:
    """Return the content of a gzip file, at most :data:`.files.MOST_TEXT` bytes.

    Parameters
    ----------
    content : content of the packed file.
    error : class of the error that is raised if the file is damaged or unpacks to more.
    what : name of the file in the error message.
    """
    with _unpacking(error, what), gzip.GzipFile(fileobj=io.BytesIO(content)) as packed:
        return _bounded(packed, error, what)


def from_zip(
    content: bytes, choose: Callable[[list[str]], str], error: type[GGBenchError], what: str
) -> bytes:
    """Return one file of a zip archive, at most :data:`.files.MOST_TEXT` bytes.

    Parameters
    ----------
    content : content of the archive.
    choose : function that selects one of the file names in the archive.
    error : class of the error that is raised if the archive is damaged, is compressed by another
        method than deflate, or unpacks to more.
    what : name of the file in the error message.
    """
    with _unpacking(error, what), zipfile.ZipFile(io.BytesIO(content)) as archive:
        name = choose([file.filename for file in archive.infolist() if not file.is_dir()])
        _require_method(archive.getinfo(name), error, what)
        with archive.open(name) as packed:
            return _bounded(packed, error, what)


def from_tar(
    content: bytes, choose: Callable[[list[str]], str], error: type[GGBenchError], what: str
) -> bytes:
    """Return one file of a tar archive, with the arguments and errors of :func:`from_zip`."""
    with _unpacking(error, what), tarfile.open(fileobj=io.BytesIO(content)) as archive:
        name = choose([file.name for file in archive.getmembers() if file.isfile()])
        packed = archive.extractfile(name)
        return _bounded(packed, error, what) if packed is not None else b""


def read_arrays(
    source: Path | bytes,
    error: type[GGBenchError],
    what: str,
    keys: Iterable[str] | None = None,
) -> dict[str, Any]:
    """Return arrays of a NumPy archive (``.npz``), together at most :data:`MOST_ARRAYS` bytes.

    Parameters
    ----------
    source : path or content of the archive.
    error : class of the error that is raised if the archive is damaged, unpacks to more, or lacks
        an array.
    what : name of the archive in the error message.
    keys : names of the arrays to read; None: all.
    """
    opened = source if isinstance(source, Path) else io.BytesIO(source)
    with _unpacking(error, what):
        with zipfile.ZipFile(opened) as archive:
            members = archive.infolist()
        for member in members:
            _require_method(member, error, what)
        size = sum(member.file_size for member in members)
        if size > MOST_ARRAYS:
            raise error(
                f"{what} unpacks to {size / 1e6:.0f} MB; at most {MOST_ARRAYS / 1e6:g} are allowed"
            )
        with np.load(opened, allow_pickle=False) as arrays:
            names = arrays.files if keys is None else [*keys]
            if missing := [key for key in names if key not in arrays]:
                present = line_of(", ".join(arrays.files)) or "none"
                raise error(f"{what} lacks the array {missing[0]}; it holds {present}")
            loaded = {key: arrays[key] for key in names}
    for key, value in loaded.items():
        if not isinstance(value, np.ndarray):  # NumPy returns other files as they are
            raise error(f"{what} cannot be unpacked: {line_of(key)} is no array")
    return loaded


def _require_method(member: zipfile.ZipInfo, error: type[GGBenchError], what: str) -> None:
    if member.compress_type not in _METHODS:
        raise error(
            f"{what} cannot be unpacked: its zip compression method is {member.compress_type}; "
            "only 8 (deflate) and 0 (uncompressed) are allowed"
        )


def _bounded(packed: IO[bytes] | gzip.GzipFile, error: type[GGBenchError], what: str) -> bytes:
    """Return the content of a packed file if it has at most :data:`.files.MOST_TEXT` bytes.

    The file is unpacked twice. The first pass only counts the bytes, in small pieces, because the
    size stated in the file may be false. A file that is too large therefore needs little memory.
    """
    size = 0
    while piece := packed.read(_PIECE):
        size += len(piece)
        if size > MOST_TEXT:
            raise error(f"{what} unpacks to more than {MOST_TEXT / 1e6:g} MB")
    packed.seek(0)
    return packed.read(size)
