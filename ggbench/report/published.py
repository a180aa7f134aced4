"""Comparison with published numbers: errors, bounds, windows and claims."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from ..estimator_spec import EstimatorSpec
from ..judging.statistics import BETTER, EQUIVALENCE_RATIO, EQUIVALENT, UNDECIDED, WORSE
from ..results.folder import Results
from . import columns
from .tables import FAILED, MOST_ROWS, code
from .views import comparable, together

MOST_REFERENCES = 3
"""Largest number of cases with published errors in a table of a page."""
MOST_GROUPS = 6
"""Largest number of rows of estimators in this table."""
STARTS_S = (0.0, 50.0, 75.0, 100.0, 150.0)
"""Starts of windows for the table of window starts [s]."""
WINDOWS = ("whole", "settled")
MOST_RUNS = 400
"""Largest number of runs for the test of a claim."""
_QUANTITIES = {
    "east position": 0,
    "north position": 1,
    "up position": 2,
    "east velocity": 3,
    "north velocity": 4,
    "up velocity": 5,
    "pitch": 6,
    "roll": 7,
    "heading": 8,
}
"""Columns of an INS's response to the gravity disturbance."""
_OPEN, _REFUTED = "open", "does not hold"
"""Verdicts on a claim, other than "holds"."""
_ARCMINUTES = math.degrees(1.0) * 60.0
_NEAR = 1.25
"""Largest ratio of a possible published improvement to the computed response."""


def referenced(metrics: pd.DataFrame) -> list[str]:
    """Return the cases with published errors, at most :data:`MOST_REFERENCES`."""
    return metrics.loc[metrics["published_m"].notna(), "case"].unique().tolist()[:MOST_REFERENCES]


def published_table(
    metrics: pd.DataFrame, titles: Mapping[str, str], own: Sequence[str] = ()
) -> pd.DataFrame:
    """Return a table with the published errors, the bounds, and the errors of the estimators.

    There is a column for each case and window. Estimators that agree within 1% in all columns share
    a row. Users' own estimators come first, even if they failed; all others are sorted by error.
    """
    cases = referenced(metrics)
    chosen = metrics[metrics["case"].isin(cases) & metrics["window"].isin(WINDOWS)]
    rows = pd.concat([comparable(chosen, window) for window in WINDOWS])
    wide = rows.pivot(index="estimator", columns=["case", "window"], values="rms_m")
    places = [(case, window) for case in cases for window in WINDOWS if (case, window) in wide]
    wide = wide[places]
    failing = [[label] for label in own if label in wide.index and wide.loc[label].isna().any()]
    wide = wide.dropna(how="all")
    order = wide.dropna()[places[-1]].sort_values().index
    groups = together([label for label in order if label != "ins"], wide)
    groups.sort(key=lambda group: not set(group) & set(own))  # stable
    groups = [*failing, *groups][:MOST_GROUPS]

    def at(key: str, causality: str) -> list[str]:
        own = rows[rows["causality"] == causality]
        first = own.groupby(["case", "window"])[key].first()
        return [columns.cell("rms_m", first.get(place, math.nan)) for place in places]

    limits = allowed(chosen).set_index(["case", "window"])
    stated = rows.groupby(["case", "window"])["published_m"].first()
    published = [_published(stated[place], limits["allowed"].get(place)) for place in places]
    lines = [["*published*", *published], ["*bound, filter*", *at("bound_m", "filter")]]
    if (rows["causality"] == "batch").any():
        lines.append(["*bound, smoother*", *at("bound_m", "batch")])
    estimator_groups = [["ins"], *groups] if "ins" in wide.index else groups
    for group in estimator_groups:
        errors = wide.reindex([group[0]])
        cells = [columns.cell("rms_m", errors.at[group[0], place]) for place in places]
        cells = [FAILED if cell == columns.NONE else cell for cell in cells]
        lines.append([", ".join(map(code, group)), *cells])
    heads = [f"{titles[case]}: {window}" for case, window in places]
    return pd.DataFrame(lines, columns=["RMS error [m]", *heads])


def _published(error: float, is_allowed: bool | None) -> str:
    """Return a published error as text; with a bound, state whether the bound allows it."""
    text = columns.metres(error)
    if is_allowed is None:
        return text
    return f"{text} ({'above' if is_allowed else 'below'} filter bound)"


def allowed(metrics: pd.DataFrame) -> pd.DataFrame:
    """Return a table that states whether each published error is at least the bound of a filter.

    The columns are case, window, published_m, bound_m and allowed. ``allowed`` is true if the
    published error is not below the bound. If all filters failed in a case, there is no bound, and
    the case is omitted.
    """
    rows = metrics[metrics["published_m"].notna() & (metrics["causality"] == "filter")]
    rows = rows[rows["bound_m"].notna()]
    rows = rows[rows["window"].isin(WINDOWS)].groupby(["case", "window"], sort=False).first()
    table = rows[["published_m", "bound_m"]].reset_index()
    return table.assign(allowed=table["bound_m"] <= table["published_m"])


