"""``ggbench cards``: page of the score cards that are reproduced by new runs."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ..display.compiling import tell_first_use
from ..display.progress import Progress
from ..errors import line_of
from ..figures.numbers import counted
from .screen import console
from .tables import require_suffix

_EXIT_NOT_REPRODUCED = 1


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "-e",
    "--estimator",
    "estimators",
    multiple=True,
    metavar="FILE",
    help="File of an estimator whose cards are repeated. Its code is run. May be given several "
    "times.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path("cards.html"),
    show_default=True,
    help="HTML file to write.",
)
@click.option(
    "-f",
    "--flights",
    type=click.Path(path_type=Path),
    default=Path("results") / "cards",
    show_default=True,
    help="Folder for the new runs; runs already in it are reused.",
)
@click.option("-j", "--jobs", type=click.IntRange(0), help="Worker processes [all processors].")
def cards(
    folder: Path, estimators: tuple[str, ...], output: Path, flights: Path, jobs: int | None
) -> None:
    """Repeat the runs of the score cards in DIR and write a page of the reproduced cards.

    The page shows the numbers of the new runs. Cards of installed estimators are always repeated.
    A card of a .py file is repeated only if -e gives this file: a card alone never runs code.

    Exit code 1 if a card is not reproduced.
    """
    require_suffix(output, ".html")
    tell_first_use("ins/strapdown.py", "in a minute or two")
    from ..campaign import registry
    from ..score import cards_page, checked

    paths, allowed, results = checked.files_of(folder), registry.choose_all(estimators), []
    for path in paths:
        with Progress(console, path.name) as progress:
            results.append(
                checked.check(
                    path, allowed, flights, jobs=jobs, tell=click.echo, progress=progress.tell
                )
            )
    cards_page.write(results, output)
    refused = [one for one in results if one.card is None]
    for one in refused:
        click.echo(f"{line_of(str(one.path))} is not reproduced: {line_of(one.reasons[0])}")
    reproduced = counted(len(results) - len(refused), "card")
    click.echo(f"{reproduced} of {len(results)} reproduced. Wrote {output}.")
    sys.exit(_EXIT_NOT_REPRODUCED if refused else 0)
