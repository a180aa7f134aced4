"""Entry point of the ``ggbench`` command, with list, run, show and compare."""

from __future__ import annotations

from . import early_interrupts  # noqa: F401

# isort: split
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.markup import escape

from ..campaign.compile_ahead import compiling_ahead
from ..display.compiling import fields_of, tell_first_use, tell_maps
from ..display.progress import Progress
from ..display.responsive_table import ResponsiveTable
from ..display.timing import Moment
from ..figures.numbers import counted
from ..spec.limits import MOST_RUNS, MOST_SEED
from .advise import advise
from .bound import bound
from .cards import cards
from .check import check
from .commands import EXIT_INTERRUPTED, Commands
from .exchange import export, judge
from .flights import estimate, record
from .imu import imu
from .keys import keys
from .library import Outcome, print_outcomes, report, run_all
from .maps import map_group
from .new import new
from .plan import plan
from .score import score
from .screen import console
from .validate import note_unusual_values, validate

if TYPE_CHECKING:
    from ..results.folder import Results

EXIT_WORSE = 1
_MANY_CASES = 10


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="ggbench", message="%(prog)s %(version)s")
def main() -> None:
    """Benchmark estimators for gravity-gradient-aided inertial navigation."""
    # One BLAS thread per process: more double the processor time for nothing on matrices this
    # small. It must be said before NumPy is loaded, so each command imports what it needs itself.
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")


for _command in (
    map_group,
    advise,
    bound,
    cards,
    check,
    imu,
    keys,
    new,
    estimate,
    export,
    judge,
    plan,
    record,
    report,
    score,
    validate,
):
    main.add_command(_command)


@main.command("list")
def list_command() -> None:
    """List the scenarios and the estimators with their parameters."""
    from ..campaign import registry
    from ..parameters import parameters_of
    from ..spec import scenario

    table = ResponsiveTable(
        "Scenarios", [("scenario", "name"), ("title", "text"), ("cases", "text")]
    )
    for name in scenario.shipped():
        loaded = scenario.load(name)
        cases = ", ".join(case.name for case in loaded.cases)
        if loaded.sweep:
            axes = (f"{len(axis.values)} of {axis.name}" for axis in loaded.sweep.axes)
            cases = f"{len(loaded.cases)}: {' × '.join(axes)}"
        table.add_row(name, escape(loaded.title), cases)
    table.print(console)
    table = ResponsiveTable(
        "Estimators", [("estimator", "name"), ("what it is", "text"), ("parameters", "text")]
    )
    for name, cls in registry.registered().items():
        parameters = [
            f"{key}={parameter.default} ({parameter.allowed()})"
            for key, parameter in parameters_of(cls).items()
        ]
        summary = (cls.__doc__ or "").strip().splitlines()[0]
        table.add_row(name, escape(summary), escape("\n".join(parameters)))
    table.print(console)
    console.print(f"Frameworks, each with an extra: {', '.join(registry.framework_points())}")
    console.print(
        "Your own: a .py file, a file of estimates (.mat, .nc, .txt), exec:PROGRAM", markup=False
    )


