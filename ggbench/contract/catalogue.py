"""Checks of ``ggbench check``: requirement, reason and test problems of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, partial

from ..problem import Estimator, Problem
from ..simulation.error_free_flight import prepare
from ..simulation.runs import simulate
from ..spec import scenario
from . import demands
from .demands import Refused
from .references import (
    gappy,
    graded,
    linear_problem,
    linear_sensor_problem,
    noisy_problem,
    with_sensor_model,
)

FLIGHT = ("wang2013", "0.01E-0.2Hz")
"""Scenario and case of the flight over a shipped map: 40 measurements of six channels."""
_SEED = 2013
_Ask = Callable[[Estimator, Problem], object]
_Asked = Iterator[tuple[str, Callable[[], object]]]
"""Tests, each with a description of its problem in words."""


@dataclass(frozen=True)
class Check:
    """A requirement that every estimator must meet, with test problems.

    Attributes
    ----------
    name : name of the check.
    demand : property that must hold.
    why : reason for the requirement.
    questions : function that takes an estimator. For each test problem it yields a description and
        a function that runs the test.
    """

    name: str
    demand: str
    why: str
    questions: Callable[[Estimator], _Asked]

    def ask(self, estimator: Estimator) -> str:
        """Run the check on all test problems; return the first remark that a test returns, or "".

        Raises
        ------
        Broken
            If the requirement is violated; the message states the problem and the size of the
            violation.
        Refused
            If the estimator refuses all problems; the message is the reason for the first problem.
        Exception
            Any exception that the estimator raises.
        """
        refused: list[Refused] = []
        count, remark = 0, ""
        for where, question in self.questions(estimator):
            count += 1
            try:
                answer = question()
            except Refused as refusal:
                refused.append(refusal)
            except demands.Broken as broken:
                raise demands.Broken(f"{where}: {broken}") from None
            except Exception as error:
                error.add_note(where)
                raise
            else:
                if answer and isinstance(answer, str):
                    remark = remark or f"{where}: {answer}"
        if len(refused) == count:
            raise refused[0]
        return remark


@cache
def flight() -> Problem:
    """Return the problem of a simulated flight over a shipped map (cached)."""
    name, case = FLIGHT
    return simulate(prepare(scenario.load(name).case(case)), _SEED, 0)[0]


def _on_both(ask: _Ask, on_flight: _Ask | None = None) -> Callable[[Estimator], _Asked]:
    """Return a function that yields the tests of a demand on a linear problem and on a flight."""

    def questions(estimator: Estimator) -> _Asked:
        yield "on a linear problem", partial(ask, estimator, linear_sensor_problem(2))
        yield "on a flight over a map", partial(on_flight or ask, estimator, flight())

    return questions


def _exact(estimator: Estimator) -> _Asked:
    if not estimator.exact_if_linear_gaussian:
        problem = with_sensor_model(noisy_problem(0))
        yield "on a linear problem", partial(demands.near_exact, estimator, problem)
        return
    for seed in range(2):
        for epochs, m in ((40, 2), (40, 1), (2, 1)):
            where = f"on a linear problem (epochs: {epochs}, channels: {m})"
            problem = linear_sensor_problem(seed, epochs, m)
            yield where, partial(demands.as_exact, estimator, problem)


def _exact_or_any(problems: Mapping[str, Callable[[], Problem]]) -> Callable[[Estimator], _Asked]:
    """Return a function that yields a test of an estimator on each problem.

    An estimator with ``exact_if_linear_gaussian`` must be exact. Other estimators must return a
    valid estimate.
    """

    def questions(estimator: Estimator) -> _Asked:
        ask: _Ask = demands.as_exact if estimator.exact_if_linear_gaussian else demands.answer
        for where, problem in problems.items():
            yield f"on a linear problem {where}", partial(ask, estimator, problem())

    return questions


CHECKS = (
    Check(
        "estimate",
        "returns an Estimate of the declared causality with a finite mean (K, n) and a "
        "covariance (K, n, n) or None",
        "a campaign counts any other result as a failed run.",
        _on_both(demands.answer),
    ),
    Check(
        "covariance",
        "all covariances are symmetric and positive definite",
        "the NEES needs the inverse; a run with another covariance fails.",
        _on_both(
            lambda estimator, problem: demands.real_covariance(demands.answer(estimator, problem))
        ),
    ),
    Check(
        "repeatable",
        "the same problem and generator give the same result, bit for bit",
        "results must be reproducible.",
        _on_both(demands.repeatable),
    ),
    Check(
        "inputs",
        "the problem is unchanged",
        "all estimators receive the same problem.",
        _on_both(demands.inputs_kept),
    ),
    Check(
        "causality",
        "no estimate depends on measurements that its causality excludes",
        "a filter that uses later measurements cannot be compared with filters that do not.",
        _on_both(demands.causal, partial(demands.causal, exactly=False)),
    ),
    Check(
        "exact",
        "on a linear Gaussian problem the result must be exact (or near, with "
        "exact_if_linear_gaussian = False)",
        "the posterior is known exactly; a deviation is a mistake in the estimator.",
        _exact,
    ),
    Check(
        "noise",
        "each measurement is weighted by the noise of its own epoch",
        "noise_cov may be (K, m, m): problem.noise_of(k) is R of epoch k.",
        _exact_or_any({"with noise that varies": lambda: graded(linear_sensor_problem(6))}),
    ),
    Check(
        "gaps",
        "a missing channel has no effect",
        "sensors fail. Where present is false, the measurement, h and H are zero.",
        _exact_or_any(
            {"with missing measurements": lambda: with_sensor_model(gappy(linear_problem(3)))}
        ),
    ),
    Check(
        "short",
        "problems of a single measurement and of a single channel are handled",
        "squeezing an array of one element loses its axes.",
        _exact_or_any(
            {
                "with one epoch and one channel": lambda: linear_sensor_problem(1, 1, 1),
                "with one epoch and two channels": lambda: linear_sensor_problem(2, 1, 2),
            }
        ),
    ),
)
"""All checks in order. The others are run only if the first check passes."""
