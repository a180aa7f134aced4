"""Options of ``ggbench map build`` for maps made from survey lines."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

_FILE = click.Path(path_type=Path)
_OPTIONS = (
    click.option(
        "--lines",
        type=_FILE,
        metavar="SURVEY",
        help="Survey lines: Geosoft *.xyz, ASEG-GDF2 *.dat with *.dfn, *.csv, also .gz.",
    ),
    click.option(
        "--column",
        multiple=True,
        metavar="NAME=COLUMN",
        help="Column of the file, optionally with a unit, for line, kind, time_s, latitude_deg, "
        "longitude_deg, height_m or a component: 'height_m=Alt [ft]'; repeatable.",
    ),
    click.option(
        "--components", metavar="LIST", help="Components to use, for example xx,xy,xz,yy,yz [all]."
    ),
    click.option(
        "--axes",
        type=click.Choice(["east-north-up", "east-north-down", "north-east-down"]),
        default="east-north-up",
        show_default=True,
        help="Axes x, y, z of the file's components.",
    ),
    click.option(
        "--quantity",
        type=click.Choice(["gradient", "disturbance", "anomaly"]),
        default="gradient",
        show_default=True,
        help="Gradient [E], gravity disturbance or free-air anomaly [mGal].",
    ),
    click.option(
        "--crs",
        metavar="EPSG:CODE",
        help="Coordinate reference system [WGS 84 in degrees]; columns of a "
        "projection are easting_m and northing_m.",
    ),
    click.option(
        "--leave-out",
        multiple=True,
        metavar="LINES",
        help="Lines to exclude from the map and the noise model: a name, a pattern such as '*.1', "
        "or a line kind such as repeat; repeatable.",
    ),
    click.option(
        "--depth",
        type=click.FloatRange(0, min_open=True),
        help="Depth of the point masses below the flights [m]. By default "
        "cross-validation over the lines chooses depth and damping; the spacing follows.",
    ),
    click.option(
        "--source-spacing",
        type=click.FloatRange(0, min_open=True),
        help="Spacing of the masses [m].",
    ),
    click.option(
        "--damping",
        type=click.FloatRange(0, min_open=True),
        help="Damping of the masses, relative to the mean diagonal of the normal equations.",
    ),
    click.option(
        "--noise",
        type=_FILE,
        metavar="JSON",
        help="Also write a model of the coloured noise, fitted to the residuals of "
        "the cross-validation.",
    ),
)
_WITH_LINES = (
    "column",
    "components",
    "crs",
    "leave_out",
    "depth",
    "source_spacing",
    "damping",
    "noise",
)


def options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options for survey lines to a command."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def require_alone(options: dict[str, Any], others: Sequence[str]) -> None:
    """Raise MapError if options for survey lines are combined with other sources.

    The error is also raised if such options are given without survey lines.
    """
    from ..gravity.gradient_map import MapError

    if options["lines"] is None:
        with_lines = [key for key in _WITH_LINES if options[key]]
        if with_lines:
            raise MapError(f"--{with_lines[0].replace('_', '-')} requires --lines.")
        return
    mixed = [key for key in others if options[key] is not None]
    if mixed:
        raise MapError(
            f"--lines excludes --{mixed[0].replace('_', '-')}: a map of survey lines has no "
            "other source."
        )


def planned(options: dict[str, Any], request: Any, command: str) -> Any:
    """Return the plan of a map made from survey lines.

    ``options`` are the options of :func:`options`. If they name a file for the noise model, this
    file is written. ``request`` describes the grid of the map, and ``command`` is recorded in the
    history of the map.
    """
    from ..gravity.gradient_map import MapError
    from ..maps.survey_fit import FitOptions
    from ..maps.survey_plan import SurveyInputs, doubts, fit_survey, plan_survey

    if options["noise"] is not None and options["noise"].suffix != ".json":
        raise MapError(f"the file of noise {options['noise']} must be named *.json.")
    unequal = [text for text in options["column"] if "=" not in text]
    if unequal:
        raise MapError(f"--column {unequal[0]} must be written NAME=COLUMN.")
    inputs = SurveyInputs(
        lines=options["lines"],
        columns=dict(text.split("=", 1) for text in options["column"]),
        components=tuple(filter(None, (options["components"] or "").replace(" ", "").split(","))),
        axes=options["axes"],
        quantity=options["quantity"],
        leave_out=options["leave_out"],
        voids=options["void"],
        crs=options["crs"],
        fit_options=FitOptions(options["depth"], options["source_spacing"], options["damping"]),
    )
    fit = fit_survey(inputs, click.echo)
    click.echo(f"Chosen: {fit.settings}.")
    survey_map = plan_survey(inputs, fit, request, command)
    if doubt := doubts(fit, options["axes"]):
        click.echo(f"Warning: {doubt}.")
    _print_errors(survey_map.errors, fit.lines.quantity)
    if options["noise"] is not None:
        _write_noise(options["noise"], inputs, fit)
    return survey_map


def _print_errors(errors: Any, quantity: str) -> None:
    """Print the standard errors of the map and their correlation lengths, if they are known."""
    names, factor, unit = ("EE", "EN", "EU", "NN", "NU", "UU", "E", "N", "U"), 1.0, "E"
    columns = range(6)
    if quantity == "disturbance":
        columns, factor, unit = range(6, 9), 1e5, "mGal"
    text = ", ".join(
        f"{names[k]} {_error(factor * errors[0][k], errors[1][k], unit)}" for k in columns
    )
    click.echo(f"Standard error of the map and its correlation length: {text}.")
    click.echo(
        "These standard errors exclude errors that are constant along a line, because the mean "
        "residual of each line is removed. Such errors may be much larger."
    )
    if not all(math.isfinite(errors[0][k]) for k in columns):
        click.echo(
            "A standard error cannot be estimated if the residuals on held-back lines are at most "
            "as large as on fitted lines."
        )


def _error(error: float, metres: float, unit: str) -> str:
    if not math.isfinite(error):
        return "not known"
    distance = f"{metres:.0f} m" if math.isfinite(metres) else "an unknown distance"
    return f"{error:.2f} {unit} over {distance}"


def _write_noise(path: Path, inputs: Any, fit: Any) -> None:
    from ..maps.survey_noise import noise_of
    from ..maps.survey_plan import provenance_of

    model, scores = noise_of(fit)
    for order, score in scores.items():
        click.echo(
            f"noise of order {order}: log-likelihood {score:.4f} per sample of the held-back lines"
        )
    replace(model, provenance=provenance_of(inputs, fit, model.order)).write(path)
    click.echo(f"Wrote {path}, order {model.order}, largest root {model.spectral_radius:.3f}.")
