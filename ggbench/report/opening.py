"""The first words of a report whose scenario has no published numbers: what came out of it.

Everything is said of the settled window and computed from the summary and the paired comparison.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import pandas as pd

from ..figures.numbers import capital, counted, short, some
from ..judging.ranking import LEAST_COVERAGE, consistent, error_ratio, often_false
from ..judging.statistics import BETTER
from ..spec.scenario import Scenario
from .outcome import Outcome, comparable_ratio, outcome
from .shares import SUCCESS, percent, share


def answer(scenario: Scenario, summary: pd.DataFrame, pairs: pd.DataFrame) -> str:
    """Return the answer in markdown: a bold sentence or two on all cases.

    Parameters
    ----------
    scenario : with the cases that were run.
    summary : rows of :func:`.summary.summarize`.
    pairs : rows of :func:`ggbench.judging.summary.paired_table`.
    """
    told = [outcome(case, summary, pairs) for case in scenario.cases]
    told = [found for found in told if found.rows]
    if len(told) == 1:
        return f"**{capital(case_answer(told[0]))}**"
    return f"**{capital(_of_many(told))}**"


def case_answer(found: Outcome) -> str:
    """Return what came out of a case, in a sentence or two."""
    best = found.best
    if best is None:
        return _without_filter(found.rows)
    text = (
        f"`{best['label']}` succeeds in {share(best, *SUCCESS)} of {counted(best['runs'], 'run')}"
    )
    if math.isfinite(best["ratio_median"]):
        text += (
            f", and where it does has {short(best['ratio_median'])} times the bound of "
            f"{short(best['position_bound_m'])} m (median; 95 % of them below "
            f"{short(best['ratio_p95'])})"
        )
    if found.ins:
        text += f"; {_GAINS[found.gain]}"
        text += f"{short(found.ins['position_median_m'])} m (median)"
    if not consistent(best):
        who = "no causal estimator is honest here" if found.nobody_honest else "it is not honest"
        text += f"; **{who}**: {_dishonesty(best)}"
    return f"{text}{_others(found)}; {_lost(found.rows.values())}."


_GAINS = {
    "gains": "the INS alone has ",
    "nothing": "aiding gains nothing over the INS, which has ",
    "worse": "aiding is worse than the INS alone, which has ",
    "unproven": "too few runs to tell whether it is better or worse than the INS, which has ",
}


def _dishonesty(row: Mapping[str, Any]) -> str:
    """Return in what an estimator claims more than it knows."""
    parts = [f"its 95 % regions hold the truth in {percent(row['coverage'])} of the epochs"]
    if often_false(row):
        parts.append(f"it is sure of a wrong place in {percent(row['false_lock_share'])}")
    return ", ".join(parts)


def _lie(row: Mapping[str, Any]) -> str:
    """Return the figure by which an estimator is not honest."""
    if row["coverage"] < LEAST_COVERAGE:
        return percent(row["coverage"])
    return f"wrong in {percent(row['false_lock_share'])}"


def _others(found: Outcome) -> str:
    """Return how the other causal estimators do beside the best one, run by run."""
    assert found.best is not None
    groups: dict[str, list[str]] = {}
    for label, state in found.beside.items():
        row, pair = found.rows[label], found.pairs[label]
        if label == found.best["label"] or not math.isfinite(row["position_mrse_m"]):
            continue
        if not consistent(row) and consistent(found.best):
            groups.setdefault("dishonest", []).append(f"`{label}` ({_lie(row)})")
        elif state == "yes":
            groups.setdefault("yes", []).append(f"`{label}`")
        elif state == "open":
            groups.setdefault("open", []).append(f"`{label}`{_times(row, found.best, pair)}")
        elif pair and pair["verdict"] == BETTER and pair["success_p"] < _SIGNIFICANT:
            groups.setdefault("seldom", []).append(f"`{label}` ({percent(row['success_share'])})")
        elif pair and pair["verdict"] == BETTER:
            groups.setdefault("no", []).append(f"`{label}` (× {short(1.0 / pair['error_ratio'])})")
        else:
            groups.setdefault("few", []).append(f"`{label}`{_times(row, found.best, pair)}")
    phrases = {
        "yes": "as good: ",
        "open": "too few runs to tell from it: ",
        "few": "farther off, but too few runs to be sure: ",
        "no": "farther off, by the mean ratio of errors: ",
        "seldom": "successful less often: ",
        "dishonest": "not to be trusted (share of the truth in 95 % regions, or of wrong locks): ",
    }
    return "".join(f"; {text}{some(groups[k])}" for k, text in phrases.items() if k in groups)


_SIGNIFICANT = 0.05


def _times(row: Mapping[str, Any], best: Mapping[str, Any], pair: Mapping[str, Any] | None) -> str:
    ratio = error_ratio(row, best, pair)
    return f" (× {short(ratio)})" if math.isfinite(ratio) else ""


def _lost(rows: Iterable[Mapping[str, Any]]) -> str:
    """Return which estimators lost runs."""
    parts = []
    for row in rows:
        counts = [f"{row[kind]} {kind}" for kind in ("failed", "diverged") if row[kind]]
        if counts:
            parts.append(f"`{row['label']}` {', '.join(counts)}")
    if not parts:
        return "no run failed or diverged"
    runs = max(int(row["runs"]) for row in rows)
    return f"of {counted(runs, 'run')} {some(parts, '; ')}"


def _without_filter(rows: Mapping[str, Mapping[str, Any]]) -> str:
    finished = {k: row for k, row in rows.items() if math.isfinite(row["position_mrse_m"])}
    if not finished:
        return f"no estimator finished a run that could be judged: {_lost(rows.values())}."
    label, row = min(finished.items(), key=lambda item: item[1]["position_mrse_m"])
    return (
        "no causal estimator finished enough runs to be judged; the least position MRSE is that "
        f"of `{label}` ({row['causality']}), {short(row['position_mrse_m'])} m; "
        f"{_lost(rows.values())}."
    )


def _of_many(told: Sequence[Outcome]) -> str:
    """Return what came out of many cases: who is as good as the best, and what aiding gains."""
    able = [found for found in told if found.best is not None]
    # Where the best is the INS again, whoever flies along with it is good, and nothing is gained.
    judged = [found for found in able if found.gain not in ("nothing", "worse")]
    counts = {
        label: sum(found.good(label) for found in judged)
        for label in dict.fromkeys(k for found in judged for k in found.beside)
    }
    most = max(counts.values(), default=0)
    parts = []
    if most:
        first = [label for label, count in counts.items() if count == most]
        rest = sorted((k for k in counts if 0 < counts[k] < most), key=lambda k: -counts[k])
        where = f"all {most}" if most == len(told) else f"{most} of {len(told)}"
        figures = some([f"`{label}`{_range(judged, label)}" for label in first])
        parts.append(f"as good as the best causal estimator and honest in {where} cases: {figures}")
        if rest:
            parts.append(f"less often: {some([f'`{k}` in {counts[k]}' for k in rest])}")
    elif judged:
        parts.append("no causal estimator is honest in any case")
    if len(able) < len(told):
        parts.append(f"no causal estimator can be judged in {len(told) - len(able)}")
    for kind, phrase in (
        ("nothing", "the best causal one gains nothing over the INS in"),
        ("worse", "the best causal one is worse than the INS in"),
        ("unproven", "too few runs to tell whether the best causal one gains anything in"),
    ):
        names = [found.case.name for found in told if found.gain == kind]
        if names:
            few = f" ({', '.join(names)})" if len(names) <= 5 else ""
            parts.append(f"{phrase} {len(names)}{few}")
    lost = [sum(int(r[kind]) for f in told for r in f.rows.values())
            for kind in ("failed", "diverged")]  # fmt: skip
    return f"{'; '.join(parts)}; {counted(lost[0], 'run')} failed, {lost[1]} diverged."


def _range(judged: Sequence[Outcome], label: str) -> str:
    """Return how often an estimator succeeds, and how near, over the cases where it is good."""
    good = [found for found in judged if found.good(label)]
    rows = [found.rows[label] for found in good]
    shares = [row["success_share"] for row in rows]
    told = (comparable_ratio(f.rows[label], f.best, f.pairs.get(label)) for f in good)
    ratios = [ratio for ratio in told if math.isfinite(ratio)]
    text = percent(min(shares))
    if min(shares) < max(shares):
        text += f" to {percent(max(shares))}"
    if ratios:
        ends = [short(min(ratios)), short(max(ratios))]
        text += f", {' to '.join(dict.fromkeys(ends))} × the bound"
    if unsure := sum(found.beside[label] == "open" for found in good):
        text += f"; in {unsure} of these too few runs to tell"
    return f" (success in {text})"
