"""The markdown tables of a report, from summary rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from ..figures.numbers import counted, short
from ..judging.ranking import ORDER, best_causal, consistent, pair_of, rows_of
from ..judging.statistics import BETTER, UNDECIDED, WORSE
from ..judging.success import EQUAL
from ..judging.summary import WINDOWS, window_mask
from ..spec.case import CaseSpec
from ..spec.scenario import Scenario
from .outcome import Outcome, comparable_ratio, outcome
from .shares import percent, share

DEFINITIONS = "definitions.md"
"""The page of definitions, beside every report."""
WINDOW_TITLES = {
    "whole": "whole flight",
    "settled": "settled window",
    "last20": "end of the flight",
}


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    escaped = ([cell.replace("|", "\\|") for cell in line] for line in lines)
    return "\n".join("| " + " | ".join(line) + " |" for line in escaped)


def glance(
    scenario: Scenario, summary: pd.DataFrame, pairs: pd.DataFrame, window: str = "settled"
) -> str:
    """Return the table at a glance: every estimator beside the paper and the bound."""
    cases = [case for case in scenario.cases if case.reference]
    if not cases and len(scenario.cases) > 1:
        return errors_of_cases(scenario, summary, pairs)
    cases = cases or list(scenario.cases)
    tables = [rows_of(summary, case, window) for case in cases]
    rows = []
    if any(case.reference for case in cases):
        published = [
            f"{c.reference.position_mrse_m:.2f}, {c.reference.velocity_mrse_mps:.3f}"
            for c in cases
            if c.reference
        ]
        rows.append(["*published*", "*filter*", *published, "", ""])

    def cells(label: str, position: str, velocity: str) -> list[str]:
        return [
            f"{table[label][position]:.2f}, {table[label][velocity]:.3f}" if label in table else ""
            for table in tables
        ]

    bounded = ""
    most = _most_runs(tables)
    for label, first in tables[0].items():
        causality = first["causality"]
        if causality not in ("none", bounded):
            bounded = causality
            bounds = cells(label, "position_bound_m", "velocity_bound_mps")
            rows.append(["*Cramér–Rao bound*", f"*{causality}*", *bounds, "", ""])
        errors = cells(label, "position_mrse_m", "velocity_mrse_mps")
        milliseconds = short(1e3 * first["seconds_per_run"])
        held = [table[label] for table in tables if label in table]
        lost = " / ".join(str(sum(row[key] for row in held)) for key in ("failed", "diverged"))
        name = f"`{label}`{_of_fewer(held, most)}"
        rows.append([name, causality, *errors, lost, milliseconds])
    titles = [f"{case.title}: m, m/s" for case in cases]
    head = [WINDOW_TITLES[window], "causality", *titles, "failed / diverged", "ms/run"]
    table = markdown(head, rows)
    if any(row["runs"] < most for held in tables for row in held.values()):
        table += (
            "\n\nErrors of fewer runs are of another sample: they do not compare with the others'."
        )
    return table


def errors_of_cases(scenario: Scenario, summary: pd.DataFrame, pairs: pd.DataFrame) -> str:
    """Return error over bound of many cases: a column for each, a row for each estimator."""
    told = [outcome(case, summary, pairs) for case in scenario.cases]
    told = [found for found in told if found.rows]
    tables = [found.rows for found in told]
    labels = list(dict.fromkeys(label for table in tables for label in table))
    causality = {k: row["causality"] for table in tables for k, row in table.items()}
    labels.sort(key=lambda label: ORDER[causality[label]])
    most = _most_runs(tables)
    rows = []
    for kind in ("filter", "fixed-lag", "batch"):
        if kind in causality.values():
            bounds = (_bounds(table, kind) for table in tables)
            least = (next((b for b in held if math.isfinite(b)), math.nan) for held in bounds)
            rows.append(
                [f"*bound [m]: {kind}*", *("" if math.isnan(b) else short(b) for b in least)]
            )
    medians = {"the best causal": [f.best for f in told], "the INS": [f.ins for f in told]}
    for who, held in medians.items():
        metres = [short(row["position_median_m"]) if row else "" for row in held]
        if any(metres):
            rows.append([f"*median [m]: {who}*", *metres])
    for label in labels:
        kind = causality[label]
        name = f"`{label}`" if kind in ("filter", "none") else f"`{label}` ({kind})"
        name += _of_fewer([t[label] for t in tables if label in t], most)
        rows.append([name, *(_over_bound(found, label) for found in told)])
    reading = (
        "Median over the runs that succeed of the position error over the bound of its kind; "
        "behind it the share of success, if it is not all, and † what is not honest of itself; "
        "of who got fewer runs (~) it is the best one's median, divided by the mean ratio of the "
        "two errors over the runs in which both succeed. "
        "The best causal estimator of a case is bold if it is honest "
        f"([definitions]({DEFINITIONS}))."
    )
    return f"{markdown(['', *(found.case.title for found in told)], rows)}\n\n{reading}"


def _most_runs(tables: Iterable[Mapping[str, Mapping[str, Any]]]) -> int:
    return max((row["runs"] for table in tables for row in table.values()), default=0)


def _of_fewer(rows: Sequence[Mapping[str, Any]], most: int) -> str:
    """Return of how many runs an estimator's figures are, if others flew more."""
    runs = max(row["runs"] for row in rows)
    return f", {counted(runs, 'run')}" if runs < most else ""


