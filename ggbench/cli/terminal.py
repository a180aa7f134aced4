"""Tables of metrics and comparisons for a terminal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.console import Console

from ..display.responsive_table import ResponsiveTable
from ..display.timing import COLD
from ..estimator_spec import shown_names
from ..figures.numbers import counted, limited, span
from ..judging.comparison import SAME, UNFINISHED, Comparison
from ..judging.consistency import MARKS
from ..judging.summary import SMOOTHERS, ordered
from ..spec.scenario import Scenario

if TYPE_CHECKING:
    import pandas as pd

_MOST_CASES = 12
_UNITS = {"position": "m", "velocity": "m/s", UNFINISHED: "fail/div"}
_COLOURS = {"worse": "red", "better": "green"}


_HEADINGS = (
    "RMS m",
    "95 %",
    "× oracle",
    "success",
    "NEES",
    "NIS",
    "",
    "RMS m/s",
    "fail/div",
    "ms/run",
)


def print_metrics(
    metrics: pd.DataFrame, runs: pd.DataFrame, scenario: Scenario, console: Console
) -> None:
    """Print the metrics of up to twelve cases in the settled window.

    This window lasts from ``windows.settled_from_s`` to the end of the flight. Causal estimators
    are sorted by RMS error; smoothers follow.
    """
    cases = scenario.cases[:_MOST_CASES]
    warm = set(runs[(runs["status"] == "ok") & ~runs["cold"]].groupby(["case", "estimator"]).groups)
    starred = False
    names = shown_names(dict(zip(metrics["estimator"], metrics["name"], strict=True)))
    for case in cases:
        rows = ordered(metrics, case.name)
        if not rows:
            continue
        table = ResponsiveTable(
            f"{case.title}: from {case.windows.settled_from_s:g} s on",
            [("estimator", "name"), *((heading, "number") for heading in _HEADINGS)],
        )
        causal = True
        for row in rows:
            if causal and row["causality"] in SMOOTHERS:
                causal = False
                table.add_section()
            cold = row["runs"] > row["failed"] and (case.name, row["estimator"]) not in warm
            starred |= cold
            table.add_row(
                names[row["estimator"]],
                _digits(row["rms_m"]),
                ""
                if math.isnan(row["rms_lo"])
                else span(_digits(row["rms_lo"]), _digits(row["rms_hi"]), separator="-"),
                limited(row["efficiency"], f"{row['efficiency']:.3f}"),
                f"{100.0 * row['success']:.0f} %",
                f"{row['nees']:.2f}",
                "" if math.isnan(row["nis"]) else f"{row['nis']:.2f}",
                " ".join(filter(None, (MARKS.get(row["consistency"], ""), row["noise_fit"]))),
                f"{row['velocity_rms_mps']:.4f}",
                f"{row['failed']}/{row['diverged']}",
                f"{1e3 * row['seconds_per_run']:.1f}{'*' if cold else ''}",
            )
        table.add_section()
        if case.reference:
            table.add_row(
                "paper",
                _digits(case.reference.position_mrse_m),
                *[""] * 6,
                f"{case.reference.velocity_mrse_mps:.4f}",
                *[""] * 2,
                style="dim",
            )
        table.print(console)
    if starred:
        console.print(COLD, markup=False)
    more = len(scenario.cases) - len(cases)
    if more:
        console.print(f"... and {counted(more, 'more case')}, in metrics.csv and in the report")


def _digits(value: float) -> str:
    """Return a number with three decimals, or fewer if it is large."""
    short = abs(value) < 100.0 or math.isnan(value)
    return limited(value, f"{value:.3f}" if short else f"{value:.1f}")


def print_comparison(compared: Comparison, console: Console) -> None:
    """Print the compared errors with verdicts.

    Cases and estimators that occur in only one of the two folders are listed below.
    """
    numbers = ("", "before", "after", "ratio", "95 % interval", "runs", "p", "verdict")
    table = ResponsiveTable(
        "", [("case", "name"), ("estimator", "name"), *((n, "number") for n in numbers)]
    )
    for row in compared.rows.to_dict("records"):
        if row["quantity"] == UNFINISHED and not row["before"] and not row["after"]:
            continue
        study = f"{row['assumption']}/" if row["assumption"] else ""
        colour = _COLOURS.get(row["verdict"])
        table.add_row(
            study + row["case"],
            row["estimator"],
            _UNITS[row["quantity"]],
            f"{row['before']:.4g}",
            f"{row['after']:.4g}",
            "" if math.isnan(row["ratio"]) else limited(row["ratio"], f"{row['ratio']:.4f}"),
            ""
            if math.isnan(row["lo"])
            else span(
                *(limited(row[end], f"{row[end]:.4f}") for end in ("lo", "hi")), separator="-"
            ),
            f"{row['runs']}",
            ""
            if row["verdict"] == SAME
            else f"{row['p_better' if row['verdict'] == 'better' else 'p']:.2g}",
            f"[{colour}]{row['verdict']}[/]" if colour else row["verdict"],
        )
    table.print(console)
    paired = compared.rows["paired"]
    how = "paired" if paired.all() else "independent" if not paired.any() else "partly paired"
    console.print(f"Runs are {how}. {_adjustment(compared.tests)}")
    for which, names in (("before", compared.only_before), ("after", compared.only_after)):
        if names:
            console.out(f"Only {which}: {', '.join(names)}")


def _adjustment(tests: int) -> str:
    """Return a sentence that explains the p-values of a comparison with this number of tests."""
    if not tests:
        return "All results are equal: no test was made."
    false_alarms = (
        "if nothing has changed, at most 5 % of comparisons report 'worse' anywhere, and at most "
        "5 % 'better'."
    )
    if tests == 1:
        return f"One quantity differs, so p needs no adjustment: {false_alarms}"
    return f"p is adjusted for {tests} tests: {false_alarms}"
