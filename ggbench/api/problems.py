"""Functions on single problems: simulate, read_flight, estimate, judge and corrected."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .. import estimation
from ..campaign import registry
from ..campaign.flights import flight_of
from ..judging import judgement
from ..judging.judgement import epochs_outside
from ..problem import Estimate, Estimator, Problem
from ..simulation import runs as simulation
from ..simulation.runs import Truth
from ..spec import scenario as scenarios
from ..spec.case import CaseSpec, WindowsSpec
from ..spec.limits import MOST_RUNS, MOST_SEED
from ..spec.scenario import Scenario
from .arguments import ArgumentError, kind, number, whole

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

_COMPONENTS = tuple(f"{axis}_{unit}" for unit in ("m", "mps") for axis in ("east", "north", "up"))


class Judgement(judgement.Judgement):
    """Errors of an estimate against the truth, with a figure and a table."""

    def plot(self) -> Figure:
        """Draw the ENU errors of position and velocity with the reported ±3σ."""
        from ..figures.errors import with_deviations  # not at the top: few want a figure

        return with_deviations(self.times, self.components, self.sigmas)

    def to_frame(self) -> pd.DataFrame:
        """Return a table with a row for each epoch: ENU errors [m, m/s] and their σ, NEES, NIS."""
        import pandas as pd

        columns = {"time_s": self.times}
        for column, name in enumerate(_COMPONENTS):
            columns[name] = self.components[:, column]
            columns[f"sigma_{name}"] = self.sigmas[:, column]
        return pd.DataFrame(columns | {"nees": self.nees, "nis": self.nis})


def judge(
    problem: Problem, estimate: Estimate, truth: Truth, windows: WindowsSpec | None = None
) -> Judgement:
    """Compare an estimate with the truth, see :func:`ggbench.judging.judgement.judge`.

    Parameters
    ----------
    problem : the problem that was estimated.
    estimate : estimate of the problem.
    truth : truth of the problem, or the reference of a recorded flight.
    windows : parts of the flight to judge in addition to the whole, for example ``case.windows``.

    Raises
    ------
    JudgingError
        If the estimate has no covariance, or if the shapes or epochs of problem, estimate and truth
        differ.
    """
    return Judgement(**vars(judgement.judge(problem, estimate, truth, windows)))


def load(name_or_path: str | Path) -> Scenario:
    """Read a scenario: the name of a shipped scenario, or the path of a TOML file.

    Raises
    ------
    ScenarioError
        If the scenario is invalid; the message states the file, the key, the value and the allowed
        values.
    """
    if not isinstance(name_or_path, str | Path):
        raise ArgumentError(f"the scenario must be a name or a path, not {kind(name_or_path)}")
    return scenarios.load(name_or_path)


def case_of(source: CaseSpec | Scenario | str | Path) -> CaseSpec:
    """Return the case itself, or the first case of a scenario (object, name or path).

    Raises
    ------
    ArgumentError, ScenarioError
        If the argument is neither a case nor a scenario, or the scenario cannot be read.
    """
    if isinstance(source, CaseSpec):
        return source
    if isinstance(source, Scenario):
        return source.cases[0]
    if isinstance(source, str | Path):
        return load(source).cases[0]
    raise ArgumentError(f"the case must be scenario.case(name) or a scenario, not {kind(source)}")


def simulate(
    case: CaseSpec | Scenario | str | Path, seed: int | None = None, run: int = 0
) -> tuple[Problem, Truth]:
    """Return the estimation problem of one run of a case, and its truth.

    Parameters
    ----------
    case : a case, from ``scenario.case(name)`` or ``case.changed(key, value)``; or a scenario
        (object, name or path), whose first case is then used. The flight is cached, so that further
        runs are quick.
    seed : seed of the random numbers; by default the scenario's, as in :func:`run`.
    run : index of the run, from 0. A campaign with the same seed has the same problem in this run.

    Raises
    ------
    ArgumentError, ScenarioError
        If ``run`` or ``seed`` is invalid, or the case breaks a rule of scenario files.
    GGBenchError
        If the case cannot be flown.
    """
    case = case_of(case)
    used_seed = whole("seed", case.seed if seed is None else seed, 0, MOST_SEED)
    run = whole("run", run, 0, MOST_RUNS)
    return simulation.simulate(flight_of(scenarios.checked(case).of_run(run)), used_seed, run)


def estimator(text: str) -> Estimator:
    """Return the estimator that a text ``NAME`` or ``NAME[parameter=value,...]`` describes.

    NAME is the name of a registered estimator, or the path of a file that defines one.

    Raises
    ------
    EstimatorError
        If the text, the name, the file or a parameter is invalid; the message states the allowed
        values.
    """
    if not isinstance(text, str):
        raise ArgumentError(f"the estimator must be a text, not {kind(text)}")
    return registry.choose(text).estimator


def estimate(problem: Problem, estimator: str | Estimator, seed: int = 0) -> Estimate:
    """Run an estimator on a problem.

    Parameters
    ----------
    problem : from :func:`simulate` or :func:`read_flight`.
    estimator : an estimator, or its text ``NAME[parameter=value,...]``.
    seed : seed of the estimator's random numbers; most estimators draw none.

    Raises
    ------
    EstimatorError
        If the estimator does not exist, refuses this problem, or returns no estimate. Errors of the
        estimator itself pass unchanged.

    Warns
    -----
    UserWarning
        If the estimated position leaves the map; beyond the border the field is extrapolated.
    """
    if not isinstance(problem, Problem):
        raise ArgumentError(f"the problem must be a Problem, not {kind(problem)}")
    chosen = _estimator(estimator)
    reason = chosen.skip(problem)
    if reason:
        raise registry.EstimatorError(f"{chosen.name} refuses this problem: {reason}")
    rng = np.random.default_rng(whole("seed", seed, 0, MOST_SEED))
    estimated = estimation.estimate(chosen, problem, rng)
    if not isinstance(estimated, Estimate):
        raise registry.EstimatorError(
            f"{chosen.name}: estimate() must return an Estimate, not {kind(estimated)}"
        )
    outside = epochs_outside(problem, estimated.mean)
    if estimated.causality != "none" and outside.any():
        warnings.warn(
            f"estimates of {chosen.name} leave the map at {np.count_nonzero(outside)} of "
            f"{problem.epochs} epochs, first {problem.times[outside.argmax()]:g} s after the "
            "start; the field is extrapolated from the border",
            stacklevel=2,
        )
    return estimated


def read_flight(path: str | Path) -> tuple[Problem, Truth | None]:
    """Read a recorded flight: the problem, and the reference if there is one.

    Parameters
    ----------
    path : path of the flight's TOML file.

    Returns
    -------
    Problem and reference, like the problem and truth of :func:`simulate`. Times [s] count from the
    first INS sample. Error states that the reference does not contain, such as biases, are NaN.
    If the reference lacks positions or velocities, the results of :func:`judge` that need them are
    NaN.

    Warnings state the number of interpolated INS samples, and the number of gradiometer rows of
    zeros, which count as missing measurements.

    Raises
    ------
    FlightError
        If the flight is invalid; the message states the file, the place, the value and the allowed
        values.
    """
    if not isinstance(path, str | Path):
        raise ArgumentError(f"the flight must be the path of a file, not {kind(path)}")
    from ..recorded.flight import read_flight as read  # not at the top: it loads slowly

    flight = read(path)
    for remark in flight.remarks:
        warnings.warn(remark, stacklevel=2)
    return flight.problem, flight.reference


def corrected(problem: Problem, estimate: Estimate, start: float = 0.0) -> pd.DataFrame:
    """Return the corrected track: the INS solution minus the estimated INS errors.

    Parameters
    ----------
    problem : from :func:`read_flight` or :func:`simulate`.
    estimate : estimate of the problem.
    start : offset added to the times [s].

    Returns
    -------
    A table with a row for each epoch: ``time_s``, ``latitude_deg``, ``longitude_deg``,
    ``height_m``, ENU velocities [m/s], ``heading_deg``, ``pitch_deg`` and ``roll_deg``. Further
    columns are standard deviations of position [m], velocity [m/s] and attitude [rad] in ENU. If
    the estimate has no covariance, they are NaN.

    Raises
    ------
    EstimateError
        If the problem has no track, or the estimate belongs to another problem.
    """
    if not isinstance(problem, Problem):
        raise ArgumentError(f"the problem must be a Problem, not {kind(problem)}")
    if not isinstance(estimate, Estimate):
        raise ArgumentError(f"the estimate must be an Estimate, not {kind(estimate)}")
    import pandas as pd

    from ..recorded.corrected import corrected as columns

    return pd.DataFrame(columns(problem, estimate, number("start", start)))


def _estimator(item: str | Estimator) -> Estimator:
    return item if isinstance(item, Estimator) else estimator(item)
