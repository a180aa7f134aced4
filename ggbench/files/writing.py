"""Atomic writing of files, and hashes of their content."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import secrets
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

from ..errors import GGBenchError, line_of

_NO_SPACE = {
    errno.ENOSPC: "no space left on the disk",
    errno.EDQUOT: "no space left in the quota",
    errno.EFBIG: "the file is larger than the file system or the process limit allows",
}
_SMALLEST_SHARE = 0.25
"""Smallest expected ratio of the compressed to the uncompressed size of a file of numbers."""
_PROBE = bytes(1 << 20)
MOST_TEXT = 500_000_000
"""Largest unpacked size of a text file [bytes]; its numbers need a few times as much memory."""
asked_to_end = threading.Event()
"""Set by a request to end this process; netCDF4 may suppress the KeyboardInterrupt."""
_temporary: set[Path] = set()
"""Temporary files that this process is writing."""


@contextlib.contextmanager
def written_whole(
    path: Path, error: type[GGBenchError], what: str = "", size: int = 0
) -> Iterator[Path]:
    """Yield a temporary path; at the end the file at this path replaces the target atomically.

    After an error the target is unchanged. Temporary files of killed processes are removed.

    Parameters
    ----------
    path : path of the target; a missing folder is created.
    error : class of the error that is raised if the file cannot be written.
    what : name of the file in the error message.
    size : bytes of the uncompressed file; 0 if unknown. If the disk has less than a quarter of this
        size free, the error is raised before writing.
    """
    free, asked_before = 0, asked_to_end.is_set()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_left_behind(path)
        free = shutil.disk_usage(path.parent).free
        if free < _SMALLEST_SHARE * size:
            raise OSError(errno.ENOSPC, "")
        with _temporary_of(path) as temporary:
            yield temporary
            if not asked_before:  # else it belongs to what is summed up at the end
                end_if_asked()
            temporary.chmod(0o644)
            temporary.replace(path)
    except OSError as failure:
        reason = reason_of(failure)
        if size and out_of_space(failure):
            reason += f": it needs up to {size / 1e6:.3g} MB, and {free / 1e6:.3g} MB are free"
        raise error(f"cannot write {what}{path}: {reason}") from None


@contextlib.contextmanager
def written_together(folder: Path) -> Iterator[Path]:
    """Yield an empty temporary folder; at the end its files are moved to ``folder``.

    If an error or interrupt occurs before the move, ``folder`` is unchanged. Raise OSError if
    ``folder`` cannot be written.
    """
    new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    temporary = folder / f".{os.getpid()}-{secrets.token_hex(4)}.part"
    _temporary.add(temporary)
    try:
        temporary.mkdir()
        yield temporary
        end_if_asked()
        for file in sorted(path for path in temporary.rglob("*") if path.is_file()):
            place = folder / file.relative_to(temporary)
            place.parent.mkdir(parents=True, exist_ok=True)
            file.replace(place)
        new = False
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        _temporary.discard(temporary)
        if new:
            with contextlib.suppress(OSError):
                folder.rmdir()


def out_of_space(failure: OSError) -> bool:
    """Return whether a write failed because the disk is full."""
    return failure.errno in _NO_SPACE


def reason_of(failure: OSError) -> str:
    """Return in words the reason why a file cannot be read or written."""
    return _NO_SPACE.get(failure.errno or 0) or failure.strerror or str(failure)


def end_if_asked() -> None:
    """Raise KeyboardInterrupt if this process has received a request to end."""
    if asked_to_end.is_set():
        raise KeyboardInterrupt


def remove_temporary() -> None:
    """Remove the temporary files of this process, before it ends."""
    for path in tuple(_temporary):
        with contextlib.suppress(OSError):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


@contextlib.contextmanager
def _temporary_of(path: Path) -> Iterator[Path]:
    """Yield an empty temporary file in the folder of a path, and remove it at the end.

    The name of the file contains the process id.

    Raises
    ------
    OSError
        If the file cannot be created. It also replaces a library's exception if the disk is full.
    """
    # Named before it is made: an interrupt between the two would leave it.
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp")
    _temporary.add(temporary)
    try:
        temporary.touch(mode=0o600, exist_ok=False)
        yield temporary
    except (OSError, GGBenchError):
        raise
    except Exception:
        # Libraries such as HDF5 say of a full disk that there was an error, and no more.
        with temporary.open("ab") as file:
            file.write(_PROBE)
        raise
    finally:
        temporary.unlink(missing_ok=True)
        _temporary.discard(temporary)


def _remove_left_behind(path: Path) -> None:
    """Remove temporary files of a path whose processes no longer run."""
    import psutil

    name = re.compile(rf"\.{re.escape(path.name)}\.(\d+)-\w+\.tmp")
    for file in path.parent.iterdir():
        match = name.fullmatch(file.name)
        if match and not psutil.pid_exists(int(match[1])):
            with contextlib.suppress(OSError):
                file.unlink()


def content_of(
    path: Path, error: type[GGBenchError], what: str = "", most: int = MOST_TEXT
) -> bytes:
    """Return the content of a small file.

    Parameters
    ----------
    path : path of the file.
    error : class of the error that is raised if the file cannot be read or is larger than ``most``.
    what : name of the file in the error message.
    most : largest number of bytes; it also limits reading from a device.
    """
    try:
        with path.open("rb") as file:
            content = file.read(most + 1)
    except (OSError, ValueError) as failure:  # ValueError: of a path with a null byte
        reason = reason_of(failure) if isinstance(failure, OSError) else str(failure)
        raise error(f"cannot read {what}{line_of(str(path))}: {reason}") from None
    if len(content) > most:
        raise error(f"cannot read {what}{line_of(str(path))}: it has more than {most / 1e6:g} MB")
    return content


def sha256_of(path: Path, error: type[GGBenchError], what: str = "") -> str:
    """Return the SHA-256 of a file's content as hexadecimal text.

    Parameters
    ----------
    path : path of the file.
    error : class of the error that is raised if the file cannot be read.
    what : name of the file in the error message.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as failure:
        raise error(f"cannot read {what}{path}: {reason_of(failure)}") from None
