"""Blocks of runs: input and output of compiled estimators.

A block has the arrays of :class:`.problem.Problem` with the run as leading axis. A block has a few
tens of runs, so that the arrays fit into the processor's cache. A campaign processes one block
after another.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any, Protocol, runtime_checkable

import numpy as np

from .numerics.frozen import freeze_arrays, read_only
from .problem import (
    Causality,
    Channel,
    Estimate,
    Estimator,
    GravityMap,
    InsSolution,
    MeasurementModel,
    Problem,
    Replay,
    StateBlock,
)
from .sensors.model import SensorModel
from .sensors.model_arrays import ModelArrays

FEWEST_STATES = 3
"""Least number of states for kernels: the tiles of :mod:`.numerics.lane_algebra` are 3 × 3."""


@runtime_checkable
class CompiledModel(MeasurementModel, Protocol):
    """A measurement model with compiled kernels and the arrays that they need."""

    @property
    def arrays(self) -> ModelArrays:
        """Arrays of the model for one run."""


@dataclass(frozen=True)
class ProblemBlock:
    """The estimation problems of R runs of one case.

    The metadata of each dataclass field names the axes of the array: R runs, K epochs, n states, m
    channels. The axis K may be missing if all epochs share a matrix.

    Attributes
    ----------
    times, noise_cov, prior_mean, prior_cov, layout, channels, map : as in
        :class:`.problem.Problem`.
    measurements, present : (R, K, m) measurements, and mask of the available ones.
    transition, process_cov : (R, K, n, n) transition matrices and process noise covariances.
    model : arrays of h and H; arrays that differ between runs have the run as leading axis.
    tracks : (R, K, 15) INS solution, as in :class:`.problem.InsSolution`: position, velocity, and
        C_nb row by row; None if unknown.
    replays : ``replay`` of :class:`.problem.Problem` for each run.
    """

    times: np.ndarray = field(metadata={"axes": "K"})
    measurements: np.ndarray = field(metadata={"axes": "RKm"})
    noise_cov: np.ndarray = field(metadata={"axes": "Kmm"})
    transition: np.ndarray = field(metadata={"axes": "RKnn"})
    process_cov: np.ndarray = field(metadata={"axes": "RKnn"})
    prior_mean: np.ndarray = field(metadata={"axes": "n"})
    prior_cov: np.ndarray = field(metadata={"axes": "nn"})
    model: ModelArrays
    layout: tuple[StateBlock, ...]
    present: np.ndarray = field(metadata={"axes": "RKm"})
    channels: tuple[Channel, ...] = ()
    tracks: np.ndarray | None = field(default=None, metadata={"axes": "RK-"})
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
        """Return a block of the epochs before ``stop``, without replays."""
        return self.part(0, stop, self.prior_mean, self.prior_cov)

    def part(self, first: int, stop: int, mean: np.ndarray, cov: np.ndarray) -> ProblemBlock:
        """Return a block of the epochs ``first`` to ``stop`` − 1, with another prior.

        Parameters
        ----------
        mean, cov : (n,), (n, n) prior of all runs, valid at the epoch before ``first``. If
            ``first`` is 0, the prior is valid at the start of the flight.
        """
        epochs = slice(first, stop)
        arrays = self._with_axis("K", lambda array, axis: array[(slice(None),) * axis + (epochs,)])
        return replace(
            self,
            **arrays | {"prior_mean": mean, "prior_cov": cov},
            model=_part_of(self.model, first, stop),
            replays=None,
        )

    def some(self, first: int, stop: int) -> ProblemBlock:
        """Return a block of the runs ``first`` to ``stop`` − 1."""
        runs = slice(first, stop)
        replays = self.replays
        return replace(
            self,
            **self._with_axis("R", lambda array, axis: array[runs]),
            model=self.model.mapped(lambda array: read_only(array[runs])),
            replays=None if replays is None else [replays[run] for run in range(first, stop)],
        )

    def problem(self, run: int) -> Problem:
        """Return the problem of the run with index ``run``."""
        values = vars(self) | self._with_axis("R", lambda array, axis: array[run])
        states, replays = values.pop("tracks"), values.pop("replays")
        track = None
        if states is not None:
            track = InsSolution(states[:, :3], states[:, 3:6], states[:, 6:].reshape(-1, 3, 3))
        values["model"] = SensorModel(self.model.of_run(run))
        return Problem(**values, track=track, replay=None if replays is None else replays[run])

    def _with_axis(
        self, axis: str, change: Callable[..., np.ndarray], *others: ProblemBlock
    ) -> dict[str, Any]:
        """Return the changed arrays of all fields that have an axis, by field name.

        Parameters
        ----------
        axis : name of the axis, such as ``R`` or ``n``.
        change : function of the array of a field and the same arrays of the other blocks. Its
            keyword ``axis`` is the index of the axis.
        others : other blocks.
        """
        changed: dict[str, Any] = {}
        for item in fields(self):
            array, axes = getattr(self, item.name), item.metadata.get("axes")
            if axes is None or array is None:
                continue
            axes = axes[len(axes) - array.ndim :]
            if axis in axes:
                rest = (getattr(other, item.name) for other in others)
                changed[item.name] = change(array, *rest, axis=axes.index(axis))
        return changed


def _part_of(model: ModelArrays, first: int, stop: int) -> ModelArrays:
    """Return the model arrays of the epochs ``first`` to ``stop`` − 1.

    For whitened measurements h at an epoch also depends on earlier epochs. Arrays of the needed
    epochs before ``first`` are appended at the end, so that negative indices refer to them.
    """
    before = min(int(model.lags[first:stop].max(initial=0)), first) if len(model.lags) > 1 else 0
    epochs: slice | np.ndarray = slice(first, stop)
    if before:
        epochs = np.r_[first:stop, first - before : first]
    part = model.mapped(lambda array: read_only(array[:, epochs]))
    own = {}
    for name in ("combined", "lags"):
        array = getattr(model, name)
        own[name] = array[first:stop] if len(array) > 1 else array
    return replace(part, times=read_only(model.times[epochs]), **own)


def joined(blocks: Sequence[ProblemBlock]) -> ProblemBlock:
    """Return one block with all runs of several blocks.

    Raises
    ------
    ValueError
        If the blocks differ in epochs or map. Also if measurements with coloured noise are missing
        at different epochs.
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
            raise ValueError("blocks with different epochs, maps or gaps cannot be joined")

    def concatenated(*arrays: np.ndarray, axis: int = 0) -> np.ndarray:
        # As those of a block are: kernels of arrays that can be written would be compiled again.
        return read_only(np.concatenate(arrays, axis))

    return replace(
        first,
        **first._with_axis("R", concatenated, *blocks[1:]),
        model=first.model.mapped(concatenated, *(block.model for block in blocks[1:])),
        replays=[replay for block in blocks for replay in block.replays or ()] or None,
    )