def _bounds(table: Mapping[str, Mapping[str, Any]], causality: str) -> list[float]:
    """Return the bounds on the position [m] of a case's estimators of a causality."""
    return [r["position_bound_m"] for r in table.values() if r["causality"] == causality]


def _over_bound(found: Outcome, label: str) -> str:
    """Return an estimator's median error over the bound, with its share of success."""
    row, best = found.rows.get(label), found.best
    if row is None:
        return ""
    ratio = comparable_ratio(row, best, found.pairs.get(label))
    mark = "~" if ratio != row["ratio_median"] else ""
    text = f"{mark}{short(ratio)}" if math.isfinite(ratio) else "–"
    if best is not None and row["label"] == best["label"] and consistent(row):
        text = f"**{text}**"
    if row["success_share"] < 1.0:
        text += f" ({percent(row['success_share'])})"
    return text if consistent(row) else f"{text} †"


def case_errors(case: CaseSpec, summary: pd.DataFrame) -> str:
    """Return the errors of one case in the settled window, smoothers in their own block."""
    head = [
        "estimator", "success", "error / bound: median", "quartiles", "95 %", "position MRSE [m]",
        "capped", "bound [m]", "velocity MRSE [m/s]", "bound", "failed / diverged",
    ]  # fmt: skip
    rows = []
    if case.reference:
        paper = [""] * len(head)
        paper[0] = "**paper**"
        paper[5] = f"{case.reference.position_mrse_m:.4f}"
        paper[8] = f"{case.reference.velocity_mrse_mps:.4f}"
        rows.append(paper)
    return markdown(head, [*rows, *_blocks(case, summary, len(head), _errors)])


def case_consistency(case: CaseSpec, summary: pd.DataFrame, updates: int) -> str:
    """Return consistency (with 95 % bands) and cost of one case in the settled window."""
    head = [
        "estimator", "NEES (band)", "NIS (band)", "coverage (band)", "ms/run", "ms/update",
        "map points",
    ]  # fmt: skip
    return markdown(head, _blocks(case, summary, len(head), lambda row: _consistency(row, updates)))


def _blocks(
    case: CaseSpec,
    summary: pd.DataFrame,
    columns: int,
    cells: Callable[[dict[str, Any]], list[str]],
) -> list[list[str]]:
    """Return a row of cells for each estimator, smoothers under their own title."""
    rows = []
    smoothing = False
    for row in rows_of(summary, case, "settled").values():
        if not smoothing and row["causality"] in ("fixed-lag", "batch"):
            smoothing = True
            rows.append(["*smoothers*", *[""] * (columns - 1)])
        rows.append(cells(row))
    return rows


