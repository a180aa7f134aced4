"""What a notebook or a script calls; ``import ggbench as gg`` has it all by ``gg.NAME``.

    scenario = gg.load("wang2013")
    problem, truth = gg.simulate(scenario.case("0.01E-1Hz"), seed=1, run=0)
    estimate = gg.estimate(problem, "ukf[points=merwe]")
    gg.judge(problem, estimate, truth)
    gg.run(scenario, ["ins", "ekf"], runs=20).figures()
    problem, reference = gg.read_flight("flight.toml")
    gg.corrected(problem, gg.estimate(problem, "ekf"))

Whatever is wrong ends in a :class:`~ggbench.errors.GGBenchError` whose message is a sentence.
"""

from __future__ import annotations

import operator
import shutil
import tempfile
import warnings
import weakref
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import estimation
from .campaign import campaign, registry, running
from .campaign.campaign import CampaignError
from .campaign.runner import flight_of
from .errors import GGBenchError
from .judging.judgement import Judgement as Judgement
from .judging.judgement import epochs_outside
from .judging.judgement import judge as judge
from .judging.summary import ordered
from .problem import Estimate, Estimator, Problem
from .results import folder
from .results.folder import ResultsError
from .results.store import Store
from .simulation import runs as simulation
from .simulation.runs import Truth
from .spec import scenario as scenarios
from .spec.case import CaseSpec
from .spec.limits import MOST_RUNS, MOST_SEED
from .spec.scenario import Scenario

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from .figures.stored import Quantity

_LONGEST_S = 1e9
_MOST_NAMED = 4


class ArgumentError(GGBenchError):
    """A function was called with something that it cannot use."""


def load(name_or_path: str | Path) -> Scenario:
    """Read a scenario: the name of a shipped one, or the path of a TOML file.

    Raises
    ------
    ScenarioError
        With a sentence that names the file, the key, what was found and what is allowed.
    """
    if not isinstance(name_or_path, str | Path):
        raise ArgumentError(
            f"a scenario is loaded by its name or path, not by {_kind(name_or_path)}"
        )
    return scenarios.load(name_or_path)


def simulate(case: CaseSpec, seed: int = 1, run: int = 0) -> tuple[Problem, Truth]:
    """Return the estimation problem of one run of a case, and the truth that it hides.

    Parameters
    ----------
    case : as ``scenario.case(name)`` gives it, or changed by its ``model_copy``. It is flown once;
        its runs then come quickly.
    seed, run : with the seed of a campaign, the same problem that it has in this run.

    Raises
    ------
    ArgumentError, ScenarioError
        If there is no such run, or the case breaks a rule of scenario files.
    GGBenchError
        If the case cannot be flown.
    """
    if not isinstance(case, CaseSpec):
        raise ArgumentError(
            f"a case is simulated, as scenario.case(name) gives it, and not {_kind(case)}"
        )
    seed, run = _whole("seed", seed, 0, MOST_SEED), _whole("run", run, 0, MOST_RUNS)
    return simulation.simulate(flight_of(scenarios.checked(case).of_run(run)), seed, run)


def estimator(text: str) -> Estimator:
    """Return the estimator that a text names: ``NAME`` or ``NAME[parameter=value,...]``.

    NAME is that of a registered estimator, or the path of a file that defines one.

    Raises
    ------
    EstimatorError
        If the text, the name, the file or a parameter is wrong; the message says what is allowed.
    """
    if not isinstance(text, str):
        raise ArgumentError(f"an estimator is named by a text, not by {_kind(text)}")
    return registry.choose(text).estimator


def estimate(problem: Problem, estimator: str | Estimator, seed: int = 0) -> Estimate:
    """Let an estimator estimate a problem.

    Parameters
    ----------
    problem : as :func:`simulate` gives it.
    estimator : itself, or the text that names it.
    seed : of the generator that it is given; most have no use for it.

    Raises
    ------
    EstimatorError
        If it is named wrongly, cannot take this problem, or returns no estimate. What it raises
        itself is not caught.

    Warns
    -----
    UserWarning
        If the estimate lies outside the problem's map, where the border's values go on.
    """
    if not isinstance(problem, Problem):
        raise ArgumentError(f"a Problem is estimated, and not {_kind(problem)}")
    chosen = _estimator(estimator)
    reason = chosen.skip(problem)
    if reason:
        raise registry.EstimatorError(f"{chosen.name} cannot take this problem: {reason}")
    rng = np.random.default_rng(_whole("seed", seed, 0, MOST_SEED))
    found = estimation.estimate(chosen, problem, rng)
    if not isinstance(found, Estimate):
        raise registry.EstimatorError(
            f"{chosen.name}: estimate() returned {_kind(found)} and must return an Estimate"
        )
    outside = epochs_outside(problem, found.mean)
    if found.causality != "none" and outside.any():
        warnings.warn(
            f"{chosen.name} believes to be outside the map at {np.count_nonzero(outside)} of "
            f"{problem.epochs} epochs, first {problem.times[outside.argmax()]:g} s after the "
            "start: the border's values go on there",
            stacklevel=2,
        )
    return found


