"""Registry of all columns: heading, unit, format and definition of every number that is shown.

Markdown tables, HTML pages, ``columns.csv`` and the page of definitions read this registry alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

Form = Literal["text", "count", "metres", "ratio", "share", "time", "p"]


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    heading : str
        Heading, without the unit.
    unit : str
        Unit of the values; may be empty.
    form : str
        How a value is written: digits and sign.
    definition : str
        Definition in one sentence; empty for the ends of an interval.
    """

    heading: str
    unit: str = ""
    form: Form = "text"
    definition: str = ""

    @property
    def head(self) -> str:
        """Heading and unit."""
        return f"{self.heading} [{self.unit}]" if self.unit else self.heading


def _with_interval(key: str, stem: str, column: Column) -> dict[str, Column]:
    """Return a column and the two ends of its 95% interval, ``<stem>_lo`` and ``<stem>_hi``."""
    ends = {
        f"{stem}_{end}": Column(f"{column.heading}, {name} end", column.unit, column.form)
        for end, name in (("lo", "lower"), ("hi", "upper"))
    }
    return {key: column} | ends


COLUMNS: dict[str, Column] = {
    "case": Column("case", definition="Name of the case in the scenario file."),
    "title": Column("case", definition="Title of the case."),
    "estimator": Column("estimator", definition="Estimator with its parameters."),
    "name": Column("name", definition="Registered name of the estimator."),
    "parameters": Column("parameters", definition="Parameters that differ from the defaults."),
    "causality": Column(
        "causality",
        definition="A filter uses past measurements, a fixed-lag smoother a few later ones, a "
        "batch smoother all.",
    ),
    "window": Column(
        "window",
        definition="Part of the flight: the whole flight, the settled part, or its last seconds.",
    ),
    "runs": Column("runs", form="count", definition="Number of runs."),
    "failed": Column(
        "failed", form="count", definition="Runs that ended with an error or without an estimate."
    ),
    "diverged": Column(
        "diverged",
        form="count",
        definition="Runs whose final position error exceeds ten bounds and the INS's error.",
    ),
    "draws": Column("draws", form="count", definition="Independent tracks or maps of the runs."),
    **_with_interval(
        "rms_m", "rms",
        Column("RMS error", "m", "metres",
               "Root mean square of the three-dimensional position error over the window and all "
               "finished runs."),
    ),
    **_with_interval(
        "velocity_rms_mps", "velocity_rms",
        Column("RMS velocity error", "m/s", "metres", "The same of the velocity."),
    ),
    "bound_m": Column(
        "bound", "m", "metres",
        "Cramér–Rao bound of the RMS error for the measurements that the estimator may use.",
    ),
    "velocity_bound_mps": Column("velocity bound", "m/s", "metres", "The same of the velocity."),
    **_with_interval(
        "efficiency", "efficiency",
        Column("× bound", "", "ratio",
               "RMS error over the bound; only where the assumed model is the true one."),
    ),
    "times_ins": Column(
        "× INS", "", "ratio", "RMS error over that of the unaided INS, on the same runs."
    ),
    **_with_interval(
        "oracle_ratio", "oracle",
        Column("× oracle", "", "ratio",
               "RMS error over that of a filter linearised at the truth, on the same runs."),
    ),
    **_with_interval(
        "success", "success",
        Column("success", "", "share",
               "Share of all runs that end within the required error of the case."),
    ),
    **_with_interval(
        "nees", "nees",
        Column("NEES", "", "ratio",
               "Mean normalised squared error of position and velocity: 6 if consistent; with "
               "its 95% band."),
    ),
    **_with_interval(
        "coverage", "coverage",
        Column("coverage", "", "share",
               "Share of epochs with the truth inside the reported 95% region."),
    ),
    **_with_interval(
        "nis", "nis",
        Column("NIS", "", "ratio", "Mean normalised squared innovation, with its 95% band."),
    ),
    "false_fixes": Column(
        "false fixes", "", "share",
        "Share of runs that end outside the required error and report to be inside with 95%.",
    ),
    **_with_interval(
        "converged_s", "converged",
        Column("converged after", "s", "metres",
               "Median time from which the error stays within the required one, over successes."),
    ),
    "consistency": Column(
        "consistency",
        definition="Consistent; overconfident (†): the covariance is too small; unsafe (‡): false "
        "fixes as well; conservative: the covariance is too large.",
    ),
    "recommended": Column(
        "recommended",
        definition="Consistent or conservative, surely better than the INS if that flew, succeeds "
        "as often as any other, and surely within 10% of the least RMS error, in ten runs or more: "
        "even ones choose the best, odd ones compare. Of these the cheapest is named; times within "
        "a factor of 2 are alike.",
    ),
    "seconds_per_run": Column("time a run", "s", "time", "Median time of a run, in one process."),
    "map_evaluations": Column(
        "map evaluations", "", "metres", "Positions per run at which the map is evaluated."
    ),
    "published_m": Column("published", "m", "metres", "RMS position error that a paper states."),
    "published_mps": Column("published", "m/s", "metres", "RMS velocity error of the paper."),
    "first": Column("first", definition="First estimator of a pair."),
    "second": Column("second", definition="Second estimator of a pair."),
    "error_ratio": Column(
        "error ratio", "", "ratio",
        "Geometric mean of the first's error over the second's, run by run; runs that both "
        "finished.",
    ),
    "lo": Column("ratio, lower end", "", "ratio"),
    "hi": Column("ratio, upper end", "", "ratio"),
    "p": Column("p", "", "p", "Two-sided p-value of equal errors, by Holm over the case."),
    "first_only": Column(
        "first alone", form="count", definition="Runs in which the first alone succeeds."
    ),
    "second_only": Column(
        "second alone", form="count", definition="Runs in which the second alone succeeds."
    ),
    "success_p": Column("p of success", "", "p", "P-value of equal success rates, by Holm."),
    "verdict": Column(
        "verdict",
        definition="The first is better or worse (5%), equivalent (within 5%), or undecided.",
    ),
    "right_model": Column(
        "right model", definition="Whether the estimators assume the true models."
    ),
    "situation": Column("situation", definition="Kind of difficulty that the case stands for."),
    "correlation_m": Column(
        "correlation length ℓ", "m", "metres",
        "Distance along the track over which the vertical gradient's autocorrelation falls to 1/e.",
    ),
    "width": Column(
        "σ/ℓ", "", "ratio", "Initial position uncertainty per axis over the correlation length."
    ),
    "position_m": Column(
        "initial uncertainty", "m", "metres", "Initial position uncertainty σ per axis."
    ),
    "required_m": Column(
        "required error", "m", "metres", "Position error within which a run succeeds."
    ),
    "smoothing_bound_m": Column("smoothing bound", "m", "metres", "Bound of a batch smoother."),
    "unfiltered_bound_m": Column(
        "unfiltered bound", "m", "metres", "Bound without the instrument's low-pass filter."
    ),
    "ins_m": Column("INS", "m", "metres", "RMS error of the unaided INS."),
    "epochs": Column("epochs", form="count", definition="Measurement times of the flight."),
    "duration_s": Column("duration", "s", "metres", "Duration of the flight."),
    "speed_mps": Column("speed", "m/s", "metres", "Mean speed."),
    "height_m": Column("height", "m", "metres", "Mean height above the ellipsoid."),
    "best": Column(
        "best causal", definition="Causal estimator of the least RMS error, consistent if any is."
    ),
    "best_smoother": Column("best smoother", definition="Smoother of the least RMS error."),
    "gain": Column(
        "gain",
        definition="Verdict of the best causal estimator against the INS, on runs of odd number.",
    ),
    "consistent": Column(
        "consistent", form="count", definition="Number of consistent causal estimators."
    ),
    "run": Column("run", form="count", definition="Number of the run."),
    "reason": Column("reason", definition="Reason of a failure."),
    "command": Column("command", definition="Command that repeats the run."),
    "assumption": Column("changed assumption", definition="Assumption that a study changes."),
    "remark": Column("remark", definition="Remark on a run, such as an estimate off the map."),
    "fixes": Column("fixes", form="metres", definition="Position fixes that a matcher tried."),
    "accepted": Column("accepted", form="metres", definition="Fixes that it accepted."),
    "false": Column("false", form="metres", definition="Accepted fixes beyond the required error."),
    **_with_interval(
        "right_share", "right",
        Column("right", "", "share", "Share of runs whose first accepted fix is right."),
    ),
    **_with_interval(
        "false_share", "false", Column("false first", "", "share", "Share with a false one.")
    ),
    **_with_interval(
        "none_share", "none", Column("without fix", "", "share", "Share without an accepted fix.")
    ),
    **_with_interval(
        "right_time_median_s", "right_time",
        Column("right after", "s", "metres", "Median time of the first right fix."),
    ),
    "cep50_m": Column("CEP 50", "m", "metres", "Horizontal error of half of the accepted fixes."),
    "cep95_m": Column("CEP 95", "m", "metres", "Horizontal error of 95% of the accepted fixes."),
}  # fmt: skip
"""All columns of the tables, by their keys."""
DEFINED = (
    "rms_m", "bound_m", "efficiency", "oracle_ratio", "times_ins", "success", "required_m",
    "diverged", "false_fixes", "nees", "coverage", "consistency",
    "recommended", "error_ratio", "verdict", "correlation_m", "width", "seconds_per_run",
)  # fmt: skip
"""Columns on the page of definitions."""

