"""``ggbench map``: builder and description of gravity-gradient maps."""

from __future__ import annotations

import datetime
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from ..display.responsive_table import ResponsiveTable
from . import survey_maps
from .map_score import score
from .screen import console

_FILE = click.Path(path_type=Path)
_SAID_EVERY_S = 10.0
_DEGREE = click.IntRange(2)
_SOURCES = (
    "terrain",
    "coefficients",
    "land_correction",
    "geoid",
    "anomaly",
    "disturbance",
    "lines",
)


@click.group("map")
def map_group() -> None:
    """Build, show and score gravity-gradient maps."""


map_group.add_command(score)


@map_group.command()
@click.option("-o", "--output", required=True, type=_FILE, help="netCDF file to write.")
@click.option(
    "--terrain", type=_FILE, help="Elevation model: GeoTIFF, .hgt, netCDF, ESRI ASCII, Surfer."
)
@click.option(
    "--density", type=float, default=2670.0, show_default=True, help="Density of rock [kg/m³]."
)
@click.option(
    "--water-density",
    type=float,
    default=1030.0,
    show_default=True,
    help="Density of sea water [kg/m³].",
)
@click.option(
    "--order", type=int, default=8, show_default=True, help="Minimum order of Parker's series."
)
@click.option(
    "--geoid-height",
    type=float,
    help="Height of the terrain's zero level above the ellipsoid [m]. Default: 0; with --drape "
    "EGM2008, unless the file declares ellipsoidal heights.",
)
@click.option("--coefficients", type=_FILE, help="Global gravity model: a .gfc file.")
@click.option("--max-degree", type=_DEGREE, help="Highest degree of the coefficients to use [all].")
@click.option("--min-degree", type=_DEGREE, default=2, show_default=True, help="Lowest degree.")
@click.option(
    "--epoch",
    type=click.DateTime(["%Y-%m-%d"]),
    metavar="YYYY-MM-DD",
    help="Date of time-variable coefficients.",
)
@click.option("--geoid", type=_FILE, help="Grid of geoid undulations or height anomalies.")
@click.option("--anomaly", type=_FILE, help="Grid of free-air gravity anomalies.")
@click.option("--disturbance", type=_FILE, help="Grid of gravity disturbances.")
@click.option(
    "--grid-height",
    type=float,
    default=0.0,
    show_default=True,
    help="Height of the gravity grid above the ellipsoid [m].",
)
@click.option(
    "--land-correction",
    type=_FILE,
    metavar="TERRAIN",
    help="Elevation model to convert the geoid on land to the height anomaly.",
)
@click.option(
    "--terrain-from-degree",
    type=_DEGREE,
    metavar="N",
    help="Highest degree of coefficients or grid; the terrain adds shorter wavelengths [that of "
    "the coefficients; required with a grid].",
)
@click.option(
    "--clearance",
    type=click.FloatRange(0.0, 1e6, min_open=True),
    metavar="M",
    help=(
        "Planned height above the ground. The lowest layer lies at most this far above the highest "
        "ground. A note states the share of the area where such flights are inside the map. With "
        "--drape it replaces --clearance-from and --clearance-to: the layers contain straight "
        "terrain-following flights across the centre of the map."
    ),
)
@click.option(
    "--drape",
    is_flag=True,
    help="Make layers that follow the ground, for flights below the summits.",
)
@click.option(
    "--clearance-from",
    type=float,
    default=60.0,
    show_default=True,
    metavar="M",
    help="Lowest layer of --drape above the base, the smoothed envelope of the ground.",
)
@click.option(
    "--clearance-to",
    type=float,
    default=500.0,
    show_default=True,
    metavar="M",
    help="Highest layer of --drape.",
)
@click.option(
    "--tolerance",
    type=float,
    default=0.5,
    show_default=True,
    metavar="E",
    help="Tolerance of the terrain field with --drape: smaller values compute more cells as "
    "prisms.",
)
@click.option(
    "--beyond",
    type=click.Choice(["mirror", "nothing"]),
    default="mirror",
    show_default=True,
    help="Continuation beyond the edges of the terrain with --drape.",
)
@click.option(
    "--void",
    type=float,
    multiple=True,
    metavar="VALUE",
    help="Void value in terrains, grids and lines; repeatable [declared values, -32768, 3.4e38 "
    "and similar].",
)
@survey_maps.options
@click.option(
    "--south",
    type=float,
    help="Bounds [deg]; longitudes -180 to 180 or 0 to 360; across the date line --west 179 --east "
    "-179. Default: from terrain, grid or lines.",
)
@click.option("--north", type=float)
@click.option("--west", type=float)
@click.option("--east", type=float)
@click.option(
    "--lowest",
    type=float,
    help="Height of the lowest layer above the ellipsoid [m]; it must be above the highest ground.",
)
@click.option("--highest", type=float, help="Height of the highest layer above the ellipsoid [m].")
@click.option("--height-spacing", type=float, help="Layer spacing [m].")
@click.option("--spacing-arcsec", type=float, help="Node spacing in latitude and longitude.")
@click.option("--spacing-arcmin", type=float, help="Node spacing in arc minutes.")
@click.option(
    "--precision", type=click.Choice(["float32", "float64"]), default="float32", show_default=True
)
@click.option(
    "--compression",
    type=click.IntRange(0, 9),
    default=1,
    show_default=True,
    help="Compression level: 0 is fastest, 9 is smallest.",
)
def build(output: Path, precision: str, compression: int, **options: Any) -> None:
    """Build a map of the disturbing gravity gradient.

    \b
    Sources:
      --terrain DEM                      attraction of the terrain
      --coefficients MODEL.gfc           global model to its degree N
      --coefficients ... --terrain ...   both: the terrain adds wavelengths beyond degree N
      --geoid | --anomaly | --disturbance GRID [--coefficients ...]
                                         remove-compute-restore [EGM2008 to degree 120]
      --lines SURVEY [--leave-out ...]   point masses fitted to survey lines
    """  # noqa: D301
    from ..gravity.gradient_map import MapError
    from ..maps import netcdf, plan

    if output.suffix != ".nc":
        raise MapError(f"the map file {output} must be named *.nc: it is a netCDF file.")
    for key in _SOURCES:
        if options[key] is not None and options[key].resolve() == output.resolve():
            raise MapError(f"the map file {output} would overwrite its own input.")
    if not options["drape"]:
        _refuse_drape_options(options)
    started = time.monotonic()
    request = _request(options)
    survey_maps.require_alone(options, [key for key in _SOURCES if key != "lines"])
    if options["lines"] is not None:
        if options["clearance"] is not None or options["drape"]:
            raise MapError("--clearance and --drape are for terrains, not for --lines.")
        planned = survey_maps.planned(options, request, _command(options))
    else:
        inputs = _inputs(options)
        planned = plan.plan(inputs, request, _command(options), _layers_for(options, inputs))
    _warn_of_densities(options)
    layers_with_rms = plan.LayersWithRms(_told(planned.layers(), planned.nodes.height_m.size))
    netcdf.write_layers(
        path=output,
        nodes=planned.nodes,
        layers=layers_with_rms,
        attributes=planned.attributes,
        dtype=precision,
        compression=compression,
        errors=planned.errors,
    )
    elapsed = time.monotonic() - started
    for remark in planned.remarks:
        click.echo(f"Note: {remark}.")
    _describe(planned.nodes, planned.attributes)
    _print_rms(planned.nodes, layers_with_rms.rms)
    click.echo(f"Wrote {output}, {output.stat().st_size / 1e6:.1f} MB, in {elapsed:.1f} s.")