def read_flight(path: str | Path) -> tuple[Problem, Truth | None]:
    """Read a recorded flight: the problem that its records are, and its reference if it has one.

    Parameters
    ----------
    path : of its TOML file. Times of the problem are since the first sample of the INS [s].

    Returns
    -------
    What :func:`simulate` gives of a simulated run. The reference's errors are NaN where it says
    nothing, as of the biases; with positions and velocities :func:`judge` takes it.

    Raises
    ------
    FlightError
        With a sentence that names the file, the place in it, what was found and what is allowed.
    """
    if not isinstance(path, str | Path):
        raise ArgumentError(f"a flight is read by the path of its file, not by {_kind(path)}")
    from .recorded.flight import read_flight as read  # not at the top: it loads slowly

    found = read(path)
    return found.problem, found.reference


def corrected(problem: Problem, estimate: Estimate, start: float = 0.0) -> pd.DataFrame:
    """Return the corrected track: what the INS indicates, less its estimated errors.

    Parameters
    ----------
    problem : as :func:`read_flight` or :func:`simulate` gives it.
    estimate : of it.
    start : what is added to the times [s].

    Returns
    -------
    A row for each epoch: ``time_s``, ``latitude_deg``, ``longitude_deg``, ``height_m``, velocities
    ENU [m/s], ``heading_deg``, ``pitch_deg``, ``roll_deg``, and standard deviations of position
    [m], velocity [m/s] and tilt [rad] about ENU, NaN if the estimate claims none.

    Raises
    ------
    EstimateError
        If the problem has no track, or the estimate is another one's.
    """
    if not isinstance(problem, Problem):
        raise ArgumentError(f"the track of a Problem is corrected, and not {_kind(problem)}")
    if not isinstance(estimate, Estimate):
        raise ArgumentError(f"a track is corrected by an Estimate, and not by {_kind(estimate)}")
    import pandas as pd

    from .recorded.corrected import corrected as columns

    return pd.DataFrame(columns(problem, estimate, _number("start", start)))


def run(
    scenario: Scenario | str | Path,
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
    progress: Callable[[int, int], object] | None = None,
) -> Results:
    """Run a scenario with estimators, as ``ggbench run`` does, and return the results.

    Parameters
    ----------
    scenario : itself, its name, or the path of its file.
    estimators : texts, or estimators whose classes are registered or come from a file; by default
        the scenario's. One that cannot take the scenario is left out with a warning.
    runs, seed : number of runs per case, and the seed; by default the scenario's.
    cases : names of those to run; by default all.
    assumptions : also study the scenario's assumptions.
    output : folder that keeps the results. What it holds already is not run again, and the same
        call goes on where it was stopped. By default a temporary one, gone with the results object.
    jobs : number of worker processes, by default one for each processor; 0: none, all runs are run
        in this process, without time limit.
    cluster : address of a Dask scheduler to run on instead.
    time_limit : longest time of one run of one estimator [s]; by default the scenario's.
    fresh : discard what the folder holds.
    progress : called with the numbers of results stored, and to be stored, by this call.

    Raises
    ------
    GGBenchError
        If something is named wrongly, a case cannot be flown, the folder cannot be used, or runs
        gave no result at all. A run that fails is no error: ``failures()`` of the results has it.
    KeyboardInterrupt
        If it is stopped; an ``output`` keeps what has finished.
    """
    count = None if runs is None else _whole("runs", runs, 1, MOST_RUNS)
    start = None if seed is None else _whole("seed", seed, 0, MOST_SEED)
    processes = None if jobs is None else _whole("jobs", jobs, 0, MOST_RUNS)
    if cluster and jobs is not None:
        raise ArgumentError("jobs are of this machine and a cluster is others: give one of them")
    if time_limit is not None and not 0.0 < _number("time_limit", time_limit) <= _LONGEST_S:
        raise ArgumentError(f"time_limit is {time_limit} s and must lie above 0, to {_LONGEST_S:g}")
    if isinstance(scenario, Scenario):
        loaded, chosen_cases = _as_written(scenario)
    else:
        loaded, chosen_cases = load(scenario), ()
    texts = [_text(item) for item in _listed(estimators, str | Estimator, "estimators")]
    kept = None if output is not None else tempfile.mkdtemp(prefix="ggbench-")
    try:
        work = campaign.planned(
            loaded, Path(kept or str(output)), texts, count, start,
            _listed(cases, str, "cases") or chosen_cases, assumptions, time_limit, fresh,
        )  # fmt: skip

        def reported(step: running.CampaignProgress) -> None:
            if step.done == 0:
                for remark in step.remarks:
                    warnings.warn(remark, stacklevel=4)
            if progress is not None:
                progress(step.done, step.total)

        ended = running.run(work, processes, cluster, reported)
        results = Results(work.folder, ended.store)
        if kept is not None:
            # At the latest when the process ends.
            weakref.finalize(results, shutil.rmtree, kept, ignore_errors=True)
    except BaseException:
        if kept is not None:
            shutil.rmtree(kept, ignore_errors=True)
        raise
    folder.write_tables(results)
    # From here on it is only read: another call may go on in the folder.
    ended.store.close()
    results.store = Store(work.folder)
    if ended.interrupted:
        raise KeyboardInterrupt
    if ended.missing:
        raise CampaignError(f"{ended.missing} runs gave no result; the same call goes on")
    return results