def paired(scenario: Scenario, summary: pd.DataFrame, pairs: pd.DataFrame) -> str:
    """Return how every estimator does against the best causal one of its case, run by run.

    ``pairs`` are the rows of :func:`ggbench.judging.summary.paired_table`.
    """
    head = [
        "case", "estimator", "against", "runs", "succeeds alone", "the other alone",
        "ratio of errors", "sign test", "verdict", "velocity: MRSE ratio",
    ]  # fmt: skip
    rows = []
    for case in scenario.cases:
        ranking = rows_of(summary, case, "settled")
        best = best_causal(ranking.values())
        for label in ranking:
            other = best is not None and label != best["label"]
            pair = pair_of(pairs, case.name, label, best["label"]) if best and other else None
            if pair:
                rows.append([case.name, *_pair(pair)])
    return markdown(head, rows) if rows else ""


def verdicts(pairs: pd.DataFrame) -> str:
    """Return in how many cases each two estimators differ, for many cases.

    ``pairs`` are the rows of :func:`ggbench.judging.summary.paired_table`.
    """
    verdicts = (BETTER, WORSE, EQUAL, UNDECIDED)
    head = ["estimator", "against", *verdicts, "mean ratio of errors farthest from 1"]
    settled = pairs[pairs["window"] == "settled"]
    rows = []
    for (first, second), pair in settled.groupby(["first", "second"], sort=False):
        found = pair["verdict"].value_counts()
        ratios = pair["error_ratio"].dropna().to_numpy()
        farthest = ratios[np.abs(np.log(ratios)).argmax()] if len(ratios) else math.nan
        counts = [str(found.get(verdict, 0)) for verdict in verdicts]
        text = "–" if math.isnan(farthest) else f"{farthest:.5g}"
        rows.append([f"`{first}`", f"`{second}`", *counts, text])
    reading = (
        "Paired over runs, position, settled window: the number of grid points of each verdict "
        f"([definitions]({DEFINITIONS}))."
    )
    return f"{reading}\n\n{markdown(head, rows)}"


def _pair(pair: dict[str, Any]) -> list[str]:
    """Return the cells of a pair."""
    ratio = "–" if math.isnan(pair["error_ratio"]) else f"{pair['error_ratio']:.4g}"
    if not math.isnan(pair["error_ratio_lo"]):
        ratio += f" [{pair['error_ratio_lo']:.4g}, {pair['error_ratio_hi']:.4g}]"
    return [
        f"`{pair['first']}`", f"`{pair['second']}`", str(pair["runs"]),
        str(pair["first_succeeded"]), str(pair["second_succeeded"]), ratio,
        f"{pair['sign_p']:.2g}", pair["verdict"], f"{1.0 + pair['velocity_relative']:.5g}",
    ]  # fmt: skip


def efficiency(scenario: Scenario, summary: pd.DataFrame) -> str:
    """Return MRSE over bound for every case, estimator and window."""
    head = ["case", "estimator"]
    for window in WINDOWS:
        head += [f"{WINDOW_TITLES[window]}: position", "velocity"]
    rows = []
    for case in scenario.cases:
        tables = {window: rows_of(summary, case, window) for window in WINDOWS}
        for label, settled in tables["settled"].items():
            if settled["causality"] == "none":
                continue
            cells = [case.name, f"`{label}`"]
            for table in tables.values():
                cells.append(f"{table[label]['position_efficiency']:.3f}")
                cells.append(f"{table[label]['velocity_efficiency']:.3f}")
            rows.append(cells)
    return markdown(head, rows)


def bounds(scenario: Scenario, arrays: Mapping[str, Mapping[str, np.ndarray]]) -> str:
    """Return the filtering bounds of every case and window; ``arrays`` are those of the cases."""
    rows = []
    for case in scenario.cases:
        cells = [case.name]
        for window in WINDOWS:
            stored = arrays[case.name]
            mask = window_mask(stored["times"], case.windows, window)
            position, velocity = np.sqrt(stored["bound-filter"][mask].mean(axis=0))
            cells.append(f"{position:.3f}, {velocity:.4f}")
        rows.append(cells)
    return markdown(["case", *(WINDOW_TITLES[w] for w in WINDOWS)], rows)


