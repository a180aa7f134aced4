"""The section of a report on gravity that the INS does not know: what it does, what is claimed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ..figures import gravity
from ..figures.style import save
from ..results.folder import Results
from ..results.store import DETAILED_RUN
from ..spec.claims import ClaimSpec

_COLUMNS = {
    "east position": 0, "north position": 1, "up position": 2,
    "east velocity": 3, "north velocity": 4, "up velocity": 5,
    "pitch": 6, "roll": 7, "heading": 8,
}  # fmt: skip
_ARCMINUTES = math.degrees(1.0) * 60.0
_NEAR = 1.25
"""By which factor a claim may exceed what is computed, and be of its size."""
MGAL = 1e5


class GravitySection:
    """What the stored results of a scenario say of unknown gravity.

    Parameters
    ----------
    results : the folder.
    arrays : of each case.
    pictures : folder of the report's figures.
    """

    def __init__(
        self, results: Results, arrays: Mapping[str, Mapping[str, np.ndarray]], pictures: Path
    ) -> None:
        self.results, self.arrays, self.pictures = results, arrays, pictures
        self.titles = {case.name: case.title for case in results.scenario.cases}
        self.felt = [name for name, stored in arrays.items() if "response" in stored]
        self.known = [name for name, stored in arrays.items() if "gravity" in stored]

    def sections(self) -> list[str]:
        """Return the section as markdown; nothing where there is no such gravity."""
        if not (self.felt or self.known):
            return []
        parts = ["## Gravity that the INS does not know", *self._response(), *self._claims()]
        return parts + self._knowledge()

    def _response(self) -> list[str]:
        if not self.felt:
            return []
        name = self.felt[0]
        stored = self.arrays[name]
        shown = self._picture(
            "response.png",
            lambda: gravity.response(stored["times"], stored["response"]),
            f"Errors of an INS that errs in nothing but the gravity: {self.titles[name]}",
        )
        return [
            "An INS without any error of its own, in exact flight, errs by what the unknown "
            "gravity does to it. As errors are small, this is what *any* INS on this flight "
            "would gain if it knew that gravity:",
            shown,
        ]

    def _claims(self) -> list[str]:
        claims = self.results.scenario.claims
        rows = [self._claim(claim) for claim in claims if claim.case in self.felt]
        if not rows:
            return []
        return [
            "### What is claimed, and what the gravity can do",
            "| claim | published | computed at that time | largest until then | verdict |\n"
            "|---|---|---|---|---|\n" + "\n".join(rows),
            f"A claim is *of the size of the response* if it is at most {_NEAR:g} times the "
            "largest error that the gravity causes until then; beyond that, the improvement must "
            "have come from something else.",
        ]

    def _claim(self, claim: ClaimSpec) -> str:
        stored = self.arrays[claim.case]
        values = np.abs(stored["response"][:, _COLUMNS[claim.quantity]])
        if claim.unit == "′":
            values = values * _ARCMINUTES
        until = values[stored["times"] <= claim.until_s + 1e-9]
        at_end, largest = (float(until[-1]), float(until.max())) if len(until) else (0.0, 0.0)
        verdict = "of the size of the response"
        if claim.published > _NEAR * largest:
            times = claim.published / largest if largest else math.inf
            verdict = f"**not reproducible**: {times:.1f} times what this gravity can do"
        unit = claim.unit
        return (
            f"| {claim.title} | {claim.published:g} {unit} | {at_end:.3g} {unit} | {largest:.3g} "
            f"{unit} | {verdict} |"
        )

    def _knowledge(self) -> list[str]:
        if not self.known:
            return []
        times = self.arrays[self.known[0]]["times"]
        parts = [
            "### What of it can be known",
            self._table(),
            "σ is the Cramér–Rao bound of an estimator with these states; *correlation* is that of "
            "the east part with the tilt about north, and of the north part with the tilt about "
            "east, at the end.",
            self._picture(
                "knowledge.png",
                lambda: gravity.knowledge(
                    times, {self.titles[name]: self.arrays[name]["gravity"] for name in self.known}
                ),
                "Bound of σ of the horizontal disturbance, and its correlation with tilt",
            ),
        ]
        for name in self.known:
            details = self._details(name)
            if details:
                parts.append(self._estimates(name, details))
        return parts

    def _estimates(self, name: str, details: dict[str, np.ndarray]) -> str:
        """Return the figure of the disturbance of a case in its detailed runs."""
        stored = self.arrays[name]
        return self._picture(
            f"gravity-{name}.png",
            lambda: gravity.estimates(stored["times"], stored["gravity"][:, :3], details),
            f"The disturbance as it is estimated in run {DETAILED_RUN}, with ±3σ: "
            f"{self.titles[name]}",
        )

    def _details(self, case: str) -> dict[str, np.ndarray]:
        """Return the detailed runs of estimators of gravity: the first, and one with feedback."""
        found: dict[str, np.ndarray] = {}
        for label in self.results.labels:
            detail = self.results.detail(case, label, DETAILED_RUN)
            wanted = label != "ins" and (not found or label.startswith("closed-loop"))
            if wanted and detail is not None and np.isfinite(detail[:, 12:]).all():
                found[label] = detail
        return found

    def _table(self) -> str:
        lines = [
            "| case | true E, N, U | σ E, N, U at half time | at the end | correlation E, N |",
            "|---|---|---|---|---|",
        ]
        for name in self.known:
            values = self.arrays[name]["gravity"]
            true, sigma = MGAL * values[:, :3].mean(axis=0), MGAL * values[:, 3:6]
            half = sigma[len(sigma) // 2]
            lines.append(
                f"| {self.titles[name]} | {_three(true)} | {_three(half)} | {_three(sigma[-1])} | "
                f"{values[-1, 6]:.2f}, {values[-1, 7]:.2f} |"
            )
        return "In mGal; the true disturbance is its mean along the flight.\n\n" + "\n".join(lines)

    def _picture(self, file: str, draw: Callable[[], Figure], caption: str) -> str:
        save(draw(), self.pictures / file)
        return f"![{caption}]({self.pictures.name}/{file})\n\n*{caption}*"


def _three(values: np.ndarray) -> str:
    return ", ".join(f"{value:.3g}" for value in values)
