"""What exceptions say and estimators print, as a record can hold it and a terminal show it."""

from __future__ import annotations

import traceback

LONGEST_TEXT = 4000
"""Most characters of an exception, a traceback, or of what was printed in a run."""


def said(error: BaseException) -> str:
    """Return an exception as a record can hold it and a terminal show it: printable, not long."""
    try:
        text = str(error)
    except Exception:
        text = "(its text cannot be made)"
    return printable(f"{type(error).__name__}: {text}")


def traced() -> str:
    """Return the traceback of the exception being handled, its end if it is long."""
    try:
        return printable(traceback.format_exc()[-LONGEST_TEXT:])
    except Exception:  # as long as the exception's own text is part of it
        return ""


def printable(text: str) -> str:
    """Return a text with what a terminal would obey, or no file can hold, spelt out; and cut."""
    shown = (c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text[:LONGEST_TEXT])
    return "".join(shown)
