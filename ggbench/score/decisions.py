"""Advice as sentences and tables: estimators, accuracy, gradiometer, tracks, error sources."""

from __future__ import annotations

import math

import pandas as pd

from ..errors import brief
from ..figures.numbers import counted
from ..judging.field_scale import on_the_prior
from ..judging.verdicts import FEWEST_RUNS
from ..report import columns
from ..report.answers import failed_in_all, left_the_map
from . import advice as advices
from .advice import Advice

ESTIMATOR_HEAD = ("estimator", "RMS m", "× oracle", "success", "", "usual ms/run")
LIMIT_HEAD = ("error source", "bound m", "change")
TRACK_HEAD = ("heading °", "east km", "north km", "bound m")
LIMITS = "Error sources that limit the accuracy: bound if one source is halved"
HALVED = "Errors of each source are halved in truth and model; the map error is removed."
_SMALL = 0.005
"""Relative gain of the bound below which a cause does not limit the accuracy."""
_EFFICIENT = 1.1
"""Ratio to the oracle above which an EKF is not called efficient."""
_SHOWN = 10


def estimator_rows(advice: Advice) -> list[tuple[str, ...]]:
    """Return a table row of texts for each estimator that was run."""
    usual = advices.usual_seconds()
    return [
        (
            row["estimator"],
            columns.cell("rms_m", row["rms_m"]),
            columns.cell("efficiency", row["efficiency"]),
            columns.cell("success", row["success"]),
            columns.SYMBOLS.get(row["consistency"], ""),
            f"{1e3 * usual[row['estimator']]:.3g}" if row["estimator"] in usual else "",
        )
        for row in advices.table(advice).to_dict("records")
    ]


def verdicts(advice: Advice) -> list[str]:
    """Return the conclusions from the runs, each as a sentence.

    The sentences recommend estimators for use in flight and after landing. They list estimators
    that failed in all runs or left the map. One sentence compares the width of the prior with the
    correlation length of the field, if this length is defined.
    """
    rows = advices.table(advice)
    errors = dict(zip(rows["estimator"], rows["rms_m"], strict=True))
    sentences = []
    flown = int(rows["runs"].max())
    few = f": {counted(flown, 'run')} are fewer than {FEWEST_RUNS}" if flown < FEWEST_RUNS else ""
    label, surely = advices.recommended(advice)
    if label in errors:
        verdict = "use" if surely else f"no estimator is recommended{few}; the least bad is"
        sentences.append(f"In flight: {verdict} {label}, RMS error {_metres(errors[label])}.")
    smoother = advices.after_landing(advice)
    if smoother in errors:
        sentences.append(f"After landing: {smoother}, RMS error {_metres(errors[smoother])}.")
    runs = advice.results.runs()
    for lost in failed_in_all(runs, {advice.case.name: advice.case.title}):
        sentences.append(f"{lost['label']} failed in all runs: {lost['reason']}.")
    outside = left_the_map(runs)
    if outside:
        sentences.append(
            f"Estimates of {', '.join(outside)} left the map; the field is extrapolated from the "
            "border. Widen the map, or add a sensor that bounds the error, such as a barometer."
        )
    row = advice.results.cases().iloc[0]
    if math.isfinite(row["width"]):
        prior = on_the_prior(row["position_m"], row["correlation_m"])
        sentences.append(f"{prior[0].upper()}{prior[1:]}.{_of_the_ekf(rows)}")
    return sentences


def _of_the_ekf(rows: pd.DataFrame) -> str:
    """Return a sentence on the EKF if it is not efficient in these runs, or ""."""
    ratios = rows.loc[rows["estimator"] == "ekf", "efficiency"]
    if ratios.empty or not ratios.iloc[0] > _EFFICIENT:
        return ""
    return (
        f" In these runs the EKF's error is {columns.efficiency(ratios.iloc[0])} times the "
        "oracle's. Its efficiency does not depend on the width of the prior alone."
    )


def limit_rows(advice: Advice) -> list[tuple[str, ...]]:
    """Return a table row of texts for each error source, the largest effect first."""
    return [
        (
            limit.cause,
            columns.metres(limit.bound_m),
            f"−{100.0 * limit.gain:.0f} %" if limit.gain > _SMALL else "none",
        )
        for limit in advice.limits
    ]


def instrument(advice: Advice, target_m: float) -> tuple[list[str], bool]:
    """Return sentences on the required gradiometer noise, and whether the target is reachable.

    The target is ``target_m``, the required RMS position error [m]. It is reachable if a
    noise level of the gradiometer exists at which the bound is at most ``target_m``. In a case
    without a gradiometer noise that can be varied, the bound with the present sensors decides.
    """
    sentences = []
    if advice.bound_m <= target_m:
        sentences.append(f"The bound allows {target_m:g} m with the sensors as they are.")
    if not advice.unit:
        sentences.append("The case has no gradiometer whose noise could be changed.")
        return sentences, advice.bound_m <= target_m
    if math.isnan(advice.noise):
        sentences.append(
            f"No gradiometer reaches {target_m:g} m here: change the track, map or INS."
        )
        return sentences, False
    sentences.append(
        f"An RMS error of {target_m:g} m requires a gradiometer noise of at most "
        f"{columns.metres(advice.noise)} {advice.unit} in truth and model, at the measurement rate "
        "of the case."
    )
    return sentences, True


def track_rows(tracks: pd.DataFrame) -> list[tuple[str, ...]]:
    """Return a table row of texts for each of the best tracks.

    Parameters
    ----------
    tracks : tracks with bounds, from :func:`ggbench.judging.planned.around`.
    """
    return [
        (f"{row.heading_deg:.0f}", f"{row.east_km:g}", f"{row.north_km:g}", f"{row.bound_m:.3g}")
        for row in _able(tracks).head(_SHOWN).itertuples()
    ]


def track_sentences(tracks: pd.DataFrame, target_m: float | None) -> list[str]:
    """Return sentences on the bounds of the tracks, and on tracks that cannot be flown.

    Parameters
    ----------
    tracks : tracks with bounds, from :func:`ggbench.judging.planned.around`.
    target_m : required RMS position error [m], or None.
    """
    able, sentences = _able(tracks), []
    if len(able):
        sentences.append(f"The worst track has a bound of {able['bound_m'].iloc[-1]:.3g} m.")
        present = able[able["present"]]
        if len(present):
            rank, bound = int(present.index[0]) + 1, present["bound_m"].iloc[0]
            sentences.append(f"The track of the case has a bound of {bound:.3g} m and rank {rank}.")
    unable = tracks[tracks["reason"] != ""]
    if len(unable):
        sentences.append(
            f"{counted(len(unable), 'track')} cannot be flown; reason of the first: "
            f"{brief(unable['reason'].iloc[0])}"
        )
    if target_m is not None:
        count = int((able["bound_m"] <= target_m).sum())
        allowed = f"{counted(count, 'track')} of {len(tracks)} {'has' if count == 1 else 'have'}"
        sentences.append(f"{allowed} a bound of at most {target_m:g} m.")
    return sentences


def _able(tracks: pd.DataFrame) -> pd.DataFrame:
    """Return the tracks that can be flown."""
    return tracks[tracks["reason"] == ""]


def _metres(error: float) -> str:
    return f"{columns.metres(error)} m"
