"""Survey lines of shipped maps, declared in ``surveyed.toml``, and distances to them."""

from __future__ import annotations

import importlib.resources
import tomllib
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..gravity.ellipsoid import metres_per_radian
from .survey_files import read_lines
from .survey_lines import Quantity, SurveyLines

Array = NDArray[np.float64]
_SPEC = importlib.resources.files(__package__) / "surveyed.toml"


class Surveyed(NamedTuple):
    """Declaration of the survey lines from which a shipped map was made.

    Attributes
    ----------
    survey : name of the file of lines.
    leave_out : names, patterns or kinds of the lines that were excluded from the map.
    quantity : measured quantity.
    """

    survey: str
    leave_out: tuple[str, ...]
    quantity: Quantity


def surveyed() -> dict[str, Surveyed]:
    """Return the declarations of all shipped maps from survey lines, by name of the map."""
    tables = tomllib.loads(_SPEC.read_text("utf-8"))
    return {
        name: Surveyed(
            table["survey"], tuple(table["leave_out"]), table.get("quantity", "gradient")
        )
        for name, table in tables.items()
    }


def lines_behind(source: str) -> SurveyLines | None:
    """Return the survey lines from which a shipped map was made; None for other maps.

    Raises MapError if the file of the lines cannot be read.
    """
    survey = surveyed().get(source)
    if survey is None:
        return None
    return _lines_of(survey.survey, survey.quantity).without(survey.leave_out)


@lru_cache(maxsize=1)
def _lines_of(survey: str, quantity: Quantity) -> SurveyLines:
    """Return the lines of a data file."""
    data = importlib.resources.files("ggbench.scenarios") / "data" / "measured"
    data /= f"{survey}.csv.gz"
    with importlib.resources.as_file(data) as path:
        return read_lines(path, quantity=quantity)


def next_line(positions: Array, lines: SurveyLines) -> tuple[str, float]:
    """Return the name of the survey line closest to a track, and its distance from the track [m].

    The distance is the median of the horizontal distances of the positions from the line. Between
    its samples a line is straight.

    Parameters
    ----------
    positions : (N, 3) latitude, longitude [rad] and height [m] of the track.
    lines : the survey lines.
    """
    scale = metres_per_radian(np.median(positions, axis=0))
    track = positions[:, :2] * scale
    places = np.radians(np.column_stack([lines.latitude_deg, lines.longitude_deg])) * scale
    medians = [
        float(np.median(distances_from(places[lines.samples(index)], track)))
        for index in range(len(lines.names))
    ]
    nearest = int(np.argmin(medians))
    return lines.names[nearest], medians[nearest]


def distances_from(line: Array, points: Array) -> Array:
    """Return the distances (N,) of points (N, 2) from a polygonal line with vertices (M, 2)."""
    starts, steps = line[:-1], np.diff(line, axis=0)
    lengths = np.maximum(np.sum(steps**2, axis=1), np.finfo(float).tiny)
    off = points[:, np.newaxis] - (starts if len(starts) else line)
    if len(starts):
        part = np.clip(np.sum(off * steps, axis=2) / lengths, 0.0, 1.0)
        off = off - part[..., np.newaxis] * steps
    return np.asarray(np.sqrt(np.sum(off**2, axis=2)).min(axis=1))
