"""Files that are written whole or not at all, and what stands for their content."""

from __future__ import annotations

import contextlib
import hashlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

from .errors import GGBenchError


@contextlib.contextmanager
def written_whole(path: Path, error: type[GGBenchError], what: str = "") -> Iterator[Path]:
    """Yield where to write a file, which takes its place in one stroke or not at all.

    Parameters
    ----------
    path : of the file; its folder is made if need be.
    error : raised, with a sentence, if it cannot be written.
    what : it is, in that sentence.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(
            dir=path.parent, prefix=f".{path.name}.", suffix=".tmp", delete=False
        ) as file:
            temporary = Path(file.name)
        try:
            yield temporary
            temporary.chmod(0o644)
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    except OSError as failure:
        reason = failure.strerror or str(failure)
        raise error(f"cannot write {what}{path}: {reason}") from None


def sha256_of(path: Path, error: type[GGBenchError], what: str = "") -> str:
    """Return the SHA-256 of a file's content, hexadecimal.

    Parameters
    ----------
    path : of the file.
    error : raised, with a sentence, if it cannot be read.
    what : it is, in that sentence.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as failure:
        reason = failure.strerror or str(failure)
        raise error(f"cannot read {what}{path}: {reason}") from None
