"""Files as they are sent: compressed with gzip, or one file in an archive of zip or tar."""

from __future__ import annotations

import gzip
import io
import tarfile
import zipfile
import zlib
from pathlib import Path

from ..errors import text_of
from ..gravity.gradient_map import MapError

_GZIP, _ZIP, _TAR, _TAR_AT = b"\x1f\x8b", b"PK\x03\x04", b"ustar", 257


def unpacked(path: Path, content: bytes, wanted: str) -> bytes:
    """Return the content of a file that may be packed.

    Parameters
    ----------
    path : of the file, for messages.
    content : of it.
    wanted : suffix of the one file that is taken from an archive of several.

    Raises
    ------
    MapError
        If it is damaged, or an archive of several files.
    """
    try:
        if content.startswith(_GZIP):
            content = gzip.decompress(content)
        if content.startswith(_ZIP):
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                files = [name for name in archive.namelist() if not name.endswith("/")]
                return archive.read(_only(path, files, wanted))
        if content[_TAR_AT:].startswith(_TAR):
            with tarfile.open(fileobj=io.BytesIO(content)) as tar:
                files = [member.name for member in tar.getmembers() if member.isfile()]
                extracted = tar.extractfile(_only(path, files, wanted))
                return extracted.read() if extracted is not None else b""
    except (
        OSError, EOFError, zlib.error, zipfile.BadZipFile, tarfile.TarError, RuntimeError,
        NotImplementedError,
    ) as error:  # fmt: skip
        raise MapError(f"{path} is damaged: {text_of(error)}") from None
    return content


def _only(path: Path, files: list[str], wanted: str) -> str:
    """The only file of an archive, or the only one with the suffix."""
    suited = files if len(files) == 1 else [name for name in files if name.endswith(wanted)]
    if len(suited) != 1:
        raise MapError(
            f"{path} is an archive of {len(files)} files, {len(suited)} of them *{wanted}; one is "
            "allowed: unpack it first."
        )
    return suited[0]