def _told(layers: Iterator[Any], count: int) -> Iterator[Any]:
    """Yield layers; print the number of finished layers and the remaining time at intervals."""
    started = last_line = time.monotonic()
    for index, layer in enumerate(layers, 1):
        yield layer
        now = time.monotonic()
        if now - last_line >= _SAID_EVERY_S and index < count:
            remaining_s = (now - started) / index * (count - index)
            click.echo(f"{index} of {count} layers, about {remaining_s:.0f} s left", err=True)
            last_line = now


def _refuse_drape_options(options: dict[str, Any]) -> None:
    """Raise MapError if options for draped layers are given for a map of level layers."""
    from ..gravity.gradient_map import MapError

    for option in _stated_layers(options):
        raise MapError(f"{option} is for draped maps: give --drape.")


def _inputs(options: dict[str, Any]) -> Any:
    """Return the inputs of a map made from terrain, coefficients and grids."""
    from ..gravity.gradient_map import MapError
    from ..maps.plan import Inputs

    grids = [kind for kind in ("geoid", "anomaly", "disturbance") if options[kind] is not None]
    if len(grids) > 1:
        raise MapError(f"--{' and --'.join(grids)} both give the field: give one of them.")
    kind = grids[0] if grids else "geoid"
    layers, clearance = (options["clearance_from"], options["clearance_to"]), options["clearance"]
    if clearance is not None:
        layers = 0.5 * clearance, 2.0 * clearance  # a first guess, see _layers_for
    return Inputs(
        terrain=options["terrain"],
        coefficients=options["coefficients"],
        grid=options[kind],
        grid_kind=kind,
        grid_height_m=options["grid_height"],
        land_correction=options["land_correction"],
        min_degree=options["min_degree"],
        max_degree=options["max_degree"],
        epoch=options["epoch"].date() if options["epoch"] else None,
        terrain_from_degree=options["terrain_from_degree"],
        density=options["density"],
        water_density=options["water_density"],
        order=options["order"],
        geoid_height_m=options["geoid_height"],
        voids=options["void"],
        clearance_m=options["clearance"],
        drape=layers if options["drape"] else None,
        tolerance_eotvos=options["tolerance"],
        continued=options["beyond"] == "mirror",
    )


