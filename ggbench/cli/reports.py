"""``ggbench report``: what came out of a campaign, as markdown or as one page to share."""

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
    help="Report every results folder in FOLDER [results] and the league of them all.",
)  # fmt: skip
@click.option(
    "--html", "as_page", is_flag=True,
    help="Write one HTML file to share, NAME.html, in place of markdown and figures; with --all "
    "beside them, and league.html.",
)  # fmt: skip
@click.option(
    "-o", "--output", type=click.Path(path_type=Path),
    help="Where to write [the folder itself; with --all: reports].",
)  # fmt: skip
def report(folder: Path | None, whole_library: bool, as_page: bool, output: Path | None) -> None:
    """Write the report of a results FOLDER: markdown and figures, or one page."""
    if folder is None and not whole_library:
        raise click.UsageError("name a results FOLDER, or --all")
    described = _described() if as_page else None
    if whole_library:
        from . import library

        good = library.report_all(
            folder or Path("results"), output or Path("reports"), console, described
        )
        sys.exit(0 if good else _EXIT_INCOMPLETE)
    assert folder is not None
    if described is None:
        from ..report import scenario_report

        path = scenario_report.write(folder, output or folder)
    else:
        from ..report.page import reports

        path = reports.write_report(folder, output or folder, described)
    click.echo(f"Wrote {path}")


def _described() -> dict[str, str]:
    """Return what each registered estimator is, for the page; its packages are asked for first."""
    from ..campaign import registry
    from ..report.page import libraries

    libraries.require()
    found = registry.registered()
    return {name: (cls.__doc__ or "").strip().partition("\n")[0] for name, cls in found.items()}
