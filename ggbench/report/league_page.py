"""The front page of the reports: which estimator to use when, the league, the scenarios."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from ..figures.numbers import counted, some
from ..figures.style import save
from . import advice_section, definitions
from .league import ABOUT, COST_OF, EXCEPTIONS, SMOOTHERS, Entry, Flown, League, geometric_mean
from .league import read as read_league
from .league_figure import draw, number
from .nonlinearity_section import opening_figure
from .scenario_report import ReportError
from .shares import percent
from .situations import LONG_S, NARROW, NOTHING, WIDE, is_right_model
from .tables import DEFINITIONS, markdown

FILE = "README.md"
"""Name of the page in a folder of reports."""
FIGURE = "README/league.png"
"""Its figure of the league, beside it."""


def write(output: Path) -> tuple[Path, list[str]]:
    """Write ``README.md`` and the figures in ``README/`` of a folder of reports.

    Parameters
    ----------
    output : folder of the reports of the scenarios, each with its digest.

    Returns
    -------
    Path of the markdown file, and a sentence for each scenario that is left out.

    Raises
    ------
    ReportError
        If nothing is finished, or a file cannot be written.
    """
    league, remarks = read_league(output)
    if not league.cases:
        raise ReportError("; ".join(["no scenario is finished that could be reported", *remarks]))
    path = output / FILE
    try:
        (output / "README").mkdir(parents=True, exist_ok=True)
        definitions.write(output)
        path.write_text(LeagueReport(league, output, remarks).text(), encoding="utf-8")
    except OSError as error:
        raise ReportError(f"cannot write to {output}: {error.strerror}") from None
    return path, remarks


class LeagueReport:
    """The page in the making.

    Parameters
    ----------
    league : the library.
    output : folder of the reports.
    remarks : what is left out, and why.
    """

    def __init__(self, league: League, output: Path, remarks: Sequence[str] = ()) -> None:
        self.league, self.output, self.remarks = league, output, remarks
        self.names = [entry.name for entry in league.entries]

    def text(self) -> str:
        """Return the page as markdown, and draw its figures."""
        cases, scenarios = len(self.league.cases), len(self.names)
        advised = list(self.league.advice())
        parts = [
            "# Which estimator should I use when, and what does it cost?",
            advice_section.answer(advised),
            advice_section.first_screen(advised),
            advice_section.later(self.league, advised),
            f"This was found on {counted(cases, 'case')} in {counted(scenarios, 'scenario')}, all "
            f"estimators on the same flights and random numbers; every scenario counts alike. "
            f"Limits: {_LIMITS}. What the words mean: [definitions]({DEFINITIONS}); by which "
            "rules: [below](#rules).",
            opening_figure(self.output),
            "## The league",
            advice_section.overall(self.league),
            self._league(),
            self._holes(),
            self._sample(),
            self._pictured(),
            "## Scenario by scenario",
            self._by_scenario(),
            self._others(),
            "## Why not another",
            advice_section.reasons(advised),
            "## Rules",
            self._rules(),
            "## The scenarios",
            self._scenarios(),
            "## How this was made",
            self._making(),
        ]
        return "\n\n".join(part.strip() for part in parts if part.strip()) + "\n"

    def _rules(self) -> str:
        rules = {
            "Advised": "the cheapest of the causal estimators that ran in all cases of the "
            f"situation, and are honest and as good as the best in all of them but "
            f"{100.0 * EXCEPTIONS:.0f} % (scenarios counting equally), those included in which the "
            "runs are too few to tell; of those within "
            f"{100.0 * (ABOUT - 1.0):.0f} % of its time the one with the fewest parameters.",
            "Situations": "the first that fits a case: *aiding gains nothing*, if the best causal "
            "estimator is not better than the INS; a receiver that fails; readings, or a map, that "
            "`[truth]` or `[model]` set apart from what the estimators are told (a map's error may "
            "be told as biases of the readings, which are states); gravity that is "
            "felt and not compensated; no gradiometer on board; a prior of "
            f"{WIDE:g} σ/ℓ or more, or of {NARROW:g} or more; a flight of {LONG_S / 60.0:g} min or "
            "more; anything else that is set apart; a narrow prior and a right model.",
            "Ranks": "over the cases that all of the standard roster ran, and no others: by the "
            "share in which an estimator is honest and as good as the best, then by success, error "
            "and cost. Nothing is imputed.",
            "Cost": f"the median time of a run over that of `{COST_OF}` on the same case.",
        }
        return "\n".join(f"- *{name}*: {text}" for name, text in rules.items())

    def _league(self) -> str:
        """Return the table of the roster over the common cases, smoothers in their own block."""
        if not self.league.standings:
            return "No case was run by the whole standard roster: nobody is ranked."
        head = ["", "estimator", "as good as the best, honest", "too few runs to tell", "success",
                "error / bound", "honest", "lost", f"time / {COST_OF}", "ms/run"]  # fmt: skip
        rows, place, block = [], 0, "filter"
        for standing in self.league.standings:
            if standing.causality in SMOOTHERS and block not in SMOOTHERS:
                rows.append(["", "*smoothers*", *[""] * (len(head) - 2)])
            block = standing.causality
            causal = block == "filter"
            place += causal
            rows.append(
                [
                    str(place) if causal else "",
                    f"`{standing.label}`",
                    percent(standing.good) if causal else "",
                    percent(standing.open) if causal else "",
                    percent(standing.mean_success),
                    number(standing.mean_ratio),
                    percent(standing.honest),
                    percent(standing.lost),
                    number(standing.cost),
                    number(standing.ms),
                ]
            )
        common = self.league.common
        scenarios = len({flown.scenario for flown in common})
        reading = (
            f"Over the {counted(len(common), 'case')} in {counted(scenarios, 'scenario')} that all "
            "of them ran; shares and means are over scenarios, each counting alike. *Error / "
            "bound*: geometric mean of the medians over the runs that succeed, of each estimator "
            "beside the bound of its kind."
        )
        return f"{markdown(head, rows)}\n\n{reading}"

    def _holes(self) -> str:
        """Return which estimators of the roster a scenario lacks, and why."""
        told = []
        for name, missing in self.league.holes().items():
            reasons: dict[str, list[str]] = {}
            for label, why in missing.items():
                reasons.setdefault(why, []).append(f"`{label}`")
            parts = [f"{', '.join(labels)} ({why})" for why, labels in reasons.items()]
            told.append(f"- [{name}]({self._link(name)}): {'; '.join(parts)}")
        if not told:
            return "The whole roster ran in every scenario."
        return "\n".join(["Not run, and why:", "", *told])

    def _sample(self) -> str:
        """Return whether the INS, of which nothing is estimated, is as consistent as it must be."""
        held = [f for f in self.league.cases if f.found.ins and is_right_model(f.found.case)]
        beyond = [
            f"{flown.scenario}/{flown.found.case.name}"
            for flown in held
            if (row := flown.found.ins) and not row["nees_lo"] <= row["nees_mean"] <= row["nees_hi"]
        ]
        if not held:
            return ""
        text = (
            "*Check of the samples*: the INS alone, of which nothing is estimated, has its mean "
            f"NEES within the 95 % band in {len(held) - len(beyond)} of "
            f"{counted(len(held), 'case')} whose model is right"
        )
        if not beyond:
            return f"{text}."
        return (
            f"{text}, and not in {some(beyond)}; by chance one independent sample in "
            "twenty is not, and cases of one scenario share theirs."
        )

    def _pictured(self) -> str:
        shown = self.league.over_all
        if not shown:
            return ""
        save(draw(shown, self.names), self.output / FIGURE)
        picture = (
            "Share of success (colour) and error over bound (number) of every estimator, over the "
            "cases of each scenario"
        )
        return f"![{picture}]({FIGURE})\n\n*{picture}*"

    def _by_scenario(self) -> str:
        """Return the table of the roster over all scenarios: error over bound, and success."""
        labels = [s.label for s in self.league.standings] or self.league.roster
        head = ["scenario", *(f"`{label}`" for label in labels)]
        rows = []
        for entry in self.league.entries:
            cells = [f"[{entry.name}]({self._link(entry.name)})"]
            for label in labels:
                cells.append(_cell([f for f in entry.cases if label in f.rows], label))
            rows.append(cells)
        return (
            f"{markdown(head, rows)}\n\nGeometric mean over the cases of the median error over the "
            "bound, and in brackets the mean share of success, if it is not all. Of who got fewer "
            "runs it is the best one's, divided by the mean ratio in common runs. Far below 1 a "
            "bound is no bound: it is that of the model, which the truth need not follow."
        )

    def _others(self) -> str:
        """Return what estimators beyond the roster did, in a table."""
        held = [s for s in self.league.others if s.scenarios > 1]
        if not held:
            return ""
        head = ["beyond the roster", "cases", "scenarios", "as good as the best, honest",
                "success", "error / bound", "honest", f"time / {COST_OF}"]  # fmt: skip
        rows = [
            [
                f"`{s.label}`", str(s.cases), str(s.scenarios),
                percent(s.good) if s.causality == "filter" else "–",
                percent(s.mean_success), number(s.mean_ratio), percent(s.honest), number(s.cost),
            ]
            for s in sorted(held, key=lambda s: -s.good)
        ]  # fmt: skip
        return (
            f"{markdown(head, rows)}\n\nOver the cases that each of them ran, which differ: no "
            "ranking. What is not causal is not set beside the best causal one (–). Those of one "
            "scenario are in its report alone."
        )

    def _scenarios(self) -> str:
        head = ["scenario", "what it is for", "cases", "best causal estimator", "INS [m]",
                "best [m]", "bound [m]"]  # fmt: skip
        rows = []
        for entry in self.league.entries:
            flown = entry.cases
            best = [f.found.best for f in flown if f.found.best]
            firsts = Counter(str(row["label"]) for row in best)
            named = ", ".join(
                f"`{label}`" + (f" ({count})" if len(flown) > 1 else "")
                for label, count in firsts.most_common()
            )
            nothing = sum(f.situation == NOTHING for f in flown)
            if nothing:
                which = f" in {nothing} of {len(flown)}" if nothing < len(flown) else ""
                named = f"{named or 'none'}; gains nothing{which}"
            unaided = [f.found.ins for f in flown if f.found.ins]
            loaded = entry.digest.scenario
            rows.append(
                [
                    f"[{loaded.title}]({self._link(loaded.name)})",
                    first_sentence(loaded.description),
                    str(len(flown)),
                    named or "none",
                    number(geometric_mean(row["position_median_m"] for row in unaided)),
                    number(geometric_mean(row["position_median_m"] for row in best)),
                    number(geometric_mean(row["position_bound_m"] for row in best)),
                ]
            )
        note = (
            "Median position error of a run in the settled window; of several cases the geometric "
            "mean, and behind an estimator the number of cases in which it is the best."
        )
        return f"{markdown(head, rows)}\n\n{note}"

    def _link(self, name: str) -> str:
        """Return the link to a scenario's report."""
        return quote(f"{name}.md")

    def _making(self) -> str:
        manifests = [entry.digest.manifest for entry in self.league.entries]
        head = ["scenario", "runs", "seed", "run on", "ggbench", "results version",
                "scenario's hash", "fewer runs"]  # fmt: skip
        rows = [_stamp(entry) for entry in self.league.entries]
        versions = {", ".join(f"{k} {v}" for k, v in m["versions"].items()) for m in manifests}
        machines = {
            f"{m['system']} on {m['architecture']}, {m['processors']} processors"
            for m in (manifest["machine"] for manifest in manifests)
        }
        numbers = {manifest["results_version"] for manifest in manifests}
        studied = " --assumptions" if any(m["assumptions"] for m in manifests) else ""
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
        if len(numbers) > 1:
            lines.append(
                f"- The scenarios were run with {len(numbers)} different versions of results: "
                "what changed between them is part of their differences."
            )
        lines += [f"- {remark}" for remark in self.remarks]
        return "\n".join([*lines, "", markdown(head, rows)])