SYMBOLS = {"overconfident": "†", "unsafe": "‡"}
"""Symbols of estimators that are not consistent."""
NONE = "–"
"""A cell without a value."""


def column(key: str) -> Column:
    """Return the column of a key; a counter of an estimator is a number named by its key."""
    return COLUMNS.get(key) or Column(key.replace("_", " "), form="metres")


def significant(value: float, digits: int) -> str:
    """Return a number with that many significant digits, without an exponent where it is short."""
    if value == 0.0:
        return "0"
    rounded = float(f"{value:.{digits - 1}e}")
    exponent = math.floor(math.log10(abs(rounded)))
    if not -4 <= exponent < 6:
        return f"{value:.{digits - 1}e}"
    return f"{rounded:.{max(0, digits - 1 - exponent)}f}"


def metres(value: float) -> str:
    """Return an error with three significant digits."""
    return significant(value, 3)


def ratio(value: float) -> str:
    """Return a ratio with two significant digits."""
    return significant(value, 2)


def share(value: float) -> str:
    """Return a share in per cent with two significant digits; 100% is every run."""
    text = significant(100.0 * value, 2)
    return ">99%" if text == "100" and value < 1.0 else f"{text}%"


def duration(value: float) -> str:
    """Return a time of a run with one significant digit."""
    if value >= 1.0:
        return f"{significant(value, 1)} s"
    return f"{significant(1e3 * value, 1)} ms"


_FORMS = {
    "count": lambda value: f"{value:.0f}",
    "metres": metres,
    "ratio": ratio,
    "share": share,
    "time": duration,
    "p": lambda value: "< 0.001" if value < 1e-3 else significant(value, 2),
}


def cell(key: str, value: Any) -> str:
    """Return a value as a table shows it.

    Parameters
    ----------
    key : str
        Key of the column.
    value : object
        A number, a text or a truth value; NaN and None are shown as a dash.
    """
    if isinstance(value, str):
        return value
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return NONE
    if isinstance(value, bool) or type(value).__name__ == "bool":
        return "yes" if value else "no"
    form = column(key).form
    if math.isinf(value):
        return "∞"
    return str(value) if form == "text" else _FORMS[form](float(value))
