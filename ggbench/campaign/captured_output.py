"""Captured standard output and error of a worker process, separated by run."""

from __future__ import annotations

import os
from collections import deque

from .texts import LONGEST_TEXT, printable

_PIECE = 1 << 16
_AT_ONCE = 64
"""Largest number of pieces per reading, because the parent must also serve other workers."""
_KEPT = 4 * LONGEST_TEXT
"""Number of bytes that are kept from the end of the output of a run."""


class CapturedOutput:
    """The parent's end of the pipe that receives a worker's standard output and error.

    Parameters
    ----------
    descriptor : file descriptor of the pipe; :meth:`close` closes it.
    seam : bytes that the worker writes between two runs, to separate their outputs.
    """

    def __init__(self, descriptor: int, seam: bytes) -> None:
        self._descriptor: int | None = descriptor
        self._seam = seam
        self._over: deque[str] = deque()
        self._end, self._count = b"", 0
        os.set_blocking(descriptor, False)

    @property
    def readable(self) -> list[int]:
        """List with the file descriptor of the pipe; empty if the pipe is closed."""
        return [] if self._descriptor is None else [self._descriptor]

    def read(self) -> None:
        """Read the available output, up to a limit."""
        for _ in range(_AT_ONCE):
            if self._descriptor is None:
                return
            try:
                piece = os.read(self._descriptor, _PIECE)
            except BlockingIOError:
                return
            if not piece:
                self.close()
            self._add(piece)

    def of_run(self) -> str:
        """Return the last part of the output of the latest run."""
        self.read()
        return self._over.popleft() if self._over else self._taken()

    def close(self) -> None:
        """Close the pipe."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def _add(self, piece: bytes) -> None:
        # A seam may be cut in two by the pieces.
        overlap = min(len(self._end), len(self._seam))
        first, *others = (self._end[len(self._end) - overlap :] + piece).split(self._seam)
        self._end = self._end[: len(self._end) - overlap]
        self._count -= overlap
        self._extend(first)
        for other in others:
            self._over.append(self._taken())
            self._extend(other)

    def _extend(self, piece: bytes) -> None:
        self._end = (self._end + piece)[-_KEPT:]
        self._count += len(piece)

    def _taken(self) -> str:
        """Return the end of the output since the last seam, and forget it."""
        tail, count = self._end, self._count
        self._end, self._count = b"", 0
        text = tail.decode(errors="replace").strip()
        excerpt = printable(text[-LONGEST_TEXT:])[-LONGEST_TEXT:]
        if count > len(tail) or len(text) > LONGEST_TEXT:
            return f"({count} bytes, ending with) {excerpt}"
        return excerpt
