"""``ggbench report``, and campaigns of all shipped scenarios."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click
from rich.markup import escape

from ..display.responsive_table import ResponsiveTable
from ..errors import GGBenchError
from ..figures.numbers import counted
from .screen import console

_EXIT_INCOMPLETE = 1


class LibraryError(GGBenchError):
    """There are no results to report."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of a scenario's campaign.

    Attributes
    ----------
    results, failed, diverged : numbers of results, of failed runs and of diverged runs in the
        results folder.
    error : message of the error that ended the campaign; "" if there was none.
    without_success : estimators without a finished run.
    """

    scenario: str
    results: int = 0
    failed: int = 0
    diverged: int = 0
    interrupted: bool = False
    error: str = ""
    seconds: float = 0.0
    without_success: tuple[str, ...] = ()


def run_all(names: Sequence[str], run_one: Callable[[str], Outcome]) -> list[Outcome]:
    """Run scenarios one after the other; a failure does not stop the next scenario.

    Return an outcome for each started scenario. After an interrupt no further scenario is started.
    """
    from ..campaign.flights import forget_flights
    from ..campaign.texts import exception_text

    outcomes = []
    for number, name in enumerate(names, 1):
        console.rule(f"{escape(name)} ({number} of {len(names)})", align="left")
        start = time.monotonic()
        try:
            outcome = run_one(name)
        except KeyboardInterrupt:
            outcome = Outcome(name, interrupted=True)
        except Exception as error:  # whatever it is, the other scenarios are to be run
            text = str(error) if isinstance(error, GGBenchError) else exception_text(error)
            outcome = Outcome(name, error=text)
            console.out(f"{name} failed: {text}")
        outcomes.append(replace(outcome, seconds=max(time.monotonic() - start, 0.0)))
        forget_flights()
        if outcome.interrupted:
            break
    return outcomes


def print_outcomes(outcomes: Sequence[Outcome], output: Path) -> None:
    """Print the outcome of every scenario, and the next step."""
    from ..results.folder import as_argument

    console.rule("The library", align="left")
    numbers = ("results", "failed", "diverged", "minutes")
    table = ResponsiveTable(
        "", [("scenario", "name"), *((heading, "number") for heading in numbers), ("", "text")]
    )
    for outcome in outcomes:
        word = "interrupted" if outcome.interrupted else "done"
        has_results = not outcome.error and outcome.results
        table.add_row(
            outcome.scenario,
            *(
                str(n) if has_results else ""
                for n in (outcome.results, outcome.failed, outcome.diverged)
            ),
            f"{outcome.seconds / 60.0:.1f}",
            f"[red]{escape(outcome.error)}[/]" if outcome.error else word,
        )
    table.print(console)
    failed = [outcome.scenario for outcome in outcomes if outcome.error]
    if failed:
        console.out(f"{counted(len(failed), 'scenario')} failed: {', '.join(failed)}.")
    if failed or any(outcome.interrupted for outcome in outcomes):
        console.print("The same command resumes.")
    again = f"ggbench report --all {as_argument(str(output))}"
    console.out(f"'{again}' reports the finished runs.")


@click.command()
@click.argument("folder", type=click.Path(path_type=Path), required=False)
@click.option(
    "--all",
    "whole_library",
    is_flag=True,
    help="Report every results folder in FOLDER [results] and write a front page.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    help="Output folder [FOLDER/report; with --all: reports].",
)
def report(folder: Path | None, whole_library: bool, output: Path | None) -> None:
    """Write the report of a results FOLDER: one page, a figure, and CSV tables.

    If ggbench[page] is installed, the command also writes an HTML page with all tables.
    """
    if folder is None and not whole_library:
        raise click.UsageError("name a results FOLDER, or --all")
    if whole_library:
        complete = _report_all(folder or Path("results"), output or Path("reports"))
        sys.exit(0 if complete else _EXIT_INCOMPLETE)
    assert folder is not None
    from ..report import render

    for path in render.write(folder, output or folder / "report"):
        click.echo(f"Wrote {path}")


def _report_all(folder: Path, output: Path) -> bool:
    """Report every results folder in a folder; return whether all reports succeeded.

    The front page lists every scenario with a report in the output folder, including old reports.
    """
    from ..report import library, render

    try:
        folders = sorted(path for path in folder.iterdir() if (path / "manifest.json").is_file())
    except OSError as error:
        raise LibraryError(f"cannot read {folder}: {error.strerror}") from None
    if not folders:
        raise LibraryError(f"{folder} holds no results folders; 'ggbench run --all' makes them")
    chosen, unread, doubles = _one_for_each(folders)
    remarks = list(unread)
    pages = {f"{name}.md" for name in chosen}
    for path in sorted(chosen.values()):
        try:
            for written in render.write(path, output, pages):
                console.out(f"Wrote {written}")
        except GGBenchError as error:
            remarks.append(str(error))
    complete = not remarks
    front, left_out = library.write(output)
    console.out(f"Wrote {front}")
    for remark in dict.fromkeys([*remarks, *doubles, *left_out]):
        console.out(remark)
    return complete


def _one_for_each(folders: Sequence[Path]) -> tuple[dict[str, Path], list[str], list[str]]:
    """Return one results folder by scenario, and sentences on unreadable and on omitted folders.

    Of several folders of a scenario, the folder with the scenario's name is used, else the newest.
    """
    from ..results.store import read_manifest

    by_name: dict[str, list[tuple[bool, str, Path]]] = {}
    unread = []
    for path in folders:
        try:
            manifest = read_manifest(path)
        except GGBenchError as error:
            unread.append(str(error))
            continue
        name = manifest["scenario"]
        by_name.setdefault(name, []).append((path.name == name, str(manifest["date"]), path))
    chosen, doubles = {}, []
    for name, group in by_name.items():
        *others, chosen[name] = (path for _, _, path in sorted(group))
        doubles += [f"{path} is left out: {chosen[name]} has the same scenario" for path in others]
    return chosen, unread, doubles
