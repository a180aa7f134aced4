"""What a user sees while a campaign runs: rate, time left, and how the estimators do so far."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from ..figures.numbers import counted
from .clocks import duration
from .compiling import Compiled
from .fitting import FittedTable

if TYPE_CHECKING:  # it is shown before there is time to load them
    from ..campaign.running import Step

_WINDOW = "settled"
_LINE_EVERY_S = 10.0
_REDRAWS_PER_S = 4.0


class Progress:
    """Progress of a campaign: a live table in a terminal, a plain line now and then elsewhere.

    Of what is done before it, too: what is compiled is told from the beginning.

    Parameters
    ----------
    console : where to show it. title : what is done.

    What is in the folder when a campaign begins counts in the errors.
    """

    def __init__(self, console: Console, title: str) -> None:
        self._console = console
        self._title = title
        self._compiled = Compiled()
        self._cells: dict[str, tuple[str, str]] = {}
        self._cases: Sequence[str] = ()
        self._labels: Sequence[str] = ()
        self._sums: dict[tuple[str, str], tuple[float, int]] = {}
        self._total = self._done = self._failed = 0
        self._start = self._last = 0.0
        self._live: Live | None = None
        self._ended = threading.Event()

    def __enter__(self) -> Progress:
        if self._console.is_terminal:
            self._live = Live(
                get_renderable=self._shown, console=self._console,
                refresh_per_second=_REDRAWS_PER_S, transient=True,
            )  # fmt: skip
            self._live.start()
        else:
            threading.Thread(target=self._tell_compiled, daemon=True).start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._ended.set()
        if self._live is not None:
            self._live.stop()
        if self._total and (self._live is not None or self._done < self._total):
            self._console.out(self._counts())

    def _tell_compiled(self) -> None:
        """Tell now and then what is compiled, if anything is."""
        told = ""
        while not self._ended.wait(_LINE_EVERY_S):
            text = self._compiled.text()
            if text and text != told:
                self._console.out(f"{self._title}: {text}")
                told = text

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
        from ..results.folder import Results

        work, total = step.campaign, step.total
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
        self._total = total
        if self._live is None:
            self._console.out(f"{self._title}: {counted(self._total, 'run')} to do")

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
        text = f"{self._title}: {self._done} of {counted(self._total, 'run')}"
        if self._failed:
            text += f" ({self._failed} failed)"
        if self._done:
            rate = self._done / max(elapsed, 1e-9)
            text += f", {rate:.1f} runs/s, {duration((self._total - self._done) / rate)} left"
        return text

    def _lead(self) -> str:
        """Return the errors so far of the first case."""
        if not self._cases or not self._sums:
            return ""
        case = self._cases[0]
        errors = ", ".join(f"{label} {self._mrse(case, label)}" for label in self._labels)
        return f"MRSE of {case} in m: {errors}"

    def _shown(self) -> RenderableType:
        compiled = self._compiled.text()
        if not self._total:
            return Text(f"{self._title}: {compiled or 'preparing'}")
        bar = Table.grid(padding=(0, 1))
        bar.add_row(ProgressBar(max(self._total, 1), self._done, width=20), Text(self._counts()))
        table = FittedTable(
            "", [("MRSE so far [m]", "name"), *((case, "number") for case in self._cases)]
        )
        for label in self._labels:
            table.add_row(label, *(self._mrse(case, label) for case in self._cases))
        first = table.fitted(self._console.width)[0]
        more = len(self._cases) + 1 - len(first.columns)
        first.caption = f"and of {counted(more, 'other case')}" if more else None
        first.caption_justify = "left"
        return Group(bar, *([Text(compiled)] if compiled else []), first)
