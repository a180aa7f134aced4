"""Checks of an estimator against the contract, in a separate process."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

from ..errors import GGBenchError

if TYPE_CHECKING:
    from ..contract.catalogue import Check

LIMIT_S = 300.0
"""Default time limit of one check [s]."""
_LONGEST_START_S = 3600.0
"""Time limit for the start of the separate process [s]; the first use includes compilation."""
_LOOK_EVERY_S = 0.2


class CheckError(GGBenchError):
    """An estimator cannot be created, so it cannot be checked."""


def examined(
    estimator: str, checks: tuple[Check, ...], limit_s: float
) -> Iterator[tuple[Check, str, str]]:
    """Run the checks; yield each with its verdict (passed, failed, refused) and a sentence.

    The checks run in a separate process. If a check ends this process or exceeds ``limit_s`` [s], a
    new process runs the remaining checks. If the first check fails, the others are not run. Raise
    CheckError if the estimator cannot be created.
    """
    waiting = list(checks)
    while waiting:
        with _isolated(estimator, [each.name for each in waiting]) as (process, answers):
            ready = _answer(process, answers, _LONGEST_START_S)
            if "prepared" in ready:
                ready = _answer(process, answers, limit_s)
            if "cannot" in ready:
                raise CheckError(ready["cannot"])
            if "ready" not in ready:
                raise CheckError(f"{estimator} cannot be imported: {ready['lost']}")
            while waiting:
                answer = _answer(process, answers, limit_s)
                if "begun" in answer:
                    continue
                check = waiting.pop(0)
                verdict, text = answer.get("verdict", "failed"), answer.get("text", "")
                yield check, verdict, answer.get("lost", text)
                if verdict == "failed" and check is checks[0]:
                    return
                if "lost" in answer:
                    break


def _answer(
    process: subprocess.Popen[bytes], answers: Connection, limit_s: float
) -> dict[str, str]:
    """Return the next message of the separate process, or the reason why there is none."""
    start = time.monotonic()
    while not answers.poll(_LOOK_EVERY_S):
        if process.poll() is not None and not answers.poll():
            return {"lost": _ended(process.returncode)}
        if time.monotonic() - start > limit_s:
            return {"lost": f"it did not return within {limit_s:g} s"}
    try:
        answer: dict[str, str] = json.loads(answers.recv_bytes())
    except EOFError:
        return {"lost": _ended(process.wait())}
    return answer


def _ended(code: int) -> str:
    if code < 0:
        return f"its process was ended by {signal.Signals(-code).name}"
    return f"it ended its process, with exit code {code}"


@contextlib.contextmanager
def _isolated(
    estimator: str, names: list[str]
) -> Iterator[tuple[subprocess.Popen[bytes], Connection]]:
    """Start a process that runs the checks; kill it and its process group after the context."""
    answers, theirs = Pipe(duplex=False)
    module, pipe = f"{__package__}.isolated_check", theirs.fileno()
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", module, str(pipe), estimator, *names],
        pass_fds=[pipe],
        start_new_session=True,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    theirs.close()
    try:
        yield process, answers
    finally:
        answers.close()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
