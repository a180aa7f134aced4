"""``ggbench estimate`` and ``ggbench record``: estimates of recorded flights, simulated records."""

from __future__ import annotations

import sys
import warnings
from numbers import Integral
from pathlib import Path

import click

from ..display.timing import Moment
from ..errors import GGBenchError
from ..spec.limits import MOST_RUNS, MOST_SEED

_EXIT_FAILED = 1


@click.command()
@click.argument("flight", type=click.Path(path_type=Path))
@click.option(
    "-e",
    "--estimator",
    "estimators",
    multiple=True,
    metavar="NAME[param=value,...]",
    help="Estimator: a name or a .py file; repeatable [ekf].",
)
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path),
    help="Folder for tracks, residuals and the report; new or empty.",
)
@click.option(
    "-s",
    "--seed",
    type=click.IntRange(0, MOST_SEED),
    default=0,
    show_default=True,
    help="Seed of the estimators' random numbers.",
)
def estimate(flight: Path, estimators: tuple[str, ...], output: Path, seed: int) -> None:
    """Estimate the track of a recorded flight.

    FLIGHT is a TOML file with the paths of the records. The command writes corrected tracks with
    standard deviations: at the epochs (CSV, GPX, KML) and at the INS samples (CSV). It also writes
    residuals, and a report with figures (markdown, HTML).
    """
    from ..api import problems
    from ..campaign import registry
    from ..problem import Estimate
    from ..recorded.corrected import Residuals, residuals
    from ..recorded.flight import read_flight
    from ..recorded.recording import require_empty
    from ..recorded.suspicion import remarks, suspicions
    from ..report import flight_report

    choices = registry.choose_all(estimators or ("ekf",))
    require_empty(output)
    recorded = read_flight(flight)
    click.echo(f"{flight}: {recorded.problem}")
    for remark in (*recorded.remarks, flight_report.of_the_reference(recorded)):
        if remark:
            click.echo(f"Note: {remark}.")
    estimates: dict[str, Estimate] = {}
    by_label: dict[str, Residuals] = {}
    for choice in choices:
        start = Moment.now()
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                estimated = problems.estimate(recorded.problem, choice.estimator, seed)
                # It raises if the estimate cannot be reported, before others are at stake.
                by_label[choice.label] = residuals(recorded.problem, estimated)
        except GGBenchError as error:
            click.echo(f"ggbench: {choice.label}: {error}", err=True)
            continue
        except Exception as error:  # an estimator of somebody's own may raise anything
            click.echo(f"ggbench: {choice.label} failed: {type(error).__name__}: {error}", err=True)
            continue
        for warning in caught:
            if issubclass(warning.category, UserWarning):
                click.echo(f"Note: {warning.message}.")
        estimates[choice.label] = estimated
        click.echo(f"{choice.label}: {start.since()}")
    if not estimates:
        raise GGBenchError("no estimator returned an estimate: no file is written")
    rejected = {
        label: int(estimate.info["rejected"])
        for label, estimate in estimates.items()
        if isinstance(estimate.info.get("rejected"), Integral)
    }
    for remark in remarks(recorded, by_label, rejected):
        click.echo(f"Note: {remark}.")
    for suspicion in suspicions(recorded, by_label, rejected):
        click.echo(f"Warning: {suspicion}.")
    for sentence in flight_report.summary(recorded, estimates):
        click.echo(f"{sentence}.")
    families = {choice.label: choice.family for choice in choices}
    path = flight_report.write(recorded, estimates, families, output)
    page = path.with_name(flight_report.PAGE)
    click.echo(f"Wrote {page} and {path.name}, and tracks and residuals in the folders next to it.")
    sys.exit(0 if len(estimates) == len(choices) else _EXIT_FAILED)


@click.command()
@click.argument("scenario_name", metavar="SCENARIO")
@click.option("-c", "--case", metavar="NAME", help="Case to record [the first].")
@click.option(
    "--run",
    "number",
    type=click.IntRange(0, MOST_RUNS),
    default=0,
    show_default=True,
    metavar="K",
    help="Run to record.",
)
@click.option("-s", "--seed", type=click.IntRange(0, MOST_SEED), help="Seed [the scenario's].")
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path),
    help="Folder for the log; new or empty.",
)
def record(
    scenario_name: str, case: str | None, number: int, seed: int | None, output: Path
) -> None:
    """Write a simulated run of a SCENARIO as a recorded flight, for 'ggbench estimate'."""
    from ..recorded.recording import write_record
    from ..results.folder import as_argument
    from ..simulation.error_free_flight import prepare
    from ..spec import scenario

    loaded = scenario.load(scenario_name)
    flown = loaded.cases[0] if case is None else loaded.find(case)[1]
    seed = loaded.campaign.seed if seed is None else seed
    title = f"{loaded.name}, {flown.name}, run {number} of seed {seed}"
    path = write_record(prepare(flown), seed, number, output, title)
    click.echo(f"Wrote {path}; 'ggbench estimate {as_argument(str(path))} -o OUT' estimates it.")
