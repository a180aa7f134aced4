"""``ggbench check``: test of an estimator against the contract."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections import Counter
from collections.abc import Iterator
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

import click

from ..display.compiling import tell_first_use
from ..errors import GGBenchError
from ..figures.numbers import counted
from .screen import console

if TYPE_CHECKING:
    from ..contract.catalogue import Check

_EXIT_FAILED = 1
_LIMIT_S = 300.0
_LONGEST_START_S = 3600.0
"""In which the separate process must be there: at the first use it compiles."""
_LOOK_EVERY_S = 0.2
_INDENT = " " * 4
_SHOWN = {"passed": ("passed", "green"), "failed": ("FAILED", "red"), "refused": ("not asked", "")}


class CheckError(GGBenchError):
    """An estimator cannot be examined."""


@click.command()
@click.argument("estimator", metavar="ESTIMATOR")
@click.option(
    "--time-limit",
    type=click.FloatRange(0.0, 1e9, min_open=True),
    default=_LIMIT_S,
    show_default=True,
    metavar="SECONDS",
    help="Longest time of one check.",
)
def check(estimator: str, time_limit: float) -> None:
    """Check that an ESTIMATOR keeps the contract: a .py file or a name, with parameters in [].

    Of each check: what it demands; if it fails, what was found, and why it is demanded; if it
    passes although the estimator loses digits by rounding, how many.

    Exit code 1 if a check failed, 2 if the estimator cannot be made or takes no problem.
    """
    tell_first_use("ins/strapdown.py", "in a minute or two")
    from ..contract.catalogue import CHECKS

    verdicts: Counter[str] = Counter()
    for asked, verdict, text in examined(estimator, CHECKS, time_limit):
        verdicts[verdict] += 1
        _tell(asked, verdict, text)
    passed, failed, refused = (verdicts[verdict] for verdict in _SHOWN)
    if not passed and not failed:
        raise CheckError(f"{estimator} takes none of the problems that the contract is asked on")
    left = len(CHECKS) - verdicts.total()
    unasked = f", {refused} not asked" if refused else ""
    untried = f"; {left} not tried without an estimate" if left else ""
    click.echo(
        f"{passed} of {counted(len(CHECKS), 'check')} passed, {failed} failed{unasked}{untried}."
    )
    sys.exit(_EXIT_FAILED if failed else 0)


def _tell(asked: Check, verdict: str, text: str) -> None:
    """Print what came out of a check."""
    word, colour = _SHOWN[verdict]
    click.echo(f"{click.style(word, fg=colour or None, bold=verdict == 'failed')}: {asked.name}")
    lines = [f"{text}."] if text else []
    if verdict == "failed":
        lines.append(f"Why: {asked.why}")
    for line in (f"{asked.demand}.", *lines):
        for part in textwrap.wrap(line, max(console.width, 40) - len(_INDENT)):
            click.echo(f"{_INDENT}{part}")


def examined(
    estimator: str, checks: tuple[Check, ...], limit_s: float
) -> Iterator[tuple[Check, str, str]]:
    """Yield each check with its verdict (passed, failed, refused) and a sentence.

    In a process of its own, and in another one after a check that ends it or does not return. If
    the first check fails, the others are not asked. Raise CheckError if the estimator cannot be
    made.
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
                asked = waiting.pop(0)
                verdict, text = answer.get("verdict", "failed"), answer.get("text", "")
                yield asked, verdict, answer.get("lost", text)
                if verdict == "failed" and asked is checks[0]:
                    return
                if "lost" in answer:
                    break


def _answer(
    process: subprocess.Popen[bytes], answers: Connection, limit_s: float
) -> dict[str, str]:
    """Return the next answer of the separate process; or how it ended, if there is none."""
    begun = time.monotonic()
    while not answers.poll(_LOOK_EVERY_S):
        if process.poll() is not None and not answers.poll():
            return {"lost": _ended(process.returncode)}
        if time.monotonic() - begun > limit_s:
            return {"lost": f"it did not return within {limit_s:g} s"}
    try:
        found: dict[str, str] = json.loads(answers.recv_bytes())
    except EOFError:
        return {"lost": _ended(process.wait())}
    return found


def _ended(code: int) -> str:
    if code < 0:
        return f"its process was ended by {signal.Signals(-code).name}"
    return f"it ended its process, with exit code {code}"


@contextlib.contextmanager
def _isolated(
    estimator: str, names: list[str]
) -> Iterator[tuple[subprocess.Popen[bytes], Connection]]:
    """Start a process that asks; whatever it has started ends with it."""
    answers, theirs = Pipe(duplex=False)
    module, pipe = "ggbench.cli.isolated_check", theirs.fileno()
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
