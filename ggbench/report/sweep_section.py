"""The report of a sweep: which sensor reaches which error, and where estimators leave the bound.

Everything is said of the settled window and computed from summary rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pandas as pd

from ..figures import sweeps
from ..figures.numbers import counted, short
from ..figures.style import save
from ..figures.sweeps import Curve, HeatMap
from ..judging.summary import JUDGED
from ..spec.scenario import Scenario
from ..spec.sweep import Plane, largest_within, number, planes
from .tables import markdown

READING = (
    "MRSE is the root of the mean, over runs and epochs of the settled window (from {settled:g} s "
    "on), of the squared spherical position error. *Bound*: posterior Cramér–Rao bound of the "
    "readings, for filters the filtering bound, for smoothers that of their data; *efficiency* = "
    "MRSE / bound. *NEES* of the six position and velocity errors, 6 if consistent; its 95 % band "
    "treats each run as a single draw, so that its false-alarm rate is below 5 % in each cell. A "
    "run *diverges* when its final position error exceeds both ten bounds and the pure INS's. All "
    "grid points share the random numbers of a run, so that neighbours deviate together: the one "
    "cell in twenty that a 95 % interval or band misses by chance comes in clusters."
)


class SweepReport:
    """The parts of a sweep's report.

    Parameters
    ----------
    scenario : with a sweep.
    summary : rows as :func:`.summary.summarize` returns them.
    pictures : folder of the figures.
    """

    def __init__(self, scenario: Scenario, summary: pd.DataFrame, pictures: Path) -> None:
        assert scenario.sweep is not None
        self.scenario, self.sweep, self.pictures = scenario, scenario.sweep, pictures
        self.axes = scenario.sweep.axes
        self.planes = planes(scenario.sweep, summary)
        self.rows = self.planes[0].rows
        causality = dict(zip(summary["label"], summary["causality"], strict=True))
        self.causality = {k: c for k, c in causality.items() if c != "none"}
        self.unaided = [label for label, c in causality.items() if c == "none"]

    def answer(self) -> str:
        """Return the answer in bold, a line for each plane; "" where nothing is to be reached."""
        if not self.sweep.targets_m or not self.causality:
            return ""
        told = [(plane.title, self._verdict(plane, self._best(plane))) for plane in self.planes]
        if len(told) == 1:
            return f"**{told[0][1]}**"
        return "\n".join(f"- **{title}**: {text}" for title, text in told)

    def sections(self) -> list[str]:
        """Return the parts in their order, and draw their figures."""
        if not self.causality:
            return [self.scenario.description, self._unaided(), self._lost()]
        settled = self.scenario.cases[0].windows.settled_from_s
        parts = []
        if self.sweep.targets_m:
            parts += ["## What is needed", *self._each(self._answer)]
        parts += [
            self.scenario.description,
            "## Position errors and their bound",
            READING.format(settled=settled),
            self._unaided(),
            *self._each(self._errors),
            "## Efficiency: MRSE over the Cramér–Rao bound",
            *self._each(self._efficiency),
            "## Consistency",
            *self._each(self._consistency),
            "## Failures and divergences",
            self._lost(),
        ]
        return parts

    def _each(self, part: Callable[[Plane], str]) -> Iterator[str]:
        """Yield a part for every plane, under its title."""
        for plane in self.planes:
            yield (f"### {plane.title}\n\n" if plane.title else "") + part(plane)

    def _picture(self, file: str, caption: str) -> str:
        return f"![{caption}]({quote(f'{self.scenario.name}/{file}')})\n\n*{caption}*"

    def _at(self, place: Iterable[Any]) -> str:
        """Return the coordinates of a cell of a plane in words."""
        axes = zip(self.axes, place, strict=False)  # without a second axis its index is idle
        return ", ".join(f"{axis.name} {axis.at(i)}" for axis, i in axes)

    def _best(self, plane: Plane) -> str:
        """Return the causal estimator (any, if none is) of the least error over the whole plane.

        Gaps count most, then fewer runs, whose errors are of other samples. Of errors that agree to
        three digits (in their geometric mean) the cheaper one's is better.
        """
        causal = [label for label, c in self.causality.items() if c == "filter"]

        def merit(label: str) -> tuple[float, ...]:
            errors = plane.error(label)
            done = np.isfinite(errors)
            if not done.any():
                return (errors.size,)
            error = math.exp(np.log(errors[done]).mean())
            cost = float(np.median(plane.of(label, "seconds_per_run")[done]))
            runs = float(np.max(plane.of(label, "runs")[done]))
            return (~done).sum(), -runs, float(f"{error:.2e}"), cost

        return min(causal or self.causality, key=merit)

    def _bounds(self, plane: Plane) -> dict[str, str]:
        """Return name to an estimator of every bound that differs from the others.

        Where an estimator has no run its bound is missing, so the most complete ones come first.
        """
        found: dict[str, str] = {}
        for label in sorted(self.causality, key=lambda k: np.isnan(plane.bound(k)).sum()):
            gaps = [plane.bound(label) / plane.bound(other) - 1.0 for other in found.values()]
            if any(np.nanmax(np.abs(gap), initial=0.0) < 1e-9 for gap in gaps):
                continue
            name = f"bound: {self.causality[label]}"
            found[f"bound: {label}" if name in found else name] = label
        return found

    def _answer(self, plane: Plane) -> str:
        first, targets = self.axes[0], sorted(self.sweep.targets_m)
        best = self._best(plane)
        errors, bound = plane.error(best), plane.bound(best)
        parts = [self._requirements(plane)]
        parts.append(
            f"Largest {first.title} at which the position MRSE of the settled window stays within "
            "the target; between grid points the logarithm of the error is interpolated. In "
            "brackets: what the ends of the error's 95 % interval give. *any*: even the largest of "
            f"the grid, {number(first.values[-1])}; *none*: not even the smallest, "
            f"{number(first.values[0])}."
        )
        if len(self.axes) > 1 and np.isfinite(errors).any():
            file = f"answer{plane.suffix}.png"
            figure = sweeps.requirement(errors, bound, targets, first, self.axes[1], best)
            save(figure, self.pictures / file)
            aims = ", ".join(f"{target:g}" for target in targets)
            caption = (
                f"Position MRSE of `{best}` in the settled window (colour), and where it (solid) "
                f"and the Cramér–Rao bound (dashed) reach {aims} m"
            )
            parts.append(self._picture(file, caption))
        return "\n\n".join(part for part in parts if part)

    def _verdict(self, plane: Plane, best: str) -> str:
        """Return the answer in one sentence: what each target needs at the ends of the plane."""
        first, errors = self.axes[0], plane.error(best)
        columns = sorted({0, errors.shape[1] - 1})
        answers = []
        for target in sorted(self.sweep.targets_m):
            needs = []
            for column in columns:
                value = self._largest(errors, column, target)
                need = f"{_value(value)} {first.unit}".rstrip() if math.isfinite(value) else {
                    math.inf: f"any {first.name} of the grid",
                    -math.inf: f"no {first.name} of the grid",
                }.get(value, "unknown")  # fmt: skip
                where = f" at {self.axes[1].at(column)}" if len(self.axes) > 1 else ""
                needs.append(need + where)
            answers.append(f"{target:g} m: {', '.join(needs)}")
        return f"Largest {first.name} with which `{best}` reaches {'; '.join(answers)}."

    def _requirements(self, plane: Plane) -> str:
        """Return the table of what reaches each target, for every estimator and bound."""
        columns = range(plane.cases.shape[1])
        rows = []
        for target in sorted(self.sweep.targets_m):
            for label in self.causality:
                error, low, high = (
                    plane.of(label, f"position_mrse_{key}") for key in ("m", "lo", "hi")
                )
                # The larger the error may be, the less noise is allowed.
                cells = [
                    _interval(_value, *(self._largest(e, i, target) for e in (error, high, low)))
                    for i in columns
                ]
                rows.append([f"{target:g} m", f"`{label}`", *cells])
            for name, label in self._bounds(plane).items():
                bound = plane.bound(label)
                cells = [_value(self._largest(bound, i, target)) for i in columns]
                rows.append([f"{target:g} m", f"*{name}*", *cells])
        title = self.axes[0].title
        if len(self.axes) == 1:
            return markdown(["to reach", "", title], rows)
        return markdown(["to reach", title, *(self.axes[1].at(i) for i in columns)], rows)

    def _largest(self, errors: np.ndarray, column: int, target: float) -> float:
        return largest_within(self.axes[0], errors[:, column], target)

    def _unaided(self) -> str:
        """Return what the INS does alone."""
        sentences = []
        for label in self.unaided:
            error = self.rows.xs(label, level="label")["position_mrse_m"]
            sentences.append(
                f"Without aiding (`{label}`) the position MRSE is {short(error.median())} m "
                f"({short(error.min())} to {short(error.max())} m over the grid)."
            )
        return " ".join(sentences)

    def _errors(self, plane: Plane) -> str:
        panels = [HeatMap(label, plane.error(label)) for label in self.causality]
        if np.isnan([panel.values for panel in panels]).all():
            return self._runs(plane)
        panels += [HeatMap(name, plane.bound(k)) for name, k in self._bounds(plane).items()]
        caption = "Position MRSE of every estimator, and the bound [m]"
        parts = [
            self._runs(plane),
            self._heat_maps(plane, panels, "errors", "position MRSE [m]", caption),
            self._line(plane) if len(self.axes) == 1 else "",
        ]
        file, against = f"curves{plane.suffix}.png", self.axes[0].name
        unaided = plane.error(self.unaided[0]) if self.unaided else None
        save(sweeps.curves(self._curves(plane), unaided, self.axes[0]), self.pictures / file)
        parts.append(
            self._picture(
                file,
                f"Position MRSE against {against}, with 95 % intervals; dashed the bound, grey the "
                "INS alone",
            )
        )
        return "\n\n".join(part for part in parts if part)

    def _runs(self, plane: Plane) -> str:
        label = self._best(plane)
        runs = plane.of(label, "runs")
        missing = int(np.isnan(plane.error(label)).sum())
        if missing == runs.size:
            return "No run has finished here."
        low, high = int(np.nanmin(runs)), int(np.nanmax(runs))
        spread = counted(low, "run") if low == high else f"{low} to {high} runs"
        note = f"; {missing} of {runs.size} grid points have no finished run" if missing else ""
        return f"{spread} at each grid point{note}."

    def _curves(self, plane: Plane) -> dict[str, list[Curve]]:
        """Return the panels of curves: one per estimator, or one for all without a second axis."""
        panels: dict[str, list[Curve]] = {}
        for label in self.causality:
            error, bound = plane.error(label), plane.bound(label)
            ends = np.stack([plane.of(label, f"position_mrse_{end}") for end in ("lo", "hi")])
            for i in range(error.shape[1]):
                single = len(self.axes) == 1
                panel, name = ("", label) if single else (label, self.axes[1].at(i))
                curve = Curve(name, error[:, i], ends[:, :, i], bound[:, i])
                panels.setdefault(panel, []).append(curve)
        return panels

    def _line(self, plane: Plane) -> str:
        """Return the table of a sweep with one axis."""
        head = [self.axes[0].title]
        columns: list[list[str]] = [[number(value) for value in self.axes[0].values]]
        for label in self.causality:
            head += [f"`{label}`: MRSE [m]", "bound", "efficiency", "NEES"]
            for key in ("position_mrse_m", "position_bound_m", "position_efficiency", "nees_mean"):
                columns.append([short(value) for value in plane.of(label, key)[:, 0]])
        return markdown(head, zip(*columns, strict=True))

    def _heat_maps(
        self, plane: Plane, panels: list[HeatMap], name: str, label: str, caption: str,
        centre: float | None = None,
    ) -> str:  # fmt: skip
        """Draw heat maps, where there are a second axis and a value; return their picture."""
        if len(self.axes) == 1 or np.isnan([panel.values for panel in panels]).all():
            return ""
        file = f"{name}{plane.suffix}.png"
        figure = sweeps.heat_maps(panels, self.axes[0], self.axes[1], label, centre)
        save(figure, self.pictures / file)
        return self._picture(file, caption)

    def _efficiency(self, plane: Plane) -> str:
        sentences, panels = [], []
        for label in self.causality:
            ratio = plane.of(label, "position_efficiency")
            low, high = (
                plane.of(label, f"position_mrse_{e}") / plane.bound(label) for e in ("lo", "hi")
            )
            above, below = low > 1.0, high < 1.0
            panels.append(HeatMap(label, ratio, above | below))
            if np.isnan(ratio).all():
                continue
            ends = []
            for find in (np.nanargmax, np.nanargmin):
                place = np.unravel_index(find(ratio), ratio.shape)
                found = _interval("{:.2f}".format, ratio[place], low[place], high[place])
                ends.append(f"{found} at {self._at(place)}")
            sentences.append(
                f"- `{label}`: {np.nanmedian(ratio):.3f} in the median cell; largest {ends[0]}; "
                f"smallest {ends[1]}; the 95 % interval lies wholly above 1 in {above.sum()} of "
                f"{counted(ratio.size, 'cell')}, wholly below in {below.sum()}."
            )
        picture = self._heat_maps(
            plane, panels, "efficiency", "MRSE / bound",
            "Position MRSE over the bound; framed where its 95 % interval does not hold 1", 1.0,
        )  # fmt: skip
        return "\n".join([*sentences, "", picture]).strip()

    def _consistency(self, plane: Plane) -> str:
        sentences, panels = [], []
        for label in self.causality:
            nees, low, high = (plane.of(label, f"nees_{key}") for key in ("mean", "lo", "hi"))
            above, below = nees > high, nees < low
            panels.append(HeatMap(label, nees, above | below))
            if np.isnan(nees).all():
                continue
            far = np.unravel_index(np.nanargmax(np.abs(np.log(nees / JUDGED))), nees.shape)
            sentences.append(
                f"- `{label}`: outside its band in {(above | below).sum()} of "
                f"{counted(nees.size, 'cell')} ({above.sum()} above, {below.sum()} below); "
                f"farthest from {JUDGED}: {short(nees[far])} (band {low[far]:.2f}–{high[far]:.2f}) "
                f"at {self._at(far)}."
            )
        caption = f"Mean NEES, {JUDGED} if consistent; framed where it lies outside its 95 % band"
        picture = self._heat_maps(plane, panels, "nees", "mean NEES", caption, JUDGED)
        return "\n".join([*sentences, "", picture]).strip()

    def _lost(self) -> str:
        rows = self.rows[(self.rows["failed"] > 0) | (self.rows["diverged"] > 0)]
        total = int(self.rows["runs"].sum())
        if rows.empty:
            who = "(all estimators and grid points)"
            return f"None of {counted(total, 'run')} {who} failed or diverged."
        worst = (rows["failed"] + rows["diverged"]).sort_values(ascending=False).index[:20]
        counts = rows.loc[worst, ["runs", "failed", "diverged"]].astype(int).astype(str)
        listed = [[case, f"`{label}`", *row] for (case, label), row in counts.T.items()]
        return (
            f"{int(rows['failed'].sum())} of {counted(total, 'run')} failed; "
            f"{int(rows['diverged'].sum())} diverged and count in the errors. "
            "The grid points with most of them:\n\n"
            + markdown(["case", "estimator", "runs", "failed", "diverged"], listed)
        )


def _value(value: float) -> str:
    """Return a requirement as a cell of a table."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "any" if value > 0.0 else "none"
    return f"{value:.2g}" if abs(value) >= 1e-4 else f"{value:.1e}"


def _interval(text: Callable[[float], str], value: float, low: float, high: float) -> str:
    """Return a number with its interval in brackets, if it has one."""
    bare = math.isnan(low) or math.isnan(high)
    return text(value) if bare else f"{text(value)} [{text(low)}, {text(high)}]"
