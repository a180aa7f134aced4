"""Plan of a map of survey lines."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ..files.writing import sha256_of
from ..gravity.gradient_map import MapError
from ..numerics.source import VERSION
from .netcdf import described
from .nodes import GridRequest, SourceExtent, nodes_for
from .plan import Plan
from .survey_conventions import convention_in_words
from .survey_error import map_error
from .survey_files import read_lines
from .survey_fit import FitOptions, SurveyFit, fit
from .survey_lines import Quantity

_STEP_M = 10.0  # to which default heights are rounded
_DOUBTFUL = 0.7  # of the readings: the map then predicts less than half of the variance


@dataclasses.dataclass(frozen=True)
class SurveyInputs:
    """Inputs of a map of survey lines; see ``ggbench map build --help``.

    Attributes
    ----------
    lines : file of the survey.
    columns, components, axes, quantity : content of the file, see :func:`.survey_files.read_lines`.
    leave_out : names, patterns or kinds of lines to exclude.
    voids, crs : missing values and coordinate system, see :func:`.survey_files.read_lines`.
    fit_options : settings that the user fixes.
    """

    lines: Path
    columns: dict[str, str]
    components: tuple[str, ...] = ()
    axes: str = "east-north-up"
    quantity: Quantity = "gradient"
    leave_out: tuple[str, ...] = ()
    voids: tuple[float, ...] = ()
    crs: str | None = None
    fit_options: FitOptions = dataclasses.field(default_factory=FitOptions)


def fit_survey(inputs: SurveyInputs, progress: Callable[[str], None]) -> SurveyFit:
    """Return the fit to the lines of a survey, without the excluded lines.

    Raises MapError if the file is invalid, or an excluded line does not exist.
    """
    lines = read_lines(
        path=inputs.lines,
        columns=inputs.columns,
        components=inputs.components,
        axes=inputs.axes,
        quantity=inputs.quantity,
        voids=inputs.voids,
        crs=inputs.crs,
    )
    return fit(lines.without(inputs.leave_out), inputs.fit_options, progress)


def plan_survey(inputs: SurveyInputs, fit: SurveyFit, request: GridRequest, command: str) -> Plan:
    """Return the plan of a map of survey lines.

    Raises MapError if bounds are outside the lines.
    """
    lines = fit.lines
    extent, request = _extent(fit), _with_heights(fit, request)
    nodes, remarks = nodes_for([extent], request)
    left_out = f", without {', '.join(inputs.leave_out)}" if inputs.leave_out else ""
    errors = map_error(fit)
    rms, readings = fit.rms
    residuals = ", ".join(
        f"{name} {value:.2f}" for name, value in zip(lines.components, rms, strict=True)
    )
    remarks.append(f"residuals of held-back lines, including noise: {residuals} {lines.unit}")
    remarks.extend(lines.remarks)
    if lines.dropped:
        remarks.append(f"{lines.dropped} samples with missing values are excluded")
    attributes = {
        "title": f"Gravity-gradient map: {inputs.lines.name}",
        "source": f"survey lines {inputs.lines.name}{left_out}: {len(lines.names)} lines, "
        f"{len(lines.line)} samples of {', '.join(lines.components)}; {fit.settings}",
        "history": f"ggbench {VERSION}: {command}",
        "source_files": described({inputs.lines.name: sha256_of(inputs.lines, MapError)}),
        "parameters": described(
            {
                **fit.settings._asdict(),
                "left_out": list(inputs.leave_out),
                "components": list(lines.components),
                "line_means": "removed",
                "held_back_rms": [round(float(value), 3) for value in rms],
                "readings_rms": [round(float(value), 3) for value in readings],
            }
        ),
        "comment": (
            "disturbing field from survey lines. It excludes the normal field of WGS84, "
            "wavelengths longer than the lines, and parts that the survey's corrections removed. "
            "Standard errors exclude the unknown constant of each line."
        ),
    }
    return Plan((fit.sources,), nodes, attributes, tuple(remarks), errors)


def doubts(fit: SurveyFit, axes: str) -> str:
    """Return a warning if the map predicts held-back lines badly, else "".

    The prediction is bad if the RMS of the residuals is close to the RMS of the measurements.
    Causes are wrong axes, or noise that is larger than the field. ``axes`` are the axes stated by
    the user; the warning names axes that fit better.
    """
    unit = fit.lines.unit
    doubtful = ", ".join(
        f"{name} {residual:.2f} {unit} and {read:.2f} {unit}"
        for name, residual, read in zip(fit.lines.components, *fit.rms, strict=True)
        if residual > _DOUBTFUL * read
    )
    if not doubtful:
        return ""
    cause = convention_in_words(fit, axes) or (
        "Check axes (--axes), signs, units and void values; if they are right, the noise is as "
        "large as the field"
    )
    return (
        "the map predicts less than half of the variance of held-back lines; RMS residual and "
        f"RMS measurement are {doubtful}. {cause[:1].upper()}{cause[1:]}"
    )


def _extent(fit: SurveyFit) -> SourceExtent:
    """Return the extent of a map: the area of the lines, and bounds one degree outside it.

    Outside the lines the field is that of the masses at the edge of the survey.
    """
    lines = fit.lines
    sides = (lines.latitude_deg, lines.longitude_deg)
    good = np.array([limit for side in sides for limit in (side.min(), side.max())])
    top = float(fit.sources.places[2].max())
    widened = good + np.array([-1.0, 1.0, -1.0, 1.0])  # degrees, more than is ever of use
    return SourceExtent(widened, good, top + 0.25 * fit.settings.depth_m, lines.height_m.min(), top)


def _with_heights(fit: SurveyFit, request: GridRequest) -> GridRequest:
    """Return a request with the heights of the flights where the user states no heights.

    If the user states only one limit, the other limit is moved if necessary. The map then extends
    over at least half the depth of the masses.
    """
    room = 0.5 * fit.settings.depth_m
    lowest, highest = fit.lines.height_m.min(), fit.lines.height_m.max() + room
    if request.lowest_m is None:
        if request.highest_m is not None:
            lowest = min(lowest, request.highest_m - room)
        lowest = max(_STEP_M * math.floor(lowest / _STEP_M), _extent(fit).floor_m)
        request = dataclasses.replace(request, lowest_m=lowest)
    if request.highest_m is None and request.lowest_m is not None:
        highest = max(highest, request.lowest_m + room)
        request = dataclasses.replace(request, highest_m=_STEP_M * math.ceil(highest / _STEP_M))
    return request


def provenance_of(inputs: SurveyInputs, fit: SurveyFit, order: int) -> str:
    """Return a text on the origin of a noise model: lines, order and settings."""
    left_out: Sequence[str] = inputs.leave_out
    return (
        f"ggbench {VERSION}: vector autoregression of order {order}, chosen and fitted on "
        f"{len(fit.held_back)} lines of {inputs.lines.name} held back from the map (not ties"
        + (f", not {', '.join(left_out)}" if left_out else "")
        + f"); {fit.settings}"
    )
