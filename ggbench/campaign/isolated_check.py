"""Separate process for the checks of ``ggbench check``.

A user's file may print endlessly, end the process or never return. Results are therefore sent
through a pipe to the parent.
"""

from __future__ import annotations

import inspect
import json
import os
import sys
import traceback
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

_LONGEST_LINE = 60


def main(pipe: str, text: str, names: list[str]) -> None:
    """Run checks on an estimator, and send the results through a pipe.

    ``pipe`` is the file descriptor of the pipe, ``text`` the text of the estimator, and ``names``
    are the names of the checks.
    """
    answers = Connection(int(pipe), readable=False)
    os.set_inheritable(int(pipe), False)

    def tell(**answer: str) -> None:
        answers.send_bytes(json.dumps(answer).encode())

    from ..contract.catalogue import CHECKS, flight
    from ..errors import GGBenchError
    from ..estimator_spec import EstimatorSpec
    from . import registry

    try:
        flight()  # which is compiled at the first use, and is no time of the estimator's
    except GGBenchError as error:
        tell(cannot=str(error))
        return
    tell(prepared="")
    try:
        estimator = registry.choose(text).estimator
    except GGBenchError as error:  # of a program or a file of estimates, too
        cause = error.__cause__
        line = _line_of(cause, EstimatorSpec.parse(text).name) if cause else ""
        tell(cannot=f"{error}{f' ({line})' if line else ''}")
        return
    file = inspect.getsourcefile(type(estimator)) or ""
    tell(ready=type(estimator).__name__)
    for check in CHECKS:
        if check.name in names:
            tell(begun=check.name)
            tell(done=check.name, **_asked(partial(check.ask, estimator), file))


def _asked(ask: Callable[[], str], file: str) -> dict[str, str]:
    """Run a check; return its verdict and a sentence."""
    from ..contract.demands import Broken, Refused
    from .texts import exception_text, printable

    try:
        return {"verdict": "passed", "text": printable(ask())}
    except Refused as refusal:
        return {"verdict": "refused", "text": printable(str(refusal))}
    except Broken as broken:
        return {"verdict": "failed", "text": printable(str(broken))}
    except BaseException as error:
        where = "".join(f"{note}: " for note in getattr(error, "__notes__", ())[-1:])
        line = _line_of(error, file)
        return {
            "verdict": "failed",
            "text": f"{where}{exception_text(error)}{f' ({line})' if line else ''}",
        }


def _line_of(error: BaseException, file: str) -> str:
    """Return the last line of a file in the traceback of an exception, or "" if none is."""
    if isinstance(error, SyntaxError) and error.filename == file:
        return f"{Path(file).name}, line {error.lineno}"
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if Path(frame.filename) == Path(file):
            line = (frame.line or "").strip()
            if len(line) > _LONGEST_LINE:
                line = f"{line[:_LONGEST_LINE]}..."
            return f"{Path(file).name}, line {frame.lineno}{f': {line}' if line else ''}"
    return ""


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3:])
