"""Display of a running campaign: rate, remaining time, and errors of the estimators."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich import progress
from rich.console import Console, RenderableType
from rich.text import Text

from ..estimator_spec import shown_names
from ..figures.numbers import counted
from .compiling import Compiled
from .responsive_table import ResponsiveTable
from .timing import duration

if TYPE_CHECKING:  # it is shown before there is time to load them
    from ..campaign.running import CampaignProgress

_WINDOW = "settled"
_LINE_EVERY_S = 10.0


class Progress(progress.Progress):
    """Progress of a campaign: a live table in a terminal, otherwise plain lines at intervals.

    Compilation before the campaign is shown too. RMS errors include runs that were stored earlier.
    ``title`` is shown until the campaign begins. ``live`` states whether the display can be
    redrawn; by default it is true only in a terminal. A pipe does not count as a terminal, even if
    ``FORCE_COLOR`` is set. Shell cells of notebooks write to a pipe.
    """

    def __init__(self, console: Console, title: str, live: bool | None = None) -> None:
        self._title = title
        self._compiled = Compiled()
        self._cells: dict[str, tuple[str, str]] = {}
        self._cases: Sequence[str] = ()
        self._names: dict[str, str] = {}
        self._sums: dict[tuple[str, str], tuple[float, int]] = {}
        self._failed = 0
        self._workers: int | None = None
        self._waiting = ""
        self._last = 0.0
        self._ended = threading.Event()
        if live is None:
            live = console.is_terminal and console.file.isatty()
        super().__init__(
            progress.BarColumn(20),
            progress.TextColumn("{task.description}", markup=False),
            console=console,
            refresh_per_second=4.0,
            transient=True,
            disable=not live,
        )

    def start(self) -> None:
        """Start the display."""
        super().start()
        if self.disable:
            threading.Thread(target=self._print_compiled, daemon=True).start()

    def stop(self) -> None:
        """Stop the display; print the counts of runs unless the last line shows them."""
        self._ended.set()
        super().stop()
        if self.tasks and not (self.disable and self.finished):
            self.console.out(self._counts())

    def _print_compiled(self) -> None:
        """Print the number of compiled functions at intervals, if it has changed."""
        printed = ""
        while not self._ended.wait(_LINE_EVERY_S):
            text = self._compiled.text()
            if text and text != printed:
                self.console.out(f"{self._title}: {text}")
                printed = text

    def tell(self, step: CampaignProgress) -> None:
        """Update the display after a step of the campaign."""
        if not step.done and step.workers is None:
            self._begin(step)
        self._workers = step.workers
        if step.waiting != self._waiting:
            self._waiting = step.waiting
            if self.disable and step.waiting:
                self.console.out(f"{self._title}: {step.waiting}")
        for result in step.new:
            self._failed += result.record["status"] != "ok"
            self._count(result.key, result.record)
        for task in self.tasks:
            self.advance(task.id, len(step.new))
        now = time.monotonic()
        if step.new and self.disable and (self.finished or now - self._last > _LINE_EVERY_S):
            self._last = now
            self.console.out("; ".join(filter(None, [self._counts(), self._errors()])))

    def _begin(self, step: CampaignProgress) -> None:
        """Print the remarks on the campaign; start the display of its runs if any are missing."""
        for remark in step.remarks:
            self.console.out(remark)
        if not step.total:
            return
        from ..results.folder import Results

        work = step.campaign
        self._title = work.scenario.name
        # All cells of the folder that belong to this campaign, not only those asked for now.
        results = Results(work.folder, step.store)
        self._cells = {c.key: (c.case, c.estimator) for c in results.cells if not c.assumption}
        self._cases = list(dict.fromkeys(case for case, _ in self._cells.values()))
        self._names = {label: "" for _, label in self._cells.values()}
        for key in self._cells:
            for record in step.store.records(key, work.runs):
                self._count(key, record)
        self._last = time.monotonic()
        self.add_task("", total=step.total)
        if self.disable:
            self.console.out(f"{self._title}: {counted(step.total, 'run')} to do")

    def _count(self, key: str, record: Mapping[str, Any]) -> None:
        cell = self._cells.get(key)
        if cell is not None and record["status"] == "ok":
            total, runs = self._sums.get(cell, (0.0, 0))
            self._names[cell[1]] = record["name"]
            self._sums[cell] = total + record[f"{_WINDOW}_position_ms"], runs + 1

    def _mrse(self, case: str, label: str) -> str:
        total, runs = self._sums.get((case, label), (0.0, 0))
        return f"{math.sqrt(total / runs):.3g}" if runs else "–"

    def _shown(self) -> dict[str, str]:
        """Return the short names of estimators by label; labels before their first result."""
        names = {label: name for label, name in self._names.items() if name}
        return {label: label for label in self._names} | shown_names(names)

    def _counts(self) -> str:
        (task,) = self.tasks
        text = f"{self._title}: {task.completed:.0f} of {counted(int(task.total or 0), 'run')}"
        if self._failed:
            text += f" ({self._failed} failed)"
        if self._workers is not None:
            text += f" on {counted(self._workers, 'worker')}"
        if task.completed:
            rate = task.completed / max(task.elapsed or 0.0, 1e-9)
            text += f", {rate:.1f} runs/s, {duration((task.remaining or 0.0) / rate)} left"
        return text

    def _errors(self) -> str:
        """Return a line with the present RMS errors in the first case."""
        if not self._sums:
            return ""
        case = self._cases[0]
        errors = ", ".join(
            f"{shown} {self._mrse(case, label)}" for label, shown in self._shown().items()
        )
        return f"RMS error of {case} in m: {errors}"

    def get_renderables(self) -> Iterator[RenderableType]:
        """Yield the progress bar, the count of compiled functions, and the table of errors."""
        compiled = self._compiled.text()
        if not self.tasks:
            yield Text(f"{self._title}: {compiled or 'preparing'}")
            return
        self.update(self.task_ids[0], description=self._counts())
        yield self.make_tasks_table(self.tasks)
        if self._waiting:
            yield Text(self._waiting)
        if compiled:
            yield Text(compiled)
        table = ResponsiveTable(
            "", [("RMS error so far [m]", "name"), *((case, "number") for case in self._cases)]
        )
        for label, shown in self._shown().items():
            table.add_row(shown, *(self._mrse(case, label) for case in self._cases))
        first = table.tables(self.console.width)[0]
        more = len(self._cases) + 1 - len(first.columns)
        first.caption = f"and of {counted(more, 'other case')}" if more else None
        first.caption_justify = "left"
        yield first
