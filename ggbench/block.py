"""Many runs of one case at once: what a compiled estimator is given, and what it gives back.

The arrays of :class:`.problem.Problem` with the run as leading axis. A block is a few tens of runs,
so that what a run needs stays in the processor's cache; a campaign is a stream of blocks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType

import numpy as np

from .numerics.frozen import read_only
from .problem import Causality, Estimate, Problem, StateBlock
from .sensors.model import GradiometerModel
from .sensors.model_kernels import ModelArrays


@dataclass(frozen=True)
class ProblemBlock:
    """The estimation problems of R runs of one case.

    Attributes
    ----------
    times, noise_cov, prior_mean, prior_cov, layout : as in :class:`.problem.Problem`.
    measurements : (R, K, m). transition, process_cov : (R, K, n, n).
    model : arrays of h and H, the run as leading axis of those that differ from run to run.
    """

    times: np.ndarray
    measurements: np.ndarray
    noise_cov: np.ndarray
    transition: np.ndarray
    process_cov: np.ndarray
    prior_mean: np.ndarray
    prior_cov: np.ndarray
    model: ModelArrays
    layout: tuple[StateBlock, ...]

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, item.name, read_only(value))

    @property
    def runs(self) -> int:
        """Number of runs R."""
        return len(self.measurements)

    @property
    def epochs(self) -> int:
        """Number of measurement epochs K."""
        return len(self.times)

    @property
    def dimension(self) -> int:
        """Number of states n."""
        return len(self.prior_mean)

    def problem(self, run: int) -> Problem:
        """Return one run as every estimator takes it."""
        return Problem(
            times=self.times,
            measurements=self.measurements[run],
            noise_cov=self.noise_cov,
            transition=self.transition[run],
            process_cov=self.process_cov[run],
            prior_mean=self.prior_mean,
            prior_cov=self.prior_cov,
            model=GradiometerModel(self.model.of_run(run)),
            layout=self.layout,
        )


MOST_STATES, MOST_COMPONENTS = 24, 9
"""Sizes of the largest problem that compiled engines take."""


def refusal(problem: Problem) -> str | None:
    """Return why no compiled engine can take a problem, or None if one can."""
    n, m = problem.dimension, problem.measurements.shape[1]
    if not isinstance(getattr(problem.model, "arrays", None), ModelArrays):
        return f"engine=numba needs the gradiometer's model, not {type(problem.model).__name__}"
    if n > MOST_STATES or m > MOST_COMPONENTS:
        return (
            f"engine=numba takes up to {MOST_STATES} states and {MOST_COMPONENTS} components, not "
            f"{n} and {m}"
        )
    return None


def block_of(problem: Problem) -> ProblemBlock:
    """Return a block of one run.

    Raises
    ------
    TypeError
        If no compiled engine can take the problem, see :func:`refusal`.
    """
    if reason := refusal(problem):
        raise TypeError(reason)
    arrays: ModelArrays = vars(problem.model)["arrays"]
    return ProblemBlock(
        problem.times,
        problem.measurements[np.newaxis],
        problem.noise_cov,
        problem.transition[np.newaxis],
        problem.process_cov[np.newaxis],
        problem.prior_mean,
        problem.prior_cov,
        arrays.as_block(),
        problem.layout,
    )


@dataclass(frozen=True)
class EstimateBlock:
    """What a compiled estimator returns.

    Attributes
    ----------
    mean : (R, K, n). cov : (R, K, n, n).
    causality, lag : as in :class:`.problem.Estimate`.
    nis : (R, K) normalised innovation squared, NaN where there was no reading; None unless the
        estimator is a filter.
    info : counters, an array (R,) each; ``map_evaluations`` counts the points at which the map was
        evaluated.
    """

    mean: np.ndarray
    cov: np.ndarray
    causality: Causality
    lag: float | None = None
    nis: np.ndarray | None = None
    info: Mapping[str, np.ndarray] = field(default_factory=lambda: MappingProxyType({}))

    def estimate(self, run: int) -> Estimate:
        """Return the estimate of one run."""
        info = {name: values[run].item() for name, values in self.info.items()}
        return Estimate(self.mean[run], self.cov[run], self.causality, self.lag, info)