def _layers_for(options: dict[str, Any], inputs: Any) -> Any:
    """Return a function that chooses the layers of --drape for flights at --clearance, or None.

    Raise MapError if the layers are also stated by options.
    """
    from ..gravity.gradient_map import MapError
    from .draped_flight import needed_layers

    terrain, clearance = inputs.terrain, inputs.clearance_m
    if inputs.drape is None or terrain is None or clearance is None:
        return None
    if _stated_layers(options):
        raise MapError(
            "--clearance cannot be given with --clearance-from or --clearance-to: both "
            "determine the layers of --drape."
        )
    return lambda nodes, zero_level: needed_layers(nodes, terrain, clearance, zero_level)


def _stated_layers(options: dict[str, Any]) -> list[str]:
    """Return the options of draped layers that differ from their defaults."""
    defaults = {p.name: p.default for p in build.params}
    keys = ("clearance_from", "clearance_to")
    return [f"--{key.replace('_', '-')}" for key in keys if options[key] != defaults[key]]


def _request(options: dict[str, Any]) -> Any:
    """Return the bounds and spacings of a map."""
    from ..gravity.gradient_map import MapError
    from ..maps.nodes import GridRequest

    seconds, minutes = options["spacing_arcsec"], options["spacing_arcmin"]
    if seconds is not None and minutes is not None:
        raise MapError("give either --spacing-arcsec or --spacing-arcmin.")
    spacing = minutes / 60.0 if minutes is not None else None
    return GridRequest(
        south_deg=options["south"],
        north_deg=options["north"],
        west_deg=options["west"],
        east_deg=options["east"],
        lowest_m=options["lowest"],
        highest_m=options["highest"],
        spacing_deg=seconds / 3600.0 if seconds is not None else spacing,
        height_spacing_m=options["height_spacing"],
    )


def _warn_of_densities(options: dict[str, Any]) -> None:
    from ..spec.quantities import DENSITY

    for option in ("density", "water_density"):
        odd = DENSITY.usual_unless(options[option])
        if odd:
            name = option.replace("_", "-")
            click.echo(f"Warning: --{name} {options[option]:g} kg/m³ is unusual ({odd}).")


