"""Files of named arrays and texts: netCDF-4, MATLAB 5 or plain text."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GGBenchError, text_of
from ..files.netcdf import NETCDF_LOCK, netcdf_file, new_netcdf_file
from ..files.writing import written_whole

Content = Mapping[str, np.ndarray | str]
"""Arrays of floats, and texts, by name."""

LARGEST_BYTES = 2**31
"""Largest size of a file and of its arrays, which is the limit of MATLAB 5."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
_TEXT_MARK, _ARRAY_MARK = "text", "array"


class ExchangeError(GGBenchError):
    """A file of problems or estimates is invalid."""


def write(path: Path, content: Content, notes: Mapping[str, str]) -> None:
    """Write arrays and texts to a file; the suffix of the file chooses the format.

    Parameters
    ----------
    path : path with the suffix .nc (netCDF-4), .mat (MATLAB 5) or .txt (plain text).
    content : arrays (any shape) and texts by name.
    notes : description of each array; only netCDF and plain text store it.

    Raises
    ------
    ExchangeError
        If the suffix is unknown, the content is too large, or the file cannot be written.
    """
    size = sum(v.nbytes for v in content.values() if isinstance(v, np.ndarray))
    if size > LARGEST_BYTES:
        raise ExchangeError(
            f"{path} would have {size / 1e9:.3g} GB, more than "
            f"{LARGEST_BYTES / 1e9:.3g} GB: export fewer runs at once"
        )
    writer = _format_of(path)[0]
    with written_whole(path, ExchangeError, size=size) as temporary:
        writer(temporary, content, notes)


def read(path: Path) -> dict[str, np.ndarray | str]:
    """Return the arrays and texts of a file by name; arrays have floats and any shape (...).

    Arrays of MATLAB files have at least two axes and lose trailing axes of length one, see
    :func:`shaped`.

    Raises
    ------
    ExchangeError
        If the file cannot be read, is damaged or too large, or contains anything except arrays of
        real numbers and texts.
    """
    reader = _format_of(path)[1]
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise ExchangeError(f"{path} is not a file")
        _require_small(path, size)
        return reader(path)
    except ExchangeError:
        raise
    except OSError as error:
        raise ExchangeError(f"cannot read {path}: {error.strerror or text_of(error)}") from None
    except NotImplementedError:  # scipy's, of a MATLAB file that is HDF5
        raise ExchangeError(
            f"{path} is a file of MATLAB 7.3: save it with the option '-v7', or as .nc"
        ) from None
    except Exception as error:  # readers of damaged files raise anything
        raise ExchangeError(f"{path} is damaged: {text_of(error)}") from None


def _require_small(path: Path, size: int) -> None:
    if size > LARGEST_BYTES:
        limit = LARGEST_BYTES / 1e9
        raise ExchangeError(f"{path} has {size / 1e9:.3g} GB; at most {limit:.3g} GB are allowed")


