"""The report of a campaign: markdown and figures, made from a results folder alone."""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pandas as pd

from ..errors import GGBenchError
from ..figures import stored
from ..figures.numbers import counted
from ..figures.style import save
from ..judging.ranking import rows_of
from ..results import digest
from ..results.folder import Results
from ..results.store import DETAILED_RUN, SERIES_RUNS
from ..spec import scenario
from ..spec.case import CaseSpec
from . import definitions, tables
from .answer_section import aided, answer_figure, caveat, fewer, telling_cases
from .claims_section import claims_section
from .families import leaders, of_the_best
from .gravity_section import GravitySection
from .locking_section import ConvergenceReport
from .making_section import making_section
from .matching_section import matching_section
from .nonlinearity_section import NonlinearityReport, is_of_the_prior
from .opening import answer
from .parameter_section import parameter_section
from .particles_section import particles_section
from .published_section import beside_published, frameworks
from .realisations_section import realisations_section
from .sweep_section import SweepReport
from .tuning_section import Tuned, on_other_maps, tuned, tuning_answer, tuning_section


class ReportError(GGBenchError):
    """A report cannot be written."""


def write(folder: Path, output: Path) -> Path:
    """Write ``NAME.md`` and its figures (in ``NAME/``) for a results folder.

    Parameters
    ----------
    folder : results of ``ggbench run``, finished or interrupted.
    output : folder to write to; made if it does not exist.

    Returns
    -------
    Path of the markdown file.

    Raises
    ------
    StoreError, ScenarioError, ReportError
        If the folder is not a results folder, is damaged or holds no finished run.
    """
    results = Results(folder)
    summary = results.summary()
    if summary.empty:
        raise ReportError(f"{folder} holds no finished run to report")
    name = results.scenario.name
    pictures = output / name
    path = output / f"{name}.md"
    try:
        digest.write(results, pictures / digest.FOLDER)
        definitions.write(output)
        path.write_text(_Report(results, summary, pictures).text(), encoding="utf-8")
    except OSError as error:
        raise ReportError(f"cannot write to {output}: {error.strerror}") from None
    results.store.close()
    return path


