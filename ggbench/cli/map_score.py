"""``ggbench map score``: suitability of map cells for matching."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ..display.responsive_table import ResponsiveTable
from ..figures.numbers import counted, short
from .screen import console
from .tables import require_suffix, write_csv

_FILE = click.Path(path_type=Path)
_SHOWN_CELLS = 5
_LEAST_SHARE = 1e-4
"""Least printed bound; the flight model is not accurate enough for smaller bounds."""


@click.command()
@click.argument("name", metavar="MAP")
@click.option(
    "--height",
    type=float,
    help="Height of the flights [m] above the ellipsoid, or above the base of a draped map [the "
    "lowest layer].",
)
@click.option("--cell-deg", type=float, default=0.5, show_default=True, help="Side of a cell [°].")
@click.option(
    "--instrument",
    type=click.Choice(["tensor", "uu", "gravity"]),
    default="tensor",
    show_default=True,
    help="Full tensor, vertical gradient, or gravimeter.",
)
@click.option(
    "--noise",
    type=float,
    default=1.0,
    show_default=True,
    help="Noise of a measurement [E; mGal for gravity].",
)
@click.option("--spacing", type=float, help="Node spacing of the statistics [m; 1/50 of a cell].")
@click.option(
    "--per-km2",
    type=float,
    default=1.0,
    show_default=True,
    help="Measurements per km² for the Fisher information of a cell.",
)
@click.option("--track-km", type=float, help="Track length in a cell [its shorter side].")
@click.option(
    "--readings", type=int, default=51, show_default=True, help="Measurements on each track."
)
@click.option(
    "--sigma-km",
    type=float,
    default=5.0,
    show_default=True,
    help=(
        "Prior standard deviation of the position, per axis. The search radius for wrong matches "
        "is three times this."
    ),
)
@click.option("--right-km", type=float, help="Largest error of a correct fix [half of --sigma-km].")
@click.option("--south", type=float, help="Bounds of the cells [deg]; default: the whole map.")
@click.option("--north", type=float)
@click.option("--west", type=float)
@click.option("--east", type=float)
@click.option("-o", "--output", type=_FILE, help="CSV file to write, a row for each cell.")
@click.option("--figure", type=_FILE, help="PNG file to draw.")
def score(
    name: str,
    height: float | None,
    cell_deg: float,
    instrument: Any,
    noise: float,
    spacing: float | None,
    per_km2: float,
    track_km: float | None,
    readings: int,
    sigma_km: float,
    right_km: float | None,
    south: float | None,
    north: float | None,
    west: float | None,
    east: float | None,
    output: Path | None,
    figure: Path | None,
) -> None:
    """Score the cells of a MAP for matching.

    MAP is a *.nc file, or the name of a shipped region or terrain. For each cell the
    command computes statistics of the field, and from them a principal-component index. The index
    only ranks the cells of this map. The command also computes the RMS position error in metres
    that a track through the cell allows. It also computes an upper bound of the share of tracks
    that match a wrong place. No flight is simulated.
    """
    from ..gravity.field import Field
    from ..matchability.information import Instrument
    from ..matchability.score import Bounds, Design
    from ..matchability.score import score as score_map
    from ..matchability.sources import named_map

    require_suffix(output, ".csv")
    require_suffix(figure, ".png")

    def metres(km: float | None) -> float | None:
        return None if km is None else 1e3 * km

    bounds = Bounds(south, north, west, east)
    design = Design(
        height_m=height,
        cell_deg=cell_deg,
        instrument=Instrument(instrument, noise),
        spacing_m=spacing,
        per_km2=per_km2,
        track_m=metres(track_km),
        readings=readings,
        sigma_m=1e3 * sigma_km,
        right_m=metres(right_km),
    )
    gradient_map, height = named_map(name, design, bounds)
    scored = score_map(Field.from_map(gradient_map), replace(design, height_m=height), bounds, name)
    _print_scored(scored)
    if output is not None:
        write_csv(scored.table, output)
    if figure is not None:
        from ..figures.style import save
        from ..matchability.figure import map_score

        save(map_score(scored, name), figure)
        click.echo(f"Wrote {figure}")


def _print_scored(scored: Any) -> None:
    """Print the design, the components, and the best and worst cells by a track's accuracy."""
    design, table = scored.design, scored.table
    console.out(
        f"{counted(len(table), 'cell')} of {design.cell_deg:g}° at {scored.height}: "
        f"{design.instrument.kind}, {design.instrument.noise:g} {design.instrument.unit}; nodes "
        f"{design.spacing_m:.0f} m apart; tracks of {design.track_m / 1e3:.3g} km with "
        f"{counted(design.readings, 'measurement')}; prior position {design.sigma_m / 1e3:g} km "
        f"(1 σ), correct fixes within {design.right_m / 1e3:g} km"
    )
    if scored.components is None:
        console.out("Too few cells for principal components: no index, no classes.")
    else:
        shares = ", ".join(f"{100.0 * share:.0f} %" for share in scored.components.explained)
        console.out(
            f"principal components explain {shares}; the index uses the first "
            f"{scored.components.kept}"
        )
    ordered = table.sort_values("track_m")
    unit = design.instrument.unit
    numbers = (
        f"σ [{unit}]",
        f"roughness [{unit}/km]",
        "index",
        "RMS error, all headings [m]",
        "best heading [°]",
        "RMS error, best heading [m]",
        "wrong match, at most",
    )
    cells_table = ResponsiveTable(
        "best and worst cells by the accuracy of a track, averaged over headings",
        [
            ("latitude [°]", "name"),
            ("longitude [°]", "name"),
            *((heading, "number") for heading in numbers),
        ],
    )
    best = min(_SHOWN_CELLS, len(ordered))
    for number, (_, row) in enumerate(ordered.iterrows()):
        if best <= number < len(ordered) - _SHOWN_CELLS:
            continue
        cells_table.add_row(
            f"{0.5 * (row['south_deg'] + row['north_deg']):.3f}",
            f"{0.5 * (row['west_deg'] + row['east_deg']):.3f}",
            f"{row['deviation']:.3g}",
            f"{1e3 * row['roughness']:.3g}",
            row["grade"] or "-",
            short(row["track_m"]),
            f"{row['best_heading_deg']:g}",
            short(row["best_track_m"]),
            _share(row["false_fix"]),
        )
        if number == best - 1 < len(ordered) - 1:
            cells_table.add_section()
    cells_table.print(console)
    richest = ordered.iloc[0]
    mean, least = (short(richest[name]) for name in ("track_m", "best_track_m"))
    console.out(
        f"In the best cell a track of {design.track_m / 1e3:.3g} km allows an RMS position "
        f"error of {mean} m on average over headings, and of {least} m on heading "
        f"{richest['best_heading_deg']:g}°. The probability of a wrong match, more than "
        f"{design.right_m:g} m off, is at most {_share(richest['false_fix'])}."
    )


def _share(value: float) -> str:
    """Return an upper bound of a share as text in percent, at least 0.01 %."""
    if value < _LEAST_SHARE:
        return f"{100.0 * _LEAST_SHARE:g} %"
    return f"{100.0 * value:.2g} %" if value < 0.995 else "100 %"
