"""``ggbench plan``: start and heading of a flight by the Cramér–Rao bound."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..display.compiling import tell_first_use
from ..display.responsive_table import ResponsiveTable
from ..errors import brief
from ..figures.numbers import counted
from .screen import console
from .tables import require_suffix, write_csv

if TYPE_CHECKING:
    import pandas as pd

    from ..figures.style import Drawing
    from ..spec.case import CaseSpec

_EXIT_OUT_OF_REACH = 1
_SHOWN = 10


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
    help="Starts along each side of a square grid around the start of the case.",
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
    help="Required RMS position error: counts the tracks that allow it.",
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

    The command moves the flight, of segments or of a track, to other starts and headings. It ranks
    them by the bound of the RMS position error. The bound ignores false fixes.

    Exit code 1 if no track allows the target.
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

        save(drawn(tracks, flown), figure)
        click.echo(f"Wrote {figure}")
    reached = target is None or bool((tracks["bound_m"] <= target).any())
    sys.exit(0 if reached else _EXIT_OUT_OF_REACH)


def drawn(tracks: pd.DataFrame, case: CaseSpec) -> Drawing:
    """Return the figure of tracks over the map, on the side of the date line of the flight."""
    from ..figures.planned import planned_tracks
    from ..simulation.field_source import beside, make_field
    from ..simulation.true_motion import trajectory_of

    present = trajectory_of(case.trajectory, case.imu.period_s).positions
    field = beside(make_field(case.side("truth").field), float(present[0, 1]))
    return planned_tracks(tracks, field, present, case.title)


def _print(tracks: pd.DataFrame, title: str, target: float | None) -> None:
    """Print the best tracks and the worst one, and what cannot be flown."""
    able = tracks[tracks["reason"] == ""]
    table = ResponsiveTable(
        f"{title}: the best of {counted(len(tracks), 'track')}",
        [
            ("heading °", "number"),
            ("east km", "number"),
            ("north km", "number"),
            ("bound m", "number"),
        ],
    )
    for row in able.head(_SHOWN).itertuples():
        table.add_row(
            f"{row.heading_deg:.0f}", f"{row.east_km:g}", f"{row.north_km:g}", f"{row.bound_m:.3g}"
        )
    table.print(console)
    if len(able):
        console.out(f"The worst track has a bound of {able['bound_m'].iloc[-1]:.3g} m.")
        present = able[able["present"]]
        if len(present):
            rank, bound = int(present.index[0]) + 1, present["bound_m"].iloc[0]
            console.out(f"The track of the case has a bound of {bound:.3g} m and rank {rank}.")
    unable = tracks[tracks["reason"] != ""]
    if len(unable):
        console.out(
            f"{counted(len(unable), 'track')} cannot be flown; reason of the first: "
            f"{brief(unable['reason'].iloc[0])}"
        )
    if target is not None:
        count = int((able["bound_m"] <= target).sum())
        console.out(
            f"{counted(count, 'track')} of {len(tracks)} have a bound of at most {target:g} m."
        )
