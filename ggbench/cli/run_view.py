"""Terminal view of one run: metrics, errors over time, and the command that repeats it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rich.markup import escape

from ..campaign import result_keys
from ..campaign.flights import flight_of
from ..campaign.registry import choose
from ..campaign.runner import Task, run_task
from ..display.responsive_table import ResponsiveTable
from ..display.timing import COLD
from ..errors import brief
from ..estimator_spec import shown_names
from ..figures.numbers import counted
from ..judging.bounds import squared_bounds
from ..results.store import kept_epochs
from ..simulation.flight_bounds import flight_bound
from ..spec.scenario import Scenario
from .screen import console

if TYPE_CHECKING:
    import pandas as pd

    from ..results.folder import Results

_BARS = "▁▂▃▄▅▆▇█"
_WIDTH = 32
_TIMES = 8
_MOST_LISTED = 5
_LONGEST_TEXT, _LONGEST_VALUE = 200, 60
"""Largest numbers of shown characters of a text, and of another value, of ``Estimate.info``."""


class RunView(NamedTuple):
    """Result of one estimator in a run.

    ``series`` (K', 4) contains the position error [m], velocity error [m/s], NEES and NIS at the K'
    stored epochs; it is None if no time series is stored.
    """

    label: str
    record: Mapping[str, Any]
    series: np.ndarray | None
    command: str


def overview(results: Results) -> None:
    """Print the content, the failures and the largest errors of a results folder."""
    manifest, table = results.manifest, results.runs()
    console.print(f"[bold]{escape(manifest['title'])}[/]")
    failed, diverged = int((table["status"] != "ok").sum()), int(table["diverged"].sum())
    console.print(
        f"scenario {escape(manifest['scenario'])} {manifest['scenario_hash'][:16]}, seed "
        f"{manifest['seed']}, {manifest['date'][:10]}, ggbench {manifest['ggbench']} results "
        f"version {manifest['results_version']}\n{counted(len(table), 'result')} of up to "
        f"{counted(results.run_count, 'run')} per case: {failed} failed, {diverged} diverged"
    )
    for label, names in results.seeking.items():
        console.out(f"{label} uses {names}, which give access to the truth")
    failures = results.failures()
    for _, row in failures.head(_MOST_LISTED).iterrows():
        console.out(
            f"failed: {_where(row)}: {brief(row['reason'])}\n  to repeat it: {row['command']}"
        )
    if len(failures) > _MOST_LISTED:
        console.print(f"... and {len(failures) - _MOST_LISTED} more, in failures.csv")


def _where(row: pd.Series) -> str:
    study = f"{row['assumption']}/" if row["assumption"] else ""
    return f"{study}{row['case']}, {row['estimator']}, run {row['run']}"


def choose_run(results: Results, case: str | None, run: int | None = None) -> tuple[str, int, str]:
    """Return case and index of the most conspicuous run, and the reason for the choice.

    If ``case`` or ``run`` is given, only runs with this case or this index are considered. Raise
    ResultsError if the folder has no such run.
    """
    from ..results.folder import ResultsError  # not at the top: to repeat a run needs no tables

    table = results.runs()
    table = table[
        (table["assumption"] == "")
        & ((table["case"] == case) | (case is None))
        & ((table["run"] == run) | (run is None))
    ]
    if table.empty:
        request = f"run {run}" if run is not None else "run"
        request += f" of case {case}" if case else ""
        raise ResultsError(
            f"{results.folder} holds no {request}; available: runs 0 to {results.run_count - 1} of "
            f"{', '.join(results.manifest['cases'])}"
        )
    failed = table[table["status"] != "ok"]
    if len(failed):
        row = failed.iloc[0]
        return row["case"], int(row["run"]), f"the first run that failed: {row['estimator']}"
    aided = table[table["causality"] != "none"]
    chosen = aided if len(aided) else table
    # In units of what the estimator usually does in this case, so that cases compare.
    usual = results.runs().groupby(["case", "estimator"])["settled_position_ms"].median()
    squares = chosen.set_index(["case", "estimator"])["settled_position_ms"]
    row = chosen.iloc[int(np.argmax((squares / usual.reindex(squares.index)).to_numpy()))]
    reason = "the largest ratio of the error to the estimator's median error in its case:"
    shown = shown_names(dict(zip(table["estimator"], table["name"], strict=True)))
    return row["case"], int(row["run"]), f"{reason} {shown[row['estimator']]}"


def show_run(results: Results, case_name: str, run: int) -> None:
    """Print one stored run of a case."""
    views = [
        RunView(
            cell.estimator,
            record,
            results.series_of(case_name, cell.estimator, run),
            results.command(cell, run),
        )
        for cell in results.cells
        if cell.case == case_name and not cell.assumption
        for record in results.store.records(cell.key, run + 1, first=run)
    ]
    arrays = results.arrays(case_name)
    title = results.scenario.case(case_name).title
    stored = arrays["kept"]
    _print(title, run, arrays["times"][stored], arrays["bound-filter"][stored], views)


def repeat_run(
    scenario: Scenario, case_names: Sequence[str], labels: Sequence[str], seed: int, run: int
) -> bool:
    """Repeat one run in this process and print it; return True if no estimator failed.

    The result is not stored. ``case_names`` are names of cases, or ``STUDY/CASE`` for a case of an
    assumption.
    """
    good = True
    names = case_names or [case.name for case in scenario.cases]
    for study, case in map(scenario.find, names):
        pairs = tuple(
            (label, result_keys.run_key(case, choose(label).content, seed)) for label in labels
        )
        messages = run_task(Task(case, study, (run,), seed, pairs))
        by_key = {result.key: result for m in messages if isinstance(m, list) for result in m}
        views = [RunView(label, by_key[key].record, by_key[key].series, "") for label, key in pairs]
        flight = flight_of(case)
        stored = kept_epochs(len(flight.times))
        bound = np.stack(squared_bounds(flight_bound(flight).filtering), axis=-1)[stored]
        _print(case.title, run, flight.times[stored], bound, views)
        good &= all(view.record["status"] == "ok" for view in views)
    return good


def _print(
    title: str, run: int, times: np.ndarray, bound: np.ndarray, views: Sequence[RunView]
) -> None:
    """Print the metrics of a run, its errors against time, and the command that repeats it."""
    shown = shown_names({view.label: view.record["name"] for view in views})
    views = [view._replace(label=shown[view.label]) for view in views]
    console.print(f"\n[bold]{escape(title)}, run {run}[/]")
    headings = ["settled m", "m/s", "final m", "NEES", "diverged", "converged s", "ms"]
    table = ResponsiveTable(
        "", [("estimator", "name"), *((heading, "number") for heading in headings)]
    )
    for view in views:
        record = view.record
        if record["status"] != "ok":
            table.add_row(view.label, "[red]failed[/]", *[""] * (len(headings) - 1))
            continue
        table.add_row(
            view.label,
            f"{record['settled_position_ms'] ** 0.5:.3g}",
            f"{record['settled_velocity_ms'] ** 0.5:.3g}",
            f"{record['final_position_error_m']:.3g}",
            f"{record['settled_nees']:.2f}",
            "[red]yes[/]" if record["diverged"] else "no",
            _convergence(record),
            f"{1e3 * record['seconds']:.1f}{'*' if record['cold'] else ''}",
        )
    table.print(console)
    if any(view.record["status"] == "ok" and view.record["cold"] for view in views):
        console.print(COLD, markup=False)
    for view in views:
        if view.record["status"] != "ok":
            console.out(f"{view.label} failed: {brief(view.record['reason'])}")
            if view.record["traceback"]:
                console.out(view.record["traceback"].rstrip())
            if view.record["output"]:
                console.out(f"Output of the run: {view.record['output']}")
        if view.record["remark"]:
            console.out(f"{view.label} {view.record['remark']}")
        if view.record["info"]:
            console.out(f"{view.label} says: {info_text(view.record['info'])}")
    _print_errors(times, bound, views)
    commands = [view for view in views if view.command]
    if commands:
        console.print("Command that repeats it and stores nothing:")
        for view in commands:
            console.out(f"  {view.command}")


def info_text(info: Mapping[str, Any]) -> str:
    """Return ``Estimate.info`` as one line; numbers have four digits, long values are cut."""
    words = []
    for name, value in info.items():
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
        most = _LONGEST_TEXT if isinstance(value, str) else _LONGEST_VALUE
        cut = text if len(text) <= most else f"{text[:most]}..."
        words.append(f"{name.replace('_', ' ')} {cut}")
    return "; ".join(words)


def _convergence(record: Mapping[str, Any]) -> str:
    """Return the time [s] at which a run converged as text, "false fix" or "never"."""
    if not math.isnan(record["converged_s"]):
        return f"{record['converged_s']:g}"
    return "[red]false fix[/]" if record["false_fix"] else "never"


def _print_errors(times: np.ndarray, bound: np.ndarray, views: Sequence[RunView]) -> None:
    """Print position errors against time: as bars on one logarithmic scale, and as numbers."""
    curves = {view.label: view.series[:, 0] for view in views if view.series is not None}
    if not curves:
        return
    curves["bound (rms)"] = np.sqrt(bound[:, 0])
    logs = {label: np.log10(np.maximum(curve, 1e-12)) for label, curve in curves.items()}
    low = min(float(values.min()) for values in logs.values())
    high = max(float(values.max()) for values in logs.values())
    low = max(low, high - 4.0)  # one touch of zero would flatten all the rest
    epochs = np.unique(np.linspace(0, len(times) - 1, _TIMES).round().astype(int))
    table = ResponsiveTable(
        f"position error in m against time; bars: {10.0**low:.2g} to {10.0**high:.2g} m, "
        f"logarithmic, {times[0]:g} to {times[-1]:g} s",
        [("seconds", "name"), ("", "number"), *((f"{times[k]:g}", "number") for k in epochs)],
    )
    for label, curve in curves.items():
        bars = _bars(logs[label], low, high)
        table.add_row(label, bars, *(_two_digits(curve[k]) for k in epochs))
    table.print(console)


def _two_digits(value: float) -> str:
    """Return an error with two digits or, up to 100 km, as whole metres."""
    return f"{value:.0f}" if 100.0 <= value < 1e5 else f"{value:.2g}"


def _bars(values: np.ndarray, low: float, high: float) -> str:
    """Return values as a line of bars between two levels.

    Each bar shows the largest of several consecutive values.
    """
    parts = np.array_split(values, min(_WIDTH, len(values)))
    scale = (len(_BARS) - 1) / max(high - low, 1e-12)
    heights = [round((float(part.max()) - low) * scale) for part in parts]
    return "".join(_BARS[min(max(height, 0), len(_BARS) - 1)] for height in heights)