_LIMITS = (
    "simulation throughout; maps that are rebuilt, or of the terrain alone; instruments whose "
    "mount is perfect where a scenario does not say otherwise"
)


def _stamp(entry: Entry) -> list[str]:
    m = entry.digest.manifest
    fewer = ", ".join(f"`{label}` {runs}" for label, runs in entry.fewer.items())
    return [m["scenario"], str(m["runs"]), str(m["seed"]), m["date"][:10], m["ggbench"],
            str(m["results_version"]), m["scenario_hash"][:16], fewer]  # fmt: skip


def _cell(ran: Sequence[Flown], label: str) -> str:
    """Return error over bound and success of an estimator over the cases of a scenario it ran."""
    if not ran:
        return "–"
    success = sum(flown.rows[label]["success_share"] for flown in ran) / len(ran)
    text = number(geometric_mean(flown.ratio(label) for flown in ran))
    return text if success == 1.0 else f"{text} ({percent(success)})"


def first_sentence(text: str) -> str:
    """Return the first sentence of a description."""
    plain = " ".join(text.split())
    ends = re.finditer(r"(?<!\bal)(?<!\be\.g)(?<!\bi\.e)(?<!\bcf)[.?!](?=\s+[^a-z\s]|$)", plain)
    end = next(ends, None)
    return plain[: end.end()] if end else plain
