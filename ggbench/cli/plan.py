"""``ggbench plan``: starts and headings of a flight, ranked by the Cramér–Rao bound."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..display.compiling import tell_first_use
from ..display.responsive_table import ResponsiveTable
from ..figures.numbers import counted
from .screen import console
from .tables import require_suffix, write_csv

if TYPE_CHECKING:
    import pandas as pd


_EXIT_OUT_OF_REACH = 1


@click.command()
@click.argument("scenario_name", metavar="SCENARIO")
@click.option("-c", "--case", metavar="NAME", help="Case [the first].")
@click.option(
    "--headings",
    type=click.IntRange(1, 72),
    default=8,
    show_default=True,
    help="Number of headings.",
)
@click.option(
    "--grid",
    type=click.IntRange(1, 15),
    default=1,
    show_default=True,
    help="Number of starts along each side of a square grid around the start of the case.",
)
@click.option(
    "--step",
    type=click.FloatRange(0.0, 1000.0, min_open=True),
    default=5.0,
    show_default=True,
    metavar="KM",
    help="Distance between starts.",
)
@click.option(
    "--target",
    type=click.FloatRange(0.0, min_open=True),
    metavar="M",
    help="Required RMS position error. Tracks with a bound of at most M are counted.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="CSV file to write.")
@click.option("--figure", type=click.Path(path_type=Path), help="PNG file to draw.")
def plan(
    scenario_name: str,
    case: str | None,
    headings: int,
    grid: int,
    step: float,
    target: float | None,
    output: Path | None,
    figure: Path | None,
) -> None:
    """Rank tracks for the flight of a SCENARIO by their Cramér–Rao bound.

    The flight must consist of segments or follow a track. The command moves it to other starts and
    headings. It ranks all tracks by the bound of the RMS position error. The bound ignores false
    fixes.

    Exit code 1 if a --target is given and no track has a bound that meets it.
    """
    tell_first_use("trajectory/truth.py", "in seconds")
    from ..judging.planned import around
    from ..spec import scenario

    require_suffix(output, ".csv")
    require_suffix(figure, ".png")
    loaded = scenario.load(scenario_name)
    flown = loaded.cases[0] if case is None else loaded.case(case)
    tracks = around(flown, headings, grid, step)
    _print(tracks, f"{loaded.name}, {flown.title}", target)
    if output is not None:
        write_csv(tracks, output)
    if figure is not None:
        from ..figures.style import save
        from ..score.decision_page import over_map

        save(over_map(tracks, flown), figure)
        click.echo(f"Wrote {figure}")
    reached = target is None or bool((tracks["bound_m"] <= target).any())
    sys.exit(0 if reached else _EXIT_OUT_OF_REACH)


def _print(tracks: pd.DataFrame, title: str, target: float | None) -> None:
    """Print the best tracks, and sentences on the bounds and on tracks that cannot be flown."""
    from ..score import decisions

    table = ResponsiveTable(
        f"{title}: the best of {counted(len(tracks), 'track')}",
        [(heading, "number") for heading in decisions.TRACK_HEAD],
    )
    for row in decisions.track_rows(tracks):
        table.add_row(*row)
    table.print(console)
    for sentence in decisions.track_sentences(tracks, target):
        console.out(sentence)
