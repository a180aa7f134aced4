"""Many runs of one case at once: what a compiled estimator is given, and what it gives back.

The arrays of :class:`.problem.Problem` with the run as leading axis. A block is a few tens of runs,
so that what a run needs stays in the processor's cache; a campaign is a stream of blocks.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Protocol, runtime_checkable

import numpy as np

from .numerics.frozen import freeze_arrays, read_only
from .problem import (
    Causality,
    Channel,
    Estimate,
    Estimator,
    GravityMap,
    MeasurementModel,
    Problem,
    Replay,
    StateBlock,
    Track,
)
from .sensors.model import SensorModel
from .sensors.model_arrays import ModelArrays

FEWEST_STATES = 3
"""States that kernels take at least: the tiles of :mod:`.numerics.lane_algebra` are 3 × 3."""


@runtime_checkable
class CompiledModel(MeasurementModel, Protocol):
    """A measurement model that is kernels and their arrays: what a block needs of a problem's."""

    @property
    def arrays(self) -> ModelArrays:
        """The arrays of one run."""


@dataclass(frozen=True)
class ProblemBlock:
    """The estimation problems of R runs of one case.

    Attributes
    ----------
    times, noise_cov, prior_mean, prior_cov, layout, channels, map : as in
        :class:`.problem.Problem`.
    measurements, present : (R, K, m).
    transition, process_cov : (R, K, n, n).
    model : arrays of h and H, the run as leading axis of those that differ from run to run.
    tracks : (R, K, 15) what the INS indicates, as :class:`.problem.Track` has it: positions,
        velocities, attitudes row by row; None if unknown.
    replays : of each run, as :class:`.problem.Problem` has it.
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
    present: np.ndarray
    channels: tuple[Channel, ...] = ()
    tracks: np.ndarray | None = None
    map: GravityMap | None = None
    replays: Sequence[Replay] | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self, read_only)

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

    def until(self, stop: int) -> ProblemBlock:
        """Return the problems of the epochs before ``stop``, which are not flown again."""
        model = self.model.mapped(lambda array: read_only(array[:, :stop]))
        return replace(
            self,
            times=self.times[:stop],
            measurements=self.measurements[:, :stop],
            noise_cov=self.noise_cov if self.noise_cov.ndim == 2 else self.noise_cov[:stop],
            transition=self.transition[:, :stop],
            process_cov=self.process_cov[:, :stop],
            model=replace(model, times=read_only(model.times[:stop])),
            present=self.present[:, :stop],
            tracks=None if self.tracks is None else self.tracks[:, :stop],
            replays=None,
        )

    def problem(self, run: int) -> Problem:
        """Return one run as every estimator takes it."""
        track = None
        if self.tracks is not None:
            states = self.tracks[run]
            track = Track(states[:, :3], states[:, 3:6], states[:, 6:].reshape(-1, 3, 3))
        return Problem(
            times=self.times,
            measurements=self.measurements[run],
            noise_cov=self.noise_cov,
            transition=self.transition[run],
            process_cov=self.process_cov[run],
            prior_mean=self.prior_mean,
            prior_cov=self.prior_cov,
            model=SensorModel(self.model.of_run(run)),
            layout=self.layout,
            present=self.present[run],
            channels=self.channels,
            track=track,
            map=self.map,
            replay=None if self.replays is None else self.replays[run],
        )


def joined(blocks: Sequence[ProblemBlock]) -> ProblemBlock:
    """Return all runs of several blocks as one.

    Raises
    ------
    ValueError
        If they do not share epochs and map, or the gaps in coloured readings.
    """
    first = blocks[0]
    if len(blocks) == 1:
        return first
    for block in blocks[1:]:
        if not (
            np.array_equal(block.times, first.times)
            and np.array_equal(block.model.origin, first.model.origin)
            and np.array_equal(block.model.coefficients, first.model.coefficients)
            and np.array_equal(block.model.combined, first.model.combined)
        ):
            raise ValueError("blocks of other epochs, maps or gaps cannot be joined")

    def concatenated(*arrays: np.ndarray) -> np.ndarray:
        # As those of a block are: kernels of arrays that can be written would be compiled again.
        return read_only(np.concatenate(arrays))

    def along(name: str) -> np.ndarray:
        return concatenated(*(getattr(block, name) for block in blocks))

    replays = [replay for block in blocks for replay in block.replays or ()]
    return replace(
        first,
        measurements=along("measurements"),
        transition=along("transition"),
        process_cov=along("process_cov"),
        model=first.model.mapped(concatenated, *(block.model for block in blocks[1:])),
        present=along("present"),
        tracks=None if first.tracks is None else along("tracks"),
        replays=replays or None,
    )


def block_of(problem: Problem) -> ProblemBlock:
    """Return a block of one run.

    Raises
    ------
    TypeError
        If the problem's model is no :class:`CompiledModel`.
    """
    if not isinstance(problem.model, CompiledModel):
        raise TypeError(_without_arrays(problem.model))
    track, tracks = problem.track, None
    if track is not None:
        attitudes = track.attitudes.reshape(-1, 9)
        tracks = np.hstack([track.positions, track.velocities, attitudes])[np.newaxis]
    return ProblemBlock(
        problem.times,
        problem.measurements[np.newaxis],
        problem.noise_cov,
        problem.transition[np.newaxis],
        problem.process_cov[np.newaxis],
        problem.prior_mean,
        problem.prior_cov,
        problem.model.arrays.as_block(),
        problem.layout,
        problem.present[np.newaxis],
        problem.channels,
        tracks,
        problem.map,
        None if problem.replay is None else (problem.replay,),
    )


def _with_idle_states(problem: Problem) -> Problem:
    """Return a problem of as many states as kernels take at least, the added ones without effect.

    They have unit variance and stay as they are; no measurement depends on them.
    """
    n, more = problem.dimension, max(FEWEST_STATES - problem.dimension, 0)
    if not more or not isinstance(problem.model, SensorModel):
        return problem
    idle = (*[(0, 0)] * (problem.transition.ndim - 2), (0, more), (0, more))
    transition, prior_cov = np.pad(problem.transition, idle), np.pad(problem.prior_cov, (0, more))
    for i in range(n, n + more):
        transition[..., i, i] = prior_cov[i, i] = 1.0
    arrays = problem.model.arrays
    rows = np.pad(arrays.rows, (*[(0, 0)] * (arrays.rows.ndim - 1), (0, more)))
    return replace(
        problem,
        transition=transition,
        process_cov=np.pad(problem.process_cov, idle),
        prior_mean=np.pad(problem.prior_mean, (0, more)),
        prior_cov=prior_cov,
        model=SensorModel(replace(arrays, dimension=n + more, rows=rows)),
        layout=(*problem.layout, StateBlock("idle", slice(n, n + more), "1")),
    )


def _without_arrays(model: MeasurementModel) -> str:
    return f"a compiled engine needs the package's own model, not {type(model).__name__}"


@dataclass(frozen=True)
class EstimateBlock:
    """What a compiled estimator returns.

    Attributes
    ----------
    mean : (R, K, n).
    cov : (R, K, n, n).
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
        nis = None if self.nis is None else self.nis[run]
        return Estimate(self.mean[run], self.cov[run], self.causality, self.lag, info, nis)


@dataclass(frozen=True)
class BlockEstimator(Estimator):
    """Base of the estimators that take many runs at once; a single run is a block of one."""

    @abstractmethod
    def estimate_block(
        self, block: ProblemBlock, rngs: Sequence[np.random.Generator] = ()
    ) -> EstimateBlock:
        """Estimate the states of all runs of a block; no run may depend on its neighbours.

        Parameters
        ----------
        block : R runs.
        rngs : a generator of each run, from which all its randomness comes. One that draws nothing
            ignores them.
        """

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate the states of a block of one run.

        Raises
        ------
        TypeError
            If the problem's model is no :class:`CompiledModel`.
        """
        found = self.estimate_block(block_of(_with_idle_states(problem)), (rng,)).estimate(0)
        n = problem.dimension
        if found.mean.shape[-1] == n:
            return found
        cov = None if found.cov is None else found.cov[:, :n, :n]
        return replace(found, mean=found.mean[:, :n], cov=cov)

    def skip(self, problem: Problem) -> str | None:
        """Refuse the models that no compiled engine can take."""
        if not isinstance(problem.model, CompiledModel):
            return _without_arrays(problem.model)
        return None
