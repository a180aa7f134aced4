"""The ``ggbench`` command: list, validate, run, report."""

from __future__ import annotations

import datetime
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from .errors import GGBenchError

if TYPE_CHECKING:
    import pandas as pd

    from .scenario import Scenario

console = Console()
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


class _Commands(click.Group):
    """A group whose commands end with a sentence and exit code 2 on an error of the user's."""

    def invoke(self, context: click.Context) -> Any:
        try:
            return super().invoke(context)
        except GGBenchError as error:
            click.echo(f"ggbench: {error}", err=True)
            context.exit(EXIT_BAD_INPUT)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="ggbench", message="%(prog)s %(version)s")
def main() -> None:
    """Benchmark estimators for gravity-gradient-aided inertial navigation."""
    # One BLAS thread per process: more double the processor time for nothing on matrices this
    # small. It must be said before NumPy is loaded, so each command imports what it needs itself.
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")


@main.command("list")
def list_command() -> None:
    """List the scenarios and the estimators with their parameters."""
    from . import registry, scenario

    table = Table("scenario", "title", "cases", title="Scenarios", title_justify="left")
    for name in scenario.shipped():
        loaded = scenario.load(name)
        table.add_row(name, escape(loaded.title), ", ".join(case.name for case in loaded.cases))
    console.print(table)
    table = Table("estimator", "what it is", "parameters", title="Estimators", title_justify="left")
    for name, cls in registry.registered().items():
        parameters = [
            f"{key}={default} ({registry.describe(annotation)})"
            for key, (annotation, default) in registry.parameters_of(cls).items()
        ]
        summary = (cls.__doc__ or "").strip().splitlines()[0]
        table.add_row(name, escape(summary), escape("\n".join(parameters)))
    console.print(table)


@main.command()
@click.argument("file")
def validate(file: str) -> None:
    """Check a scenario: FILE is a path or the name of a shipped one."""
    from . import campaign, scenario

    loaded = scenario.load(file)
    campaign.check(loaded, assumptions=True)
    for text in (*loaded.campaign.estimators, loaded.campaign.assumption_estimator):
        _choose(text)
    click.echo(
        f"{file} is valid: {len(loaded.cases)} cases, {len(loaded.assumptions)} assumptions, "
        f"{len(loaded.provenance)} values with provenance"
    )


@main.command()
@click.argument("scenario_name", metavar="SCENARIO")
@click.option(
    "-e", "--estimator", "estimators", multiple=True, metavar="NAME[param=value,...]",
    help="Estimator to run: a name or a .py file; repeat for more. Default: the scenario's.",
)  # fmt: skip
@click.option("-n", "--runs", type=click.IntRange(1), help="Runs per case [the scenario's].")
@click.option(
    "-j",
    "--jobs",
    type=click.IntRange(0),
    help="Worker processes [all processors]; 0: none, to debug.",
)
@click.option("-s", "--seed", type=click.IntRange(0), help="Seed [the scenario's].")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Results folder [new].")
@click.option("--assumptions", is_flag=True, help="Also study the scenario's assumptions.")
@click.option("--fresh", is_flag=True, help="Discard what the results folder holds.")
def run(
    scenario_name: str,
    estimators: tuple[str, ...],
    runs: int | None,
    jobs: int | None,
    seed: int | None,
    output: Path | None,
    assumptions: bool,
    fresh: bool,
) -> None:
    """Run a scenario: SCENARIO is the name of a shipped one or a path."""
    from . import campaign, scenario

    loaded = scenario.load(scenario_name)
    texts = [*(estimators or loaded.campaign.estimators)]
    if assumptions:  # its runs without the change are what the study is compared with
        texts.append(loaded.campaign.assumption_estimator)
    labels = tuple(dict.fromkeys(_choose(text) for text in texts))
    stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
    folder = output or Path("results") / f"{loaded.name}-{stamp}"
    work = campaign.Campaign(
        loaded,
        labels,
        runs or loaded.campaign.runs,
        loaded.campaign.seed if seed is None else seed,
        assumptions,
        folder,
        fresh,
    )
    campaign.check(loaded, assumptions)
    store = work.open()
    interrupted = False
    try:
        for reason in work.prepare_cases(store):
            click.echo(reason)
        tasks = work.tasks(store)
        with _progress(f"{loaded.name}") as progress:
            campaign.execute(
                tasks, store, (os.cpu_count() or 1) if jobs is None else jobs, progress
            )
    except KeyboardInterrupt:
        interrupted = True
    summary, _ = campaign.summarize(store, loaded)
    store.close()
    if len(summary):
        _print_summary(summary, loaded)
    if interrupted:
        click.echo(
            f"Interrupted. The runs that finished are in {folder}: 'ggbench report {folder}' "
            "reports them, the same command with -o goes on."
        )
        sys.exit(EXIT_INTERRUPTED)
    click.echo(f"Results are in {folder}; 'ggbench report {folder}' writes the report.")


