"""``ggbench check``: test of an estimator against the contract."""

from __future__ import annotations

import sys
import textwrap
from collections import Counter
from typing import TYPE_CHECKING

import click

from ..campaign.examination import LIMIT_S, CheckError, examined
from ..display.compiling import tell_first_use
from ..figures.numbers import counted
from .screen import console

if TYPE_CHECKING:
    from ..contract.catalogue import Check

_EXIT_FAILED = 1
_INDENT = " " * 4
_SHOWN = {"passed": ("passed", "green"), "failed": ("FAILED", "red"), "refused": ("skipped", "")}


@click.command()
@click.argument("estimator", metavar="ESTIMATOR")
@click.option(
    "--time-limit",
    type=click.FloatRange(0.0, 1e9, min_open=True),
    default=LIMIT_S,
    show_default=True,
    metavar="SECONDS",
    help="Time limit of one check.",
)
def check(estimator: str, time_limit: float) -> None:
    """Check an ESTIMATOR: shapes, repeatability, causality, Kalman filter on linear problems.

    ESTIMATOR is a .py file or a name, with parameters in []. The command prints each check. For a
    failed check it prints the error and the reason for the check. It also reports
    whether the estimator amplifies rounding errors.

    Exit code 1 if a check failed, 2 if the estimator cannot be created or refuses all problems.
    """
    tell_first_use("ins/strapdown.py", "in a minute or two")
    from ..contract.catalogue import CHECKS

    verdicts: Counter[str] = Counter()
    for demand, verdict, text in examined(estimator, CHECKS, time_limit):
        verdicts[verdict] += 1
        _tell(demand, verdict, text)
    passed, failed, refused = (verdicts[verdict] for verdict in _SHOWN)
    if not passed and not failed:
        raise CheckError(f"no check was applied: {estimator} refuses all test problems")
    untested = len(CHECKS) - verdicts.total()
    unasked = f", {refused} not applicable" if refused else ""
    untried = f"; {untested} not run, because there is no estimate" if untested else ""
    click.echo(
        f"{passed} of {counted(len(CHECKS), 'check')} passed, {failed} failed{unasked}{untried}."
    )
    sys.exit(_EXIT_FAILED if failed else 0)


def _tell(check: Check, verdict: str, text: str) -> None:
    """Print the verdict and the text of a check."""
    word, colour = _SHOWN[verdict]
    click.echo(f"{click.style(word, fg=colour or None, bold=verdict == 'failed')}: {check.name}")
    lines = [f"{text}."] if text else []
    if verdict == "failed":
        lines.append(f"Why: {check.why}")
    for line in (f"{check.demand}.", *lines):
        for part in textwrap.wrap(line, max(console.width, 40) - len(_INDENT)):
            click.echo(f"{_INDENT}{part}")