@main.command()
@click.argument("scenario_name", metavar="[SCENARIO]", required=False)
@click.option(
    "--all",
    "whole_library",
    is_flag=True,
    help="Run every shipped scenario, into results/NAME, or DIR/NAME with -o DIR.",
)
@click.option(
    "-e",
    "--estimator",
    "estimators",
    multiple=True,
    metavar="NAME[param=value,...]",
    help="A name, a .py file, a file of estimates, exec:PROGRAM or a roster: a named set such as "
    "@core; repeatable [the scenario's].",
)
@click.option(
    "-n", "--runs", type=click.IntRange(1, MOST_RUNS), help="Runs per case [the scenario's]."
)
@click.option("-s", "--seed", type=click.IntRange(0, MOST_SEED), help="Seed [the scenario's].")
@click.option(
    "-c", "--case", "cases", multiple=True, metavar="NAME", help="Case to run; repeatable [all]."
)
@click.option(
    "--assumptions",
    is_flag=True,
    help="Also run the changes in the scenario's [[assumption]] tables.",
)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="Results folder [results/SCENARIO]."
)
@click.option(
    "--resume/--fresh",
    default=True,
    help="Resume the stored campaign, or discard it [resume].",
)
@click.option(
    "--retry-failed",
    is_flag=True,
    help="Repeat failed runs.",
)
@click.option(
    "-j",
    "--jobs",
    type=click.IntRange(0),
    help="Worker processes [all processors]; 0: this process, for debugging, without time limit.",
)
@click.option("--cluster", metavar="ADDRESS", help="Run on the Dask scheduler at this address.")
@click.option(
    "--time-limit",
    type=click.FloatRange(0.0, 1e9, min_open=True),
    metavar="SECONDS",
    help="Time limit of one run of one estimator [the scenario's, else 600].",
)
@click.option(
    "--run",
    "one_run",
    type=click.IntRange(0, MOST_RUNS),
    metavar="K",
    help="Run only run K, in this process; show it and store nothing.",
)
def run(
    scenario_name: str | None,
    whole_library: bool,
    output: Path | None,
    one_run: int | None,
    **options: Any,
) -> None:
    """Run a SCENARIO.

    SCENARIO is the name of a shipped scenario or a path. Each finished run is stored at once. The
    same command resumes an interrupted campaign.

    Exit code 1 if every run of an estimator failed, 2 if the command is invalid, 130 if it was
    interrupted.
    """
    request = _Asked(**options)
    if request.cluster and request.jobs is not None:
        raise click.UsageError("give either -j or --cluster")
    if request.retry_failed and not request.resume:
        raise click.UsageError("--fresh discards all runs: remove --retry-failed")
    if whole_library and (scenario_name or request.cases or one_run is not None):
        raise click.UsageError(
            "--all runs all cases of all scenarios: remove SCENARIO, -c and --run"
        )
    if scenario_name is None and not whole_library:
        raise click.UsageError("name a SCENARIO, or --all")
    alone = _Asked(request.estimators, seed=request.seed, cases=request.cases)
    if one_run is not None and (output or request != alone):
        raise click.UsageError("--run stores nothing: only -e, -c and --seed are allowed with it")
    request = replace(request, first=tell_first_use("ins/strapdown.py", "in a minute or two"))
    if scenario_name is None:
        sys.exit(_run_library(request, output or Path("results")))
    if one_run is not None:
        sys.exit(0 if _repeat(scenario_name, request, one_run) else EXIT_WORSE)
    outcome = _run_scenario(scenario_name, request, output)
    if outcome.interrupted:
        sys.exit(EXIT_INTERRUPTED)
    sys.exit(EXIT_WORSE if outcome.without_success else 0)


@dataclass(frozen=True)
class _Asked:
    """The options of a campaign, as the user gave them."""

    estimators: tuple[str, ...] = ()
    runs: int | None = None
    seed: int | None = None
    cases: tuple[str, ...] = ()
    assumptions: bool = False
    resume: bool = True
    retry_failed: bool = False
    jobs: int | None = None
    cluster: str | None = None
    time_limit: float | None = None
    first: bool = False
    """Whether the cache of compiled code is empty."""


def _repeat(name: str, request: _Asked, number: int) -> bool:
    """Repeat one run and print it; return whether no estimator failed."""
    from ..campaign import registry
    from ..spec import scenario
    from . import run_view

    loaded = scenario.load(name)
    flown = tuple(loaded.find(case)[1] for case in request.cases) or loaded.cases
    note_unusual_values(replace(loaded, cases=flown, assumptions=()))
    tell_maps(fields_of(flown))
    choices = registry.choose_all(request.estimators or loaded.campaign.estimators)
    seed = loaded.campaign.seed if request.seed is None else request.seed
    labels = [choice.label for choice in choices]
    return run_view.repeat_run(loaded, request.cases, labels, seed, number)


def _run_scenario(name: str, request: _Asked, output: Path | None) -> Outcome:
    """Run a scenario and return its outcome; the default output folder is results/SCENARIO."""
    start = Moment.now()
    with (
        Progress(console, name) as progress,
        compiling_ahead(request.first, request.jobs) as compile_them,
    ):
        # All of it here: an interrupt is not to meet an import once runs are running.
        from ..campaign import campaign, running
        from ..spec import scenario
        from . import flight_limits, flight_summary

        loaded = scenario.load(name)
        work = campaign.planned(
            loaded,
            output or Path("results") / loaded.name,
            request.estimators,
            runs=request.runs,
            seed=request.seed,
            cases=request.cases,
            assumptions=request.assumptions,
            time_limit=request.time_limit,
            fresh=not request.resume,
            retry_failed=request.retry_failed,
        )
        compile_them(work.labels)
        planned = work.plan.scenario
        flight_summary.warn(flight_limits.examined(planned))  # it tells of maps that it builds
        tell_maps(fields_of(case for _, case in planned.every_case()))
        if len(loaded.cases) > _MANY_CASES:
            click.echo(f"preparing {counted(len(loaded.cases), 'case')}")
        ended: BaseException | None = None
        try:
            results = running.fly(work, request.jobs, request.cluster, progress.tell)
        except (running.InterruptedCampaign, running.MissingRunsError) as error:
            ended, results = error, error.results
    # Of workers elsewhere nothing is known here.
    took = "" if request.cluster else f"It took {start.since()}."
    outcome = _finish(results, isinstance(ended, running.InterruptedCampaign), took)
    if isinstance(ended, running.MissingRunsError):
        raise ended
    return outcome


