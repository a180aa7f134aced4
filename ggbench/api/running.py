"""Functions that run campaigns: a scenario, changed cases, or a sweep over values."""

from __future__ import annotations

import contextlib
import itertools
import shutil
import tempfile
import warnings
import weakref
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..campaign import campaign, registry, running
from ..campaign.compile_ahead import compiling_ahead
from ..display.compiling import first_use
from ..problem import Estimator
from ..spec import scenario as scenarios
from ..spec import written
from ..spec.case import CaseSpec
from ..spec.limits import MOST_RUNS, MOST_SEED
from ..spec.scenario import Scenario
from .arguments import ArgumentError, listed, number, whole
from .problems import load
from .results import Results
from .showing import shown_progress

_LONGEST_S = 1e9


def run(
    scenario: Scenario | CaseSpec | Sequence[CaseSpec] | str | Path,
    estimators: Sequence[str | Estimator] | str | Estimator = (),
    runs: int | None = None,
    *,
    seed: int | None = None,
    cases: Sequence[str] | str = (),
    assumptions: bool = False,
    output: Path | str | None = None,
    jobs: int | None = None,
    cluster: str | None = None,
    time_limit: float | None = None,
    fresh: bool = False,
    retry_failed: bool = False,
    progress: bool | Callable[[int, int], object] | None = None,
) -> Results:
    """Run a scenario with estimators, as ``ggbench run`` does, and return the results.

    Parameters
    ----------
    scenario : a scenario, its name, the path of its file, or one or more cases.
    estimators : texts ``NAME[parameter=value,...]``, or estimators whose classes are registered or
        come from a file; by default the scenario's estimators. An estimator that refuses the
        scenario is left out with a warning.
    runs, seed : number of runs per case, and the seed; by default the scenario's.
    cases : names of the cases to run; by default all.
    assumptions : whether to also run the scenario's assumptions. An assumption is a change of the
        scenario that applies to every case with published numbers.
    output : folder for the results. Stored runs are not repeated, and the same call resumes an
        interrupted campaign. By default a temporary folder, which is removed with the results
        object.
    jobs : number of worker processes, by default one for each processor; 0: all runs in this
        process, without time limit.
    cluster : address of a Dask scheduler, for execution on a cluster.
    time_limit : time limit of one run of one estimator [s]; by default the scenario's.
    fresh : whether to discard the stored results of the folder.
    retry_failed : whether to repeat failed runs, for example after a full disk.
    progress : whether to show compilation, map building and progress on standard error; by default
        in a terminal and in a notebook. In place of True or False, a function may be given. It is
        called with two numbers: results stored so far by this call, and all results to store.

    Raises
    ------
    GGBenchError
        If a name does not exist, a case cannot be flown, the folder is unusable, or runs have
        neither a result nor a recorded failure. A failed run raises nothing: ``failures()`` of the
        results lists it.
    KeyboardInterrupt
        If interrupted; ``output`` keeps the finished runs.
    """
    count = None if runs is None else whole("runs", runs, 1, MOST_RUNS)
    start = None if seed is None else whole("seed", seed, 0, MOST_SEED)
    processes = None if jobs is None else whole("jobs", jobs, 0, MOST_RUNS)
    if cluster and jobs is not None:
        raise ArgumentError("give either jobs or cluster")
    if time_limit is not None and not 0.0 < number("time_limit", time_limit) <= _LONGEST_S:
        raise ArgumentError(
            f"time_limit is {time_limit} s and must be above 0 and at most {_LONGEST_S:g}"
        )
    loaded, chosen_cases = scenario_of(scenario)
    texts = [text_of_estimator(item) for item in listed(estimators, str | Estimator, "estimators")]
    temporary = None if output is not None else tempfile.mkdtemp(prefix="ggbench-")
    display = shown_progress(progress, loaded.name)
    try:

        def reported(step: running.CampaignProgress) -> None:
            first_remarks = step.remarks if step.done == 0 and step.workers is None else ()
            for remark in (*first_remarks, *filter(None, [step.waiting])):
                warnings.warn(remark, stacklevel=5)
            display.tell(step)

        compiled = first_use("ins/strapdown.py", "in a minute or two")
        with (
            display.display or contextlib.nullcontext(),
            compiling_ahead(bool(compiled), processes) as compile_them,
        ):
            work = campaign.planned(
                loaded,
                Path(temporary or str(output)),
                texts,
                runs=count,
                seed=start,
                cases=listed(cases, str, "cases") or chosen_cases,
                assumptions=assumptions,
                time_limit=time_limit,
                fresh=fresh,
                retry_failed=retry_failed,
            )
            compile_them(work.labels)
            display.tell_first_use(compiled, work.plan.scenario)
            running.fly(work, processes, cluster, reported)
        results = Results(work.folder)
        if temporary is not None:
            # At the latest when the process ends.
            weakref.finalize(results, shutil.rmtree, temporary, ignore_errors=True)
    except BaseException:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
        raise
    return results


def sweep(
    case: CaseSpec,
    values: Mapping[str, Sequence[Any]],
    estimators: Sequence[str | Estimator] | str | Estimator,
    runs: int,
    **options: Any,
) -> Results:
    """Run a case with every combination of values and return the results.

    ``gg.sweep(case, {"gradiometer.noise_eotvos": [0.1, 1.0]}, "ekf", 20)``

    Parameters
    ----------
    case : case to change.
    values : values of each dotted key (:meth:`.CaseSpec.changed`).
    estimators, runs : as in :func:`run`.
    options : further arguments of :func:`run`.

    Returns
    -------
    Results whose cases are named ``point-0``, ``point-1``, ... in the order of the combinations;
    their titles state the values.

    Raises
    ------
    GGBenchError
        As in :func:`run`; also if a case with these values breaks a rule of scenario files.
    """
    keys = list(values)
    if not keys or not all(values.values()):
        raise ArgumentError("a sweep needs at least one key, and each key at least one value")
    points = []
    for number_of, combination in enumerate(itertools.product(*values.values())):
        point = case
        for key, value in zip(keys, combination, strict=True):
            point = point.changed(key, value)
        title = ", ".join(f"{k.split('.')[-1]} {v}" for k, v in zip(keys, combination, strict=True))
        points.append(point.changed("name", f"point-{number_of}").changed("title", title))
    return run(points, estimators, runs, **options)


def scenario_of(
    source: Scenario | CaseSpec | Sequence[CaseSpec] | str | Path,
) -> tuple[Scenario, tuple[str, ...]]:
    """Return a scenario, and the names of its chosen cases.

    The names are empty if all cases are chosen.

    Raise ArgumentError if there is no case, ScenarioError if a file cannot be read.
    """
    if isinstance(source, CaseSpec):
        return written.of_cases([source]), ()
    if isinstance(source, Scenario):
        complete = scenarios.as_written(source)
        names = tuple(case.name for case in source.cases)
        return complete, () if len(names) == len(complete.cases) else names
    if isinstance(source, Sequence) and not isinstance(source, str):
        cases = listed(source, CaseSpec, "cases")
        if not cases:
            raise ArgumentError("a campaign needs at least one case")
        return written.of_cases(cases), ()
    return load(source), ()


def text_of_estimator(item: str | Estimator) -> str:
    """Return the text ``NAME[parameter=value,...]`` of an estimator."""
    return str(registry.spec_of(item)) if isinstance(item, Estimator) else item
