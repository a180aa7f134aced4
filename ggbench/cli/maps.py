"""``ggbench map``: build a gravity-gradient map from a user's own data, show what a map is."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ..figures.numbers import counted
from .responsive_table import ResponsiveTable
from .screen import console
from .tables import require_suffix, write_csv

_FILE = click.Path(path_type=Path)
_DEGREE = click.IntRange(2)


@click.group("map")
def map_group() -> None:
    """Build gravity-gradient maps from data of your own, and look at them."""


@map_group.command()
@click.option("-o", "--output", required=True, type=_FILE, help="netCDF file to write.")
@click.option("--terrain", type=_FILE, help="Elevation model: GeoTIFF, .hgt, netCDF, ESRI ASCII.")
@click.option("--density", type=float, default=2670.0, show_default=True, help="Of rock [kg/m³].")
@click.option(
    "--water-density", type=float, default=1030.0, show_default=True, help="Of the sea [kg/m³]."
)
@click.option(
    "--order", type=int, default=8, show_default=True, help="Fewest orders of Parker's series."
)
@click.option(
    "--geoid-height",
    type=float,
    default=0.0,
    show_default=True,
    help="Height of the terrain's zero level above the ellipsoid [m].",
)
@click.option("--coefficients", type=_FILE, help="Global gravity model: a .gfc file.")
@click.option("--max-degree", type=_DEGREE, help="Highest degree of the coefficients to use [all].")
@click.option("--min-degree", type=_DEGREE, default=2, show_default=True, help="Lowest degree.")
@click.option("--geoid", type=_FILE, help="Grid of geoid undulations or height anomalies.")
@click.option("--anomaly", type=_FILE, help="Grid of free-air gravity anomalies.")
@click.option("--disturbance", type=_FILE, help="Grid of gravity disturbances.")
@click.option(
    "--grid-height",
    type=float,
    default=0.0,
    show_default=True,
    help="Height above the ellipsoid at which the gravity grid holds [m].",
)
@click.option(
    "--land-correction", type=_FILE, metavar="TERRAIN",
    help="Elevation model that turns the geoid of land into the height anomaly.",
)  # fmt: skip
@click.option(
    "--terrain-from-degree", type=_DEGREE, metavar="N",
    help="Degree up to which the other data hold the field; the terrain adds what is shorter "
    "[the highest degree of the coefficients].",
)  # fmt: skip
@click.option(
    "--south",
    type=float,
    help="Bounds [deg], longitudes from -180 or from 0; "
    "across the date line 179 to -179. Default: what the data can serve.",
)
@click.option("--north", type=float)
@click.option("--west", type=float)
@click.option("--east", type=float)
@click.option(
    "--lowest",
    type=float,
    help="Lowest height above the ellipsoid, and above the highest ground [m].",
)
@click.option("--highest", type=float, help="Highest height above the ellipsoid [m].")
@click.option("--height-spacing", type=float, help="Between layers [m].")
@click.option("--spacing-arcsec", type=float, help="In latitude and longitude.")
@click.option("--spacing-arcmin", type=float, help="The same in arc minutes.")
@click.option(
    "--precision", type=click.Choice(["float32", "float64"]), default="float32", show_default=True
)
@click.option(
    "--compression",
    type=click.IntRange(0, 9),
    default=1,
    show_default=True,
    help="0: none, fastest; 9: smallest.",
)
def build(output: Path, precision: str, compression: int, **options: Any) -> None:
    """Build a map of the disturbing gravity gradient from data of your own.

    \b
    Sources:
      --terrain DEM                      what the ground attracts
      --coefficients MODEL.gfc           a global model to its degree N
      --coefficients ... --terrain ...   both: the terrain adds only what is shorter than degree N
      --geoid | --anomaly | --disturbance GRID [--coefficients ...]
                                         remove, compute, restore (EGM2008 to degree 120)
    """  # noqa: D301
    from ..gravity.gradient_map import MapError
    from ..maps import netcdf, plan
    from ..maps.nodes import Wishes
    from ..spec.quantities import DENSITY

    grids = [kind for kind in ("geoid", "anomaly", "disturbance") if options[kind] is not None]
    if len(grids) > 1:
        raise MapError(f"--{' and --'.join(grids)} are two grids of one field: give one of them.")
    seconds, minutes = options["spacing_arcsec"], options["spacing_arcmin"]
    if seconds is not None and minutes is not None:
        raise MapError("--spacing-arcsec and --spacing-arcmin are the same: give one of them.")
    if output.suffix != ".nc":
        raise MapError(f"the map file {output} must be named *.nc: it is a netCDF file.")
    for key in ("terrain", "coefficients", "land_correction", *grids):
        if options[key] is not None and options[key].resolve() == output.resolve():
            raise MapError(f"the map file {output} would overwrite what it is made of.")
    kind = grids[0] if grids else "geoid"
    inputs = plan.Inputs(
        terrain=options["terrain"],
        coefficients=options["coefficients"],
        grid=options[kind],
        grid_kind=kind,
        grid_height_m=options["grid_height"],
        land_correction=options["land_correction"],
        min_degree=options["min_degree"],
        max_degree=options["max_degree"],
        terrain_from_degree=options["terrain_from_degree"],
        density=options["density"],
        water_density=options["water_density"],
        order=options["order"],
        geoid_height_m=options["geoid_height"],
    )
    spacing = minutes / 60.0 if minutes is not None else None
    wishes = Wishes(
        south_deg=options["south"],
        north_deg=options["north"],
        west_deg=options["west"],
        east_deg=options["east"],
        lowest_m=options["lowest"],
        highest_m=options["highest"],
        spacing_deg=seconds / 3600.0 if seconds is not None else spacing,
        height_spacing_m=options["height_spacing"],
    )
    started = time.monotonic()
    made = plan.plan(inputs, wishes, _command(options))
    for option in ("density", "water_density"):
        odd = DENSITY.usual_unless(options[option])
        if odd:
            name = option.replace("_", "-")
            click.echo(f"Warning: --{name} {options[option]:g} kg/m³ is unusual ({odd}).")
    watched = plan.Watched(made.layers())
    netcdf.write_layers(output, made.nodes, watched, made.attributes, precision, compression)
    elapsed = time.monotonic() - started
    for remark in made.remarks:
        click.echo(f"Note: {remark}.")
    _describe(made.nodes, made.attributes)
    _print_rms(made.nodes, watched.rms)
    click.echo(f"Wrote {output}, {output.stat().st_size / 1e6:.1f} MB, in {elapsed:.1f} s.")


@map_group.command()
@click.argument("file", type=_FILE)
@click.option("-o", "--output", type=_FILE, help="PNG file of the six components to draw.")
@click.option("--height", type=float, help="Height to draw, to the nearest node [the lowest].")
def show(file: Path, output: Path | None, height: float | None) -> None:
    """Print what the map in FILE is, and draw its six components."""
    from ..gravity.gradient_map import MapError
    from ..maps import netcdf_reader, plan

    if output is not None and output.suffix.lower() != ".png":
        raise MapError(f"the figure {output} must be named *.png: it is a PNG file.")
    nodes, attributes, layers = netcdf_reader.read_layers(file)
    lowest, highest = nodes.height_m[0], nodes.height_m[-1]
    if height is not None and not lowest <= height <= highest:
        raise MapError(f"--height {height:g} is not in {file}: {lowest:g} to {highest:g} m is.")
    wanted = nodes.height_m[0] if height is None else height
    drawn = int(abs(nodes.height_m - wanted).argmin())
    chosen: Any = None
    watched = plan.Watched(layers)
    for index, layer in enumerate(watched):
        if index == drawn:
            chosen = layer
    _describe(nodes, attributes)
    for key in ("parameters", "source_files", "history", "ggbench_version"):
        if attributes.get(key):
            console.out(f"{key}: {attributes[key]}")
    _print_rms(nodes, watched.rms)
    if output is not None and chosen is not None:
        from ..figures.map_components import map_components
        from ..figures.style import save

        source = attributes.get("source", "")
        save(map_components(nodes, chosen[0], float(nodes.height_m[drawn]), source), output)
        click.echo(f"Wrote {output}")


@map_group.command()
@click.argument("name", metavar="MAP")
@click.option("--height", type=float, help="Of the flights above the ellipsoid [m; the lowest].")
@click.option("--cell-deg", type=float, default=0.5, show_default=True, help="Side of a cell [°].")
@click.option(
    "--instrument",
    type=click.Choice(["tensor", "uu", "gravity"]),
    default="tensor",
    show_default=True,
    help="Six components, the vertical gradient alone, or a gravimeter.",
)
@click.option(
    "--noise", type=float, default=1.0, show_default=True, help="Of a reading [E; mGal of gravity]."
)
@click.option("--spacing", type=float, help="Between nodes of the statistics [m; a cell's 50th].")
@click.option(
    "--per-km2", type=float, default=1.0, show_default=True,
    help="Readings on a square kilometre, of the information.",
)  # fmt: skip
@click.option("--track-km", type=float, help="Length of tracks through a cell [its shorter side].")
@click.option("--readings", type=int, default=51, show_default=True, help="Of each track.")
@click.option(
    "--sigma-km", type=float, default=5.0, show_default=True,
    help="To what the position is known before, per axis: A_min looks to three times as far.",
)  # fmt: skip
@click.option("--right-km", type=float, help="How far off a fix is right [half of --sigma-km].")
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
    """Score the cells of a MAP: where is it worth matching.

    MAP is a file *.nc or *.npz, or the name of a shipped region or terrain. Each cell gets the
    statistics of the literature and their index by principal components; the accuracy that
    Fisher's information of a track through it allows; and A_min, how far the likeliest wrong place
    is from being taken for the right one. None of these has seen an error of a flight.
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
        height, cell_deg, Instrument(instrument, noise), spacing, per_km2, metres(track_km),
        readings, 1e3 * sigma_km, metres(right_km),
    )  # fmt: skip
    found, height = named_map(name, design, bounds)
    scored = score_map(Field.from_map(found), replace(design, height_m=height), bounds, name)
    _print_scored(scored)
    if output is not None:
        write_csv(scored.table, output)
    if figure is not None:
        from ..figures.style import save
        from ..matchability.figure import map_score

        save(map_score(scored, name), figure)
        click.echo(f"Wrote {figure}")


