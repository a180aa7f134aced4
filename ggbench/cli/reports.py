"""``ggbench report``: the pages of a campaign, or of all campaigns."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from .screen import console

_EXIT_INCOMPLETE = 1


@click.command()
@click.argument("folder", type=click.Path(path_type=Path), required=False)
@click.option(
    "--all", "whole_library", is_flag=True,
    help="Report every results folder in FOLDER [results], and write their front page.",
)  # fmt: skip
@click.option(
    "-o", "--output", type=click.Path(path_type=Path),
    help="Where to write [FOLDER/report; with --all: reports].",
)  # fmt: skip
def report(folder: Path | None, whole_library: bool, output: Path | None) -> None:
    """Write the report of a results FOLDER: one page, its figure and all numbers as CSV.

    With the extra 'page' installed, an HTML page with all tables is written next to it.
    """
    if folder is None and not whole_library:
        raise click.UsageError("name a results FOLDER, or --all")
    if whole_library:
        from . import library

        complete = library.report_all(folder or Path("results"), output or Path("reports"), console)
        sys.exit(0 if complete else _EXIT_INCOMPLETE)
    assert folder is not None
    from ..report import render

    for path in render.write(folder, output or folder / "report"):
        click.echo(f"Wrote {path}")
