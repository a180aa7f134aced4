"""Which estimator to use in which situation: in a few lines, in a table; and why not another."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..figures.numbers import capital, counted, short, some
from .league import COST_OF, EXCEPTIONS, SMOOTHERS, Advice, Flown, League, Standing, geometric_mean
from .league_figure import number
from .shares import SUCCESS, percent, share
from .situations import NARROW, NOTHING, SITUATIONS, WIDE
from .tables import markdown

_LINES = {
    "The model is right": {
        "plain": f"narrow prior (σ/ℓ below {NARROW:g})",
        "between": f"σ/ℓ of {NARROW:g} to {WIDE:g}",
        "wide": f"σ/ℓ of {WIDE:g} or more",
    },
    "Long or little aided": {
        "long": "half an hour or more",
        "scalar": "no gradiometer",
        "outage": "after satellite navigation",
    },
    "Readings or model are wrong": {
        "readings": "outliers or gaps",
        "model": "sensors, times, initial errors",
        "gravity": "unknown gravity",
    },
    "The map is wrong": {
        "map": "error of the map not told, or told as white noise",
        "told": "error of the map told as a bias of each channel that walks",
    },
    "Aiding gains nothing": {NOTHING: ""},
}
"""The lines of the answer: what each says of which situations, in a few words."""
HALF = 0.5
"""Share of the cases in which an estimator must be good to be named where none is in all."""


def answer(advised: Sequence[Advice]) -> str:
    """Return the answer as a list: which estimator, how sure, at what cost; a line for each group.

    How sure: the share of success in the case in which it is least, with its 95 % interval.
    """
    held = {advice.situation: advice for advice in advised}
    lines = []
    for title, situations in _LINES.items():
        told = [
            f"{word}: {_told(held[key])}" if word else _told(held[key])
            for key, word in situations.items()
            if key in held
        ]
        if told:
            lines.append(f"- **{title}.** {capital('; '.join(told))}.")
    return "\n".join(lines)


def _told(advice: Advice) -> str:
    """Return what to use in a situation, in half a sentence."""
    cases = counted(len(advice.cases), "case")
    if advice.situation == NOTHING:
        where = ", ".join(f"`{name}`" for name in advice.scenarios)
        return f"no causal estimator beats the INS in {cases} of {where}"
    chosen = advice.choice
    if chosen:
        return (
            f"**`{chosen.label}`**, {short(chosen.ms)} ms a run, {number(chosen.mean_ratio)} × "
            f"the bound, success in {share(chosen.worst, *SUCCESS)} where it is least"
        )
    text = f"no estimator is honest and good in {'all of ' if len(advice.cases) > 1 else ''}{cases}"
    if advice.standings:
        first = advice.standings[0]
        if first.good >= HALF:
            text += (
                f" (most often `{first.label}`, {percent(first.good)}: {short(first.ms)} ms a run, "
                f"{number(first.mean_ratio)} × the bound, success in "
                f"{share(first.worst, *SUCCESS)} where it is least)"
            )
        elif len(advice.cases) > 1:
            text += ", nor in half of them"
    left = [
        flown.found.best["position_median_m"] / flown.found.ins["position_median_m"]
        for flown in advice.cases
        if flown.found.best and flown.found.ins
    ]
    if left:
        text += f"; the best of each case leaves {number(geometric_mean(left))} of the INS's error"
    return f"{text}{_nobody(advice, '; in ')}"


def _nobody(advice: Advice, before: str) -> str:
    """Return in how many cases nobody is honest, behind some words; nothing if there is none."""
    return f"{before}{advice.nobody} of them nobody is honest" if advice.nobody else ""


def first_screen(advised: Sequence[Advice]) -> str:
    """Return the advice in markdown: a row for every situation that the library holds."""
    head = ["situation", "cases", "use", "good in", "success", "where it is least",
            "error / bound", "ms a run", f"as good, at another cost (× `{COST_OF}`)"]  # fmt: skip
    reading = (
        "*Good*: honest, and as good as the best causal estimator of the case, scenarios counting "
        "alike. *Success*: mean over the cases, and in the case in which it is least with its 95 % "
        "interval. *Error / bound*: medians of the runs that succeed."
    )
    return f"{markdown(head, [_row(advice) for advice in advised])}\n\n{reading}"


def overall(league: League) -> str:
    """Return in a sentence who is good most often over the cases that all of the roster ran."""
    held = [s for s in league.standings if s.causality == "filter"]
    if not held:
        return ""
    said = ", ".join(f"`{s.label}` in {percent(s.good)} ({number(s.ms)} ms a run)" for s in held)
    return (
        f"Over the {counted(len(league.common), 'case')} that the whole roster ran, whatever their "
        f"situation, honest and as good as the best causal estimator: {said}."
    )


def later(league: League, advised: Sequence[Advice]) -> str:
    """Return what an answer after the fact is worth, situation by situation; "" without any.

    By the paired comparison with the best causal estimator of each case, over the runs in which
    both succeed.
    """
    held = [s for s in league.standings if s.causality in SMOOTHERS and s.mean_success > 0.0]
    if not held:
        return ""
    best = max(held, key=lambda s: (round(s.mean_success, 2), -s.mean_ratio))
    told = [
        f"{word or title.lower()}: {number(ratio)}"
        for title, situations in _LINES.items()
        for key, word in situations.items()
        for advice in advised
        if advice.situation == key != NOTHING
        and math.isfinite(ratio := geometric_mean(_against_best(advice.cases, best.label)))
    ]
    if not told:
        return ""
    return (
        f"**If the answer may wait**: the error of `{best.label}` ({best.causality}, "
        f"{cost(best)}) over that of the best causal estimator, run by run. "
        f"{capital('; '.join(told))}."
    )


def _against_best(cases: Iterable[Flown], label: str) -> Iterable[float]:
    """Yield the mean ratio of an estimator's errors to the best one's, of cases that have both."""
    for flown in cases:
        if pair := flown.found.pairs.get(label):
            yield 1.0 / pair["error_ratio"] if pair["error_ratio"] else math.nan


def reasons(advised: Sequence[Advice]) -> str:
    """Return a list of what the advice of each situation rests on, and of who falls short."""
    return "\n".join(_reason(advice) for advice in advised)


def cost(standing: Standing) -> str:
    """Return an estimator's time beside the EKF's, or its own where there is none."""
    if math.isnan(standing.cost):
        return f"{short(standing.ms)} ms a run"
    return f"{short(standing.cost)} × the time of `{COST_OF}`"


def _row(advice: Advice) -> list[str]:
    where = f"{len(advice.cases)} in {counted(len(advice.scenarios), 'scenario')}"
    title = f"**{SITUATIONS[advice.situation]}**"
    if advice.situation == NOTHING:
        return [title, where, "`ins`: no causal estimator beats it", *[""] * 6]
    if not advice.standings:
        return [title, where, "no causal estimator ran in all of them", *[""] * 6]
    shown = advice.choice or advice.standings[0]
    named = f"**`{shown.label}`**"
    if not advice.choice:
        named = f"none{_nobody(advice, '; in ')}"
        if shown.good < HALF:
            # Who is good in fewer leads by chance, and its figures are no advice.
            return [title, where, f"{named}; nor in half of them", *[""] * 6]
        named += f"; most often `{shown.label}`"
    good = percent(shown.good)
    if shown.open:
        good += f" (in {percent(shown.open)} too few runs to tell)"
    return [
        title, where, named, good, percent(shown.mean_success), _least(shown.worst),
        number(shown.mean_ratio), short(shown.ms), some([_beside(s) for s in _alike(advice)]),
    ]  # fmt: skip


def _least(row: Mapping[str, Any]) -> str:
    return f"{share(row, *SUCCESS)} of {row['runs']}"


def _beside(standing: Standing) -> str:
    ratio = "" if math.isnan(standing.cost) else f" ({short(standing.cost)})"
    return f"`{standing.label}`{ratio}"


def _alike(advice: Advice) -> list[Standing]:
    """Return who is as good as the one that is advised."""
    return [s for s in advice.standings if s.good >= 1.0 - EXCEPTIONS and s is not advice.choice]


def _reason(advice: Advice) -> str:
    title = f"- **{SITUATIONS[advice.situation]}**, {some(advice.scenarios)}: "
    if advice.situation == NOTHING:
        cases = [f"{f.scenario}/{f.found.case.name}" for f in advice.cases]
        return f"{title}no causal estimator beats the INS in {', '.join(cases)}."
    shown = advice.choice or (advice.standings[0] if advice.standings else None)
    rest = [s for s in advice.standings if s is not shown and s not in _alike(advice)]
    if not rest:
        return f"{title}nobody falls short of it."
    return f"{title}not as good are {some([f'`{s.label}` ({_shortcomings(s)})' for s in rest])}."


def _shortcomings(standing: Standing) -> str:
    """Return in how much an estimator is not as good as the best."""
    text = f"as good in {percent(standing.good)}; success {percent(standing.mean_success)}"
    if math.isfinite(standing.mean_ratio):
        text += f", {number(standing.mean_ratio)} × the bound"
    if standing.honest <= 1.0 - EXCEPTIONS:
        text += f", honest in {percent(standing.honest)}"
    return text
