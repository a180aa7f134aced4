"""The section of a report on tuning: what each estimator gains if its parameters are chosen."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..figures.numbers import counted, short
from ..judging.ranking import best, honest, rows_of
from ..results.folder import Results
from .shares import percent
from .tables import DEFINITIONS, markdown


@dataclass(frozen=True)
class Tuned:
    """A grid in a case: what was chosen on half of the runs, and how it does on the other half.

    Attributes
    ----------
    case, name : title of the case; the estimator, with its causality.
    runs : number of runs on which it is judged.
    label : of the variant that was chosen.
    plain, chosen : rows of the summary of the runs that judge.
    """

    case: str
    name: str
    runs: int
    label: str
    plain: Mapping[str, Any]
    chosen: Mapping[str, Any]

    @property
    def gain(self) -> str:
        """``better`` or ``worse`` than the plain one, beyond both intervals; ``open``; ``same``.

        Success counts first, then the error over the bound of the runs that succeed.
        """
        if self.chosen["label"] == self.plain["label"]:
            return "same"
        for low, high, sign in (
            ("success_lo", "success_hi", 1.0),
            ("ratio_median_lo", "ratio_median_hi", -1.0),
        ):
            ends = [
                sorted((sign * row[low], sign * row[high])) for row in (self.plain, self.chosen)
            ]
            if ends[1][0] > ends[0][1]:
                return "better"
            if ends[1][1] < ends[0][0]:
                return "worse"
        return "open"

    @property
    def mends(self) -> bool:
        """Whether the plain estimator is not honest, and the chosen one is."""
        return honest(self.chosen) and not honest(self.plain)


def tuned(results: Results) -> list[Tuned]:
    """Return every grid of every case; none where the scenario asks for no tuning.

    Variants of one estimator of one causality are a grid. In each case the best of them
    (:func:`.ranking.best`) on the runs of even number is judged on those of odd number, beside the
    plain one, which is asked for with the fewest parameters.
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
            chosen = best(tried[label] for label in grid if label in tried)
            if chosen is None:
                continue
            label, plain = str(chosen["label"]), min(grid, key=lambda k: k.count("="))
            if plain in found and label in found:  # else no run of odd number is there
                told.append(Tuned(case.title, name, common // 2, label, found[plain], found[label]))
    return told


def tuning_section(told: Sequence[Tuned]) -> list[str]:
    """Return the section as markdown; nothing without a grid."""
    if not told:
        return []
    rows = [
        [each.case, each.name, str(each.runs), *_figures(each.plain), f"`{each.label}`",
         *_figures(each.chosen), _GAINS[each.gain] + (", honest now" if each.mends else "")]
        for each in told
    ]  # fmt: skip
    head = ["case", "estimator", "runs judged", "plain: success", "error / bound",
            "tuned: which", "success", "error / bound", "gain"]  # fmt: skip
    reading = (
        "Every estimator with the best of its variants: chosen in each case on the runs of even "
        "number, judged, as the plain one beside it, on those of odd number. Median error over "
        "bound of the runs that succeed, with its 95 % interval. Of variants of which some got "
        "fewer runs only these are looked at. Better or worse: beyond both intervals, in success "
        f"or, where that is not told apart, in error ([definitions]({DEFINITIONS}))."
    )
    return ["## Tuned and not", reading, markdown(head, rows)]


_GAINS = {"better": "better", "worse": "worse", "open": "not told apart", "same": "none: the plain"}


def tuning_answer(told: Sequence[Tuned]) -> str:
    """Return in markdown what tuning buys, case by case: a bold sentence or two."""
    parts = []
    for case in dict.fromkeys(each.case for each in told):
        of_case = [each for each in told if each.case == case]
        gains = Counter(each.gain for each in of_case)
        better = sorted((e for e in of_case if e.gain == "better"), key=_left)
        text = f"*{case}*: {gains['better']} of {counted(len(of_case), 'estimator')}"
        if better:
            text += f" (most: {', '.join(_said(each) for each in better[:2])})"
        if mended := sum(each.mends for each in of_case):
            text += f", and {mended} honest only so"
        if gains["worse"]:
            text += f"; {gains['worse']} lose"
        parts.append(text)
    return (
        "**What gains beyond the intervals, if the parameters of a small grid are chosen on half "
        f"of the runs and judged on the others: {'; '.join(parts)}.**"
    )


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
    return f"{text} {before} → {after} × the bound"


def _grids(results: Results, rows: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the variants of each estimator that has some."""
    found: dict[str, list[str]] = {}
    for label in results.labels:
        if label in rows:
            name = f"`{label.partition('[')[0]}`, {rows[label]['causality']}"
            found.setdefault(name, []).append(label)
    return {name: grid for name, grid in found.items() if len(grid) > 1}


def _figures(row: Mapping[str, Any]) -> list[str]:
    """Return success and error over bound of an estimator, marked if it is not honest."""
    mark = "" if honest(row) else " †"
    if not math.isfinite(row["ratio_median"]):
        return [percent(row["success_share"]), f"–{mark}"]
    text = short(row["ratio_median"])
    low, high = row["ratio_median_lo"], row["ratio_median_hi"]
    if not math.isnan(low):
        text += f" [{short(low)}, {short(high)}]"
    return [percent(row["success_share"]), f"{text}{mark}"]