def block_of(problem: Problem) -> ProblemBlock:
    """Return a block with a single run.

    Raises
    ------
    TypeError
        If the problem's model is no :class:`CompiledModel`.
    """
    if not isinstance(problem.model, CompiledModel):
        raise TypeError(without_kernels(problem))
    track, replay = problem.track, problem.replay
    values: dict[str, Any] = {}
    for item in fields(ProblemBlock):
        if item.name in ("tracks", "replays"):
            continue
        value = getattr(problem, item.name)
        values[item.name] = value[np.newaxis] if "R" in item.metadata.get("axes", "") else value
    if track is not None:
        attitudes = track.attitudes.reshape(-1, 9)
        values["tracks"] = np.hstack([track.positions, track.velocities, attitudes])[np.newaxis]
    values["model"] = problem.model.arrays.as_block()
    return ProblemBlock(**values, replays=None if replay is None else (replay,))


def _with_idle_states(block: ProblemBlock) -> ProblemBlock:
    """Return a block with at least :data:`FEWEST_STATES` states, by adding states without effect.

    The added states have unit variance, are constant and do not affect any measurement.
    """
    n, more = block.dimension, max(FEWEST_STATES - block.dimension, 0)
    if not more:
        return block

    def padded(array: np.ndarray, axis: int) -> np.ndarray:
        return np.pad(array, [(0, 0)] * axis + [(0, more)] * (array.ndim - axis))

    arrays = block._with_axis("n", padded)
    for name in ("transition", "prior_cov"):
        for i in range(n, n + more):
            arrays[name][..., i, i] = 1.0
    rows, linear = (
        read_only(np.pad(array, (*[(0, 0)] * (array.ndim - 1), (0, more))))
        for array in (block.model.rows, block.model.linear)
    )
    return replace(
        block,
        **arrays,
        model=replace(block.model, dimension=n + more, rows=rows, linear=linear),
        layout=(*block.layout, StateBlock("idle", slice(n, n + more), "1")),
    )


