"""The section of a report on tuning: what each estimator gains if its parameters are chosen."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..figures.numbers import counted, short
from ..judging.ranking import best, consistent, pair_of, rows_of
from ..judging.statistics import BETTER, UNDECIDED, WORSE
from ..results.folder import Results
from ..spec.case import CaseSpec
from .answer_section import Rows
from .families import kinds, plain_of
from .realisations_section import MAPS, groups
from .shares import percent
from .tables import DEFINITIONS, markdown

if TYPE_CHECKING:
    import pandas as pd

SAME = "the plain one"
"""What is gained if the plain one is chosen."""


@dataclass(frozen=True)
class Tuned:
    """A grid in a case: what was chosen on half of the runs, and how it does on the other half.

    Attributes
    ----------
    case, name : title of the case; the estimator, with its causality.
    runs : number of runs on which it is judged.
    label : of the variant that was chosen.
    plain, chosen : rows of the summary of the runs that judge, their errors over one bound.
    gain : the verdict on the chosen one beside the plain one, run by run
        (:func:`ggbench.judging.success.compared`); :data:`SAME` if it is the plain one.
    """

    case: str
    name: str
    runs: int
    label: str
    plain: Mapping[str, Any]
    chosen: Mapping[str, Any]
    gain: str

    @property
    def mends(self) -> bool:
        """Whether the plain estimator is not honest, and the chosen one is."""
        return consistent(self.chosen) and not consistent(self.plain)


def tuned(results: Results) -> list[Tuned]:
    """Return every grid of every case; none where the scenario asks for no tuning.

    Variants of one estimator of one causality are a grid. In each case the best of them
    (:func:`.ranking.best`) on the runs of even number is judged on those of odd number, beside the
    plain one (:func:`.families.plain_of`). Errors are over the plain one's bound: a longer lag has
    a lower one of its own, which says nothing of what it gains.
    """
    if not results.scenario.campaign.tuning:
        return []
    summary, told = results.summary(), list[Tuned]()
    for case in results.scenario.cases:
        held = rows_of(summary, case, "settled")
        for name, grid in _grids(results, held).items():
            # Who got fewer runs sets how many are looked at: all of a grid fly the same ones.
            common = min(int(held[label]["runs"]) for label in grid)
            tried, found = (rows_of(half, case, "settled") for half in results.halves(common))
            plain = plain_of(grid)
            label = _chosen(tried, grid, held[plain]["position_bound_m"])
            if label is None or not {plain, label} <= found.keys():  # no run of odd number is there
                continue
            gain = SAME
            if label != plain:
                pairs = results.judged_pairs(case.name, (plain, label), common)
                gain = _gain(pairs, case, label, plain)
            told.append(_judged(case, name, common // 2, label, plain, found, gain))
    return told


def on_other_maps(results: Results) -> list[Tuned]:
    """Return for maps of one error what was chosen over the first, as it does over each other one.

    A map's error is the same in all runs: runs that judge over the map that chose hold nothing out
    of it. None where the scenario asks for no tuning, or no map was drawn twice.
    """
    if not results.scenario.campaign.tuning:
        return []
    drawn = [maps for what, maps in groups(results.scenario.cases) if what == MAPS]
    if not drawn:
        return []
    summary, pairs, told = results.summary(), results.paired(), list[Tuned]()
    for first, *others in drawn:
        tried = rows_of(summary, first, "settled")
        tables = [(other, rows_of(summary, other, "settled")) for other in others]
        for name, grid in _grids(results, tried).items():
            plain = plain_of(grid)
            label = _chosen(tried, grid, tried[plain]["position_bound_m"])
            if label is None or label == plain:
                continue
            for other, found in tables:
                if {plain, label} <= found.keys():
                    runs = min(int(found[k]["runs"]) for k in (plain, label))
                    gain = _gain(pairs, other, label, plain)
                    told.append(_judged(other, name, runs, label, plain, found, gain))
    return told


def _chosen(rows: Rows, grid: Iterable[str], bound: float) -> str | None:
    """Return the label of the best of a grid, all errors over one bound [m]; None without any."""
    row = best(_over(rows[label], bound) for label in grid if label in rows)
    return None if row is None else str(row["label"])


def _gain(pairs: pd.DataFrame, case: CaseSpec, label: str, plain: str) -> str:
    """Return the verdict on a variant beside the plain one."""
    pair = pair_of(pairs, case.name, label, plain)
    return str(pair["verdict"]) if pair else UNDECIDED


def _judged(
    case: CaseSpec, name: str, runs: int, label: str, plain: str, rows: Rows, gain: str
) -> Tuned:
    bound = rows[plain]["position_bound_m"]
    first, second = (_over(rows[k], bound) for k in (plain, label))
    return Tuned(case.title, name, runs, label, first, second, gain)


def _over(row: Mapping[str, Any], bound: float) -> dict[str, Any]:
    """Return a row of the summary with its ratios over another bound [m]."""
    scale = row["position_bound_m"] / bound
    return {k: v * scale if k.startswith("ratio_") else v for k, v in row.items()}


def tuning_section(told: Sequence[Tuned], elsewhere: Sequence[Tuned] = ()) -> list[str]:
    """Return the section as markdown; nothing without a grid.

    ``elsewhere`` is what :func:`on_other_maps` finds.
    """
    if not told:
        return []
    reading = (
        "Every estimator with the best of its variants: chosen in each case on the runs of even "
        "number, judged, as the plain one beside it, on those of odd number. Median error over "
        "the plain one's bound of the runs that succeed, with its 95 % interval. Of variants of "
        "which some got fewer runs only these are looked at. *Gain*: the verdict run by run, in "
        f"success first, then in error; of {counted(len(told), 'comparison')} of estimators that "
        "do not differ up to a tenth would be called better or worse "
        f"([definitions]({DEFINITIONS}))."
    )
    parts = ["## Tuned and not", reading, _table(told)]
    if elsewhere:
        gains = Counter(each.gain for each in elsewhere)
        lies = sum(not consistent(each.chosen) for each in elsewhere)
        parts += [
            "The error of a map is the same in all runs, so that those which judge above hold "
            "nothing out of it. Chosen over the first of the maps of an error, and flown over the "
            f"others, a variant is better than the plain one in {gains[BETTER]} of "
            f"{len(elsewhere)}, worse in {gains[WORSE]}, and not honest in {lies}:",
            _table(elsewhere),
        ]
    return parts


def _table(told: Sequence[Tuned]) -> str:
    rows = [
        [each.case, each.name, str(each.runs), *_figures(each.plain), f"`{each.label}`",
         *_figures(each.chosen), each.gain + (", and honest now" if each.mends else "")]
        for each in told
    ]  # fmt: skip
    head = ["case", "estimator", "runs judged", "plain: success", "error / bound",
            "tuned: which", "success", "error / bound", "gain"]  # fmt: skip
    return markdown(head, rows)


def tuning_answer(told: Sequence[Tuned]) -> str:
    """Return in markdown what tuning buys, case by case: a list."""
    parts = []
    for case in dict.fromkeys(each.case for each in told):
        of_case = [each for each in told if each.case == case]
        gains = Counter(each.gain for each in of_case)
        better = sorted((e for e in of_case if e.gain == BETTER), key=_left)
        text = f"*{case}*: {gains[BETTER]} of {counted(len(of_case), 'estimator')}"
        if better:
            text += f" (most: {', '.join(_said(each) for each in better[:2])})"
        mended = sum(e.mends for e in of_case)
        consistent_before = sum(consistent(e.plain) for e in of_case)
        if mended:
            text += f", {mended} become honest"
        elif better and not consistent_before and not any(consistent(e.chosen) for e in of_case):
            text += ", none is honest with or without"
        if gains[WORSE]:
            text += f"; {counted(gains[WORSE], 'estimator')} worse"
        parts.append(text)
    lead = (
        "**What gains, run by run, if the parameters of a small grid are chosen on half of the "
        "runs and judged on the others:**"
    )
    return "\n".join([lead, "", *(f"- {part}" for part in parts)])


def _left(each: Tuned) -> float:
    """Return what is left of the plain one's error over the bound; less where more succeed."""
    share = each.plain["success_share"] / each.chosen["success_share"]
    ratio = each.chosen["ratio_median"] / each.plain["ratio_median"]
    return float(share * ratio) if math.isfinite(ratio) else 0.0


