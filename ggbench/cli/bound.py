"""``ggbench bound``: what a planned flight can reach, before anything is run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .responsive_table import ResponsiveTable
from .screen import console
from .tables import require_suffix, write_csv

if TYPE_CHECKING:
    import pandas as pd

_SHOWN_EPOCHS = 8


@click.command()
@click.argument("scenario_name", metavar="SCENARIO")
@click.option("-c", "--case", metavar="NAME", help="Case to plan [the first].")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="CSV file to write.")
@click.option("--figure", type=click.Path(path_type=Path), help="PNG file to draw.")
def bound(scenario_name: str, case: str | None, output: Path | None, figure: Path | None) -> None:
    """Print the Cramér–Rao bound along the track of a SCENARIO.

    SCENARIO is the name of a shipped one or a path; its track may be a CSV file of your own
    ([trajectory] file). No estimator's standard deviations can be smaller, and on a good track
    those of a good one are as small; of wrong places that look alike the bound knows nothing:
    'ggbench map score' looks for those.
    """
    from ..judging.planned import planned
    from ..simulation.error_free_flight import prepare
    from ..spec import scenario

    require_suffix(output, ".csv")
    require_suffix(figure, ".png")
    loaded = scenario.load(scenario_name)
    flown = loaded.cases[0] if case is None else loaded.find(case)[1]
    flight = prepare(flown)
    bounds = planned(flight)
    title = f"{loaded.name}, {flown.title}"
    _print(bounds, title)
    if output is not None:
        write_csv(bounds, output)
    if figure is not None:
        from ..figures.planned import planned_bound
        from ..figures.style import save

        save(planned_bound(bounds, flight.field, title), figure)
        click.echo(f"Wrote {figure}")


def _print(bounds: pd.DataFrame, title: str) -> None:
    """Print the bounds at a few epochs, the first and the last among them."""
    kinds = ("east", "north", "up", "spherical", "all readings")
    table = ResponsiveTable(
        f"{title}: bound of the position and of the velocity",
        [
            ("time s", "name"),
            *((f"{kind} {unit}", "number") for unit in ("m", "m/s") for kind in kinds),
        ],
    )
    last = len(bounds) - 1
    shown = sorted({round(k * last / (_SHOWN_EPOCHS - 1)) for k in range(_SHOWN_EPOCHS)})
    for number in shown:
        row = bounds.iloc[number]
        table.add_row(
            f"{row['time_s']:g}",
            *(
                f"{row[f'{name}_{unit}']:.3g}"
                for unit, what in (("m", "position"), ("mps", "velocity"))
                for name in ("east", "north", "up", what, f"{what}_smoothed")
            ),
        )
    table.print(console)
