"""``ggbench advise``: recommended estimator and instrument for a user's case."""

from __future__ import annotations

import math
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

if TYPE_CHECKING:
    from ..score.advice import Advice

_EXIT_OUT_OF_REACH = 1
_SMALL = 0.005
"""Relative gain of the bound below which a cause does not limit the accuracy."""


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
@click.option("-j", "--jobs", type=click.IntRange(0), help="Worker processes [all processors].")
def advise(
    scenario_name: str,
    case: str | None,
    target: float | None,
    runs: int,
    output: Path | None,
    jobs: int | None,
) -> None:
    """Recommend an estimator and an instrument for a SCENARIO.

    SCENARIO is a name or a path. The command flies a few runs of the estimators that the suite
    recommends. It prints the best one, its error and its time, the causes that limit the accuracy,
    and the gradiometer that reaches the target.

    Exit code 1 if no gradiometer reaches the target.
    """
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
    click.echo(f"It took {start.since()}.")
    sys.exit(0 if reached else _EXIT_OUT_OF_REACH)


def _print(advice: Advice) -> None:
    """Print the estimators, the recommended one, and what limits the accuracy."""
    from ..judging.field_scale import on_the_prior
    from ..report import columns
    from ..score import advice as advices

    headings = ("RMS m", "× oracle", "success", "", "usual ms/run")
    table = ResponsiveTable(
        f"{advice.case.title}: bound {columns.metres(advice.bound_m)} m",
        [("estimator", "name"), *((heading, "number") for heading in headings)],
    )
    rows, usual = advices.table(advice), advices.usual_seconds()
    for row in rows.to_dict("records"):
        table.add_row(
            row["estimator"],
            columns.cell("rms_m", row["rms_m"]),
            columns.cell("efficiency", row["efficiency"]),
            columns.cell("success", row["success"]),
            columns.SYMBOLS.get(row["consistency"], ""),
            f"{1e3 * usual[row['estimator']]:.3g}" if row["estimator"] in usual else "",
        )
    table.print(console)
    errors = dict(zip(rows["estimator"], rows["rms_m"], strict=True))
    label, surely = advices.recommended(advice)
    if label in errors:
        verdict = "use" if surely else "no estimator is recommended; the least bad is"
        console.out(f"In flight: {verdict} {label}, RMS error {columns.metres(errors[label])} m.")
    smoother = advices.after_landing(advice)
    if smoother in errors:
        console.out(f"After landing: {smoother}, RMS error {columns.metres(errors[smoother])} m.")
    row = advice.results.cases().iloc[0]
    if math.isfinite(row["width"]):
        prior = on_the_prior(row["position_m"], row["correlation_m"])
        console.out(f"{prior[0].upper()}{prior[1:]}.")
    table = ResponsiveTable(
        "What limits the accuracy: each cause halved",
        [("cause", "text"), ("bound m", "number"), ("change", "number")],
    )
    for limit in advice.limits:
        change = f"−{100.0 * limit.gain:.0f} %" if limit.gain > _SMALL else "none"
        table.add_row(limit.cause, columns.metres(limit.bound_m), change)
    table.print(console)
    console.out("For each cause, truth and model have half the errors.")


def _print_target(advice: Advice, target: float) -> bool:
    """Print which gradiometer reaches a target; return whether any does."""
    from ..report import columns

    if advice.bound_m <= target:
        console.out(f"The bound allows {target:g} m with the sensors as they are.")
    if not advice.unit:
        console.out("The case has no gradiometer whose noise could be changed.")
        return advice.bound_m <= target
    if math.isnan(advice.noise):
        console.out(f"No gradiometer reaches {target:g} m here: change the track, map or INS.")
        return False
    console.out(
        f"{target:g} m need a gradiometer noise of at most {columns.metres(advice.noise)} "
        f"{advice.unit}, in truth and model, at the rate of the case."
    )
    return True
