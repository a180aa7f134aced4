"""Messages between a campaign and its workers, protected against foreign bytes.

A message consists of its length, a checksum and pickled bytes. Bytes that an estimator writes to
the connection are detected and never unpickled.
"""

from __future__ import annotations

import pickle
import struct
import zlib
from collections.abc import Iterator
from typing import Any

_MARK = b"ggb\x00"
_HEADER = struct.Struct("<4sIQ")
_LARGEST = 1 << 32


class GarbledError(Exception):
    """Received bytes do not form a valid message."""


def packed(message: object) -> bytes:
    """Return a message as bytes with length and checksum."""
    content = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    return _HEADER.pack(_MARK, zlib.crc32(content), len(content)) + content


class Inbox:
    """Reassembles messages from pieces of received bytes."""

    def __init__(self) -> None:
        self._held = bytearray()

    def take(self, piece: bytes) -> Iterator[Any]:
        """Add a piece of bytes, and yield the messages that it completes.

        Raise GarbledError if the bytes are no message.
        """
        self._held += piece
        while len(self._held) >= _HEADER.size:
            mark, checksum, length = _HEADER.unpack_from(self._held)
            if mark != _MARK or length > _LARGEST:
                raise GarbledError
            end = _HEADER.size + length
            if len(self._held) < end:
                return
            content = bytes(self._held[_HEADER.size : end])
            del self._held[:end]
            if zlib.crc32(content) != checksum:
                raise GarbledError
            try:
                message = pickle.loads(content)
            except Exception:  # of a process that changed how messages are written
                raise GarbledError from None
            yield message
