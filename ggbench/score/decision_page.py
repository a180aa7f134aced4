"""HTML page with the advice on a case and a figure of map and track."""

from __future__ import annotations

import base64
import tempfile
import time
from pathlib import Path

import pandas as pd

from ..figures.planned import planned_tracks
from ..figures.style import Drawing, save
from ..files.writing import written_whole
from ..report.page_templates import html
from ..simulation.field_source import beside, make_field
from ..simulation.true_motion import trajectory_of
from ..spec.case import CaseSpec
from ..spec.scenario import Scenario
from . import decisions
from .advice import Advice
from .stored_runs import ScoreError


def over_map(tracks: pd.DataFrame, case: CaseSpec) -> Drawing:
    """Return a figure of tracks over the map.

    Longitudes are shifted to the flight's side of the date line.

    Parameters
    ----------
    tracks : tracks with bounds, from :func:`ggbench.judging.planned.around`.
    case : case with the original flight.
    """
    present = trajectory_of(case.trajectory, case.imu.period_s).positions
    field = beside(make_field(case.side("truth").field), float(present[0, 1]))
    return planned_tracks(tracks, field, present, case.title)


def write(
    scenario: Scenario, advice: Advice, tracks: pd.DataFrame, target_m: float | None, path: Path
) -> None:
    """Write the HTML page.

    Parameters
    ----------
    scenario : scenario of the case.
    advice : advice on the case.
    tracks : tracks with bounds, from :func:`ggbench.judging.planned.around`.
    target_m : required RMS position error [m], or None.
    path : path of the page.

    Raises
    ------
    ScoreError
        If the page cannot be written.
    """
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "tracks.png"
        save(over_map(tracks, advice.case), picture)
        image = base64.b64encode(picture.read_bytes()).decode()
    text = html(
        "decision.html.j2",
        scenario=scenario,
        advice=advice,
        runs=advice.results.run_count,
        date=time.strftime("%Y-%m-%d"),
        answers=decisions.verdicts(advice),
        instrument=[] if target_m is None else decisions.instrument(advice, target_m)[0],
        estimators=(decisions.ESTIMATOR_HEAD, decisions.estimator_rows(advice)),
        limits=(decisions.LIMIT_HEAD, decisions.limit_rows(advice)),
        limits_title=decisions.LIMITS,
        halved=decisions.HALVED,
        tracks=(decisions.TRACK_HEAD, decisions.track_rows(tracks)),
        where=decisions.track_sentences(tracks, target_m),
        image=image,
    )
    with written_whole(path, ScoreError) as temporary:
        temporary.write_text(text, encoding="utf-8")
