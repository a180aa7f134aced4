"""Interface of estimators: Problem, Estimate, Estimator.

A :class:`Problem` is the only input of an estimator and never contains truth. The interface
describes any system with linear dynamics and nonlinear measurements of a position.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from .numerics.frozen import freeze_arrays
from .numerics.positive import ranked_root
from .parameters import Positive, require_valid

Causality = Literal["none", "filter", "fixed-lag", "batch"]
Family = Literal[
    "inertial", "kalman", "sigma-point", "mixture", "sampled", "matching", "smoother", "own"
]
"""Kinds of estimators, by how they represent the posterior; figures have a colour for each."""


class MeasurementModel(Protocol):
    """h and its Jacobian, as functions of epoch and state."""

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return h(k, x) of shape (..., m) for states x (..., n), any leading axes."""

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return ∂h/∂x of shape (..., m, n) at states x (..., n), any leading axes."""


@runtime_checkable
class AlongModel(MeasurementModel, Protocol):
    """A measurement model that evaluates a whole trajectory in one call, which is faster."""

    def predict_along(self, at: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return h (N, m) at epochs ``at`` (N,), one state for each epoch, x (N, n)."""

    def jacobian_along(self, at: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return ∂h/∂x (N, m, n) at epochs ``at`` (N,), a state for each, x (N, n)."""


def predict_along(model: MeasurementModel, at: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return h (N, m) of any model at epochs ``at`` (N,), one state for each epoch, x (N, n)."""
    if isinstance(model, AlongModel):
        return model.predict_along(at, x)
    return np.stack([model.predict(int(k), state) for k, state in zip(at, x, strict=True)])


def jacobian_along(model: MeasurementModel, at: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return ∂h/∂x (N, m, n) of any model at epochs ``at`` (N,), a state for each, x (N, n)."""
    if isinstance(model, AlongModel):
        return model.jacobian_along(at, x)
    return np.stack([model.jacobian(int(k), state) for k, state in zip(at, x, strict=True)])


@runtime_checkable
class CountingModel(MeasurementModel, Protocol):
    """A measurement model that counts the states at which it was evaluated."""

    @property
    def evaluations(self) -> int:
        """Number of evaluations of h and of its Jacobian so far."""


@dataclass(frozen=True)
class StateBlock:
    """A named part of the state: its slice of the vector and the unit of its elements."""

    name: str
    slice: slice
    unit: str


@dataclass(frozen=True)
class Channel:
    """One of the m measured numbers: its name, its unit, and its sensor.

    ``sensor`` is the name of the sensor: ``gnss``, or its own name if there are several of a kind.
    """

    name: str
    unit: str
    sensor: str


_OF_THE_MAP = ("E", "mGal")
"""Units of gradient and gravity channels; the names of sensors are the case's own."""


def matched_with_map(channels: Sequence[Channel], count: int) -> np.ndarray:
    """Return the mask (m,) of the channels that are matched with the map; all if unnamed."""
    if not channels:
        return np.ones(count, dtype=bool)
    return np.array([channel.unit in _OF_THE_MAP for channel in channels])


@dataclass(frozen=True)
class InsSolution:
    """Solution of the INS at the epochs; its errors are the states.

    Attributes
    ----------
    positions : (K, 3) latitude, longitude [rad], ellipsoidal height [m].
    velocities : (K, 3) ENU [m/s].
    attitudes : (K, 3, 3) C_nb, from body to ENU.
    """

    positions: np.ndarray
    velocities: np.ndarray
    attitudes: np.ndarray

    def __post_init__(self) -> None:
        freeze_arrays(self)


class ClosedLoop(Protocol):
    """A flight that is mechanised in parts; each part starts from the corrected end of the last."""

    def ahead(self, last: int) -> Problem:
        """Return the problem of the uncorrected epochs up to ``last``.

        Its prior is the estimate at the last correction.
        """

    def correct(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """Reset the INS by the estimates (K', n), (K', n, n) of the latest part.

        Returns
        -------
        The same estimates (K', n) as errors of the uncorrected INS, as in the original problem.
        """


class Replay(Protocol):
    """Inertial measurements of a flight, for a mechanization with feedback."""

    def start(self, problem: Problem) -> ClosedLoop:
        """Return a closed loop at the start of the problem."""


class GravityMap(Protocol):
    """The field that the estimators assume."""

    @property
    def lower(self) -> np.ndarray:
        """First node (3,) of the map in its coordinates [rad, rad, m]; −∞ without a map.

        The third coordinate is the height; of a draped map it is that above its base surface.
        """

    @property
    def upper(self) -> np.ndarray:
        """Last node (3,) of the map in its coordinates [rad, rad, m]; ∞ without a map."""

    def coordinates(self, positions: np.ndarray) -> np.ndarray:
        """Return positions (..., 3) [rad, rad, m] in the map's coordinates."""

    def over_nodes(
        self, latitude: ArrayLike, longitude: ArrayLike, third: ArrayLike
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return latitude, longitude [rad] and height [m] (...) of a place in its coordinates."""

    def tensor(self, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike) -> np.ndarray:
        """Return the gradient tensor (..., 6) [E] at positions [rad, rad, m] within the map."""

    def gravity_disturbance(
        self, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike
    ) -> np.ndarray:
        """Return the gravity disturbance (..., 3), ENU [m/s²], at positions within the map."""


@dataclass(frozen=True)
class Problem:
    """One estimation problem. Every array is an immutable copy of its argument.

    x_0 ~ N(prior_mean, prior_cov) at the start; x_k = transition[k] x_{k−1} + w_k with
    w_k ~ N(0, process_cov[k]) (which may be singular); measurements[k] = h(k, x_k) + v_k with
    v_k ~ N(0, R_k), k = 0..K−1. ``transition[0]`` leads from the start to times[0].

    If a channel has no measurement at an epoch, ``present`` is false, and its measurement, h and H
    are zero. An update with zeros changes nothing, so most estimators can ignore ``present``.

    Attributes
    ----------
    times : (K,) measurement epochs [s].
    measurements : (K, m), without NaN.
    noise_cov : (m, m) R of all epochs, or (K, m, m) of each; see :meth:`noise_of`.
    transition, process_cov : (K, n, n).
    prior_mean : (n,).
    prior_cov : (n, n), positive definite.
    model : h and H.
    layout : names, slices and units of the n states.
    present : (K, m) mask of available measurements; by default all.
    channels : names, units and sensors of the m measurements; ``()`` if unknown.
    track : solution of the INS, if the states are its errors.
    map : field in which h evaluates the measurements, if any.
    replay : inertial measurements for a mechanization with feedback; None if they are not
        available.
    """

    times: np.ndarray
    measurements: np.ndarray
    noise_cov: np.ndarray
    transition: np.ndarray
    process_cov: np.ndarray
    prior_mean: np.ndarray
    prior_cov: np.ndarray
    model: MeasurementModel
    layout: tuple[StateBlock, ...]
    present: np.ndarray = None  # type: ignore[assignment]  # never None: see __post_init__
    channels: tuple[Channel, ...] = ()
    track: InsSolution | None = None
    map: GravityMap | None = None
    replay: Replay | None = None

    def __post_init__(self) -> None:
        if self.present is None:
            object.__setattr__(self, "present", np.ones(self.measurements.shape, dtype=bool))
        freeze_arrays(self)

    def __repr__(self) -> str:
        first, last = (round(float(time), 6) for time in self.times[[0, -1]])
        return (
            f"Problem({self.epochs} epochs of {self.measurements.shape[1]} channels from {first} "
            f"to {last} s, {self.dimension} states, {type(self.model).__name__})"
        )

    @property
    def epochs(self) -> int:
        """Number of measurement epochs K."""
        return len(self.times)

    @property
    def dimension(self) -> int:
        """Number of states n."""
        return len(self.prior_mean)

    def noise_of(self, k: int) -> np.ndarray:
        """Return R (m, m) of epoch ``k``."""
        return self.noise_cov if self.noise_cov.ndim == 2 else self.noise_cov[k]

    def noise_root(self, k: int) -> np.ndarray:
        """Return G (n, r), G Gᵀ = Q of epoch ``k``, r its rank: w_k = G u with u ~ N(0, I)."""
        return ranked_root(self.process_cov[k])[0]

    def log_likelihood(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return ln p(z_k | x) (...) of the available measurements at states x (..., n)."""
        there = self.present[k]
        residual = (self.measurements[k] - self.model.predict(k, x))[..., there]
        root = np.linalg.cholesky(self.noise_of(k)[np.ix_(there, there)])
        white = np.linalg.solve(root, residual[..., np.newaxis])[..., 0]
        constant = np.log(np.diag(root)).sum() + 0.5 * len(root) * np.log(2.0 * np.pi)
        return np.asarray(-0.5 * (white**2).sum(axis=-1) - constant)


@dataclass(frozen=True)
class Fixes:
    """Accepted and rejected position fixes of a matcher, each from a window of measurements.

    There is one row for each attempt, in order of the epochs, and at most one per epoch. F may be
    zero.

    Attributes
    ----------
    epoch : (F,) increasing integers: epoch of the fix, and last epoch of its measurements.
    mean : (F, 2) or (F, 3) position error east, north[, up] [m] at that epoch, the first states.
    cov : (F, 2, 2) or (F, 3, 3) its covariance [m²], including the uncertainty of all other states.
    accepted : (F,) whether the estimator accepts the fix.
    statistic : (F,) statistic of the acceptance test; a larger one is more certain. By default it
        is the log odds of the position against the next best. −∞: rejected for any threshold. ∞: no
        other position.
    """

    epoch: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    accepted: np.ndarray
    statistic: np.ndarray

    def __len__(self) -> int:
        return len(self.epoch)


@dataclass(frozen=True)
class Estimate:
    """Result of an estimator.

    A matcher without a fix returns the propagated prior; nothing else marks such epochs.

    Attributes
    ----------
    mean : (K, n) state at the measurement epochs.
    cov : (K, n, n) its error covariance, or None if the estimator has none.
    causality : ``filter`` (uses measurements up to each epoch), ``fixed-lag`` (up to a lag beyond
        it), ``batch`` (all of them) or ``none`` (no measurement at all).
    lag : the lag of a fixed-lag estimate [s], else None.
    info : counters and remarks of this run (iterations, repairs, ...).
    nis : (K,) normalised innovation squared, only of filters whose innovations do not follow from
        mean, cov and problem; NaN without a measurement.
    fixes : position fixes of a matcher; None for other estimators.
    """

    mean: np.ndarray
    cov: np.ndarray | None
    causality: Causality
    lag: float | None = None
    info: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    nis: np.ndarray | None = None
    fixes: Fixes | None = None

    def __repr__(self) -> str:
        # Of whatever an estimator has put into it: a wrong estimate is to be looked at, too.
        causality = self.causality if self.lag is None else f"{self.causality} of {self.lag} s"
        cov = "no covariance" if self.cov is None else f"cov {np.shape(self.cov)}"
        return f"Estimate(mean {np.shape(self.mean)}, {cov}, {causality})"


@dataclass(frozen=True)
class Estimator(ABC):
    """Base of all estimators: a frozen dataclass whose fields are its parameters.

    A parameter is a field with a default, typed ``int``, ``float``, ``bool``, ``str`` or a
    ``Literal`` of strings, with its limits as in :mod:`.parameters`; ``name[parameter=value]`` on
    the command line sets it. An estimator whose causality is ``fixed-lag`` has a parameter ``lag``
    [s]. An estimator that processes many runs at once is a :class:`.block.BlockEstimator`.

    Parameters
    ----------
    noise_scale : factor on the assumed standard deviations of gravity and gradient measurements.
        The problem that ``estimate`` receives has that R already (:mod:`.estimation`).

    Raises
    ------
    ValueError
        If a parameter is beyond its limits, or contradicts another one (:meth:`conflict`).
    """

    noise_scale: Positive = field(default=1.0, kw_only=True)

    name: ClassVar[str]
    family: ClassVar[Family] = "own"

    def __post_init__(self) -> None:
        require_valid(self)
        if reason := self.conflict():
            raise ValueError(f"{self.name}: {reason}")

    @property
    @abstractmethod
    def causality(self) -> Causality:
        """Measurements on which an estimate at time t may depend."""

    @property
    def exact_if_linear_gaussian(self) -> bool:
        """Whether the estimate of a linear Gaussian problem is exact.

        An exact estimate equals that of the Kalman filter or smoother of the same causality, to
        rounding. Particles and grids are exact only in the limit.
        """
        return True

    @abstractmethod
    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate the state at every epoch; all randomness comes from ``rng``."""

    def conflict(self) -> str | None:
        """Return why the parameters contradict each other, or None if they do not."""
        return None

    def skip(self, problem: Problem) -> str | None:
        """Return why this estimator cannot process the problem, or None if it can.

        A campaign calls it once per case, with the first run. The result must not depend on the
        run.
        """
        return None
