"""``ggbench export`` and ``ggbench judge``: files of problems and estimates."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ..errors import brief
from ..spec.limits import MOST_RUNS, MOST_SEED

_EXIT_FAILED = 1


@click.command()
@click.argument("scenario_name", metavar="SCENARIO")
@click.option(
    "-c", "--case", "cases", multiple=True, metavar="NAME", help="Case; repeatable [all]."
)
@click.option(
    "-n",
    "--runs",
    type=click.IntRange(1, MOST_RUNS),
    default=20,
    show_default=True,
    help="Number of runs of each case.",
)
@click.option("-s", "--seed", type=click.IntRange(0, MOST_SEED), help="Seed [the scenario's].")
@click.option(
    "--format",
    "file_format",
    type=click.Choice(["mat", "nc", "txt"]),
    default="mat",
    show_default=True,
    help="MATLAB 5 (also for Octave), netCDF-4 (HDF5), or plain text.",
)
@click.option(
    "--until",
    type=click.FloatRange(0.0, min_open=True),
    metavar="SECONDS",
    help="Omit later epochs: 'ggbench judge --cut' then detects the use of future measurements.",
)
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path),
    help="Folder for one file of each case.",
)
def export(
    scenario_name: str,
    cases: tuple[str, ...],
    runs: int,
    seed: int | None,
    file_format: str,
    until: float | None,
    output: Path,
) -> None:
    """Write the problems of a SCENARIO as files for other languages.

    A file contains measurements, Φ, Q, R, the prior, the map and the measurement equation, but no
    truth. 'ggbench judge' reads the estimates.
    """
    from ..api import exchange

    paths = exchange.export(
        scenario_name,
        output,
        cases=cases,
        runs=runs,
        seed=seed,
        file_format=file_format,
        until_s=until,
    )
    for path in paths:
        click.echo(f"Wrote {path} ({path.stat().st_size / 1e6:.1f} MB)")


@click.command()
@click.argument("estimates", type=click.Path(path_type=Path))
@click.option(
    "--cut",
    type=click.Path(path_type=Path),
    help=(
        "Estimates of the problems exported with --until. They show whether a filter uses future "
        "measurements."
    ),
)
@click.option(
    "--scenario", "scenario_name", metavar="SCENARIO", help="Scenario [that of the problem's file]."
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    help="Results folder [results/judged/NAME of the file].",
)
def judge(
    estimates: Path, cut: Path | None, scenario_name: str | None, output: Path | None
) -> None:
    """Judge ESTIMATES of exported problems.

    ESTIMATES is a file or a folder of files with estimates of problems from 'ggbench export'. The
    command writes a results folder for 'ggbench report'.

    Exit code 1 if an estimate is refused.
    """
    from ..api import exchange
    from ..results.folder import as_argument
    from .screen import console
    from .terminal import print_metrics

    folder = output or Path("results") / "judged" / estimates.stem
    results = exchange.judge_estimates(
        estimates, scenario=scenario_name, cut=cut, output=folder, jobs=0, progress=False
    )
    metrics = results.metrics()
    if len(metrics):
        print_metrics(metrics, results.runs(), results.scenario, console)
    for sentence in exchange.misreadings(estimates, results):
        click.echo(f"Warning: {sentence}.")
    failed = results.failures()
    for reason in dict.fromkeys(map(brief, failed["reason"])) if len(failed) else ():
        click.echo(f"Failed: {reason}")
    name = as_argument(str(folder))
    click.echo(f"Results are in {name}; 'ggbench report {name}' writes the report.")
    sys.exit(_EXIT_FAILED if len(failed) else 0)
