"""``ggbench advise``: recommended estimators and gradiometer for a case."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..display.compiling import tell_first_use
from ..display.progress import Progress
from ..display.responsive_table import ResponsiveTable
from ..display.timing import Moment
from ..spec.limits import MOST_RUNS
from .screen import console
from .tables import require_suffix

if TYPE_CHECKING:
    from ..score.advice import Advice

_EXIT_OUT_OF_REACH = 1
_HEADINGS = 8
"""Headings of the tracks on the page."""


@click.command()
@click.argument("scenario_name", metavar="SCENARIO")
@click.option("-c", "--case", metavar="NAME", help="Case to advise on [the first].")
@click.option(
    "--target",
    type=click.FloatRange(0.0, min_open=True),
    metavar="M",
    help="Required RMS position error [m].",
)
@click.option(
    "-n",
    "--runs",
    type=click.IntRange(2, MOST_RUNS),
    default=40,  # fewer give no recommendation
    show_default=True,
    help="Runs of each estimator.",
)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="Results folder [results/advise/NAME]."
)
@click.option(
    "--page",
    type=click.Path(path_type=Path),
    help="HTML page to write, with map, track and Cramér–Rao bounds of other headings.",
)
@click.option("-j", "--jobs", type=click.IntRange(0), help="Worker processes [all processors].")
def advise(
    scenario_name: str,
    case: str | None,
    target: float | None,
    runs: int,
    output: Path | None,
    page: Path | None,
    jobs: int | None,
) -> None:
    """Recommend an estimator and an instrument for a SCENARIO.

    SCENARIO is a name or a path. The command runs the INS and the estimators that are
    recommended in the standard suite. It prints the fastest recommended filter and the best
    smoother, each with its position error and computing time. It also prints the error sources
    that limit the accuracy. With --target it also prints the largest gradiometer noise whose
    Cramér–Rao bound meets this position error.

    Exit code 1 if a --target is given and no gradiometer reaches it.
    """
    require_suffix(page, ".html")
    start = Moment.now()
    tell_first_use("ins/strapdown.py", "in a minute or two")
    with Progress(console, scenario_name) as progress:
        from ..score import advice as advices
        from ..spec import scenario

        loaded = scenario.load(scenario_name)
        flown = loaded.cases[0] if case is None else loaded.case(case)
        folder = output or Path("results") / "advise" / loaded.name
        advice = advices.advise(
            scenario=loaded,
            case=flown,
            folder=folder,
            target_m=target,
            runs=runs,
            jobs=jobs,
            progress=progress.tell,
        )
    _print(advice)
    reached = target is None or _print_target(advice, target)
    if page is not None:
        from ..judging.planned import around
        from ..score import decision_page

        tracks = around(flown, headings=_HEADINGS, starts=1, step_km=1.0)
        decision_page.write(loaded, advice, tracks, target, page)
        click.echo(f"Wrote {page}")
    click.echo(f"It took {start.since()}.")
    sys.exit(0 if reached else _EXIT_OUT_OF_REACH)


def _print(advice: Advice) -> None:
    """Print the estimators, the recommendation, and the error sources that limit the accuracy."""
    from ..report import columns
    from ..score import decisions

    name, *numbers = decisions.ESTIMATOR_HEAD
    table = ResponsiveTable(
        f"{advice.case.title}: bound {columns.metres(advice.bound_m)} m",
        [(name, "name"), *((heading, "number") for heading in numbers)],
    )
    for row in decisions.estimator_rows(advice):
        table.add_row(*row)
    table.print(console)
    for sentence in decisions.verdicts(advice):
        console.out(sentence)
    cause, *numbers = decisions.LIMIT_HEAD
    table = ResponsiveTable(
        decisions.LIMITS, [(cause, "text"), *((heading, "number") for heading in numbers)]
    )
    for row in decisions.limit_rows(advice):
        table.add_row(*row)
    table.print(console)
    console.out(decisions.HALVED)


def _print_target(advice: Advice, target: float) -> bool:
    """Print the gradiometer noise that reaches a target [m]; return whether any noise does."""
    from ..score import decisions

    sentences, reached = decisions.instrument(advice, target)
    for sentence in sentences:
        console.out(sentence)
    return reached
