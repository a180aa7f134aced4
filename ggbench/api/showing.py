"""Progress display of a campaign started from Python."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from rich.console import Console

from ..campaign.running import CampaignProgress
from ..display.compiling import fields_of, maps_to_build
from ..display.progress import Progress
from ..spec.scenario import Scenario


@dataclass(frozen=True)
class Shown:
    """Display of a campaign: a progress table, nothing, or calls of a user's function."""

    display: Progress | None = None
    called: Callable[[int, int], object] | None = None

    def tell_first_use(self, compiled: Sequence[str], scenario: Scenario) -> None:
        """Announce the code to compile and the maps to build before the first run."""
        if self.display is None:
            return
        cases = (case for _, case in scenario.every_case())
        for sentence in (*compiled, *maps_to_build(fields_of(cases))):
            self.display.console.out(sentence)

    def tell(self, step: CampaignProgress) -> None:
        """Display a step of the campaign; its remarks are not displayed but issued as warnings."""
        if self.called is not None:
            self.called(step.done, step.total)
        if self.display is not None:
            self.display.tell(replace(step, remarks=()))


def shown_progress(choice: bool | Callable[[int, int], object] | None, title: str) -> Shown:
    """Return the display that ``choice`` selects.

    If ``choice`` is True, a progress table is shown. If it is None, the table is shown only in
    terminals and notebooks. If it is False, nothing is shown. If it is a function, this function is
    called instead.

    A notebook needs ipywidgets to update the table; without them it prints lines at intervals.
    """
    if callable(choice):
        return Shown(called=choice)
    console = Console(stderr=True, highlight=False)
    if choice is False or (choice is None and not console.is_terminal):
        return Shown()
    live = console.is_terminal
    if console.is_jupyter:
        live = importlib.util.find_spec("ipywidgets") is not None
    return Shown(Progress(console, title, live))