_SHOWN_CELLS = 5


def _print_scored(scored: Any) -> None:
    """Print the design, the components, and the best and worst cells by a track's accuracy."""
    design, table = scored.design, scored.table
    console.out(
        f"{counted(len(table), 'cell')} of {design.cell_deg:g}° at {design.height_m:g} m: "
        f"{design.instrument.kind}, {design.instrument.noise:g} {design.instrument.unit}; nodes "
        f"{design.spacing_m:.0f} m apart; tracks of {design.track_m / 1e3:.3g} km with "
        f"{counted(design.readings, 'reading')}; position known to "
        f"{design.sigma_m / 1e3:g} km, a fix right within {design.right_m / 1e3:g} km"
    )
    if scored.components is None:
        console.out("Too few cells for principal components: no index, no classes.")
    else:
        shares = ", ".join(f"{100.0 * share:.0f} %" for share in scored.components.explained)
        console.out(
            f"principal components explain {shares}; the index has the first "
            f"{scored.components.kept}"
        )
    ordered = table.sort_values("track_m")
    unit = design.instrument.unit
    numbers = (
        f"σ [{unit}]", f"roughness [{unit}/km]", "class", "track √tr J⁻¹ [m]", "best heading [°]",
        "A_min [nepers]", "false fixes ≤",
    )  # fmt: skip
    shown = ResponsiveTable(
        "best and worst cells by the accuracy of a track, over its headings",
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
        shown.add_row(
            f"{0.5 * (row['south_deg'] + row['north_deg']):.3f}",
            f"{0.5 * (row['west_deg'] + row['east_deg']):.3f}",
            f"{row['deviation']:.3g}", f"{1e3 * row['roughness']:.3g}", row["grade"] or "-",
            f"{row['track_m']:.3g}", f"{row['best_heading_deg']:g}", f"{row['ambiguity']:.3g}",
            f"{row['false_fix']:.2g}",
        )  # fmt: skip
        if number == best - 1 < len(ordered) - 1:
            shown.add_section()
    shown.print(console)


def _describe(nodes: Any, attributes: dict[str, str]) -> None:
    """Print what a map is: frame, bounds, spacing."""
    from ..maps.netcdf import CONTENT, FRAME

    lat, lon, height = nodes.latitude_deg, nodes.longitude_deg, nodes.height_m
    n_lat, n_lon, n_h = nodes.shape
    lines = (
        ("source", attributes.get("source", "not said")),
        ("field", attributes.get("comment", CONTENT)),
        ("frame", attributes.get("frame", FRAME)),
        ("nodes", f"{n_lat} x {n_lon} x {n_h} in latitude, longitude and height"),
        ("latitude", _axis(lat, "°", 3600.0, "″")),
        ("longitude", _axis(lon, "°", 3600.0, "″")),
        ("height", _axis(height, " m", 1.0, " m") + " above the ellipsoid"),
    )
    for key, text in lines:
        console.out(f"{key}: {text}")


def _axis(values: Any, unit: str, factor: float, step_unit: str) -> str:
    step = factor * (values[-1] - values[0]) / (values.size - 1)
    first, last = (f"{value:.6f}".rstrip("0").rstrip(".") for value in (values[0], values[-1]))
    return f"{first}{unit} to {last}{unit} every {step:.6g}{step_unit}"


def _print_rms(nodes: Any, rms: list[Any]) -> None:
    from ..maps.netcdf import TENSOR, VECTOR

    headings = [f"{name.upper()} [E]" for name in TENSOR]
    headings += [f"{name.upper()} [mGal]" for name in VECTOR]
    table = ResponsiveTable(
        "rms of the disturbing gradient and of the gravity disturbance",
        [("height [m]", "name"), *((heading, "number") for heading in headings)],
    )
    for height, row in zip(nodes.height_m, rms, strict=True):
        numbers = [*row[: len(TENSOR)], *(1e5 * row[len(TENSOR) :])]
        table.add_row(f"{height:g}", *(f"{number:.3g}" for number in numbers))
    table.print(console)


def _command(options: dict[str, Any]) -> str:
    """The options as they were given, files by their names only."""
    defaults = {p.name: p.default for p in build.params}
    words = [
        f"--{key.replace('_', '-')} {value.name if isinstance(value, Path) else value}"
        for key, value in options.items()
        if value is not None and value != defaults[key]
    ]
    return " ".join(["ggbench map build", *words])
