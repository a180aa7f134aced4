"""Printable texts from exceptions and from the output of estimators."""

from __future__ import annotations

import inspect
import traceback
from contextlib import nullcontext
from typing import TYPE_CHECKING

from ..errors import brief
from ..figures.numbers import some
from ..problem import Estimator
from .foreign_changes import OWN_MODULE, put_back

if TYPE_CHECKING:
    from ..problem import Problem

LONGEST_TEXT = 4000
"""Most characters of an exception, of a traceback, or of the output of a run."""


def exception_text(error: BaseException) -> str:
    """Return the class name and message of an exception, printable and shortened."""
    try:
        text = str(error)
    except Exception:
        text = "(message not available: str() failed)"
    return printable(f"{type(error).__name__}: {text}")


def refusal(estimator: Estimator, problem: Problem) -> str:
    """Return in one short line why an estimator cannot process a problem, or "" if it can.

    The reason is the result of ``skip``, an exception in ``skip``, or the fact that ``skip``
    replaces functions of other modules.
    """
    replaced: list[str] = []
    own = type(estimator).__module__.startswith(OWN_MODULE)
    guarded = own and inspect.getattr_static(estimator, "skip") is not Estimator.skip
    try:
        with put_back(replaced) if guarded else nullcontext():
            reason = estimator.skip(problem)
        if replaced:
            reason = f"its skip replaces {some(replaced)}"
        return brief(str(reason)) if reason else ""
    except Exception as error:
        return brief(f"its skip raises {exception_text(error)}")


def traceback_text() -> str:
    """Return the end of the traceback of the current exception as printable text."""
    try:
        return printable(traceback.format_exc()[-LONGEST_TEXT:])
    except Exception:  # as long as the exception's own text is part of it
        return ""


def printable(text: str) -> str:
    """Return a shortened text, with control characters and lone surrogates as escapes."""
    characters = (
        c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text[:LONGEST_TEXT]
    )
    return "".join(characters)
