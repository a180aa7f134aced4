"""Problems from Python: simulate or read one, estimate it, judge and correct."""

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
        """Draw the ENU errors of position and velocity with their reported ±3σ."""
        from ..figures.errors import with_deviations  # not at the top: few want a figure

        return with_deviations(self.times, self.components, self.sigmas)

    def to_frame(self) -> pd.DataFrame:
        """Return a row for each epoch: errors ENU [m, m/s] and their σ, NEES and NIS."""
        import pandas as pd

        columns = {"time_s": self.times}
        for column, name in enumerate(_COMPONENTS):
            columns[name] = self.components[:, column]
            columns[f"sigma_{name}"] = self.sigmas[:, column]
        return pd.DataFrame(columns | {"nees": self.nees, "nis": self.nis})


def judge(
    problem: Problem, estimate: Estimate, truth: Truth, windows: WindowsSpec | None = None
) -> Judgement:
    """Judge an estimate of a problem by its truth; as :func:`ggbench.judging.judgement.judge`.

    Parameters
    ----------
    problem : that was estimated.
    estimate : of it.
    truth : that the problem hides.
    windows : parts of the flight to be judged besides the whole, as ``case.windows`` has them.

    Raises
    ------
    JudgingError
        If the estimate has another shape than the problem, or no covariance; or the truth is of
        other epochs.
    """
    return Judgement(**vars(judgement.judge(problem, estimate, truth, windows)))


def load(name_or_path: str | Path) -> Scenario:
    """Read a scenario: the name of a shipped one, or the path of a TOML file.

    Raises
    ------
    ScenarioError
        With a sentence that names the file, the key, what was found and what is allowed.
    """
    if not isinstance(name_or_path, str | Path):
        raise ArgumentError(f"the scenario must be a name or a path, not {kind(name_or_path)}")
    return scenarios.load(name_or_path)


def case_of(source: CaseSpec | Scenario | str | Path) -> CaseSpec:
    """Return a case, or the first one of a scenario, its name or its path.

    Raises
    ------
    ArgumentError, ScenarioError
        If it is none of these, or the scenario cannot be read.
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
    """Return the estimation problem of one run of a case, and the truth that it hides.

    Parameters
    ----------
    case : as ``scenario.case(name)`` gives it, or changed by its ``changed(key, value)``; or a
        scenario, its name or its path, of which the first case is taken. It is flown once; its runs
        then come quickly.
    seed : of the random numbers; by default that of the case's scenario, as for :func:`run`.
    run : its number. A campaign of the same seed has the same problem in this run.

    Raises
    ------
    ArgumentError, ScenarioError
        If there is no such run, or the case breaks a rule of scenario files.
    GGBenchError
        If the case cannot be flown.
    """
    case = case_of(case)
    used_seed = whole("seed", case.seed if seed is None else seed, 0, MOST_SEED)
    run = whole("run", run, 0, MOST_RUNS)
    return simulation.simulate(flight_of(scenarios.checked(case).of_run(run)), used_seed, run)


def estimator(text: str) -> Estimator:
    """Return the estimator that a text names: ``NAME`` or ``NAME[parameter=value,...]``.

    NAME is that of a registered estimator, or the path of a file that defines one.

    Raises
    ------
    EstimatorError
        If the text, the name, the file or a parameter is wrong; the message says what is allowed.
    """
    if not isinstance(text, str):
        raise ArgumentError(f"the estimator must be a text, not {kind(text)}")
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
        raise ArgumentError(f"the flight must be the path of a file, not {kind(path)}")
    from ..recorded.flight import read_flight as read  # not at the top: it loads slowly

    flight = read(path)
    return flight.problem, flight.reference


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
        raise ArgumentError(f"the problem must be a Problem, not {kind(problem)}")
    if not isinstance(estimate, Estimate):
        raise ArgumentError(f"the estimate must be an Estimate, not {kind(estimate)}")
    import pandas as pd

    from ..recorded.corrected import corrected as columns

    return pd.DataFrame(columns(problem, estimate, number("start", start)))


def _estimator(item: str | Estimator) -> Estimator:
    return item if isinstance(item, Estimator) else estimator(item)
