"""The first words of a report whose scenario has no published numbers: what came out of it.

Everything is said of the settled window and computed from the summary and the paired comparison.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import pandas as pd
from scipy.special import bdtrc

from ..figures.numbers import short
from ..judging.ranking import best_causal, pair_of, rows_of
from ..judging.statistics import BETTER, UNDECIDED, WORSE
from ..spec.case import CaseSpec
from ..spec.scenario import Scenario

MOST_CASES = 8
"""Most cases of which a sentence each is said."""
NOTHING_GAINED = 1.05
"""Ratio of the INS's MRSE to an estimator's up to which a gain is called none, if not certain."""
_SIGNIFICANT = 0.05
_MOST_NAMED = 6
"""Estimators of which one thing is said by name; the others are in the table below."""


def answer(scenario: Scenario, summary: pd.DataFrame, pairs: pd.DataFrame) -> str:
    """Return the answer in markdown: a bold sentence, or one for each case.

    Parameters
    ----------
    scenario : with the cases that were run. summary : rows of :func:`.summary.summarize`.
    pairs : rows of :func:`ggbench.judging.summary.paired_table`.
    """
    told = [case for case in scenario.cases if rows_of(summary, case, "settled")]
    if len(told) == 1:
        return f"**{_capital(case_answer(told[0], summary, pairs))}**"
    if len(told) <= MOST_CASES:
        texts = (case_answer(case, summary, pairs) for case in told)
        return "\n".join(f"- **{c.title}:** {text}" for c, text in zip(told, texts, strict=True))
    return f"**{_capital(_of_many(told, summary, pairs))}**"


def case_answer(case: CaseSpec, summary: pd.DataFrame, pairs: pd.DataFrame) -> str:
    """Return what came out of a case, in a sentence or two."""
    rows = rows_of(summary, case, "settled")
    best = best_causal(rows.values())
    if best is None:
        return _without_filter(rows)
    label = best["label"]
    text = f"the best causal estimator is `{label}`"
    if ins := _unaided(rows):
        text = _against_ins(best, ins, pair_of(pairs, case.name, label, ins["label"]))
    else:
        text += f" with a position MRSE of {_error(best)}"
    text += f"; the bound is {short(best['position_bound_m'])} m (efficiency "
    text += f"{short(best['position_efficiency'])})"
    if not math.isnan(best["lock_share"]):
        text += f"; it locks on in {100.0 * best['lock_share']:.0f} % of the runs"
    others = _others(case, best, rows, pairs)
    return f"{text}{others}; {_lost(rows.values())}."


def gain(best: Mapping[str, Any], ins: Mapping[str, Any], pair: Mapping[str, Any] | None) -> str:
    """Return "gains", "nothing", "unproven" or "worse": the best causal estimator beside the INS.

    By the paired verdict of their squared position errors. Without a verdict: nothing, where the
    ratio of MRSE lies within :data:`NOTHING_GAINED` of 1; else a gain (or loss) is unproven.
    """
    verdict = pair["position_verdict"] if pair else UNDECIDED
    if verdict == WORSE:
        return "worse"
    if verdict == BETTER:
        return "gains"
    ratio = _ratio(ins["position_mrse_m"], best["position_mrse_m"])
    return "nothing" if 1.0 / NOTHING_GAINED <= ratio <= NOTHING_GAINED else "unproven"


def _against_ins(
    best: Mapping[str, Any], ins: Mapping[str, Any], pair: Mapping[str, Any] | None
) -> str:
    """Return what the best causal estimator gains over the INS."""
    label, kind = best["label"], gain(best, ins, pair)
    figures = f"position MRSE {_error(best)} against {_error(ins)}"
    if kind == "gains":
        ratio = _ratio(ins["position_mrse_m"], best["position_mrse_m"])
        if ratio >= 1.5:
            much = f"{short(ratio)} times less than the INS's {_error(ins)}"
        else:
            much = f"{100.0 * (1.0 - 1.0 / ratio):.2g} % less than the INS's {_error(ins)}"
        return (
            f"the best causal estimator is `{label}` with a position MRSE of {_error(best)}, {much}"
        )
    beside = f" ({_paired(pair)})" if pair else ""
    if kind == "worse":
        return (
            f"aiding is worse than the INS alone: of the causal estimators `{label}` does best, "
            f"{figures} of the INS{beside}"
        )
    if kind == "nothing":
        return (
            f"aiding gains nothing over the INS: the best causal estimator, `{label}`, cannot be "
            f"told from it, {figures}{beside}"
        )
    return (
        f"the best causal estimator is `{label}`, but these runs do not decide whether it is "
        f"better or worse than the INS: {figures}{beside}"
    )


def _paired(pair: Mapping[str, Any]) -> str:
    """Return the figures of a pair: mean difference of squared error, its interval, wins."""
    text = f"paired over {pair['runs']} runs: difference of squared error "
    text += f"{pair['position_difference_m2']:+.3g} m²"
    if not math.isnan(pair["position_lo"]):
        text += f" [{pair['position_lo']:+.3g}, {pair['position_hi']:+.3g}]"
    return f"{text}, smaller in {100.0 * pair['position_win_rate']:.0f} % of the runs"


def _others(
    case: CaseSpec,
    best: Mapping[str, Any],
    rows: Mapping[str, Mapping[str, Any]],
    pairs: pd.DataFrame,
) -> str:
    """Return how the other causal estimators differ from the best one, run by run."""
    same, often, worse, better, lost = [], [], [], [], []
    for label, row in rows.items():
        if row["causality"] != "filter" or label == best["label"]:
            continue
        if not math.isfinite(row["position_mrse_m"]):
            continue
        pair = pair_of(pairs, case.name, best["label"], label)
        verdict = pair["position_verdict"] if pair else UNDECIDED
        ratio = _ratio(row["position_mrse_m"], best["position_mrse_m"])
        named = f"`{label}` (× {_times(ratio)})"
        if row["lock_hi"] < best["lock_lo"]:
            lost.append(f"`{label}` ({100.0 * row['lock_share']:.0f} %)")
        elif verdict == BETTER:
            worse.append(named)
        elif verdict == WORSE:
            better.append(named)
        else:
            # So far apart and yet undecided: a few runs make the difference.
            if pair and abs(math.log(ratio)) > math.log(NOTHING_GAINED):
                more = f"larger in {100.0 * pair['position_win_rate']:.0f} % of the runs"
                named = f"`{label}` (× {_times(ratio)}, {more})"
                if ratio > 1.0 and _mostly(pair):
                    often.append(named)
                    continue
            same.append(f"`{label}`" if abs(ratio - 1.0) < 5e-4 else named)
    parts = []
    if lost:
        share = 100.0 * best["lock_share"]
        parts.append(f"surely locking on less often than in {share:.0f} %: {_some(lost)}")
    if same:
        parts.append(f"not distinguishable from it: {_some(same)}")
    if often:
        # A mean that a few runs make has a wide interval; what most runs do is sure all the same.
        parts.append(
            "with larger errors in significantly more than half of the runs (sign test), though a "
            f"few runs make the mean: {_some(often)}"
        )
    if worse:
        parts.append(f"significantly worse, by their ratio of MRSE: {_some(worse)}")
    if better:
        parts.append(f"smaller errors where they finish, but runs lost: {_some(better)}")
    return "".join(f"; {part}" for part in parts)


def _some(said: Sequence[str], separator: str = ", ") -> str:
    """Return what is said of the first few, the best, and of how many more it could be said."""
    more = len(said) - _MOST_NAMED
    return separator.join(said[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def _mostly(pair: Mapping[str, Any]) -> bool:
    """Return whether the first of a pair has the smaller error in most runs (sign test, 5 %)."""
    runs = int(pair["runs"] + pair["first_only"] + pair["second_only"])
    wins = round(pair["position_win_rate"] * runs)
    return runs > 0 and bool(bdtrc(wins - 1, runs, 0.5) < _SIGNIFICANT)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _times(ratio: float) -> str:
    """Return a ratio near or far from 1 with the digits that tell it from 1."""
    if abs(ratio - 1.0) < 5e-5:
        return "1.0000"
    return f"{ratio:.4f}" if abs(ratio - 1.0) < 0.05 else short(ratio)


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
    return f"of {runs} run{'s' * (runs != 1)} {_some(parts, '; ')}"


def _without_filter(rows: Mapping[str, Mapping[str, Any]]) -> str:
    finished = {k: row for k, row in rows.items() if math.isfinite(row["position_mrse_m"])}
    if not finished:
        return f"no estimator finished a run that could be judged: {_lost(rows.values())}."
    label, row = min(finished.items(), key=lambda item: item[1]["position_mrse_m"])
    return (
        f"no causal estimator finished enough runs to be judged; the least position MRSE is that "
        f"of `{label}` ({row['causality']}), {_error(row)}; {_lost(rows.values())}."
    )


def _of_many(told: Sequence[CaseSpec], summary: pd.DataFrame, pairs: pd.DataFrame) -> str:
    """Return what came out of many cases: who is best in how many, and what aiding gains."""
    firsts: Counter[str] = Counter()
    kinds: dict[str, list[str]] = {}
    efficiencies, failed, diverged = [], 0, 0
    for case in told:
        rows = rows_of(summary, case, "settled")
        failed += sum(int(row["failed"]) for row in rows.values())
        diverged += sum(int(row["diverged"]) for row in rows.values())
        best = best_causal(rows.values())
        if best is None:
            kinds.setdefault("unjudged", []).append(case.name)
            continue
        firsts[best["label"]] += 1
        efficiencies.append(best["position_efficiency"])
        if ins := _unaided(rows):
            pair = pair_of(pairs, case.name, best["label"], ins["label"])
            kinds.setdefault(gain(best, ins, pair), []).append(case.name)
    parts = []
    if firsts:
        best_in = ", ".join(f"`{label}` in {count}" for label, count in firsts.most_common())
        parts.append(f"of {len(told)} cases the best causal estimator is {best_in}")
        parts.append(
            f"its position MRSE is {short(min(efficiencies))} to {short(max(efficiencies))} times "
            "the bound"
        )
    for kind, phrase in (
        ("gains", "aiding gains on the INS in"),
        ("nothing", "aiding gains nothing over the INS in"),
        ("worse", "aiding is worse than the INS in"),
        ("unproven", "these runs do not decide whether aiding gains anything in"),
        ("unjudged", "no causal estimator can be judged in"),
    ):
        if kind in kinds:
            few = f" ({', '.join(kinds[kind])})" if len(kinds[kind]) <= 5 else ""
            parts.append(f"{phrase} {len(kinds[kind])}{few}")
    return "; ".join([*parts, f"{failed} runs failed, {diverged} diverged."])


def _unaided(rows: Mapping[str, Mapping[str, Any]]) -> Mapping[str, Any] | None:
    """Return the row of the INS, if it has a figure."""
    found = (row for row in rows.values() if row["causality"] == "none")
    return next((row for row in found if math.isfinite(row["position_mrse_m"])), None)


def _error(row: Mapping[str, Any]) -> str:
    value = f"{short(row['position_mrse_m'])} m"
    low, high = row["position_mrse_lo"], row["position_mrse_hi"]
    return value if math.isnan(low) else f"{value} [{short(low)}, {short(high)}]"


def _ratio(one: float, other: float) -> float:
    return one / other if other > 0.0 else math.inf
