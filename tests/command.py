"""The command, run within the test's own process."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest
from click.testing import CliRunner

from ggbench.cli.main import main
from ggbench.cli.screen import console


@dataclass(frozen=True)
class Outcome:
    """What a command left behind."""

    returncode: int
    stdout: str
    stderr: str


def invoke(arguments: list[str], cwd: Path, columns: int | None = None) -> Outcome:
    """Run the command's function in this process; a crash is an outcome with a traceback."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(cwd)
        if columns:  # of another number pytest may have told it when it was loaded
            patch.setattr(console, "width", columns)
        done = CliRunner().invoke(main, arguments, prog_name="ggbench")
    crash = ""
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        crash = f"Traceback: {done.exception!r}"
    return Outcome(done.exit_code, done.stdout, done.stderr + crash)