def from_starts(results: Results, metrics: pd.DataFrame, labels: Sequence[str]) -> pd.DataFrame:
    """Return a table of errors in windows from several start times to the end of the flight.

    Each case with published errors has a row for the bound, and a row for the RMS error of each
    finished estimator. Rows beyond the largest size of a table are omitted. The table is empty if a
    flight is too short or too long for :data:`STARTS_S`.
    """
    cases, lines = referenced(metrics), []
    for case in cases:
        arrays, title = results.arrays(case), results.scenario.case(case).title
        times = arrays["times"]
        if not STARTS_S[-1] < times[-1] < 4.0 * STARTS_S[-1]:
            return pd.DataFrame()
        epochs, squares = times[arrays["kept"]], {}
        for label in labels:
            series = results.series(case, label)
            if len(series):
                squares[code(label)] = epochs, (series[:, :, 0] ** 2).mean(axis=0)
        if not squares:
            return pd.DataFrame()
        rows = {"bound": (times, arrays["bound-filter"][:, 0])} | squares
        for name, (at, values) in [*rows.items()][: MOST_ROWS // len(cases)]:
            errors = [math.sqrt(float(values[at >= start].mean())) for start in STARTS_S]
            lines.append([f"{title}: {name}", *map(columns.metres, errors)])
    heads = [f"{start:g} s" for start in STARTS_S]
    return pd.DataFrame(lines, columns=["RMS error [m] from this time to the end", *heads])


def gravity_claims(results: Results) -> pd.DataFrame:
    """Return a table that compares published improvements with computed INS responses.

    A published improvement is the INS error that disappears if the gravity disturbance is known.
    The response is the INS error that the gravity disturbance causes. A claim states a time
    ``until_s``. A published improvement is possible if it is at most 1.25 times the largest
    response up to this time.
    """
    rows = []
    for claim in results.scenario.claims:
        if claim.case not in results.manifest["cases"]:
            continue
        arrays = results.arrays(claim.case)
        if "response" not in arrays:
            continue
        values = np.abs(arrays["response"][:, _QUANTITIES[claim.quantity]])
        values = values * (_ARCMINUTES if claim.unit == "′" else 1.0)
        until = values[arrays["times"] <= claim.until_s + 1e-9]
        largest = float(until.max()) if len(until) else 0.0
        possible = claim.published <= _NEAR * largest
        unit = claim.unit if claim.unit == "′" else f" {claim.unit}"
        rows.append(
            {
                "claim": claim.title,
                "published": f"{claim.published:g}{unit}",
                "largest response": f"{columns.metres(largest)}{unit}",
                "possible": "yes" if possible else "no",
            }
        )
    return pd.DataFrame(rows)


def claimed(results: Any) -> pd.DataFrame:
    """Return a table of published claims on pairs of estimators, with verdicts.

    A claim of an "equal" error holds if the verdict on the pair is "equivalent". A claim of a
    "larger" error holds if the verdict is "worse", of a "smaller" error if it is "better". A claim
    on computing times compares medians. All other claims of the scenario form one family of tests,
    over which the p-values are adjusted (:func:`.judging.pairs.family`). An undecided claim is
    "open"; its row has the number of runs that a decision needs.
    """
    judged = {"larger": WORSE, "smaller": BETTER, "equal": EQUIVALENT}
    metrics = results.metrics()
    settled = metrics[metrics["window"] == "settled"].set_index(["case", "estimator"])
    names_by_label = results.shown
    # A scenario may state parameters in another order than the labels of the runs.
    specs = [(EstimatorSpec.parse(label), label) for label in names_by_label]

    def flown_label(text: str) -> str:
        spec = EstimatorSpec.parse(text)
        return next((label for own, label in specs if own == spec), text)

    def has_flown(case: str, label: str) -> bool:
        return (case, names_by_label.get(label, label)) in settled.index

    stated = [
        (claim, value, claim.case, *map(flown_label, claim.labels(value)))
        for claim in results.scenario.comparisons
        for value in claim.values
    ]
    flown = [row for row in stated if all(has_flown(row[2], label) for label in row[3:])]
    of_errors = [tuple(row[2:]) for row in flown if row[0].quantity != "time"]
    family = iter(results.pairs_of(of_errors).to_dict("records") if of_errors else ())
    rows = []
    for claim, value, case, first, second in flown:
        names = names_by_label.get(first, first), names_by_label.get(second, second)
        if claim.quantity == "time":
            one, two = (settled.loc[(case, name), "seconds_per_run"] for name in names)
            pair = {"error_ratio": one / two, "verdict": _of_ratio(one / two)}
        else:
            pair = next(family)
        verdict = _OPEN if pair["verdict"] == UNDECIDED else _REFUTED
        verdict = "holds" if pair["verdict"] == judged[claim.relation] else verdict
        rows.append(
            {
                "claim": claim.title_of(value),
                "first": code(names[0]),
                "second": code(names[1]),
                "error_ratio": pair["error_ratio"],
                "holds": verdict,
                "needed_runs": _needed(pair.get("needed_runs", math.nan)),
            }
        )
    table = pd.DataFrame(rows)
    decided = table.empty or (table["needed_runs"] == columns.NONE).all()
    return table.drop(columns="needed_runs", errors="ignore") if decided else table


def claims_in_words(claims: pd.DataFrame) -> str:
    """Return the caption of a table of :func:`claimed`, with the number of each verdict."""
    if claims.empty:
        return ""
    counts = claims["holds"].value_counts()
    parts = [
        f"{counts.get(verdict, 0)} {words}"
        for verdict, words in (("holds", "hold"), (_REFUTED, "do not"), (_OPEN, "are open"))
        if counts.get(verdict, 0)
    ]
    return f"Claims tested: {', '.join(parts)}. Ratio: first over second"


def _needed(runs: float) -> str:
    """Return a number of runs as text, rounded up to tens; ``> 400`` above :data:`MOST_RUNS`."""
    if math.isnan(runs):
        return columns.NONE
    return f"> {MOST_RUNS}" if runs > MOST_RUNS else f"{10 * math.ceil(runs / 10.0)}"


def _of_ratio(ratio: float) -> str:
    """Return the verdict on a ratio of two times, with the equivalence margin of errors."""
    if 1.0 / EQUIVALENCE_RATIO <= ratio <= EQUIVALENCE_RATIO:
        return EQUIVALENT
    return BETTER if ratio < 1.0 else WORSE
