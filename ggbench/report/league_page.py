"""The front page of the reports: which estimator to use when, the league, the scenarios."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from urllib.parse import quote

from ..figures.numbers import short
from ..figures.style import save
from .league import (
    COST_OF,
    EXCEPTIONS,
    SMOOTHERS,
    UNCERTAIN,
    WITHIN,
    Advice,
    Entry,
    League,
    Standing,
    geometric_mean,
    read,
)
from .league_figure import draw, number
from .scenario_report import ReportError
from .situations import LONG_S, NOTHING, SITUATIONS, WIDE_M
from .tables import markdown

_MOST_NAMED = 6


def write(folders: Iterable[Path], output: Path) -> tuple[Path, list[str]]:
    """Write ``README.md`` and ``README/league.png`` for a library of results folders.

    Parameters
    ----------
    folders : results folders, one for each scenario; what cannot be used is left out.
    output : folder to write to, where the reports of the scenarios are.

    Returns
    -------
    Path of the markdown file, and a sentence for each folder that is left out.

    Raises
    ------
    ReportError
        If nothing is finished, or a file cannot be written.
    """
    league, remarks = read(folders)
    if not league.cases:
        raise ReportError("; ".join(["no scenario is finished that could be reported", *remarks]))
    path = output / "README.md"
    try:
        (output / "README").mkdir(parents=True, exist_ok=True)
        text = LeagueReport(league, output, remarks).text()
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ReportError(f"cannot write to {output}: {error.strerror}") from None
    return path, remarks


class LeagueReport:
    """The page in the making.

    Parameters
    ----------
    league : the library. output : folder of the reports. remarks : what is left out, and why.
    """

    def __init__(self, league: League, output: Path, remarks: Sequence[str] = ()) -> None:
        self.league, self.output, self.remarks = league, output, remarks
        self.names = [entry.scenario.name for entry in league.entries]

    def text(self) -> str:
        """Return the page as markdown, and draw its figure."""
        save(draw(self.league.standings, self.names), self.output / "README" / "league.png")
        cases, scenarios = len(self.league.cases), len(self.names)
        picture = "Position MRSE of every estimator over that of the best causal one"
        parts = [
            "# Which estimator should I use when, and what does it cost?",
            "\n".join(self._advice(advice) for advice in self.league.advice()),
            self._later(),
            f"This was found on {cases} cases in {scenarios} scenarios, on the same random "
            "numbers for all estimators, by these rules:",
            self._rules(),
            "## The league",
            self._league(lambda s, name: number(s.by_scenario.get(name, math.nan)), whole=True),
            self._reading(),
            self._local(),
            f"![{picture}](README/league.png)\n\n*{picture}*",
            "## Efficiency: position MRSE over the Cramér–Rao bound",
            self._league(lambda s, name: number(s.efficiency.get(name, math.nan)), whole=False),
            "Geometric means over the cases of a scenario; every estimator beside the bound of its "
            "own kind (filter, fixed lag, batch), the INS beside that of a filter. Far below 1 a "
            "bound is no bound: it is that of the model, which the truth need not follow.",
            "## The scenarios",
            self._scenarios(),
            "## How this was made",
            self._making(),
        ]
        return "\n\n".join(part.strip() for part in parts if part.strip()) + "\n"

    def _advice(self, advice: Advice) -> str:
        """Return the advice for a situation as a list item."""
        count = len(advice.cases)
        where = f"{count} case{'s' if count > 1 else ''} of {self._few(advice.scenarios)}"
        title = f"- **{SITUATIONS[advice.situation]}** ({where}): "
        if advice.situation == NOTHING:
            return f"{title}{self._nothing(advice)}"
        if advice.choice is None:
            return f"{title}no causal estimator ran in half of them and can be judged."
        held = {standing.label: standing for standing in advice.standings}
        chosen = held[advice.choice]
        text = f"{title}**`{chosen.label}`**, {self._figures(chosen)}"
        equal = advice.equal[chosen.label]
        if advice.as_good:
            text += f"; as good as the best in {equal} of {chosen.ran}"
        else:
            text += (
                ", has the least errors; no estimator is as good as the best everywhere, it is in "
                f"{equal} of {chosen.ran}"
            )
        alike = [
            s
            for s in advice.standings
            if s is not chosen and s.ran - advice.equal[s.label] <= EXCEPTIONS * s.ran
        ]
        rest = [s for s in advice.standings if s is not chosen and s not in alike]
        if alike:
            costs = ", ".join(f"`{s.label}` ({_cost(s)})" for s in alike)
            text += f". As good, at another cost: {costs}"
        if rest:
            named = ", ".join(
                f"`{s.label}` (MRSE × {number(s.own)}{self._lock(s)}; as good in "
                f"{advice.equal[s.label]} of {s.ran})"
                for s in rest
            )
            text += f". Not as good: {named}"
        beside_ins = geometric_mean(_against_ins(advice, chosen.label))
        if beside_ins > 1.0:
            text += f". Its MRSE is {number(beside_ins)} times the INS's"
        return f"{text}."

    def _figures(self, standing: Standing) -> str:
        parts = [
            f"MRSE {number(standing.own)} times the best's and "
            f"{number(geometric_mean(standing.efficiency.values()))} times the bound"
        ]
        if not math.isnan(standing.locked):
            parts.append(f"{100.0 * standing.locked:.0f} % of the runs locked")
        if standing.lost:
            parts.append(f"{_share(standing.lost)} of the runs lost")
        return f"{', '.join(parts)}, {short(standing.ms)} ms a run ({_cost(standing)})"

    @staticmethod
    def _lock(standing: Standing) -> str:
        if math.isnan(standing.locked):
            return ""
        return f", {100.0 * standing.locked:.0f} % locked"

    def _nothing(self, advice: Advice) -> str:
        cases = [f"{flown.scenario}/{flown.case.name}" for flown in advice.cases]
        worse = [
            standing.label
            for standing in advice.standings
            if geometric_mean(_against_ins(advice, standing.label)) > UNCERTAIN
        ]
        text = f"the INS alone; no causal estimator beats it in {self._few(cases)}"
        if worse:
            named = ", ".join(f"`{label}`" for label in worse)
            text += f". More than 10 % worse than the INS: {named}"
        return f"{text}."

    @staticmethod
    def _few(names: Sequence[str]) -> str:
        shown = ", ".join(names[:_MOST_NAMED])
        more = len(names) - _MOST_NAMED
        return f"{shown} and {more} more" if more > 0 else shown

    def _later(self) -> str:
        """Return what an answer after the fact is worth."""
        held = [s for s in self.league.standings if s.causality in SMOOTHERS]
        held = [s for s in held if math.isfinite(s.score) and not self.league.is_partial(s)]
        if not held:
            return ""
        best = min(held, key=lambda s: s.score)
        waiting = "" if best.own < 1.0 else "over the whole library waiting does not pay: "
        return (
            f"**If the answer may wait**: {waiting}`{best.label}` ({best.causality}) has "
            f"{number(best.own)} times the MRSE of the best causal estimator, at {_cost(best)}; "
            f"{_share(best.lost)} of its runs failed or diverged."
        )

    def _rules(self) -> str:
        wide, long = f"{WIDE_M / 1000.0:g} km", f"{LONG_S / 60.0:g} min"
        rules = {
            "Errors": "of position, root mean square (MRSE) over the settled window and the runs.",
            "The best of a case": "the causal estimator of the least MRSE; not one that failed in "
            "more than 5 % of the runs, nor one that locks on surely less often than another "
            "(Wilson intervals apart).",
            "As good": f"MRSE at most {100.0 * (WITHIN - 1.0):.0f} % larger than the best's, or "
            f"at most {100.0 * (UNCERTAIN - 1.0):.0f} % larger and not distinguishable from it, "
            "run by run (paired bootstrap-t, 95 %); failing in 5 % of the runs at most, and "
            "locking on not surely less often.",
            "Advised": "the cheapest of those that are as good in all cases of the situation that "
            "they ran in, but one of twenty, and ran in half of it or more (scenarios counting "
            "equally); in all of it, if any of those did.",
            "Situations": "the first that fits a case: *aiding gains nothing*, if the best causal "
            "estimator is not significantly better than the INS and within 5 % of it, or "
            "significantly worse; a receiver that fails; readings, or a map, that `[truth]` or "
            "`[model]` set apart from "
            f"what the estimators are told; a prior of {wide} or more; a flight of {long} or "
            "more; anything else that is set apart; a narrow prior and a right model.",
            "Cost": f"the median time of a run over that of `{COST_OF}` on the same case.",
        }
        return "\n".join(f"- *{name}*: {text}" for name, text in rules.items())

    def _league(self, cell: Callable[[Standing, str], str], whole: bool) -> str:
        """Return a table of estimators over scenarios, smoothers in their own block."""
        head = ["", "estimator", *(f"[{name}]({self._link(name)})" for name in self.names)]
        if whole:
            head += ["all", "lost", "locked", "NEES in its band", f"time / {COST_OF}", "ms/run",
                     "cases run"]  # fmt: skip
        rows, place, block = [], 0, "filter"
        for standing in self.league.standings:
            if standing.causality in SMOOTHERS and block not in SMOOTHERS:
                rows.append(["", "*smoothers*", *[""] * (len(head) - 2)])
                place = 0
            block = standing.causality
            partial = self.league.is_partial(standing)
            ranked = block != "none" and not partial and math.isfinite(standing.score)
            place += ranked
            mark = " †" if partial else ""
            cells = [str(place) if ranked else "", f"`{standing.label}`{mark}"]
            cells += [cell(standing, name) for name in self.names]
            if whole:
                cells += [
                    f"**{number(standing.score)}**",
                    _share(standing.lost),
                    "–" if math.isnan(standing.locked) else f"{100.0 * standing.locked:.0f} %",
                    f"{standing.consistent} of {standing.judged}" if standing.judged else "–",
                    number(standing.cost),
                    number(standing.ms),
                    f"{standing.ran} of {len(self.league.cases)}",
                ]
            rows.append(cells)
        return markdown(head, rows)

    def _reading(self) -> str:
        text = (
            "Position MRSE over that of the best causal estimator of each case: geometric mean "
            "over the cases of a scenario, and in *all* over the scenarios, by which the league is "
            "ordered (equal to three digits: the cheaper first). Where an estimator was not run "
            "(–) it counts in *all* as the median of the others of its kind did there: "
            "nobody gains by staying away from hard scenarios. A failed run counts with the "
            "INS's error, since that is what is left without an estimate. *Lost*: runs that failed "
            "or diverged. *Locked*: mean share of the runs that locked on, over the cases in which "
            "that is judged. *NEES in its band*: cases in which the mean NEES of position and "
            "velocity lies in the 95 % band of a consistent estimator. Causal estimators and "
            "smoothers are not ranked against each other; `ins` "
            "is what is there without aiding."
        )
        if any(self.league.is_partial(s) for s in self.league.standings):
            text += (
                " † ran in less than half of the library (scenarios counting equally): listed last "
                "and not ranked."
            )
        return text

    def _local(self) -> str:
        """Return which estimators the tables leave out, variants of one counted together."""
        parts = []
        for name, labels in sorted(self.league.local.items()):
            kinds: dict[str, list[str]] = {}
            for label in labels:
                kinds.setdefault(label.partition("[")[0], []).append(label)
            told = [
                f"`{held[0]}`" if len(held) == 1 else f"`{kind}` in {len(held)} variants"
                for kind, held in kinds.items()
            ]
            parts.append(f"[{name}]({self._link(name)}): {', '.join(told)}")
        if not parts:
            return ""
        return f"Run in one scenario alone, and told of in its report only: {'; '.join(parts)}."

    def _scenarios(self) -> str:
        head = ["scenario", "what it is for", "cases", "best causal estimator", "INS [m]",
                "best [m]", "bound [m]"]  # fmt: skip
        rows = []
        for entry in self.league.entries:
            flown = entry.cases
            best = [f.best for f in flown if f.best]
            firsts = Counter(str(row["label"]) for row in best)
            named = ", ".join(
                f"`{label}`" + (f" ({count})" if len(flown) > 1 else "")
                for label, count in firsts.most_common()
            )
            nothing = sum(f.situation == NOTHING for f in flown)
            if nothing:
                which = f" in {nothing} of {len(flown)}" if nothing < len(flown) else ""
                named = f"{named or 'none'}; gains nothing{which}"
            rows.append(
                [
                    f"[{entry.scenario.title}]({self._link(entry.scenario.name)})",
                    first_sentence(entry.scenario.description),
                    str(len(flown)),
                    named or "none",
                    number(geometric_mean(f.ins["position_mrse_m"] for f in flown if f.ins)),
                    number(geometric_mean(row["position_mrse_m"] for row in best)),
                    number(geometric_mean(row["position_bound_m"] for row in best)),
                ]
            )
        note = (
            "Position MRSE in the settled window; of several cases the geometric mean, and behind "
            "an estimator the number of cases in which it is the best."
        )
        return f"{markdown(head, rows)}\n\n{note}"

    def _link(self, name: str) -> str:
        """Return the link to a scenario's report."""
        return quote(f"{name}.md")

    def _making(self) -> str:
        entries = self.league.entries
        head = ["scenario", "runs", "seed", "run on", "ggbench", "source", "scenario's hash",
                "fewer runs"]  # fmt: skip
        rows = [self._stamp(entry) for entry in entries]
        versions = {
            ", ".join(f"{k} {v}" for k, v in entry.manifest["versions"].items())
            for entry in entries
        }
        machines = {
            f"{m['system']} on {m['architecture']}, {m['processors']} processors"
            for m in (entry.manifest["machine"] for entry in entries)
        }
        sources = {entry.manifest["source_hash"] for entry in entries}
        studied = " --assumptions" if any(e.manifest["assumptions"] for e in entries) else ""
        lines = [
            "Generated, not edited. To get it again:",
            "",
            "```",
            f"ggbench run --all{studied} -o results",
            "ggbench report --all results -o reports",
            "```",
            "",
            "The exact command of each scenario is at the end of its report.",
            "",
            *(f"- {text}" for text in sorted(versions | machines)),
        ]
        if len(sources) > 1:
            lines.append(
                f"- The scenarios were run with {len(sources)} different sources of the package: "
                "what changed between them is part of their differences."
            )
        lines += [f"- {remark}" for remark in self.remarks]
        return "\n".join([*lines, "", markdown(head, rows)])

    @staticmethod
    def _stamp(entry: Entry) -> list[str]:
        m = entry.manifest
        fewer = ", ".join(f"`{label}` {runs}" for label, runs in entry.fewer.items())
        return [m["scenario"], str(m["runs"]), str(m["seed"]), m["date"][:10], m["ggbench"],
                m["source_hash"], m["scenario_hash"][:16], fewer]  # fmt: skip


def _against_ins(advice: Advice, label: str) -> list[float]:
    """Return an estimator's error over the INS's in the cases of a situation."""
    return [
        flown.error(label) / flown.ins["position_mrse_m"]
        for flown in advice.cases
        if flown.ins and label in flown.rows
    ]


def first_sentence(text: str) -> str:
    """Return the first sentence of a description."""
    plain = " ".join(text.split())
    ends = re.finditer(r"(?<!\bal)(?<!\be\.g)(?<!\bi\.e)(?<!\bcf)[.?!](?=\s+[^a-z\s]|$)", plain)
    end = next(ends, None)
    return plain[: end.end()] if end else plain


def _share(share: float) -> str:
    percent = 100.0 * share
    return f"{percent:.1f} %" if 0.0 < percent < 10.0 else f"{percent:.0f} %"


def _cost(standing: Standing) -> str:
    if math.isnan(standing.cost):
        return f"{short(standing.ms)} ms a run"
    return f"{short(standing.cost)} × the time of `{COST_OF}`"
