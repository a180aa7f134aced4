"""Windows of flights and matchers of them, of any measurement model, in NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ggbench.block import EstimateBlock
from ggbench.engines.window_search import ITERATIONS, Place
from ggbench.estimators.correlation import Correlation
from ggbench.estimators.tercom import Tercom, TercomEkf
from ggbench.problem import (
    Estimate,
    InsSolution,
    MeasurementModel,
    Problem,
    jacobian_along,
    predict_along,
)

from . import textbook
from .iterated_smoother import IteratedSmoother, place_of


@dataclass(frozen=True)
class _Later:
    """A measurement model whose epochs are counted from a later one."""

    model: MeasurementModel
    first: int

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        return self.model.predict(self.first + k, x)

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        return self.model.jacobian(self.first + k, x)

    def predict_along(self, at: np.ndarray, x: np.ndarray) -> np.ndarray:
        return predict_along(self.model, self.first + at, x)

    def jacobian_along(self, at: np.ndarray, x: np.ndarray) -> np.ndarray:
        return jacobian_along(self.model, self.first + at, x)


def section(problem: Problem, first: int, stop: int, mean: np.ndarray, cov: np.ndarray) -> Problem:
    """Return the problem of some epochs, as ``ProblemBlock.part`` has it of many runs."""
    part, track = slice(first, stop), problem.track
    if track is not None:
        track = InsSolution(track.positions[part], track.velocities[part], track.attitudes[part])
    return Problem(
        times=problem.times[part],
        measurements=problem.measurements[part],
        noise_cov=problem.noise_cov if problem.noise_cov.ndim == 2 else problem.noise_cov[part],
        transition=problem.transition[part],
        process_cov=problem.process_cov[part],
        prior_mean=mean,
        prior_cov=cov,
        model=_Later(problem.model, first),
        layout=problem.layout,
        present=problem.present[part],
        channels=problem.channels,
        track=track,
        map=problem.map,
    )


class OneRun:
    """A problem of any measurement model in the place of a block of one run."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self.epochs, self.present = problem.epochs, problem.present[np.newaxis]

    def problem(self, run: int) -> Problem:
        return self._problem

    def part(self, first: int, stop: int, mean: np.ndarray, cov: np.ndarray) -> OneRun:
        return OneRun(section(self._problem, first, stop, mean, cov))


class WindowSearch:
    """The searches of a window by :class:`.IteratedSmoother`."""

    def __init__(self, block: OneRun, loss: str = "none", threshold: float = np.inf) -> None:
        self.block, self.evaluations = block, np.zeros(1, dtype=int)
        self._smoother = IteratedSmoother(block.problem(0), loss, threshold)

    def places(self, starts: Sequence[np.ndarray]) -> list[Place | None]:
        """Return the place that each start leads to."""
        smoother = self._smoother
        ends = [smoother.search(smoother.from_prior(start), ITERATIONS) for start in starts]
        return [place_of(smoother, end) for end in ends]


class _InNumPy:
    """What a matcher of any measurement model has instead of the compiled parts."""

    def skip(self, problem: Problem) -> str | None:
        return None

    def estimate(self, problem: Problem, rng: np.random.Generator | None = None) -> Estimate:
        return self._match(OneRun(problem))  # type: ignore[attr-defined, no-any-return]


class NumPyTercom(_InNumPy, Tercom):
    def _search(self, window: Any) -> Any:
        return WindowSearch(window, self.loss, self.limit)

    def _filtered(self, rest: Any) -> EstimateBlock:
        one = textbook.extended(rest.problem(0), 5, self.loss, self.limit)
        info = {"map_evaluations": np.zeros(1, dtype=int)}
        return EstimateBlock(one.mean[np.newaxis], one.cov[np.newaxis], "filter", info=info)


class NumPyTercomEkf(NumPyTercom, TercomEkf):
    pass


class NumPyCorrelation(_InNumPy, Correlation):
    def _search(self, window: Any) -> Any:
        return WindowSearch(window)


MATCHERS = {"tercom": NumPyTercom, "tercom-ekf": NumPyTercomEkf, "correlation": NumPyCorrelation}
"""Of the compiled matchers' names: the same in NumPy, of any measurement model."""
