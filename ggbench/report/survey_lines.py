"""Table of errors by survey line, with the distance of the nearest line in the map."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from ..maps.surveyed import lines_behind, next_line
from ..results.folder import Results
from ..spec.case import CaseSpec
from ..spec.draws import drawn_track

_PLACES = 31
"""Places along a flown line from which distances are measured."""


def by_line(results: Results, runs: pd.DataFrame) -> pd.DataFrame:
    """Return a table with a row for each case, flown survey line and estimator.

    ``rms_m`` and ``nees`` are the RMS error [m] and the mean NEES in the settled window over the
    finished runs on the line. ``next_line`` and ``next_line_m`` are the nearest line in the map and
    the distance to it [m]. They have values only for a shipped map that was made from survey lines.
    The table is empty if no survey lines are flown.

    Parameters
    ----------
    runs : table of runs (:meth:`.Results.runs`).

    Raises
    ------
    MapError, TrajectoryError
        If a file of survey lines cannot be read.
    """
    flown = {case.name: case for case in results.scenario.cases if case.trajectory.drawn_lines}
    own = runs[(runs["assumption"] == "") & (runs["status"] == "ok") & runs["case"].isin(flown)]
    if own.empty:
        return pd.DataFrame()
    lines = [
        flown[case].trajectory.drawn_lines[run % len(flown[case].trajectory.drawn_lines)]
        for case, run in zip(own["case"], own["run"].tolist(), strict=True)
    ]
    table = (
        own.assign(line=lines)
        .groupby(["case", "line", "estimator"], sort=False)
        .agg(
            runs=("run", "count"),
            rms_m=("settled_position_ms", lambda squares: float(np.sqrt(squares.mean()))),
            nees=("settled_nees", "mean"),
        )
        .reset_index()
    )
    nearest = _nearest({name: flown[name] for name in table["case"].unique()})
    places = [nearest[key] for key in zip(table["case"], table["line"], strict=True)]
    table["next_line"] = [name for name, _ in places]
    table["next_line_m"] = [distance for _, distance in places]
    order = {key: place for place, key in enumerate(nearest)}
    rank = [order[key] for key in zip(table["case"], table["line"], strict=True)]
    ranked = table.iloc[np.argsort(rank, kind="stable")]
    return ranked.reset_index(drop=True)


def _nearest(cases: Mapping[str, CaseSpec]) -> dict[tuple[str, str], tuple[str, float]]:
    """Return the nearest survey line in the map and its distance [m], by case and flown line."""
    nearest: dict[tuple[str, str], tuple[str, float]] = {}
    known: dict[object, tuple[str, float]] = {}
    for name, case in cases.items():
        source = case.side("model").field.source
        behind = lines_behind(source)
        for run, line in enumerate(case.trajectory.drawn_lines):
            key = source, case.trajectory.file, line, case.trajectory.middle_s
            if key not in known:
                known[key] = "", float("nan")
                if behind is not None:
                    track = drawn_track(case.trajectory, case.draw, run).track()
                    times = np.linspace(track.times[0], track.times[-1], _PLACES)
                    known[key] = next_line(
                        np.column_stack([part(times) for part in track.position]), behind
                    )
            nearest[name, line] = known[key]
    return nearest
