"""The report of a campaign: markdown and figures, made from a results folder alone."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from . import campaign, figures, metrics, scenario
from .errors import GGBenchError
from .scenario import CaseSpec, Scenario
from .store import Store

_ORDER = {"filter": 0, "none": 1, "fixed-lag": 2, "batch": 3}
WINDOW_TITLES = {
    "whole": "whole flight",
    "settled": "settled window",
    "last20": "end of the flight",
}


class ReportError(GGBenchError):
    """A report cannot be written."""


def ranked(rows: pd.DataFrame) -> pd.DataFrame:
    """Return summary rows with the best causal estimator first, smoothers in a block at the end."""
    order = rows["causality"].map(_ORDER)
    return (
        rows.assign(_order=order).sort_values(["_order", "position_mrse_m"]).drop(columns="_order")
    )


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
    store = Store(folder)
    loaded = stored_scenario(store)
    summary, studies = campaign.summarize(store, loaded)
    if summary.empty:
        raise ReportError(f"{folder} holds no finished run to report")
    pictures = output / loaded.name
    try:
        pictures.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ReportError(f"cannot write to {output}: {error.strerror}") from None
    report = _Report(store, loaded, summary, studies, pictures)
    path = output / f"{loaded.name}.md"
    path.write_text(report.text(), encoding="utf-8")
    store.close()
    return path


def stored_scenario(store: Store) -> Scenario:
    """Return the scenario of a results folder, from the copy it holds."""
    manifest = store.manifest()
    return scenario.from_text(
        store.read_text("scenario.toml"), manifest["scenario"], manifest.get("notes", "")
    )


class _Report:
    """One report in the making."""

    def __init__(
        self,
        store: Store,
        loaded: Scenario,
        summary: pd.DataFrame,
        studies: pd.DataFrame,
        pictures: Path,
    ) -> None:
        self.store = store
        self.scenario = loaded
        self.summary = summary
        self.studies = studies
        self.pictures = pictures
        self.manifest = store.manifest()
        self.references = [case for case in loaded.cases if case.reference]

    def text(self) -> str:
        """Return the whole report as markdown."""
        parts = [
            f"# {self.scenario.title}",
            self._verdict(),
            self._glance(),
            self.scenario.description,
            "## Results",
            self._reading(),
            *(self._case_table(case) for case in self.scenario.cases),
            "## Efficiency: MRSE over the Cramér–Rao bound, in every window",
            self._efficiency_table(),
            "## Figures",
            self._figures(),
            "## Assumptions",
            self._assumptions(),
            self.scenario.notes,
            "## How this was made",
            self._making(),
        ]
        return "\n\n".join(part.strip() for part in parts if part.strip()) + "\n"

    def _rows(self, case: CaseSpec, window: str) -> pd.DataFrame:
        chosen = (self.summary["case"] == case.name) & (self.summary["window"] == window)
        return ranked(self.summary[chosen])

    def _causal(self, window: str = "settled") -> pd.DataFrame:
        return self.summary[
            (self.summary["causality"] == "filter") & (self.summary["window"] == window)
        ]

    def _verdict(self) -> str:
        causal = self._causal()
        with_reference = causal.dropna(subset=["paper_position_m"])
        if with_reference.empty:
            return ""
        above = with_reference[
            (with_reference["position_mrse_m"] > with_reference["paper_position_m"])
            | (with_reference["velocity_mrse_mps"] > with_reference["paper_velocity_mps"])
        ]
        names = ", ".join(f"`{name}`" for name in dict.fromkeys(causal["label"]))
        numbers = 2 * len(self.references)
        runs = int(with_reference["runs"].min())
        if above.empty:
            head = (
                f"**At {runs} runs per case every causal estimator ({names}) is at or below the "
                f"paper's {numbers} numbers in the settled window"
            )
        else:
            failing = ", ".join(f"`{r.label}` in {r.case}" for r in above.itertuples())
            head = (
                f"**At {runs} runs per case not every causal estimator reaches the paper's "
                f"numbers in the settled window: {failing} does not"
            )
        efficiency = causal["position_efficiency"]
        per_case = causal.groupby("case")["position_mrse_m"]
        spread = float((per_case.max() / per_case.min() - 1.0).max())
        return (
            f"{head}; their position error is {efficiency.min():.2f} to {efficiency.max():.2f} "
            "times the Cramér–Rao bound, and within one case they differ by "
            f"{100 * spread:.1g} % at most.**"
        )

    def _glance(self) -> str:
        """Return the table of a README: every estimator beside the paper and the bound."""
        cases = self.references or list(self.scenario.cases[:1])
        lines = [
            "| settled window | causality | "
            + " | ".join(f"{case.title}: m, m/s" for case in cases)
            + " | ms/run |",
            "|---|---|" + "---|" * len(cases) + "---|",
        ]
        if self.references:
            published = [
                f"{c.reference.position_mrse_m:.2f}, {c.reference.velocity_mrse_mps:.3f}"
                for c in self.references
                if c.reference
            ]
            lines.append("| *paper (UKF)* | *filter* | " + " | ".join(published) + " | |")
        tables = [self._rows(case, "settled").set_index("label").to_dict("index") for case in cases]
        bounded = ""
        for label, first in tables[0].items():
            if first["causality"] not in ("none", bounded):
                bounded = first["causality"]
                bounds = [
                    f"{t[label]['position_bound_m']:.2f}, {t[label]['velocity_bound_mps']:.3f}"
                    for t in tables
                    if label in t
                ]
                lines.append(f"| *Cramér–Rao bound* | *{bounded}* | " + " | ".join(bounds) + " | |")
            cells = [
                f"{t[label]['position_mrse_m']:.2f}, {t[label]['velocity_mrse_mps']:.3f}"
                if label in t
                else ""
                for t in tables
            ]
            lines.append(
                f"| `{label}` | {first['causality']} | " + " | ".join(cells) + " | "
                f"{1e3 * first['seconds_per_run']:.0f} |"
            )
        return "\n".join(lines)

    def _reading(self) -> str:
        case = self.scenario.cases[0]
        w = case.windows
        return (
            "MRSE is the root of the mean, over runs and epochs of a window, of the squared "
            f"spherical error. Windows: the settled one from {w.settled_from_s:g} s on, the whole "
            f"flight from the first update, the last {w.last_s:g} s. In brackets: 95 % bootstrap "
            "interval over runs. *Bound*: posterior Cramér–Rao bound of the unfiltered readings, "
            "for filters the filtering bound, for smoothers that of their data; *efficiency* = "
            "MRSE / bound, for position. *NEES* of the six position and velocity errors, 6 if "
            "consistent; its 95 % band treats each run as a single draw, so that its false-alarm "
            "rate is below 5 %. *Coverage*: share of epochs whose truth lies in the claimed 95 % "
            "region. *NIS*: normalised innovation squared, the number of components if consistent. "
            "A run *diverges* when its final position error exceeds both ten bounds and the pure "
            "INS's. Times are medians, warmed up, of one process. *Map points*: positions at which "
            "a run evaluates the field. Causal estimators and smoothers never share a block. `ins` "
            "is set beside the filtering bound: what aiding could give."
        )

    def _case_table(self, case: CaseSpec) -> str:
        rows = self._rows(case, "settled")
        if rows.empty:
            return ""
        lines = [
            f"### {case.title}",
            "",
            "| estimator | position MRSE [m] | bound | efficiency | velocity MRSE [m/s] | bound "
            "| NEES (band) | coverage | NIS | failed / diverged | ms/run | ms/update "
            "| map points |",
            "|---|---|---|---|---|---|---|---|---|---|---|---|---|",
        ]
        if case.reference:
            lines.append(
                f"| **paper** | {case.reference.position_mrse_m:.4f} | | | "
                f"{case.reference.velocity_mrse_mps:.4f} | | | | | | | | |"
            )
        updates = len(self.store.arrays(case.name)["times"])
        causal = rows["causality"].isin(["filter", "none"])
        for block, title in ((rows[causal], ""), (rows[~causal], "*smoothers*")):
            if title and len(block):
                lines.append(f"| {title} |" + " |" * 12)
            lines += [_table_row(row, updates) for row in block.to_dict("records")]
        notes = []
        for row in rows.to_dict("records"):
            if row["diverged"]:
                notes.append(
                    f"Without its {row['diverged']} diverged runs `{row['label']}` has a position "
                    f"MRSE of {row['position_without_diverged_m']:.3f} m."
                )
            if row["failed"]:
                notes.append(
                    f"`{row['label']}` failed in {row['failed']} runs: {self._failure(row)}"
                )
        return "\n".join(lines) + ("\n\n" + " ".join(notes) if notes else "")

    def _failure(self, row: dict[str, Any]) -> str:
        for record in self.store.records():
            same = (record["case"], record["estimator"]) == (row["case"], row["label"])
            if same and record["status"] != "ok":
                return f"{record['reason']} (run {record['run']})."
        return ""

    def _efficiency_table(self) -> str:
        windows = metrics.WINDOWS
        lines = [
            "| case | estimator | " + " | ".join(
                f"{WINDOW_TITLES[w]}: position | velocity" for w in windows
            ) + " |",
            "|---|---|" + "---|---|" * len(windows),
        ]  # fmt: skip
        for case in self.scenario.cases:
            tables = {w: self._rows(case, w).set_index("label").to_dict("index") for w in windows}
            for label in self._rows(case, "settled")["label"]:
                if tables["settled"][label]["causality"] == "none":
                    continue
                cells = [
                    f"{tables[w][label]['position_efficiency']:.3f} | "
                    f"{tables[w][label]['velocity_efficiency']:.3f}"
                    for w in windows
                ]
                lines.append(f"| {case.name} | `{label}` | " + " | ".join(cells) + " |")
        bounds = ["", "The bounds themselves, position [m] and velocity [m/s], filtering:", ""]
        bounds += ["| case | " + " | ".join(WINDOW_TITLES[w] for w in windows) + " |"]
        bounds += ["|---|" + "---|" * len(windows)]
        for case in self.scenario.cases:
            arrays = self.store.arrays(case.name)
            cells = []
            for window in windows:
                mask = metrics.window_mask(arrays["times"], case.windows, window)
                position, velocity = np.sqrt(arrays["bound-filter"][mask].mean(axis=0))
                cells.append(f"{position:.3f}, {velocity:.4f}")
            bounds.append(f"| {case.name} | " + " | ".join(cells) + " |")
        return "\n".join(lines + bounds)

    def _figures(self) -> str:
        name = self.scenario.name
        lead = self.scenario.cases[0]
        arrays = self.store.arrays(lead.name)
        shown = []

        def show(file: str, caption: str) -> None:
            shown.append(f"![{caption}]({name}/{file})\n\n*{caption}*")

        panels = []
        for case in self.references or [lead]:
            curves = {}
            for label in self._rows(case, "settled")["label"]:
                series = self.store.series(case.name, label)
                curves[label] = np.sqrt(np.mean(series[:, :, :2] ** 2, axis=0))
            stored = self.store.arrays(case.name)
            keys = [key for key in stored if key.startswith("bound-")]
            bounds = {key.replace("bound-", "bound: "): np.sqrt(stored[key]) for key in keys}
            panels.append((case.title, stored["times"], curves, bounds))
        figures.error_over_time(panels, self.pictures / "error_over_time.png")
        show(
            "error_over_time.png",
            "RMS spherical error over all runs against time, with the Cramér–Rao bounds of "
            "filter, fixed-lag smoother and smoother",
        )
        if "map_vertical" in arrays:
            figures.field_map(arrays, self.pictures / "field.png")
            show(
                "field.png",
                "Vertical gradient of the disturbing field at flight height, with the track",
            )
        figures.gradient_along_track(arrays, lead.title, self.pictures / "gradient.png")
        show(
            "gradient.png",
            "Vertical gradient along the track: true, noisy, and filtered (the paper's figure 2)",
        )
        best = self._rows(lead, "settled")
        best = best[best["causality"] == "filter"]
        if len(best):
            label = best["label"].iloc[0]
            aided = self.store.detail(lead.name, label, campaign.DETAILED_RUN)
            ins = self.store.detail(lead.name, "ins", campaign.DETAILED_RUN)
            if aided is not None:
                for first, quantity, unit in ((0, "position", "m"), (3, "velocity", "m/s")):
                    file = f"{quantity}_error.png"
                    figures.component_errors(
                        arrays["times"], aided, ins, first, unit, label, self.pictures / file
                    )
                    show(
                        file,
                        f"ENU {quantity} errors of run {campaign.DETAILED_RUN}, {lead.title}: "
                        f"`{label}` and the pure INS (the paper's figure {3 if first == 0 else 4})",
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
            lines += ["", self._study_table()]
        return "\n".join(lines)

    def _study_table(self) -> str:
        settings = self.scenario.campaign
        estimator = settings.assumption_estimator
        runs = int(self.studies["runs"].max())
        lines = [
            f"How the numbers move when one assumption changes (`{estimator}`, {runs} runs, "
            "settled window unless said otherwise; position MRSE [m], velocity MRSE [m/s]; NEES 6 "
            "if consistent):",
            "",
            "| assumption | " + " | ".join(f"{c.name} | NEES" for c in self.references) + " |",
            "|---|" + "---|---|" * len(self.references),
        ]

        def line(title: str, frame: pd.DataFrame, window: str) -> str:
            cells = []
            for case in self.references:
                chosen = frame[(frame["case"] == case.name) & (frame["window"] == window)]
                if chosen.empty:
                    cells.append("– | –")
                    continue
                row = chosen.iloc[0]
                cells.append(
                    f"{row['position_mrse_m']:.3f}, {row['velocity_mrse_mps']:.4f} | "
                    f"{_short(row['nees_mean'])}"
                )
            return f"| {title} | " + " | ".join(cells) + " |"

        paper = [
            f"{c.reference.position_mrse_m}, {c.reference.velocity_mrse_mps} | "
            for c in self.references
            if c.reference
        ]
        lines.append("| *paper* | " + " | ".join(paper) + " |")
        base = self.summary[self.summary["label"] == estimator]
        if len(base):
            lines.append(line("**as declared**", base, "settled"))
            lines.append(line("window: the whole flight", base, "whole"))
            lines.append(line("window: the end of the flight", base, "last20"))
        for study in self.scenario.assumptions:
            frame = self.studies[self.studies["assumption"] == study.name]
            lines.append(line(study.title, frame, "settled"))
        return "\n".join(lines)

    def _making(self) -> str:
        m = self.manifest
        versions = ", ".join(f"{name} {version}" for name, version in m["versions"].items())
        machine = m["machine"]
        flags = " --assumptions" if m["assumptions"] else ""
        return "\n".join(
            [
                "Generated, not edited. To get it again:",
                "",
                "```",
                f"ggbench run {self.scenario.name} -n {m['runs']} --seed {m['seed']}{flags} "
                f"-o results/{self.scenario.name}",
                f"ggbench report results/{self.scenario.name} -o reports",
                "```",
                "",
                f"- ggbench {m['ggbench']}, source {m['source_hash']}, scenario "
                f"{m['scenario_hash'][:16]}, seed {m['seed']}, run on {m['date'][:10]}",
                f"- {versions}",
                f"- {machine['system']} on {machine['architecture']}, "
                f"{machine['processors']} processors",
            ]
        )


def _table_row(row: dict[str, Any], updates: int) -> str:
    def interval(key: str, digits: int) -> str:
        low, high = row[f"{key}_lo"], row[f"{key}_hi"]
        stem = {"position_mrse": "position_mrse_m", "velocity_mrse": "velocity_mrse_mps"}[key]
        text = f"{row[stem]:.{digits}f}"
        return text if math.isnan(low) else f"{text} [{low:.{digits}f}, {high:.{digits}f}]"

    nis = "" if math.isnan(row["nis_mean"]) else _short(row["nis_mean"])
    milliseconds = 1e3 * row["seconds_per_run"]
    return (
        f"| `{row['label']}` | {interval('position_mrse', 3)} | {row['position_bound_m']:.3f} | "
        f"{row['position_efficiency']:.3f} | {interval('velocity_mrse', 4)} | "
        f"{row['velocity_bound_mps']:.4f} | "
        f"{_short(row['nees_mean'])} ({row['nees_lo']:.2f}–{row['nees_hi']:.2f}) | "
        f"{100 * row['coverage']:.1f} % | {nis} | {row['failed']} / {row['diverged']} | "
        f"{milliseconds:.1f} | {milliseconds / updates:.3f} | {row['map_evaluations']:.0f} |"
    )


def _short(value: float) -> str:
    """Return a number with two decimals, or without any if it is large."""
    return f"{value:.2f}" if abs(value) < 100.0 else f"{value:.0f}"
