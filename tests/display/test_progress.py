"""Progress of a campaign on the screen."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from ggbench.display.progress import Progress


class Terminal(io.StringIO):
    """An output that a terminal shows."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("output", "live"), [(io.StringIO, False), (Terminal, True)])
def test_a_pipe_is_no_terminal_where_colours_are_forced(output, live, monkeypatch):
    """Shell cells of notebooks force colours: no bar is drawn over and over into their output."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    file = output()
    console = Console(file=file)
    assert console.is_terminal
    progress = Progress(console, "title")
    with progress:
        progress.refresh()
    assert ("title" in file.getvalue(), progress.disable) == (live, not live)
