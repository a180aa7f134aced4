"""``ggbench score``: score of an estimator in the standard suite."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..campaign.compile_ahead import compiling_ahead
from ..display.compiling import tell_first_use
from ..display.progress import Progress
from ..display.responsive_table import Kind, ResponsiveTable
from ..display.timing import Moment
from ..errors import line_of
from ..figures.numbers import counted
from ..spec.limits import MOST_RUNS, MOST_SEED
from .screen import console

if TYPE_CHECKING:
    from ..score.card import Card
    from ..score.scoring import Score

_CARD = "card.json"
_EXIT_WORSE, _EXIT_INTERRUPTED = 1, 130
_MOST_LISTED = 5
_COLOURS = {"better": "green", "worse": "red"}


@click.command()
@click.argument("estimator", metavar="[ESTIMATOR]", required=False)
@click.option("--quick", is_flag=True, help="Fly 20 runs of each case.")
@click.option(
    "-n", "--runs", type=click.IntRange(2, MOST_RUNS), help="Runs of each case [all stored ones]."
)
@click.option(
    "-s",
    "--seed",
    type=click.IntRange(0, MOST_SEED),
    help="Seed of new tracks, map errors and noise for all estimators [public seed].",
)
@click.option(
    "-c", "--case", "cases", multiple=True, metavar="NAME", help="Case to fly; repeatable."
)
@click.option(
    "--judge",
    type=click.Choice(["all", "odd", "even"]),
    default="all",
    show_default=True,
    help="Runs to judge, by index. To avoid overfitting, tune on even runs and report odd runs.",
)
@click.option(
    "--check",
    "checked",
    type=click.Path(path_type=Path),
    metavar="CARD",
    help="Repeat a card. Runs the ESTIMATOR's code. Exit code 1 if not reproduced.",
)
@click.option(
    "--against",
    "before",
    type=click.Path(path_type=Path),
    metavar="CARD",
    help="Compare with an older card. Exit code 1 if a case is significantly worse.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    help="Folder [results/score/ESTIMATOR; with --check: ESTIMATOR-again].",
)
@click.option("-j", "--jobs", type=click.IntRange(0), help="Worker processes [all processors].")
def score(
    estimator: str | None,
    quick: bool,
    runs: int | None,
    seed: int | None,
    cases: tuple[str, ...],
    judge: str,
    checked: Path | None,
    before: Path | None,
    output: Path | None,
    jobs: int | None,
) -> None:
    """Score an ESTIMATOR in the standard suite.

    ESTIMATOR is a .py file or a name. It is compared with other estimators. Their runs are stored
    with the suite. With another --seed the command runs the other estimators, too. Without --check
    the command writes card.json, card.md, card.html and card.png.

    The command runs the code of the ESTIMATOR. With --check it may be omitted if the estimator of
    the card is installed: a card alone never runs code.

    Exit code 1 if a card is not reproduced or is significantly worse than an older one.
    """
    if quick and runs:
        raise click.UsageError("give either --quick, which flies 20 runs of each case, or -n")
    if checked and (quick or runs or cases or seed is not None or before):
        raise click.UsageError(
            "--check repeats the runs of a card: remove --quick, -n, -s, -c and --against"
        )
    start = Moment.now()
    first = tell_first_use("ins/strapdown.py", "in a minute or two")
    from ..score import card as cards
    from ..score import cards_compared, page, scoring

    old = cards.read(checked) if checked else None
    if old is not None:
        estimator, runs, seed = estimator or _installed(old), old.runs, old.seed
        cases, judge = tuple(question.case for question in old.questions), old.judged
    if estimator is None:
        raise click.UsageError("give an ESTIMATOR, or a card with --check")
    name = re.sub(r"\W+", "-", estimator).strip("-") + ("-again" if checked else "")
    folder = output or Path("results") / "score" / name
    if checked and _same(checked, folder / _CARD):
        raise click.UsageError(
            f"{folder} holds the runs of {checked}, which --check repeats: choose another folder "
            "with -o"
        )
    if before and _same(before, folder / _CARD):
        raise click.UsageError(
            f"--against {before} is the card that this command overwrites: copy it first, or "
            "choose another folder with -o"
        )
    previous = cards.read(before) if before else None
    if previous is not None:
        cards_compared.require_comparable(previous, cases, seed)
    if checked:
        click.echo(f"The check runs the code of {line_of(estimator)}.")
    if quick:
        runs = scoring.QUICK_RUNS
    with Progress(console, "suite") as progress, compiling_ahead(first, jobs) as compile_them:
        compile_them([estimator])
        half: Any = judge  # one of the choices
        scored = scoring.score(
            estimator=estimator,
            folder=folder,
            runs=runs,
            seed=seed,
            judged_runs=half,
            cases=cases,
            jobs=jobs,
            progress=progress.tell,
        )
    if scored.card is None:
        click.echo(f"Interrupted. Finished runs are stored in {folder}; the same command resumes.")
        sys.exit(_EXIT_INTERRUPTED)
    _print_card(scored.card)
    _print_failures(scored)
    if old is None:
        cards.write(scored.card, folder / _CARD)
        written = [folder / _CARD, *page.write(scored.card, scored.failures, folder)]
        click.echo(f"It took {start.since()}. Wrote {', '.join(map(str, written))}.")
    sys.exit(_verdict(scored.card, old, previous))


def _installed(card: Card) -> str:
    """Return the label of a card's estimator; raise UsageError unless it is installed."""
    from ..campaign import registry

    label = card.estimator.label
    if registry.is_own(label):
        raise click.UsageError(
            f"the card is of {label}, which is not installed: give the ESTIMATOR to run"
        )
    return label


