"""Factor graph, compiled: batch, incremental (iSAM2) and fixed-lag smoothing of one graph.

The factor graph is that of :mod:`.gtsam_smoothers`, solved by compiled Kalman smoothers for many
runs at once. The incremental modes make the same linearisations as GTSAM. In the batch mode
Gauss–Newton steps are halved until the cost decreases (:mod:`ggbench.engines.line_search`), whereas
GTSAM damps the steps; both have the same minimum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..block import BlockEstimator, EstimateBlock, ProblemBlock
from ..engines import incremental_smoother
from ..engines.trajectory_search import from_the_prior
from ..parameters import AtLeastOne, Positive
from ..problem import Causality, MeasurementModel, Problem
from .robust import RobustLoss

SAME_TIME = 1e-6
"""Times that differ by less are equal [s]."""
_SAMPLED = 50
"""Number of epochs at which the Jacobian of h is evaluated."""


@dataclass(frozen=True)
class GraphParameters(RobustLoss):
    """Parameters of the solution of a factor graph.

    Parameters
    ----------
    mode : returned nodes; a node is the state at one epoch. ``isam2`` returns the newest node after
        each epoch (causal). ``fixed-lag`` returns each node when it leaves a sliding window; its
        estimate uses measurements up to ``lag`` later. ``batch`` returns all nodes, given all
        measurements.
    lag : length of the sliding window [s].
    relinearize_threshold : change of h that causes relinearisation [standard deviations of the
        noise]. iSAM2 and the sliding window relinearise a node if the change of any of its states
        changes h by this amount or more, see :func:`noticeable_changes`. States without effect on h
        are ignored.
    max_iterations : largest number of steps of the batch optimizer.
    """

    family = "smoother"

    mode: Literal["batch", "isam2", "fixed-lag"] = "isam2"
    lag: Positive = 20.0
    relinearize_threshold: Positive = 1.0
    max_iterations: AtLeastOne = 50

    @property
    def causality(self) -> Causality:
        """Causality of the estimates: ``filter`` for ``mode=isam2``, else the value of ``mode``."""
        return "filter" if self.mode == "isam2" else self.mode

    @property
    def fixed_lag(self) -> float | None:
        """Lag [s] of the mode ``fixed-lag``; None in other modes."""
        return self.lag if self.mode == "fixed-lag" else None

    def skip(self, problem: Problem) -> str | None:
        """Return a reason to skip the problem, or None if there is none.

        In the mode ``fixed-lag`` no measurement interval may exceed ``lag``.
        """
        longest = float(np.diff(problem.times).max(initial=0.0))
        if self.mode == "fixed-lag" and self.lag + SAME_TIME < longest:
            return (
                f"lag must be at least the time between two measurements, {longest:g} s; "
                f"it is {self.lag:g} s"
            )
        return super().skip(problem)

    def oldest_nodes(self, times: np.ndarray) -> np.ndarray:
        """Return the index (K,) of the oldest node of the window at each epoch.

        GTSAM drops nodes that are older than the lag. Rounding errors of ``times`` [s] do not
        affect the result.
        """
        return np.searchsorted(times, times - (self.lag + SAME_TIME))


@dataclass(frozen=True)
class FactorGraph(GraphParameters, BlockEstimator):
    """Maximum a posteriori estimate on a factor graph."""

    name = "factor-graph"

    def estimate_block(
        self, block: ProblemBlock, rngs: Sequence[np.random.Generator] = ()
    ) -> EstimateBlock:
        """Solve the problems of all runs of a block."""
        if self.mode == "batch":
            return from_the_prior(block, self.max_iterations, self.loss, self.limit)
        leaving = None if self.mode == "isam2" else self.oldest_nodes(block.times)
        changes = [noticeable_changes(block.problem(run)) for run in range(block.runs)]
        limits = self.relinearize_threshold * np.stack(changes)
        mean, cov, info = incremental_smoother.smoother(
            block, limits, leaving, self.loss, self.limit
        )
        return EstimateBlock(mean, cov, self.causality, self.fixed_lag, info=info)


def noticeable_changes(problem: Problem) -> np.ndarray:
    """Return the noticeable change (n,) of each state.

    If one state changes by this amount, h changes by one standard deviation of the noise. The
    change of h is an RMS over epochs of the flight. It is computed with H at the propagated prior
    mean. The result is infinite for states on which h does not depend. If the problem names its
    channels, only gradient channels are used, because other sensors are almost linear in the
    states.
    """
    shown = np.unique(np.linspace(0, problem.epochs - 1, _SAMPLED).astype(int))
    channels = problem.measurements.shape[1]
    counted = [c.unit == "E" for c in problem.channels] or [True] * channels
    x, total = problem.prior_mean, np.zeros(problem.dimension)
    for k, phi in enumerate(problem.transition):
        x = phi @ x
        if k in shown:
            jacobian = checked_jacobian(problem.model, k, x, channels)
            white = np.linalg.solve(np.linalg.cholesky(problem.noise_of(k)), jacobian)
            total += (white[counted] ** 2).sum(axis=0)
    with np.errstate(divide="ignore"):
        return np.sqrt(len(shown) / total)


def checked_jacobian(model: MeasurementModel, k: int, x: np.ndarray, channels: int) -> np.ndarray:
    """Return H (m, n) of a model at the state x (n,) and epoch k.

    Raises ValueError if the shape of H is wrong.
    """
    jacobian = np.asarray(model.jacobian(k, x), dtype=float)
    require_shape("Jacobian", jacobian, (channels, len(x)))
    return jacobian


def require_shape(name: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    """Raise ValueError if an array (...) of a model does not have the given shape."""
    if array.shape != shape:
        raise ValueError(f"the model's {name} has shape {array.shape}, not {shape}")