class _Report:
    """One report in the making."""

    def __init__(self, results: Results, summary: pd.DataFrame, pictures: Path) -> None:
        self.results = results
        self.scenario = loaded = results.scenario
        self.summary = summary
        self.studies = results.studies()
        self.pictures = pictures
        self.manifest = results.manifest
        plain = () if loaded.sweep else loaded.cases  # a sweep's figures are of its summary alone
        self.arrays = {case.name: results.arrays(case.name) for case in plain}
        self.references = [case for case in loaded.cases if case.reference]

    @cached_property
    def paired(self) -> pd.DataFrame:
        """The paired comparisons, which cost time and are not in every report."""
        return self.results.paired()

    def text(self) -> str:
        """Return the whole report as markdown."""
        parts = self._of_sweep() if self.scenario.sweep else self._of_cases()
        return "\n\n".join(part.strip() for part in parts if part.strip()) + "\n"

    def _of_sweep(self) -> list[str]:
        if is_of_the_prior(self.scenario):
            return self._of_widths()
        sweep = SweepReport(self.scenario, self.summary, self.pictures)
        return [
            f"# {self.scenario.title}",
            sweep.answer(),
            self._seeking(),
            caveat(self.results, self.summary),
            *sweep.sections(),
            "## Estimators beside each other, run by run",
            tables.verdicts(self.paired),
            "## Assumptions",
            self._assumptions(),
            self.scenario.notes,
            "## How this was made",
            "Velocity errors, the other windows and all intervals are in the results folder's "
            "`summary.csv`.",
            making_section(self.results),
        ]

    def _of_widths(self) -> list[str]:
        widths = NonlinearityReport(digest.read(self.pictures / digest.FOLDER), self.pictures)
        return [
            f"# {self.scenario.title}",
            widths.answer(),
            self._seeking(),
            caveat(self.results, self.summary),
            self.scenario.description,
            *widths.sections(),
            "## Assumptions",
            self._assumptions(),
            self.scenario.notes,
            "## How this was made",
            making_section(self.results),
        ]

    def _of_cases(self) -> list[str]:
        return [
            f"# {self.scenario.title}",
            self._verdict(),
            self._seeking(),
            answer_figure(self.results, self.summary, self.pictures),
            caveat(self.results, self.summary),
            tables.glance(self.scenario, self.summary, self.paired),
            frameworks(self.results.estimators),
            self._beside_published(),
            self.scenario.description,
            *ConvergenceReport(self.results, self.summary, self.pictures).sections(),
            "## Results",
            self._windows(),
            self._unaided(),
            *(self._case_table(case) for case in self.scenario.cases),
            *realisations_section(self.scenario, self.summary),
            *tuning_section(self.tuned, on_other_maps(self.results)),
            *matching_section(self.results, self.pictures),
            *particles_section(self.results),
            *self._paired(),
            *parameter_section(self.results, self.summary, self.pictures),
            *claims_section(self.scenario, self.summary, self.paired),
            *GravitySection(self.results, self.arrays, self.pictures).sections(),
            "## Efficiency: MRSE over the Cramér–Rao bound, in every window",
            tables.efficiency(self.scenario, self.summary),
            "The bounds themselves, position [m] and velocity [m/s], filtering:",
            tables.bounds(self.scenario, self.arrays),
            "## Figures",
            self._figures(),
            "## Assumptions",
            self._assumptions(),
            self.scenario.notes,
            "## How this was made",
            making_section(self.results),
        ]

    @cached_property
    def tuned(self) -> list[Tuned]:
        """What the parameters of each estimator buy in each case."""
        return tuned(self.results)

    def _verdict(self) -> str:
        if self.tuned and not self.scenario.campaign.league:
            return tuning_answer(self.tuned)  # a study of tuning, and no race
        return beside_published(self.summary) or answer(self.scenario, self.summary, self.paired)

    def _seeking(self) -> str:
        """Return a warning of estimators that may have seen the truth, or nothing."""
        found = [f"`{label}` uses {names}" for label, names in self.results.seeking.items()]
        if not found:
            return ""
        return (
            f"**Read with care: {'; '.join(found)}. What looks through the process that runs it "
            "may have seen the truth: how such an estimator comes to its figures is told by its "
            "source alone.**"
        )

    def _beside_published(self) -> str:
        """Return the same of the whole flight, where errors were published, and of all cases.

        Which window a source means is seldom said, and the settled one is the kind one.
        """
        if not self.references:
            return ""
        parts = [
            "The same numbers over the whole flight, its first updates included:",
            tables.glance(self.scenario, self.summary, self.paired, "whole"),
        ]
        if len(self.references) < len(self.scenario.cases):
            parts.append(tables.errors_of_cases(self.scenario, self.summary, self.paired))
        return "\n\n".join(parts)

    def _windows(self) -> str:
        w = self.scenario.cases[0].windows
        return (
            f"Windows: the settled one from {w.settled_from_s:g} s on, the whole flight from the "
            f"first update, the last {w.last_s:g} s. Best first; causal estimators and smoothers "
            f"never share a block ([definitions]({tables.DEFINITIONS}))."
        )

    def _unaided(self) -> str:
        """Return what the INS does alone, from its stored errors at the end of the flight."""
        case = self.scenario.cases[0]
        series = self.results.series(case.name, "ins")
        if not len(series):
            return ""
        position, velocity = np.sqrt(np.mean(series[:, -1, :2] ** 2, axis=0) / 3.0)
        which = "" if self.references or len(self.scenario.cases) == 1 else " of the first case"
        return (
            f"The pure INS ends the flight{which}, after "
            f"{self.arrays[case.name]['times'][-1]:g} s, with "
            f"errors of {position:.0f} m and {velocity:.2f} m/s per axis (root mean square over "
            f"{counted(len(series), 'run')} and the three axes)."
        )

    def _case_table(self, case: CaseSpec) -> str:
        rows = rows_of(self.summary, case, "settled")
        if not rows:
            return ""
        updates = len(self.arrays[case.name]["times"])
        notes = []
        for label, row in rows.items():
            if row["diverged"] and math.isfinite(row["position_without_diverged_m"]):
                runs = "run" if row["diverged"] == 1 else counted(row["diverged"], "run")
                notes.append(
                    f"Without the {runs} that diverged `{label}` has a position MRSE of "
                    f"{row['position_without_diverged_m']:.3f} m."
                )
            elif row["diverged"]:
                notes.append(f"No run of `{label}` is left without those that diverged.")
            if row["failed"]:
                notes.append(
                    f"`{label}` failed in {counted(row['failed'], 'run')}: {self._failure(row)}"
                )
            notes += self._remarks(row)
        errors = tables.case_errors(case, self.summary)
        consistency = tables.case_consistency(case, self.summary, updates)
        return f"### {case.title}\n\n{errors}\n\n{consistency}\n\n{' '.join(notes)}"

    def _paired(self) -> list[str]:
        table = tables.paired(self.scenario, self.summary, self.paired)
        reading = (
            "Every estimator against the best causal one of its case, on the same runs: in how "
            "many runs one of them alone succeeds; where both do, the geometric mean of the ratio "
            "of their errors. All pairs and windows, and squared errors, are in the results "
            f"folder's `paired.csv` ([definitions]({tables.DEFINITIONS}))."
        )
        return ["## Estimators beside each other, run by run", reading, table] if table else []

    def _failure(self, row: dict[str, Any]) -> str:
        failures = self.results.failures()
        same = failures[
            (failures["case"] == row["case"])
            & (failures["estimator"] == row["label"])
            & (failures["assumption"] == "")
        ]
        first = same.iloc[0]
        return f"{first['reason']} (run {first['run']}; again: `{first['command']}`)."

    def _remarks(self, row: dict[str, Any]) -> list[str]:
        """Return what is remarked of an estimator's runs in a case, each remark once."""
        runs = self.results.runs()
        same = (runs["case"] == row["case"]) & (runs["estimator"] == row["label"])
        found = runs.loc[same & (runs["assumption"] == "") & (runs["remark"] != ""), "remark"]
        return [
            f"`{row['label']}` {remark} ({counted(count, 'run')})."
            for remark, count in found.value_counts(sort=False).items()
        ]

    def _figures(self) -> str:
        name = self.scenario.name
        telling = telling_cases(self.scenario.cases, self.summary)
        lead = self.scenario.cases[0] if self.references else telling[0]
        arrays = self.arrays[lead.name]
        shown = []

        def show(file: str, caption: str) -> None:
            shown.append(f"![{caption}]({quote(name)}/{file})\n\n*{caption}*")

        lead_cases = self.references or telling[:3]
        ranked = [rows_of(self.summary, case, "settled") for case in lead_cases]
        few = {"ins", *fewer(leaders(self.results.estimators, aided(ranked)), ranked)}
        shown_cases = {
            case.name: [label for label in rows if label in few]
            for case, rows in zip(lead_cases, ranked, strict=True)
        }
        save(
            stored.error_over_time(self.results, shown_cases), self.pictures / "error_over_time.png"
        )
        show(
            "error_over_time.png",
            f"Spherical error over {_drawn(self.results.run_count)} against time: medians, of the "
            "best of each panel and of the INS the quartiles, too; and the Cramér–Rao bounds of "
            "filter, fixed-lag smoother and smoother, which are root mean squares"
            + of_the_best(self.results.estimators),
        )
        if stored.has_map(self.results, lead.name):
            save(stored.field_map(self.results, lead.name), self.pictures / "field.png")
            show(
                "field.png",
                "Vertical gradient of the disturbing field at flight height, with the track",
            )
        if stored.has_gradients(self.results, lead.name):
            save(stored.track_gradient(self.results, lead.name), self.pictures / "gradient.png")
            show(
                "gradient.png",
                "Vertical gradient Γ_UU along the track: true, with the instrument's noise, and "
                "filtered; below, what the filter delays, and the noise before and behind it"
                if "filtered" in arrays
                else "Vertical gradient Γ_UU along the track: true and with the instrument's "
                "noise; below, the noise",
            )
        rows = rows_of(self.summary, lead, "settled")
        causal = [label for label, row in rows.items() if row["causality"] == "filter"]
        if causal:
            label = causal[0]
            quantities: tuple[stored.Quantity, ...] = ("position", "velocity")
            detailed = self.results.detail(lead.name, label, DETAILED_RUN) is not None
            for quantity in quantities if detailed else ():
                file = f"{quantity}_error.png"
                figure = stored.component_errors(self.results, lead.name, label, quantity)
                save(figure, self.pictures / file)
                show(
                    file,
                    f"ENU {quantity} errors of run {DETAILED_RUN}, {lead.title}: "
                    f"`{label}` and the pure INS",
                )
        return "\n\n".join(shown)

    def _assumptions(self) -> str:
        assumed = {
            key: note.removeprefix("assumed:").strip()
            for key, note in self.scenario.provenance.items()
            if note.startswith("assumed")
        }
        lines = []
        if assumed:
            values = scenario.values(self.scenario.source)
            lines += ["What the source leaves open, and what is assumed:", ""]
            lines += ["| key | value | why |", "|---|---|---|"]
            lines += [f"| `{key}` | {values.get(key)} | {why} |" for key, why in assumed.items()]
        if len(self.studies):
            runs = int(self.studies["runs"].max())
            lines += [
                "",
                "How the numbers move when one assumption changes "
                f"(`{self.scenario.campaign.assumption_estimator}`, the first "
                f"{counted(runs, 'run')}, settled window unless said otherwise; position "
                "MRSE [m], velocity MRSE [m/s]; NEES 6 if consistent):",
                "",
                tables.study(self.scenario, self.studies),
            ]
        return "\n".join(lines)


def _drawn(runs: int) -> str:
    """Return of which runs curves over time are."""
    if runs <= SERIES_RUNS:
        return "all runs"
    return f"the first {SERIES_RUNS} of {runs} runs (tables are of all of them)"
