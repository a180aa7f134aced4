"""How lost one may be: success and error against σ/ℓ, over the settings of a sweep of the prior."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from ..errors import GGBenchError
from ..figures.nonlinearity import Curve, against_width, each_setting
from ..figures.style import save
from ..judging.convergence import wilson_of
from ..results import digest
from ..results.digest import Digest
from ..spec.scenario import Scenario
from .league import geometric_mean, mean, name_of
from .shares import percent
from .tables import DEFINITIONS, markdown

SCENARIO = "nonlinearity"
"""The scenario whose figure opens the front page."""
SURE = 0.95
"""Share of success down to which an estimator is said to bear a prior."""
_EDGES = np.array([0.02, 0.04, 0.075, 0.15, 0.3, 0.6, 1.2, 2.5, 5.0, 12.0])
"""Of the classes of σ/ℓ in which settings are taken together."""


def is_of_the_prior(scenario: Scenario) -> bool:
    """Return whether a scenario sweeps the width of the prior, and nothing else."""
    sweep = scenario.sweep
    if sweep is None or len(sweep.axes) != 1:
        return False
    widths = {case.initial_error.position_m for case in scenario.cases}
    return len(widths) == len(sweep.axes[0].values)


class Widths:
    """A sweep of the prior's width, case by case.

    Parameters
    ----------
    held : the digest of the campaign.
    """

    def __init__(self, held: Digest) -> None:
        self.scenario = held.scenario
        assert held.scenario.sweep is not None
        self.sweep = held.scenario.sweep
        self.scales = held.correlation_m
        self.width = {
            case.name: case.initial_error.position_m / held.correlation_m[case.name]
            for case in held.scenario.cases
        }
        table = held.summary[held.summary["causality"] != "none"]
        self.rows = {
            (str(row["case"]), name_of(str(row["label"]))): row for row in table.to_dict("records")
        }
        self.labels = list(dict.fromkeys(label for _, label in self.rows))
        self.causality = {label: row["causality"] for (_, label), row in self.rows.items()}

    def curve(self, label: str, column: str, base: str) -> Curve:
        """Return a figure of an estimator against σ/ℓ in one setting."""
        found = sorted(
            (self.width[case], row[column])
            for (case, name), row in self.rows.items()
            if name == label and self.sweep.points[case].base == base
        )
        width, value = np.array(found, dtype=float).reshape(-1, 2).T
        return width, value

    def pooled(self, label: str, column: str) -> Curve:
        """Return a figure of an estimator against σ/ℓ, the settings of a class of σ/ℓ together.

        The mean of shares, the geometric mean of ratios. No ratio where less than half of the runs
        succeed: of a few that were lucky it says nothing.
        """
        over = mean if column.endswith("_share") else geometric_mean
        classes: dict[int, list[tuple[float, float]]] = {}
        for (case, name), row in self.rows.items():
            if name == label and (over is mean or row["success_share"] >= 0.5):
                place = int(np.searchsorted(_EDGES, self.width[case]))
                classes.setdefault(place, []).append((self.width[case], row[column]))
        held = [zip(*classes[place], strict=True) for place in sorted(classes)]
        points = [(geometric_mean(width), over(value)) for width, value in held]
        width, value = np.array(points, dtype=float).reshape(-1, 2).T
        return width, value

    def borne(self, label: str) -> float:
        """Return the largest σ/ℓ up to which an estimator succeeds in :data:`SURE` of the runs.

        Over the classes of :meth:`pooled`; 0 if not even in the narrowest.
        """
        width, share = self.pooled(label, "success_share")
        short = np.flatnonzero(~(share >= SURE))
        last = int(short[0]) if len(short) else len(share)
        return float(width[last - 1]) if last else 0.0

    def sentence(self) -> str:
        """Return which estimators bear which width, the widest first."""
        held = sorted(self.labels, key=lambda label: -self.borne(label))
        widest = max(float(self.pooled(label, "success_share")[0][-1]) for label in self.labels)
        groups: dict[str, list[str]] = {}
        for label in held:
            limit = self.borne(label)
            text = f"up to σ/ℓ of {limit:.2g}" if limit else "not even from the narrowest"
            if limit >= widest:
                text = f"from every prior flown (σ/ℓ up to {widest:.2g})"
            groups.setdefault(text, []).append(f"`{label}`")
        parts = [f"with {', '.join(labels)} {limit}" for limit, labels in groups.items()]
        return f"In {percent(SURE)} of the runs or more one finds back {'; '.join(parts)}."

    def ends(self, label: str) -> np.ndarray:
        """Return the ends (2, n) of the 95 % intervals of the pooled shares of success.

        Wilson's, each run counted once: the settings of a class share its random numbers, and are
        no further samples.
        """
        runs: dict[int, int] = {}
        for (case, name), row in self.rows.items():
            if name == label:
                place = int(np.searchsorted(_EDGES, self.width[case]))
                runs[place] = max(runs.get(place, 0), int(row["runs"]))
        _, shares = self.pooled(label, "success_share")
        counts = (runs[place] for place in sorted(runs))
        return np.array([wilson_of(s, n)[1:] for s, n in zip(shares, counts, strict=True)]).T

    def sureness(self) -> str:
        """Return for which estimators that is not sure, by the lower ends of the intervals."""
        unsure = []
        for label in self.labels:
            width, _ = self.pooled(label, "success_share")
            low = self.ends(label)[0, width <= self.borne(label)]
            if low.min(initial=1.0) < SURE:
                unsure.append(f"`{label}` ({percent(low.min())})")
        least = f"The lower ends of these shares' 95 % intervals are {percent(SURE)} or more, too"
        return f"{least}, but for {', '.join(unsure)}." if unsure else f"{least}."

    def overview(self) -> Any:
        """Return the figure of all settings together."""
        return against_width(
            {label: self.pooled(label, "success_share") for label in self.labels},
            {label: self.ends(label) for label in self.labels},
            {label: self.pooled(label, "ratio_median") for label in self.labels},
        )


def opening_figure(reports: Path) -> str:
    """Draw the figure that opens the front page, if its study is there; return it as markdown."""
    folder = reports / SCENARIO / digest.FOLDER
    if not (folder / "manifest.json").is_file():
        return ""
    try:
        held = digest.read(folder)
    except GGBenchError:  # the page says so among what is left out
        return ""
    if not is_of_the_prior(held.scenario):  # a user's own, of the same name
        return ""
    widths = Widths(held)
    save(widths.overview(), reports / "README" / "nonlinearity.png")
    caption = (
        "Share of runs that find back, and how near the bound they come, against the prior's σ "
        "per axis over the field's correlation length"
    )
    return (
        f"{widths.sentence()} {widths.sureness()}\n\n"
        f"![{caption}](README/nonlinearity.png)\n\n*{caption}: "
        f"[{widths.scenario.title}]({quote(SCENARIO)}.md)*"
    )


class NonlinearityReport:
    """The parts of the report of a sweep of the prior's width.

    Parameters
    ----------
    held : the digest of the campaign.
    pictures : folder of the figures.
    """

    def __init__(self, held: Digest, pictures: Path) -> None:
        self.widths, self.pictures = Widths(held), pictures

    def answer(self) -> str:
        """Return the answer, and the figure in which it is seen."""
        save(self.widths.overview(), self.pictures / "answer.png")
        caption = (
            "Share of the runs that succeed, and the error of those over the bound of its kind, "
            "against σ/ℓ; settings of about the same σ/ℓ together"
        )
        return (
            f"**{self.widths.sentence()}**\n\n{self.widths.sureness()}\n\n"
            f"{self._shown('answer.png', caption)}"
        )

    def sections(self) -> list[str]:
        """Return the parts in their order, and draw their figures."""
        bases = self.widths.sweep.bases
        panels = [
            {label: self.widths.curve(label, "success_share", base) for label in self.widths.labels}
            for base in bases
        ]
        columns = 3 if len(bases) % 3 == 0 else min(len(bases), 4)
        save(each_setting(list(bases.values()), panels, columns), self.pictures / "settings.png")
        return [
            "## Setting by setting",
            self._shown("settings.png", "Share of success against σ/ℓ in every setting"),
            self._table("success_share", percent),
            "Share of the runs that succeed.",
            self._table("ratio_median", lambda value: f"{value:.3g}"),
            "Median error over the bound, of the runs that succeed.",
            self._table("false_lock_share", percent),
            f"Share of the runs that end sure of a wrong place ([definitions]({DEFINITIONS})).",
        ]

    def _table(self, column: str, text: Any) -> str:
        """Return a figure of all estimators in every case."""
        rows = []
        for case in self.widths.scenario.cases:
            cells = []
            for label in self.widths.labels:
                row = self.widths.rows.get((case.name, label))
                known = row is not None and not math.isnan(row[column])
                cells.append(text(row[column]) if row is not None and known else "–")
            rows.append([case.title, f"{self.widths.width[case.name]:.2g}", *cells])
        return markdown(["case", "σ/ℓ", *(f"`{k}`" for k in self.widths.labels)], rows)

    def _shown(self, file: str, caption: str) -> str:
        return f"![{caption}]({quote(self.pictures.name)}/{file})\n\n*{caption}*"
