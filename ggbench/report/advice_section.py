"""Which estimator to use in which situation, in a table; and why not another."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..figures.numbers import counted, short, some
from .league import COST_OF, EXCEPTIONS, Advice, League, Standing
from .league_figure import number
from .shares import percent
from .situations import NOTHING, SITUATIONS
from .tables import markdown


def first_screen(advised: Sequence[Advice]) -> str:
    """Return the advice in markdown: a row for every situation that the library holds."""
    head = ["situation", "cases", "use", "honest and as good as the best", "success",
            "error / bound", "ms a run",
            f"as good, at another cost (× the time of `{COST_OF}`)"]  # fmt: skip
    return markdown(head, [_row(advice) for advice in advised])


def overall(league: League) -> str:
    """Return in a sentence who is good most often over the cases that all of the roster ran."""
    held = [s for s in league.standings if s.causality == "filter"]
    if not held:
        return ""
    said = ", ".join(f"`{s.label}` in {percent(s.good)} ({number(s.ms)} ms a run)" for s in held)
    return (
        f"**Over the {counted(len(league.common), 'case')} that the whole roster ran, honest and "
        f"as good as the best causal estimator: {said}.**"
    )


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
        return [title, where, "`ins`: no causal estimator beats it", *[""] * 5]
    if not advice.standings:
        return [title, where, "no causal estimator ran in all of them", *[""] * 5]
    shown = advice.choice or advice.standings[0]
    named = f"**`{shown.label}`**"
    if not advice.choice:
        named = f"none is good everywhere; most often `{shown.label}`"
    good = percent(shown.good)
    if shown.open:
        good += f" (in {percent(shown.open)} too few runs to tell)"
    return [
        title, where, named, good, percent(shown.mean_success), number(shown.mean_ratio),
        short(shown.ms), some([_beside(s) for s in _alike(advice)]),
    ]  # fmt: skip


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
