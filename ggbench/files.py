"""Files that are written whole or not at all."""

from __future__ import annotations

import contextlib
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
    error : raised, with a sentence, if it cannot be written. what : it is, in that sentence.
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