@map_group.command()
@click.argument("file", type=_FILE)
@click.option("-o", "--output", type=_FILE, help="PNG file of the six components.")
@click.option("--height", type=float, help="Height to draw, to the nearest node [the lowest].")
@click.option(
    "--clearance",
    type=float,
    help="Layer to draw of a draped map: its height above the base [the lowest].",
)
def show(file: Path, output: Path | None, height: float | None, clearance: float | None) -> None:
    """Describe the map in FILE and draw its six components."""
    from ..gravity.gradient_map import MapError
    from ..maps import netcdf_reader, plan

    if output is not None and output.suffix.lower() != ".png":
        raise MapError(f"the figure {output} must be named *.png: it is a PNG file.")
    nodes, attributes, layers = netcdf_reader.read_layers(file)
    lowest, highest = nodes.height_m[0], nodes.height_m[-1]
    option, other = ("height", clearance) if nodes.base_m is None else ("clearance", height)
    if other is not None:
        raise MapError(
            f"{file} is a map of {'level' if nodes.base_m is None else 'draped'} layers: give "
            f"--{option}, {lowest:g} to {highest:g} m."
        )
    height = height if nodes.base_m is None else clearance
    if height is not None and not lowest <= height <= highest:
        raise MapError(
            f"--{option} {height:g} is outside {file}, which has {lowest:g} to {highest:g} m."
        )
    layer_height = nodes.height_m[0] if height is None else height
    drawn = int(abs(nodes.height_m - layer_height).argmin())
    chosen: Any = None
    layers_with_rms = plan.LayersWithRms(layers)
    for index, layer in enumerate(layers_with_rms):
        if index == drawn:
            chosen = layer
    _describe(nodes, attributes)
    for key in ("parameters", "source_files", "history", "ggbench_version"):
        if attributes.get(key):
            console.out(f"{key}: {attributes[key]}")
    _print_rms(nodes, layers_with_rms.rms)
    if output is not None and chosen is not None:
        from ..figures.map_components import map_components
        from ..figures.style import save

        source = attributes.get("source", "")
        where = f"{nodes.height_m[drawn]:g} m"
        if nodes.base_m is not None:
            where += " above the base surface"
        save(map_components(nodes, chosen[0], where, source), output)
        click.echo(f"Wrote {output}")


def _describe(nodes: Any, attributes: dict[str, str]) -> None:
    """Print source, field, frame, bounds and spacings of a map."""
    from ..maps.netcdf import CONTENT, FRAME

    lat, lon, height = nodes.latitude_deg, nodes.longitude_deg, nodes.height_m
    n_lat, n_lon, n_h = nodes.shape
    lines = [
        ("source", attributes.get("source", "not said")),
        ("field", attributes.get("comment", CONTENT)),
        ("frame", attributes.get("frame", FRAME)),
        ("nodes", f"{n_lat} x {n_lon} x {n_h} in latitude, longitude and height"),
        ("latitude", _axis(lat, "°", 3600.0, "″")),
        ("longitude", _axis(lon, "°", 3600.0, "″")),
    ]
    above = _axis(height, " m", 1.0, " m")
    if nodes.base_m is None:
        lines.append(("height", f"{above} above the ellipsoid"))
    else:
        base = nodes.base_m
        lines += [
            ("clearance", f"{above} above the base surface"),
            ("base surface", f"{base.min():.0f} to {base.max():.0f} m above the ellipsoid"),
        ]
    for key, text in lines:
        console.out(f"{key}: {text}")


def _axis(values: Any, unit: str, factor: float, step_unit: str) -> str:
    step = factor * (values[-1] - values[0]) / (values.size - 1)
    first, last = (f"{value:.6f}".rstrip("0").rstrip(".") for value in (values[0], values[-1]))
    return f"{first}{unit} to {last}{unit} every {step:.6g}{step_unit}"


def _print_rms(nodes: Any, rms: list[Any]) -> None:
    from ..maps.netcdf import TENSOR, VECTOR

    third = "height" if nodes.base_m is None else "clearance"
    headings = [f"{name.upper()} [E]" for name in TENSOR]
    headings += [f"{name.upper()} [mGal]" for name in VECTOR]
    table = ResponsiveTable(
        "rms of the disturbing gradient and of the gravity disturbance",
        [
            (f"{third} [m]", "name"),
            *((heading, "number") for heading in headings),
        ],
    )
    for height, row in zip(nodes.height_m, rms, strict=True):
        numbers = [*row[: len(TENSOR)], *(1e5 * row[len(TENSOR) :])]
        table.add_row(f"{height:g}", *(f"{number:.3g}" for number in numbers))
    table.print(console)


def _command(options: dict[str, Any]) -> str:
    """Return the command with its options; files are given by name, without folders."""
    defaults = {p.name: p.default for p in build.params}
    words = [
        f"--{key.replace('_', '-')} {_word(value)}".strip()
        for key, values in options.items()
        for value in (values if isinstance(values, tuple) else (values,))
        if value is not None and value is not False and value != defaults[key]
    ]
    return " ".join(["ggbench map build", *words])


def _word(value: Any) -> str:
    if isinstance(value, datetime.datetime):
        return f"{value:%Y-%m-%d}"
    if value is True:  # of a flag
        return ""
    return value.name if isinstance(value, Path) else str(value)