@main.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="Where to write [the folder itself]."
)
def report(folder: Path, output: Path | None) -> None:
    """Write the report of a results FOLDER: markdown and figures."""
    from . import report as reporting

    path = reporting.write(folder, output or folder)
    click.echo(f"Wrote {path}")


def _choose(text: str) -> str:
    """Return the label of an estimator, checked."""
    from . import registry

    return registry.choose(text).label


class _progress:
    """Progress of a campaign: a bar in a terminal, a plain line now and then elsewhere."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._bar: Progress | None = None

    def __enter__(self) -> Callable[[int, int], None]:
        self._start = self._last = time.monotonic()
        if console.is_terminal:
            self._bar = Progress(
                TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
                TextColumn("elapsed"), TimeElapsedColumn(),
                TextColumn("left"), TimeRemainingColumn(),
                console=console,
            )  # fmt: skip
            self._task = self._bar.add_task(f"{self._title} (case runs)", total=None)
            self._bar.start()
        return self._show

    def __exit__(self, *exception: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def _show(self, done: int, total: int) -> None:
        if self._bar is not None:
            self._bar.update(self._task, completed=done, total=total)
            return
        now = time.monotonic()
        if done == total or now - self._last > 10.0:
            self._last = now
            left = (now - self._start) * (total - done) / done if done else 0.0
            click.echo(f"{self._title}: {done} of {total} case runs, {left:.0f} s left")


def _print_summary(summary: pd.DataFrame, scenario: Scenario) -> None:
    """Print the settled window of every case: causal estimators, best first, then smoothers."""
    from .tables import rows_of

    for case in scenario.cases:
        rows = rows_of(summary, case, "settled")
        if not rows:
            continue
        table = Table(
            title=f"{escape(case.title)}: MRSE from {case.windows.settled_from_s:g} s on",
            title_justify="left",
            box=box.SIMPLE_HEAD,
            pad_edge=False,
            padding=(0, 1, 0, 0),
        )
        table.add_column("estimator", no_wrap=True)
        for heading in ("m", "m/s", "/bound", "NEES", "fail/div", "ms/run"):
            table.add_column(heading, justify="right", no_wrap=True, min_width=len(heading) + 2)
        causal = True
        for row in rows.values():
            if causal and row["causality"] in ("fixed-lag", "batch"):
                causal = False
                table.add_section()
            table.add_row(
                escape(row["label"]),
                f"{row['position_mrse_m']:.3f}",
                f"{row['velocity_mrse_mps']:.4f}",
                f"{row['position_efficiency']:.3f}",
                f"{row['nees_mean']:.2f}",
                f"{row['failed']}/{row['diverged']}",
                f"{1e3 * row['seconds_per_run']:.1f}",
            )
        table.add_section()
        if case.reference:
            table.add_row(
                "paper",
                f"{case.reference.position_mrse_m:.3f}",
                f"{case.reference.velocity_mrse_mps:.4f}",
                style="dim",
            )
        console.print(table)
