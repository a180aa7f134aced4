"""Base class of user errors, and short messages from exceptions of libraries."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

_LONGEST_REASON = 300
_LONGEST_TEXT = 200


class GGBenchError(Exception):
    """An error that a user can cause.

    The message is one sentence with the fault, the place and the allowed values.
    """


@contextlib.contextmanager
def reported(error: type[GGBenchError], failure: str) -> Iterator[None]:
    """Convert any exception of a library in the ``with`` block to a user error.

    A :class:`GGBenchError` passes unchanged.

    Parameters
    ----------
    error : class of the error that is raised instead.
    failure : beginning of the message; the text of the exception follows.
    """
    try:
        yield
    except GGBenchError:
        raise
    except Exception as reason:
        raise error(f"{failure}: {text_of(reason)}") from None


def text_of(error: BaseException) -> str:
    """Return the message of a library's exception as one short, printable line.

    Libraries quote their input, so the original message may be of any length.
    """
    return line_of(str(error)) or type(error).__name__


def brief(text: str) -> str:
    """Return the text of a failure as one printable line of at most 300 characters.

    The tables of a results folder contain the whole text.
    """
    line = line_of(text, _LONGEST_REASON + 1)
    return line if len(line) <= _LONGEST_REASON else f"{line[: _LONGEST_REASON - 1]}…"


def line_of(text: str, longest: int = _LONGEST_TEXT) -> str:
    """Return an untrusted text as one printable line with a maximum length.

    Line breaks become spaces, and control characters become escapes.
    """
    line = " ".join(text[: 2 * longest].split())
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line[:longest])