def _run_library(request: _Asked, output: Path) -> int:
    """Run every shipped scenario, even after a failure; return the exit code."""
    from ..campaign import registry
    from ..spec import scenario

    registry.choose_all(request.estimators)  # a wrong name is wrong in all of them

    def run_one(name: str) -> Outcome:
        studied = request.assumptions and bool(scenario.load(name).assumptions)
        return _run_scenario(name, replace(request, assumptions=studied), output / name)

    outcomes = run_all(scenario.shipped(), run_one)
    print_outcomes(outcomes, output)
    if any(outcome.interrupted for outcome in outcomes):
        return EXIT_INTERRUPTED
    any_failed = any(outcome.error or outcome.without_success for outcome in outcomes)
    return EXIT_WORSE if any_failed else 0


def _finish(results: Results, interrupted: bool, took: str) -> Outcome:
    """Print the metrics of the stored runs and the next command; return the outcome."""
    from ..campaign.campaign import left_out_remarks
    from ..results.folder import as_argument
    from .terminal import print_metrics

    metrics = results.metrics()
    runs, failed = results.runs(), len(results.failures())
    if len(metrics):
        print_metrics(metrics, runs, results.scenario, console)
    finished = (runs["status"] == "ok").groupby(runs["estimator"], sort=False).any()
    outcome = Outcome(
        results.scenario.name,
        len(runs),
        failed,
        int(runs["diverged"].sum()),
        interrupted,
        without_success=tuple(finished.index[~finished]),
    )
    name = as_argument(str(results.folder))
    if took:
        click.echo(took)
    if failed:
        click.echo(
            f"{counted(failed, 'run')} failed: 'ggbench show {name}' shows the reasons and the "
            "commands that repeat them."
        )
    manifest = results.manifest
    for remark in left_out_remarks(manifest["left_out"], manifest["cases"]):
        click.echo(f"Note: {remark}.")
    if outcome.without_success:
        click.echo(f"All runs of {' and of '.join(outcome.without_success)} failed.")
    if interrupted:
        click.echo(
            f"Interrupted. Finished runs are stored in {name}: 'ggbench report {name}' reports "
            "them, and the same command resumes."
        )
        return outcome
    click.echo(f"Results are in {name}; 'ggbench report {name}' writes the report.")
    return outcome


@main.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--run", "number", type=click.IntRange(0), metavar="K", help="Run to show.")
@click.option("-c", "--case", metavar="NAME", help="Case to show.")
def show(folder: Path, number: int | None, case: str | None) -> None:
    """Show the contents of a results FOLDER and one of its runs.

    By default this is the first failed run. If no run failed, it is the run with the largest error
    relative to the median.
    """
    from ..results.folder import Results
    from . import run_view

    results = Results(folder)
    chosen, which, reason = run_view.choose_run(results, case, number)
    if number is None:
        run_view.overview(results)
    console.out(f"Shown: {reason}")
    run_view.show_run(results, chosen, which)


@main.command()
@click.argument("before", type=click.Path(path_type=Path))
@click.argument("after", type=click.Path(path_type=Path))
@click.option(
    "--threshold",
    type=click.FloatRange(0.0),
    default=0.01,
    show_default=True,
    help="Accepted relative increase of an error; 0.01 is one percent.",
)
@click.option(
    "--window",
    type=click.Choice(["whole", "settled", "last20"]),
    default="settled",
    show_default=True,
    help="Averaging window: whole flight, from settled_from_s on, or the last last_s seconds.",
)
@click.option(
    "--require-all", is_flag=True, help="Also fail if AFTER lacks an estimator or case of BEFORE."
)
def compare(before: Path, after: Path, threshold: float, window: str, require_all: bool) -> None:
    """Compare the errors of two results folders, run by run.

    Exit code 1 if an error increased significantly by more than the threshold. With --require-all
    the exit code is also 1 if AFTER lacks an estimator or case of BEFORE.
    """
    from ..judging.comparison import compare as compare_runs
    from ..results.folder import Results
    from .terminal import print_comparison

    compared = compare_runs(Results(before).runs(), Results(after).runs(), threshold, window)
    print_comparison(compared, console)
    incomplete = require_all and bool(compared.only_before)
    sys.exit(EXIT_WORSE if compared.worse or incomplete else 0)
