"""Cramér–Rao bound at every epoch of a planned flight."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from ..errors import GGBenchError
from ..simulation.error_free_flight import Flight, prepare
from ..simulation.flight_bounds import flight_bound
from ..simulation.true_motion import trajectory_of
from ..spec import draws
from ..spec.case import CaseSpec
from .bounds import squared_bounds
from .run_errors import window_mask

if TYPE_CHECKING:
    import pandas as pd

_PRESENT = (0.0, 0.0, 0.0)
AXES = ("east", "north", "up")


def planned(flight: Flight) -> pd.DataFrame:
    """Return a table of the Cramér–Rao bound along a track, with a row for each epoch.

    The table has these columns:

    - ``time_s``;
    - the true ``latitude_deg``, ``longitude_deg`` and ``height_m``;
    - bounds on the standard deviations of a filter's position errors: ``east_m``, ``north_m``,
      ``up_m`` and ``position_m`` (3-D);
    - bounds on the standard deviations of a filter's velocity errors: ``east_mps``, ``north_mps``,
      ``up_mps`` and ``velocity_mps`` (3-D);
    - the 3-D bounds for a smoother: ``position_smoothed_m`` and ``velocity_smoothed_mps``.

    :func:`ggbench.simulation.flight_bounds.bounds` lists the errors that the bound omits.
    """
    import pandas as pd  # not at the top: it loads slowly

    at = flight.motion_at_epochs.positions
    bound = flight_bound(flight)
    filtering, smoothing = (
        np.diagonal(cov[:, :6, :6], axis1=1, axis2=2) for cov in (bound.filtering, bound.smoothing)
    )
    columns = {
        "time_s": flight.times,
        "latitude_deg": np.degrees(at[:, 0]),
        "longitude_deg": np.degrees(at[:, 1]),
        "height_m": at[:, 2],
    }
    for unit, name, part in (("m", "position", slice(3)), ("mps", "velocity", slice(3, 6))):
        for axis, variance in zip(AXES, filtering[:, part].T, strict=True):
            columns[f"{axis}_{unit}"] = np.sqrt(variance)
        columns[f"{name}_{unit}"] = np.sqrt(filtering[:, part].sum(axis=1))
        columns[f"{name}_smoothed_{unit}"] = np.sqrt(smoothing[:, part].sum(axis=1))
    return pd.DataFrame(columns)


def bound_of(case: CaseSpec, smoothed: bool = False) -> float:
    """Return the Cramér–Rao bound of the RMS position error in the settled window [m].

    Parameters
    ----------
    case : the case; if each run draws its flight, the flight of run 0 is used.
    smoothed : whether to return the bound of a smoother instead of a filter.
    """
    flight = prepare(case.of_run(0))
    bound = flight_bound(flight)
    squares, _ = squared_bounds(bound.smoothing if smoothed else bound.filtering)
    return math.sqrt(float(squares[window_mask(flight.times, case.windows, "settled")].mean()))


def around(case: CaseSpec, headings: int, starts: int, step_km: float) -> pd.DataFrame:
    """Return the table of :func:`tracks` for evenly spaced headings and a square grid of starts.

    Parameters
    ----------
    case : case with the original flight, whose start is the centre of the grid.
    headings : number of headings.
    starts : number of starts along each side of the square.
    step_km : distance between neighbouring starts [km].
    """
    offsets = [step_km * (k - 0.5 * (starts - 1)) for k in range(starts)]
    places = [(east, north) for north in offsets for east in offsets]
    return tracks(case, places, [360.0 * k / headings for k in range(headings)])


def tracks(
    case: CaseSpec, places_km: Iterable[tuple[float, float]], turns_deg: Iterable[float]
) -> pd.DataFrame:
    """Return a table of the bounds of a flight with other starts and headings.

    Parameters
    ----------
    case : case whose flight consists of segments or follows a track from a file.
    places_km : displacements of the start to the east and north [km].
    turns_deg : clockwise rotations about each start [deg].

    Returns
    -------
    A table with the columns ``east_km``, ``north_km``, ``heading_deg`` at the start, ``bound_m``
    (:func:`bound_of`), ``present`` and ``reason``. The smallest bound comes first. ``present`` is
    true for the original flight, which always has a row. Tracks that cannot be flown come last,
    with the ``reason``.

    Raises
    ------
    GGBenchError
        If the flight follows survey lines, or its track cannot be used.
    """
    import pandas as pd

    if case.trajectory.lines:
        raise GGBenchError(
            "the flight follows recorded survey lines and cannot be displaced or rotated: choose a "
            "case with segments or a track"
        )
    turns = list(turns_deg)
    moves = [(east, north, turn) for east, north in places_km for turn in turns]
    if _PRESENT not in moves:
        moves.append(_PRESENT)
    first = _first_heading(case)
    rows = []
    for east, north, turn in moves:
        flown = draws.moved(case.trajectory, east, north, turn)
        bound, reason = math.nan, ""
        try:
            bound = bound_of(case.model_copy(update={"trajectory": flown}))
        except GGBenchError as error:
            reason = str(error)
        present = (east, north, turn) == _PRESENT
        rows.append((east, north, (first + turn) % 360.0, bound, present, reason))
    columns = ["east_km", "north_km", "heading_deg", "bound_m", "present", "reason"]
    table = pd.DataFrame(rows, columns=columns)
    return table.sort_values("bound_m", kind="stable", ignore_index=True)


def _first_heading(case: CaseSpec) -> float:
    """Return the heading at the start of a flight [deg]."""
    if case.trajectory.file is None:
        return math.degrees(case.trajectory.start().heading)
    attitude = trajectory_of(case.trajectory, case.imu.period_s).attitudes[0]
    return math.degrees(math.atan2(attitude[0, 1], attitude[1, 1]))