def shaped(array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray | None:
    """Reshape an array of any shape (...) to a shape that differs only in axes of length one.

    Return None if the shapes differ in other axes too.
    """
    if [n for n in array.shape if n != 1] != [n for n in shape if n != 1]:
        return None
    return array.reshape(shape)


def _format_of(path: Path) -> tuple[Callable[..., None], Callable[[Path], dict[str, Any]]]:
    if path.suffix not in _FORMATS:
        raise ExchangeError(f"{path} must end with {', '.join(_FORMATS)}")
    return _FORMATS[path.suffix]


def _checked(path: Path, name: str, value: Any) -> np.ndarray | str:
    """Return a value of a file: real numbers as an array of floats, or a text."""
    if not _NAME.fullmatch(name):
        raise ExchangeError(f"{path}: {name[:80]!a} is not a valid name of an array")
    if isinstance(value, str):
        return value
    array = np.ma.filled(value, math.nan) if np.ma.isMaskedArray(value) else np.asarray(value)
    if array.dtype.kind == "U":
        return "\n".join(map(str, array.ravel())).rstrip()
    if array.dtype.kind not in "biuf":
        kind = {"c": "complex numbers", "S": "bytes"}.get(array.dtype.kind, str(array.dtype)[:40])
        raise ExchangeError(f"{path}: {name} contains {kind}, not real numbers")
    return np.ascontiguousarray(array, dtype=float)


def _write_netcdf(path: Path, content: Content, notes: Mapping[str, str]) -> None:
    with NETCDF_LOCK, new_netcdf_file(path) as file:
        for name, value in content.items():
            if isinstance(value, str):
                file.setncattr_string(name, value)
                continue
            axes = []
            for length in value.shape:
                axis = f"n{length}"
                if axis not in file.dimensions:
                    file.createDimension(axis, length)
                axes.append(axis)
            variable = file.createVariable(name, "f8", axes, zlib=value.size > 100, complevel=1)
            variable[...] = value
            if name in notes:
                variable.setncattr_string("long_name", notes[name])


def _read_netcdf(path: Path) -> dict[str, np.ndarray | str]:
    content: dict[str, np.ndarray | str] = {}
    with netcdf_file(path, ExchangeError, str(path)) as file:
        file.set_auto_mask(False)
        total = sum(math.prod(v.shape) for v in file.variables.values()) * 8
        if total > LARGEST_BYTES:
            raise ExchangeError(
                f"{path} contains {total / 1e9:.3g} GB, more than {LARGEST_BYTES / 1e9:.3g}"
            )
        for name in file.ncattrs():
            if isinstance(value := file.getncattr(name), str):
                content[name] = _checked(path, name, value)
        for name, variable in file.variables.items():
            content[name] = _checked(path, name, variable[...])
    return content


def _write_matlab(path: Path, content: Content, notes: Mapping[str, str]) -> None:
    from scipy.io import savemat

    with path.open("wb") as file:
        savemat(file, dict(content), format="5", do_compression=True, oned_as="column")


def _read_matlab(path: Path) -> dict[str, np.ndarray | str]:
    from scipy.io import loadmat, whosmat

    with path.open("rb") as file:
        if file.read(8)[1:4] == b"HDF":
            raise ExchangeError(f"{path} is a MATLAB 7.3 file: save with -v7 or -v6, or as netCDF")
    total = sum(math.prod(map(int, shape)) for _, shape, _ in whosmat(path)) * 8
    _require_small(path, total)
    content = loadmat(path, chars_as_strings=True, struct_as_record=True)
    return {n: _checked(path, n, v) for n, v in content.items() if not n.startswith("__")}


def _write_text(path: Path, content: Content, notes: Mapping[str, str]) -> None:
    """Write ``text NAME`` and a line, or ``array NAME AXES LENGTHS...`` and its numbers by rows."""
    with path.open("w", encoding="utf-8") as file:
        for name, value in content.items():
            if name in notes:
                file.write(f"# {name}: {notes[name]}\n")
            if isinstance(value, str):
                escaped = value.replace("\n", "\\n")
                file.write(f"{_TEXT_MARK} {name}\n{escaped}\n")
                continue
            shape = " ".join(map(str, value.shape))
            file.write(f"{_ARRAY_MARK} {name} {value.ndim} {shape}\n")
            rows = value.reshape(-1, value.shape[-1] if value.ndim and value.size else 1)
            for row in rows:
                file.write(" ".join(map(repr, row.tolist())) + "\n")


def _read_text(path: Path) -> dict[str, np.ndarray | str]:
    content: dict[str, np.ndarray | str] = {}
    with path.open(encoding="utf-8") as file:
        lines = iter(file)
        for line in lines:
            words = line.split()
            if not words or words[0].startswith("#"):
                continue
            if words[0] == _TEXT_MARK and len(words) == 2:
                value: Any = next(lines, "").rstrip("\r\n").replace("\\n", "\n")
            elif words[0] == _ARRAY_MARK and len(words) >= 3:
                value = _numbers(path, words[1], words[2:], lines)
            else:
                raise ExchangeError(
                    f"{path}: {line.strip()[:80]!a} must be 'text NAME' or 'array NAME AXES "
                    "LENGTHS...'"
                )
            content[words[1]] = _checked(path, words[1], value)
    return content


def _numbers(path: Path, name: str, sizes: list[str], lines: Iterator[str]) -> np.ndarray:
    """Read the numbers after the header line of an array; return them in the stated shape."""
    lengths = [int(size) if size.isdecimal() and len(size) < 12 else -1 for size in sizes]
    axes, shape = lengths[0], tuple(lengths[1:])
    count = math.prod(shape)
    if min(lengths) < 0 or axes != len(shape) or count * 8 > LARGEST_BYTES:
        raise ExchangeError(f"{path}: the shape of {name} is damaged: {' '.join(sizes)[:80]}")
    parts: list[np.ndarray] = []
    count_read = 0
    while count_read < count:
        line = next(lines, None)
        if line is None:
            raise ExchangeError(f"{path}: {name} ends after {count_read} of {count} numbers")
        try:
            part = np.array(line.split(), dtype=float)
        except ValueError:
            raise ExchangeError(
                f"{path}: {name} contains {line.strip()[:80]!a}, which is not a number"
            ) from None
        parts.append(part)
        count_read += part.size
    if count_read > count:
        raise ExchangeError(f"{path}: {name} has more numbers than its shape, {count}")
    return np.concatenate(parts or [np.empty(0)]).reshape(shape)


_FORMATS = {
    ".nc": (_write_netcdf, _read_netcdf),
    ".mat": (_write_matlab, _read_matlab),
    ".txt": (_write_text, _read_text),
}
SUFFIXES = tuple(_FORMATS)
"""Suffixes of files that are written and read."""
