"""GNSS outages in a recorded drive, and the drift of its INS during the outages."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

import ggbench as gg
from ggbench.recorded.flight import RecordedFlight, read_flight

DRIVE = Path(__file__).parents[2] / "scenarios" / "data" / "comma2k19"
"""Folder of the recorded drive."""
FILTER, SMOOTHER = "ekf", "factor-graph[mode=batch]"
ESTIMATORS = (FILTER, "ukf", "multiple-model", SMOOTHER)
LENGTHS_S = (5.0, 10.0, 20.0, 30.0)
FIRST_S, STEP_S = 15.0, 1.0
"""Start of the first outage, and interval between the starts [s]."""
_RECORD, _AIDING = "gnss.csv", "aiding.csv"


def fly(
    lengths: Sequence[float] = LENGTHS_S,
    estimators: Sequence[str] = ESTIMATORS,
    step_s: float = STEP_S,
) -> pd.DataFrame:
    """Return one row for each outage and estimator.

    Parameters
    ----------
    lengths : outage lengths [s].
    estimators : labels of the estimators.
    step_s : interval between the starts of outages of one length [s].

    Returns
    -------
    Columns ``estimator``, ``length_s``, ``start_s``, ``drift_m`` and ``sigma_m``; the last two are
    the results of :func:`drift`.
    """
    whole = read_flight(DRIVE / "flight.toml")
    last = whole.problem.times[-1]
    rows = []
    for length in lengths:
        for start in np.arange(FIRST_S, last - length, step_s):
            flight = with_outage(whole.start, start, length)
            for label in estimators:
                rows.append((label, length, start, *drift(flight, label, start)))
    return pd.DataFrame(rows, columns=["estimator", "length_s", "start_s", "drift_m", "sigma_m"])


def with_outage(clock_s: float, start_s: float, length_s: float) -> RecordedFlight:
    """Return the drive without GNSS velocities during an outage.

    Parameters
    ----------
    clock_s : time of the first inertial sample on the clock of the record [s].
    start_s : start of the outage, counted from the first inertial sample [s].
    length_s : length of the outage [s].
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(DRIVE, folder, dirs_exist_ok=True)
        record = pd.read_csv(folder / _RECORD, comment="#")
        since = record["time_s"] - clock_s
        record[(since <= start_s) | (since > start_s + length_s)].to_csv(
            folder / _AIDING, index=False
        )
        # The reference remains the complete record.
        file = folder / "flight.toml"
        text = file.read_text(encoding="utf-8")
        file.write_text(text.replace(f'[gnss]\nfile = "{_RECORD}"', f'[gnss]\nfile = "{_AIDING}"'))
        return read_flight(file)


def drift(flight: RecordedFlight, label: str, start_s: float) -> tuple[float, float]:
    """Return the change of the horizontal error during an outage, and its standard deviation [m].

    The change is from the last velocity before the outage to the first velocity after the outage.
    The error at the start is a constant of the drive. Its variance is therefore subtracted from the
    variance at the end. The standard deviation of a smoother is NaN, because its errors are
    correlated in time.
    """
    assert flight.reference is not None
    estimate = gg.estimate(flight.problem, label)
    before = int(np.searchsorted(flight.problem.times, start_s, side="right")) - 1
    errors = (estimate.mean - flight.reference.error_state)[:, :2]
    assert estimate.cov is not None
    variance = np.trace(estimate.cov[:, :2, :2], axis1=1, axis2=2)
    sigma = np.sqrt(variance[before + 1] - variance[before])
    causal = estimate.causality == "filter"
    return float(np.linalg.norm(errors[before + 1] - errors[before])), sigma if causal else np.nan
