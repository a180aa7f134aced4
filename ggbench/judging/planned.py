"""What a planned flight can reach, before it is flown: its bound at every epoch of its track."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..simulation.error_free_flight import Flight

if TYPE_CHECKING:
    import pandas as pd

AXES = ("east", "north", "up")


def planned(flight: Flight) -> pd.DataFrame:
    """Return the Cramér–Rao bound along the track of a flight, a row for each epoch.

    Columns: ``time_s``; ``latitude_deg``, ``longitude_deg``, ``height_m`` of the truth; bounds on
    the standard deviation of the errors, given the readings up to the epoch, ``east_m``,
    ``north_m``, ``up_m``, ``position_m`` (spherical), ``east_mps``, ``north_mps``, ``up_mps``,
    ``velocity_mps`` (spherical); and the spherical ones given the readings of the whole flight,
    ``position_smoothed_m``, ``velocity_smoothed_mps``. What the bound leaves out is said at
    :attr:`~ggbench.simulation.error_free_flight.Flight.bound`.
    """
    import pandas as pd  # not at the top: it loads slowly

    at = flight.motion_at_epochs.positions
    filtering, smoothing = (
        np.diagonal(cov[:, :6, :6], axis1=1, axis2=2)
        for cov in (flight.bound.filtering, flight.bound.smoothing)
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