def by_block(problem: Problem, solve: Callable[[ProblemBlock], Estimate]) -> Estimate:
    """Return the estimate of one run from a function that estimates a block.

    Kernels need at least :data:`FEWEST_STATES` states, so the block may have additional states. The
    returned estimate has only the states of the problem.

    Raises
    ------
    TypeError
        If the problem's model is no :class:`CompiledModel`.
    """
    n, estimate = problem.dimension, solve(_with_idle_states(block_of(problem)))
    if estimate.mean.shape[-1] == n:
        return estimate
    cov = None if estimate.cov is None else estimate.cov[:, :n, :n]
    return replace(estimate, mean=estimate.mean[:, :n], cov=cov)


def without_kernels(problem: Problem) -> str | None:
    """Return the reason why compiled kernels cannot process a problem, or None if they can."""
    if isinstance(problem.model, CompiledModel):
        return None
    name = type(problem.model).__name__
    return f"a compiled engine needs the model of ggbench, not {name}"


@dataclass(frozen=True)
class EstimateBlock:
    """Result of a compiled estimator.

    Attributes
    ----------
    mean : (R, K, n) estimated states.
    cov : (R, K, n, n) covariances.
    causality, lag : as in :class:`.problem.Estimate`.
    nis : (R, K) normalised innovation squared, NaN without a measurement; None if the estimator is
        no filter.
    info : counters and texts, each an array (R,); ``map_evaluations`` counts the points at which
        the map was evaluated.
    """

    mean: np.ndarray
    cov: np.ndarray
    causality: Causality
    lag: float | None = None
    nis: np.ndarray | None = None
    info: Mapping[str, np.ndarray] = field(default_factory=lambda: MappingProxyType({}))

    def estimate(self, run: int) -> Estimate:
        """Return the estimate of the run with index ``run``."""
        info = {name: values[run].item() for name, values in self.info.items()}
        nis = None if self.nis is None else self.nis[run]
        return Estimate(self.mean[run], self.cov[run], self.causality, self.lag, info, nis)


@dataclass(frozen=True)
class BlockEstimator(Estimator):
    """Base of estimators that process many runs at once; a single run is a block with R = 1."""

    @abstractmethod
    def estimate_block(
        self, block: ProblemBlock, rngs: Sequence[np.random.Generator] = ()
    ) -> EstimateBlock:
        """Estimate the states of all runs of a block, each run independently of the others.

        Parameters
        ----------
        block : problems of R runs.
        rngs : one generator for each run, the only source of random numbers.
        """

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate the states of a single run, as a block with R = 1.

        Raises
        ------
        TypeError
            If the problem's model is no :class:`CompiledModel`.
        """
        return by_block(problem, lambda block: self.estimate_block(block, (rng,)).estimate(0))

    def skip(self, problem: Problem) -> str | None:
        """Return the reason why kernels cannot process the problem, or None if they can."""
        return without_kernels(problem)
