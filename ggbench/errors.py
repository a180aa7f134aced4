"""The base class of the errors that users can cause, and the texts of other errors."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

_LONGEST_REASON = 300
_LONGEST_TEXT = 200


class GGBenchError(Exception):
    """An error a user can cause.

    Its message is a sentence that says what was wrong, where, and what is allowed.
    """


@contextlib.contextmanager
def reported(error: type[GGBenchError], failure: str) -> Iterator[None]:
    """Raise whatever a library raises within the context as an error with one sentence.

    Errors of the package pass.

    Parameters
    ----------
    error : raised instead.
    failure : beginning of the sentence; the reason follows.
    """
    try:
        yield
    except GGBenchError:
        raise
    except Exception as reason:
        raise error(f"{failure}: {text_of(reason)}") from None


def text_of(error: BaseException) -> str:
    """Return what an error of a library says, for a sentence: on one line, printable and short.

    Libraries quote what they read, and a damaged file may be quoted at any length.
    """
    return line_of(str(error)) or type(error).__name__


def brief(text: str) -> str:
    """Return the reason of a failure as one printable line of at most 300 characters.

    The tables of a results folder keep the whole text.
    """
    line = line_of(text, _LONGEST_REASON + 1)
    return line if len(line) <= _LONGEST_REASON else f"{line[: _LONGEST_REASON - 1]}…"


def line_of(text: str, longest: int = _LONGEST_TEXT) -> str:
    """Return a text of anyone's as one printable line of at most some characters.

    Line breaks become spaces; control characters, which a terminal would obey, become escapes.
    """
    line = " ".join(text[: 2 * longest].split())
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line[:longest])