class Results(folder.Results):
    """What a results folder holds: tables, and figures of its cases.

    ``runs()``, ``figures()``, ``pairs()``, ``cases()`` and ``failures()`` are tables (pandas); each
    ``plot_...()`` returns a Matplotlib figure, which a notebook shows and ``savefig`` writes. A
    case that is not named is the first.

    Parameters
    ----------
    folder : of ``ggbench run``, or the ``output`` of :func:`run`.

    Raises
    ------
    StoreError
        If it is no results folder or is damaged.
    """

    def __repr__(self) -> str:
        cases = ", ".join(self.manifest["cases"][:_MOST_NAMED])
        if len(self.manifest["cases"]) > _MOST_NAMED:
            cases = f"{len(self.manifest['cases'])} cases"
        return (
            f"Results({self.manifest['scenario']}: {cases}; {', '.join(self.labels)}; runs 0 to "
            f"{self.run_count - 1}; in {self.folder})"
        )

    def plot_error_over_time(self, case: str | None = None) -> Figure:
        """Draw the RMS position and velocity errors over the runs against time, and the bounds.

        Raises
        ------
        ScenarioError
            If there is no such case.
        """
        from .figures import stored  # not at the top: tables need no Matplotlib

        name = self._case(case)
        shown = [row["estimator"] for row in ordered(self.figures(), name)]
        return stored.error_over_time(self, {name: shown})

    def plot_errors(
        self,
        case: str | None = None,
        estimator: str | None = None,
        quantity: Quantity = "position",
    ) -> Figure:
        """Draw the ENU errors of run 0 with their reported ±3σ, with the pure INS's if it was run.

        Parameters
        ----------
        case : its name.
        estimator : its label in the tables; by default the first that aids.
        quantity : ``position`` or ``velocity``.

        Raises
        ------
        ScenarioError, ResultsError
            If there is no such case or estimator, or run 0 has failed.
        """
        from .figures import stored

        label = estimator
        if label is None:
            label = next((label for label in self.labels if label != "ins"), self.labels[0])
        elif label not in self.labels:
            raise ResultsError(
                f"{self.folder} holds no estimator '{label}'; it holds {', '.join(self.labels)}"
            )
        return stored.component_errors(self, self._case(case), label, quantity)

    def plot_field(self, case: str | None = None) -> Figure:
        """Draw the map that a case flies over, at flight height, with the track.

        Raises
        ------
        ScenarioError, ResultsError
            If there is no such case, or it has no map.
        """
        from .figures import stored

        return stored.field_map(self, self._case(case))

    def plot_track_gradient(self, case: str | None = None) -> Figure:
        """Draw the vertical gradient along the track: true, with the noise, and filtered.

        Raises
        ------
        ScenarioError
            If there is no such case.
        """
        from .figures import stored

        return stored.track_gradient(self, self._case(case))

    def _case(self, name: str | None) -> str:
        """Return the name of a case that was run, the first one's for None."""
        return self.scenario.cases[0].name if name is None else self.scenario.case(name).name


def _as_written(scenario: Scenario) -> tuple[Scenario, tuple[str, ...]]:
    """Return the whole of a scenario and, if only some of its cases are in it, their names."""
    whole = scenarios.as_written(scenario)
    names = tuple(case.name for case in scenario.cases)
    return whole, () if len(names) == len(whole.cases) else names


def _estimator(item: str | Estimator) -> Estimator:
    return item if isinstance(item, Estimator) else estimator(item)


def _text(item: str | Estimator) -> str:
    return str(registry.spec_of(item)) if isinstance(item, Estimator) else item


def _listed(items: Any, kind: Any, name: str) -> list[Any]:
    """Return one thing of a kind, or a sequence of them, as a list.

    Raises
    ------
    ArgumentError
        If it is neither.
    """
    if isinstance(items, kind):
        return [items]
    if not isinstance(items, Sequence) or not all(isinstance(item, kind) for item in items):
        wanted = "texts" if kind is str else "texts or estimators"
        raise ArgumentError(f"{name} must be a list of {wanted}, and is {items!r}")
    return list(items)


def _whole(name: str, value: Any, least: int, most: int) -> int:
    """Return a whole number within limits, or raise ArgumentError."""
    try:
        number = operator.index(value)
    except TypeError:
        raise ArgumentError(f"{name} is {value!r} and must be a whole number") from None
    if not least <= number <= most:
        raise ArgumentError(f"{name} is {number} and must lie between {least} and {most}")
    return number


def _number(name: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ArgumentError(f"{name} is {value!r} and must be a number") from None


def _kind(value: Any) -> str:
    """Return of which type something is, as a message says it."""
    return f"an object of type {type(value).__name__}"
