"""What a user sees while a campaign runs: rate, time left, and how the estimators do so far."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.markup import escape
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from ..campaign.running import Step
from ..results.folder import Results

_WINDOW = "settled"
_MOST_CASES = 4
_LINE_EVERY_S = 10.0
_REDRAWS_PER_S = 4.0


class Progress:
    """Progress of a campaign: a live table in a terminal, a plain line now and then elsewhere.

    ``console`` is where to show it. What is in the folder when it begins counts in the errors.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._title = ""
        self._cells: dict[str, tuple[str, str]] = {}
        self._cases: Sequence[str] = ()
        self._labels: Sequence[str] = ()
        self._sums: dict[tuple[str, str], tuple[float, int]] = {}
        self._total = self._done = self._failed = 0
        self._start = self._last = 0.0
        self._live: Live | None = None

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._live is not None:
            self._live.stop()
        if self._live is not None or self._done < self._total:
            self._console.out(self._counts())

    def tell(self, step: Step) -> None:
        """Show how far the campaign has come."""
        if not step.done:
            self._begin(step)
        for result in step.new:
            self._done += 1
            self._failed += result.record["status"] != "ok"
            self._count(result.key, result.record)
        now = time.monotonic()
        if self._live or not step.new:
            return
        if self._done == self._total or now - self._last > _LINE_EVERY_S:
            self._last = now
            line = "; ".join(filter(None, [self._counts(), self._lead()]))
            self._console.out(line)

    def _begin(self, step: Step) -> None:
        """Say what the user should know, and show what is to come, if anything is."""
        for remark in step.remarks:
            self._console.out(remark)
        if not step.total:
            return
        work, self._total = step.campaign, step.total
        self._title = work.scenario.name
        # Of all that the folder holds of this campaign, not only of what was asked for now.
        held = Results(work.folder, step.store)
        self._cells = {c.key: (c.case, c.estimator) for c in held.cells if not c.assumption}
        self._cases = list(dict.fromkeys(case for case, _ in self._cells.values()))
        self._labels = list(dict.fromkeys(label for _, label in self._cells.values()))
        for key in self._cells:
            for record in step.store.records(key, work.runs):
                self._count(key, record)
        self._start = self._last = time.monotonic()
        if self._console.is_terminal:
            self._live = Live(
                get_renderable=self._table, console=self._console,
                refresh_per_second=_REDRAWS_PER_S, transient=True,
            )  # fmt: skip
            self._live.start()
        else:
            self._console.out(f"{self._title}: {self._total} runs to do")

    def _count(self, key: str, record: Mapping[str, Any]) -> None:
        cell = self._cells.get(key)
        if cell is not None and record["status"] == "ok":
            total, runs = self._sums.get(cell, (0.0, 0))
            self._sums[cell] = total + record["windows"][_WINDOW]["position_ms"], runs + 1

    def _mrse(self, case: str, label: str) -> str:
        total, runs = self._sums.get((case, label), (0.0, 0))
        return f"{math.sqrt(total / runs):.3g}" if runs else "–"

    def _counts(self) -> str:
        elapsed = time.monotonic() - self._start
        text = f"{self._title}: {self._done} of {self._total} runs"
        if self._failed:
            text += f" ({self._failed} failed)"
        if self._done:
            rate = self._done / max(elapsed, 1e-9)
            text += f", {rate:.1f} runs/s, {_duration((self._total - self._done) / rate)} left"
        return text

    def _lead(self) -> str:
        """Return the errors so far of the first case."""
        if not self._cases or not self._sums:
            return ""
        case = self._cases[0]
        errors = ", ".join(f"{label} {self._mrse(case, label)}" for label in self._labels)
        return f"MRSE of {case} in m: {errors}"

    def _table(self) -> RenderableType:
        bar = Table.grid(padding=(0, 1))
        bar.add_row(ProgressBar(max(self._total, 1), self._done, width=30), Text(self._counts()))
        shown = self._cases[:_MOST_CASES]
        more = len(self._cases) - len(shown)
        table = Table(
            escape("MRSE so far [m]"), *(escape(case) for case in shown), box=box.SIMPLE_HEAD,
            caption=f"and of {more} other cases" if more else None, caption_justify="left",
        )  # fmt: skip
        for label in self._labels:
            table.add_row(escape(label), *(self._mrse(case, label) for case in shown))
        return Group(bar, table)


def _duration(seconds: float) -> str:
    """Return a duration as a user reads it."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    if seconds < 5400.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"