def _same(one: Path, other: Path) -> bool:
    """Return whether two paths are one file that exists."""
    try:
        return one.samefile(other)
    except OSError:
        return False


def _print_card(card: Card) -> None:
    """Print a card: a row for each case of the suite, and the verdicts in sentences."""
    from ..score import page

    kinds: tuple[Kind, ...] = ("name", "number", "number", "number", "number", "name", "number")
    table = ResponsiveTable(
        f"{page.shown_name(card)}, {counted(card.runs, 'run')} of each case, seed {card.seed}",
        [*zip(page.HEAD, kinds, strict=True)],
    )
    for row in page.rows(card):
        cells = [f"[{_COLOURS[cell]}]{cell}[/]" if cell in _COLOURS else cell for cell in row]
        table.add_row(*cells)
    table.print(console)
    for question in card.questions:
        if question.skipped:
            console.out(f"{question.title}: skipped, {question.skipped}")
    console.out(page.headline(card))


def _print_failures(scored: Score) -> None:
    """Print each kind of failure, and the command that repeats one run of it."""
    from ..score import page

    kinds = page.kinds_of_failures(scored.failures)
    for reason, where, command in kinds[:_MOST_LISTED]:
        console.out(f"{where}: {reason}\n  {command}")
    if len(kinds) > _MOST_LISTED:
        console.out(f"... and {counted(len(kinds) - _MOST_LISTED, 'more kind')} of failures")


def _verdict(card: Card, old: Card | None, previous: Card | None) -> int:
    """Print whether a card is reproduced or has become worse; return the exit code."""
    from ..score import cards_compared

    if old is not None:
        differences = cards_compared.differences(old, card)
        click.echo("The card is reproduced." if not differences else "The card is not reproduced:")
    elif previous is not None:
        differences = cards_compared.worse(previous, card)
        both = {question.case for question in previous.questions if not question.skipped}
        count = counted(len(both & {question.case for question in card.questions}), "question")
        click.echo(
            f"{count} compared, none significantly worse."
            if not differences
            else "Worse than the older card:"
        )
    else:
        return 0
    for sentence in differences:
        click.echo(f"  {sentence}")
    return _EXIT_WORSE if differences else 0
