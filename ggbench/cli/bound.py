"""``ggbench bound``: Cramér–Rao bound along a planned flight."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.markup import escape

from ..display.responsive_table import ResponsiveTable
from .screen import console
from .tables import require_suffix, write_csv

if TYPE_CHECKING:
    import pandas as pd

    from ..spec.scenario import Scenario

_SHOWN_EPOCHS = 8


@click.command()
@click.argument("scenario_name", metavar="SCENARIO")
@click.option("-c", "--case", metavar="NAME", help="Case [the first].")
@click.option(
    "--all", "every", is_flag=True, help="Print the RMS bound of every case after settled_from_s."
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="CSV file to write.")
@click.option("--figure", type=click.Path(path_type=Path), help="PNG file to draw.")
def bound(
    scenario_name: str, case: str | None, every: bool, output: Path | None, figure: Path | None
) -> None:
    """Print the Cramér–Rao bound along the track of a SCENARIO.

    SCENARIO is the name of a shipped scenario or a path. Its track may be a CSV file, which
    the key 'file' of [trajectory] names. The bound is linearised at the truth. It ignores false
    fixes, for which see 'ggbench map score'.
    """
    from ..judging.planned import planned
    from ..simulation.error_free_flight import prepare
    from ..spec import scenario

    require_suffix(output, ".csv")
    require_suffix(figure, ".png")
    if every and (case or figure):
        raise click.UsageError("--all prints all cases: remove -c and --figure")
    loaded = scenario.load(scenario_name)
    if every:
        _print_all(loaded, output)
        return
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


def _print_all(loaded: Scenario, output: Path | None) -> None:
    """Print the bounds of every case in the settled window; write them to ``output`` if given."""
    import pandas as pd

    from ..judging.planned import bound_of

    rows = [
        (case.name, case.title, bound_of(case), bound_of(case, smoothed=True))
        for case in loaded.cases
    ]
    table = ResponsiveTable(
        f"{loaded.name}: bound of the RMS position error in the settled window"
        + (", of run 0" if any(case.drawn for case in loaded.cases) else ""),
        [("case", "name"), ("title", "text"), ("filter m", "number"), ("smoother m", "number")],
    )
    for name, title, filtering, smoothing in rows:
        table.add_row(name, escape(title), f"{filtering:.3g}", f"{smoothing:.3g}")
    table.print(console)
    if output is not None:
        columns = ["case", "title", "bound_m", "smoothing_bound_m"]
        write_csv(pd.DataFrame(rows, columns=columns), output)


def _print(bounds: pd.DataFrame, title: str) -> None:
    """Print the bounds at a few epochs, the first and the last among them."""
    kinds = ("east", "north", "up", "spherical", "smoother")
    table = ResponsiveTable(
        f"{title}: bound of the position and of the velocity",
        [
            ("time s", "name"),
            *((f"{kind} {unit}", "number") for unit in ("m", "m/s") for kind in kinds),
        ],
    )
    last = len(bounds) - 1
    epochs = sorted({round(k * last / (_SHOWN_EPOCHS - 1)) for k in range(_SHOWN_EPOCHS)})
    for number in epochs:
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