def study(scenario: Scenario, studies: pd.DataFrame) -> str:
    """Return how the published numbers move when one assumption changes."""
    cases = [case for case in scenario.cases if case.reference]
    head = ["assumption"]
    for case in cases:
        head += [case.name, "NEES"]
    paper = ["*paper*"]
    for case in cases:
        if case.reference:
            paper += [f"{case.reference.position_mrse_m}, {case.reference.velocity_mrse_mps}", ""]
    rows = [paper]
    declared = studies[studies["assumption"] == ""]
    for title, window in (
        ("**as declared**", "settled"),
        ("window: the whole flight", "whole"),
        ("window: the end of the flight", "last20"),
    ):
        rows.append([title, *_study_cells(cases, declared, window)])
    for assumption in scenario.assumptions:
        frame = studies[studies["assumption"] == assumption.name]
        rows.append([assumption.title, *_study_cells(cases, frame, "settled")])
        # What was wrong at the start is seen before it settles.
        starts = {case.name: case.initial_error for case in cases}
        if any(starts[case.name] != case.initial_error for case in assumption.cases):
            title = "the same, whole flight"
            rows.append([title, *_study_cells(cases, frame, "whole")])
    return markdown(head, rows)


def _study_cells(cases: Sequence[CaseSpec], frame: pd.DataFrame, window: str) -> list[str]:
    cells = []
    for case in cases:
        chosen = frame[(frame["case"] == case.name) & (frame["window"] == window)]
        if chosen.empty:
            cells += ["–", "–"]
            continue
        row = chosen.iloc[0]
        lost = int(row["failed"] + row["diverged"])
        note = f" ({lost} of {row['runs']} failed or diverged)" if lost else ""
        cells.append(f"{row['position_mrse_m']:.3f}, {row['velocity_mrse_mps']:.4f}{note}")
        cells.append(_short(row["nees_mean"]))
    return cells


def _errors(row: dict[str, Any]) -> list[str]:
    """Return the cells of one estimator's errors."""
    quartiles = (short(row[f"ratio_quartile_{end}"]) for end in ("lo", "hi"))
    succeeds = math.isfinite(row["ratio_median"])
    return [
        f"`{row['label']}`" + ("" if consistent(row) else " †"),
        share(row, "success_share", "success_lo", "success_hi"),
        _ended(row, "ratio_median") if succeeds else "–",
        " to ".join(quartiles) if succeeds else "–",
        short(row["ratio_p95"]) if succeeds else "–",
        _interval(row, "position_mrse", "m", 3),
        f"{row['capped_mrse_m']:.3f}",
        f"{row['position_bound_m']:.3f}",
        _interval(row, "velocity_mrse", "mps", 4),
        f"{row['velocity_bound_mps']:.4f}",
        f"{row['failed']} / {row['diverged']}",
    ]


def _ended(row: dict[str, Any], key: str) -> str:
    """Return a figure with the ends of its interval, if it has one."""
    low, high = row[f"{key}_lo"], row[f"{key}_hi"]
    text = short(row[key])
    return text if math.isnan(low) else f"{text} [{short(low)}, {short(high)}]"


def _consistency(row: dict[str, Any], updates: int) -> list[str]:
    """Return the cells of one estimator's consistency and cost."""
    milliseconds = 1e3 * row["seconds_per_run"]
    covered = [100.0 * row[f"coverage{end}"] for end in ("", "_lo", "_hi")]
    return [
        f"`{row['label']}`",
        _band(_short(row["nees_mean"]), row["nees_lo"], row["nees_hi"], 2),
        _band(_short(row["nis_mean"]), row["nis_lo"], row["nis_hi"], 2),
        _band(f"{covered[0]:.1f} %", covered[1], covered[2], 1),
        f"{milliseconds:.1f}",
        f"{milliseconds / updates:.3f}",
        f"{row['map_evaluations']:.0f}",
    ]


def _band(text: str, low: float, high: float, digits: int) -> str:
    """Return a figure with its band; blank if there is no figure."""
    if text.startswith("nan"):
        return ""
    return text if math.isnan(low) else f"{text} ({low:.{digits}f}–{high:.{digits}f})"


def _interval(row: dict[str, Any], key: str, unit: str, digits: int) -> str:
    low, high = row[f"{key}_lo"], row[f"{key}_hi"]
    text = f"{row[f'{key}_{unit}']:.{digits}f}"
    return text if math.isnan(low) else f"{text} [{low:.{digits}f}, {high:.{digits}f}]"


def _short(value: float) -> str:
    """Return a number with two decimals, or without any if it is large."""
    return f"{value:.2f}" if abs(value) < 100.0 else f"{value:.0f}"
