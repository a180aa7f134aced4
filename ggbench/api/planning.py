"""Planning and scoring functions: bound, plan, advise, scorecard and check."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..campaign import examination
from ..judging import planned
from ..problem import Estimator
from ..simulation.error_free_flight import prepare
from ..spec.case import CaseSpec
from ..spec.limits import MOST_RUNS, MOST_SEED
from ..spec.scenario import Scenario
from .arguments import listed, number, whole
from .problems import case_of
from .running import scenario_of, text_of_estimator

if TYPE_CHECKING:
    import pandas as pd

    from ..score.advice import Advice
    from ..score.scoring import Score

_MOST_HEADINGS, _MOST_STARTS = 360, 15


def bound(case: CaseSpec | Scenario | str | Path) -> pd.DataFrame:
    """Return the Cramér–Rao bound along the track of a case, as ``ggbench bound`` does.

    Parameters
    ----------
    case : a case; or a scenario (object, name or path), whose first case is then used.

    Returns
    -------
    A table with a row for each epoch, see :func:`ggbench.judging.planned.planned`.

    Raises
    ------
    GGBenchError
        If the case cannot be flown.
    """
    return planned.planned(prepare(case_of(case).of_run(0)))


def plan(
    case: CaseSpec | Scenario | str | Path,
    headings: int = 8,
    starts: int = 1,
    step_km: float = 5.0,
) -> pd.DataFrame:
    """Rank alternative starts and headings of a flight by their bounds, as ``ggbench plan`` does.

    Parameters
    ----------
    case : as for :func:`bound`; the flight must consist of segments or follow a track.
    headings : number of evenly spaced headings.
    starts : number of starts along each side of a square centred at the original start.
    step_km : distance between neighbouring starts [km].

    Returns
    -------
    A table with a row for each track, smallest bound first; see
    :func:`ggbench.judging.planned.tracks`.

    Raises
    ------
    ArgumentError
        If a number is out of its range.
    GGBenchError
        If the flight follows survey lines.
    """
    return planned.around(
        case_of(case),
        whole("headings", headings, 1, _MOST_HEADINGS),
        whole("starts", starts, 1, _MOST_STARTS),
        number("step_km", step_km),
    )


def advise(
    scenario: Scenario | CaseSpec | str | Path,
    case: str | None = None,
    *,
    target_m: float | None = None,
    runs: int = 40,
    output: Path | str | None = None,
    jobs: int | None = None,
) -> Advice:
    """Recommend estimators for a case, as ``ggbench advise`` does.

    Parameters
    ----------
    scenario : as for :func:`ggbench.run`.
    case : name of the case; by default the first.
    target_m : required RMS position error [m].
    runs : number of runs of each estimator; a recommendation needs at least 40.
    output : results folder; by default a temporary folder, which is not removed.
    jobs : worker processes; by default one for each processor.

    Raises
    ------
    GGBenchError
        If the case cannot be flown, or no run has a result.
    """
    from ..score import advice  # not at the top: few want it

    loaded, names = scenario_of(scenario)
    flown = loaded.case(case or (names[0] if names else loaded.cases[0].name))
    return advice.advise(
        scenario=loaded,
        case=flown,
        folder=Path(output or tempfile.mkdtemp(prefix="ggbench-")),
        target_m=None if target_m is None else number("target_m", target_m),
        runs=whole("runs", runs, 2, MOST_RUNS),
        jobs=None if jobs is None else whole("jobs", jobs, 0, MOST_RUNS),
    )


def scorecard(
    estimator: str | Estimator,
    *,
    runs: int | None = None,
    seed: int | None = None,
    cases: Sequence[str] | str = (),
    output: Path | str | None = None,
    jobs: int | None = None,
) -> Score:
    """Score an estimator on the standard suite, as ``ggbench score`` does.

    Parameters
    ----------
    estimator : an estimator, or its text ``NAME[parameter=value,...]``.
    runs : number of runs of each case; by default as many as the suite stores.
    seed : seed of the runs; by default the public seed, for which runs of other estimators are
        stored.
    cases : names of the cases to fly; by default all.
    output : results folder; by default a temporary folder, which is not removed.
    jobs : worker processes; by default one for each processor.

    Returns
    -------
    A score with two attributes. ``card`` is the score card, and None if the campaign was
    interrupted. ``failures`` is a table of the runs that failed or diverged.

    Raises
    ------
    GGBenchError
        If the estimator or a case does not exist, or the estimator refuses all cases.
    """
    from ..score import scoring

    return scoring.score(
        estimator=text_of_estimator(estimator),
        folder=Path(output or tempfile.mkdtemp(prefix="ggbench-")),
        runs=None if runs is None else whole("runs", runs, 2, MOST_RUNS),
        seed=None if seed is None else whole("seed", seed, 0, MOST_SEED),
        cases=listed(cases, str, "cases"),
        jobs=None if jobs is None else whole("jobs", jobs, 0, MOST_RUNS),
    )


def check(estimator: str | Estimator, time_limit: float = examination.LIMIT_S) -> pd.DataFrame:
    """Test an estimator against the contract, as ``ggbench check`` does.

    Parameters
    ----------
    estimator : an estimator, or its text ``NAME[parameter=value,...]``.
    time_limit : time limit of each check [s].

    Returns
    -------
    A table with a row for each check. Column ``check`` is the name of the check. ``verdict`` is
    passed, failed or refused. ``demand`` is the property that must hold. ``text`` is a sentence on
    the verdict.

    Raises
    ------
    CheckError
        If the estimator cannot be created.
    """
    import pandas as pd

    from ..contract.catalogue import CHECKS

    limit, text = number("time_limit", time_limit), text_of_estimator(estimator)
    rows = [
        (demand.name, verdict, demand.demand, remark)
        for demand, verdict, remark in examination.examined(text, CHECKS, limit)
    ]
    return pd.DataFrame(rows, columns=["check", "verdict", "demand", "text"])