def _said(each: Tuned) -> str:
    shares = [percent(row["success_share"]) for row in (each.plain, each.chosen)]
    ratios = [row["ratio_median"] for row in (each.plain, each.chosen)]
    text = f"`{each.label}`"
    if shares[0] != shares[1]:
        text += f" success {shares[0]} → {shares[1]},"
    before, after = (short(r) if math.isfinite(r) else "–" for r in ratios)
    mark = "" if consistent(each.chosen) else ", not honest"
    return f"{text} {before} → {after} × the bound{mark}"


def _grids(results: Results, rows: Rows) -> dict[str, list[str]]:
    """Return the variants of each estimator that has some."""
    found = kinds((label for label in results.labels if label in rows), rows)
    return {f"`{name}`, {kind}": grid for (name, kind), grid in found.items() if len(grid) > 1}


def _figures(row: Mapping[str, Any]) -> list[str]:
    """Return success and error over bound of an estimator, marked if it is not honest."""
    mark = "" if consistent(row) else " †"
    if not math.isfinite(row["ratio_median"]):
        return [percent(row["success_share"]), f"–{mark}"]
    text = short(row["ratio_median"])
    low, high = row["ratio_median_lo"], row["ratio_median_hi"]
    if not math.isnan(low):
        text += f" [{short(low)}, {short(high)}]"
    return [percent(row["success_share"]), f"{text}{mark}"]
