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
"""Families of estimators by representation of the posterior; each has a colour in figures."""


class MeasurementModel(Protocol):
    """Measurement function h and its Jacobian, as functions of epoch index and state."""

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return h(k, x) (..., m) at epoch ``k`` and states x (..., n).

        The states may have any leading axes.
        """

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return the Jacobian ∂h/∂x (..., m, n) at epoch ``k`` and states x (..., n).

        The states may have any leading axes.
        """


@runtime_checkable
class AlongModel(MeasurementModel, Protocol):
    """A measurement model that can evaluate all epochs of a trajectory in one call."""

    def predict_along(self, at: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return h (N, m) at N epochs, with one state for each epoch.

        ``at`` (N,) contains the indices of the epochs, and x (N, n) contains the states.
        """

    def jacobian_along(self, at: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return ∂h/∂x (N, m, n) at N epochs, with one state for each epoch.

        ``at`` (N,) contains the indices of the epochs, and x (N, n) contains the states.
        """


def predict_along(model: MeasurementModel, at: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return h (N, m) of any model at N epochs, with one state for each epoch.

    ``at`` (N,) contains the indices of the epochs, and x (N, n) contains the states.
    """
    if isinstance(model, AlongModel):
        return model.predict_along(at, x)
    return np.stack([model.predict(int(k), state) for k, state in zip(at, x, strict=True)])


def jacobian_along(model: MeasurementModel, at: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return ∂h/∂x (N, m, n) of any model at N epochs, with one state for each epoch.

    ``at`` (N,) contains the indices of the epochs, and x (N, n) contains the states.
    """
    if isinstance(model, AlongModel):
        return model.jacobian_along(at, x)
    return np.stack([model.jacobian(int(k), state) for k, state in zip(at, x, strict=True)])


@runtime_checkable
class CountingModel(MeasurementModel, Protocol):
    """A measurement model that counts its evaluations."""

    @property
    def evaluations(self) -> int:
        """Number of states at which h or its Jacobian has been evaluated so far."""


@dataclass(frozen=True)
class StateBlock:
    """A named part of the state: its slice of the vector and the unit of its elements."""

    name: str
    slice: slice
    unit: str


@dataclass(frozen=True)
class Channel:
    """One component of the measurement vector: its name, unit and sensor.

    ``sensor`` is the name of the sensor. Unless the scenario names the sensor, the name is the kind
    of the sensor, such as ``gnss``.
    """

    name: str
    unit: str
    sensor: str


_OF_THE_MAP = ("E", "mGal")
"""Units of gradient and gravity channels; the names of sensors are the case's own."""


def matched_with_map(channels: Sequence[Channel], count: int) -> np.ndarray:
    """Return the mask (m,) of channels that are matched with the map.

    These are the channels of gravity and gravity gradients. If ``channels`` is empty, all ``count``
    channels are included.
    """
    if not channels:
        return np.ones(count, dtype=bool)
    return np.array([channel.unit in _OF_THE_MAP for channel in channels])


@dataclass(frozen=True)
class InsSolution:
    """INS solution at the measurement epochs; the errors of this solution are the states.

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
    """INS mechanization with feedback, in consecutive parts.

    Each part starts from the corrected INS state at the end of the part before.
    """

    def ahead(self, last: int) -> Problem:
        """Return the problem of the next part, which ends with the epoch ``last``.

        The part begins with the epoch after the last correction. The prior of the problem is the
        estimate at that correction.
        """

    def correct(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """Correct the INS by the estimates of the latest part.

        ``mean`` (K', n) and ``cov`` (K', n, n) are the estimates at the K' epochs of this part.

        Returns
        -------
        The same estimates (K', n), converted to errors of the INS without feedback. These errors
        are the states of the original problem.
        """


class Replay(Protocol):
    """Stored inertial measurements of a flight, from which an INS with feedback is computed."""

    def start(self, problem: Problem) -> ClosedLoop:
        """Return a closed loop at the start of the problem, before any correction of the INS."""


class GravityMap(Protocol):
    """The gravity field that the estimators assume."""

    @property
    def lower(self) -> np.ndarray:
        """Lower corner (3,) of the map in map coordinates [rad, rad, m]; −∞ without a map.

        The third coordinate is the height. In a draped map it is the height above the base surface.
        """

    @property
    def upper(self) -> np.ndarray:
        """Upper corner (3,) of the map in map coordinates [rad, rad, m]; ∞ without a map."""

    def coordinates(self, positions: np.ndarray) -> np.ndarray:
        """Convert positions (..., 3) [rad, rad, m] to map coordinates."""

    def over_nodes(
        self, latitude: ArrayLike, longitude: ArrayLike, third: ArrayLike
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Convert map coordinates to latitude, longitude [rad] and ellipsoidal height [m].

        Each result has the shape (...) to which the arguments broadcast.
        """

    def tensor(self, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike) -> np.ndarray:
        """Return the gradient tensor (..., 6) [E] at positions [rad, rad, m] within the map."""

    def gravity_disturbance(
        self, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike
    ) -> np.ndarray:
        """Return the gravity disturbance (..., 3), ENU [m/s²], at positions within the map."""


@dataclass(frozen=True)
class Problem:
    """One estimation problem. Every array is an immutable copy of its argument.

    The state at the start is x_{−1} ~ N(prior_mean, prior_cov). For the epochs k = 0..K−1,

        x_k = transition[k] x_{k−1} + w_k,        w_k ~ N(0, process_cov[k]),
        measurements[k] = h(k, x_k) + v_k,        v_k ~ N(0, R_k).

    ``transition[0]`` propagates from the start to times[0]. ``process_cov[k]`` may be singular.

    If a channel has no measurement at an epoch, ``present`` is false, and its measurement, h and H
    are zero. An update with zeros changes nothing, so most estimators can ignore ``present``.

    Attributes
    ----------
    times : (K,) measurement epochs [s].
    measurements : (K, m) measurements, without NaN.
    noise_cov : (m, m) R for all epochs, or (K, m, m) R of each epoch; see :meth:`noise_of`.
    transition, process_cov : (K, n, n) transition matrices and process noise covariances.
    prior_mean : (n,) mean at the start.
    prior_cov : (n, n) covariance at the start, positive definite.
    model : measurement function h and Jacobian H.
    layout : names, slices and units of the n states.
    present : (K, m) mask of available measurements; by default all.
    channels : names, units and sensors of the m measurements; ``()`` if unknown.
    track : INS solution if the states are INS errors; otherwise None.
    map : gravity field from which h predicts measurements; None if there is none.
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
        """Return the noise covariance R (m, m) of epoch ``k``."""
        return self.noise_cov if self.noise_cov.ndim == 2 else self.noise_cov[k]

    def noise_root(self, k: int) -> np.ndarray:
        """Return G (n, r) with G Gᵀ = Q of epoch ``k``, where r is the rank of Q.

        Noise samples are w_k = G u with u ~ N(0, I).
        """
        return ranked_root(self.process_cov[k])[0]

    def log_likelihood(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return the log-likelihoods ln p(z_k | x) of states x (..., n), with shape (...).

        z_k contains the available measurements of epoch ``k``.
        """
        there = self.present[k]
        residual = (self.measurements[k] - self.model.predict(k, x))[..., there]
        root = np.linalg.cholesky(self.noise_of(k)[np.ix_(there, there)])
        white = np.linalg.solve(root, residual[..., np.newaxis])[..., 0]
        constant = np.log(np.diag(root)).sum() + 0.5 * len(root) * np.log(2.0 * np.pi)
        return np.asarray(-0.5 * (white**2).sum(axis=-1) - constant)


@dataclass(frozen=True)
class Fixes:
    """Position fixes of a matcher, accepted and rejected, each from a window of measurements.

    Each of the F ≥ 0 rows is one attempted fix. The rows are in order of the epochs, with at most
    one row per epoch.

    Attributes
    ----------
    epoch : (F,) increasing indices of the epochs of the fixes; each is the last epoch of the
        window.
    mean : (F, 2) or (F, 3) estimated position errors [m] at these epochs: east, north and, with
        three columns, up. They are the first two or three states.
    cov : (F, 2, 2) or (F, 3, 3) covariance of ``mean`` [m²]. It includes the effect of the
        uncertainty of all other states.
    accepted : (F,) whether the estimator accepts the fix.
    statistic : (F,) statistic of the acceptance test; larger values are more certain. The default
        statistic is the log odds between the best and the second-best position. −∞: the fix is
        rejected at any threshold. ∞: there is no second position.
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

    At epochs without a fix, a matcher returns the propagated prior. These epochs are not marked.

    Attributes
    ----------
    mean : (K, n) estimated state at the measurement epochs.
    cov : (K, n, n) error covariance of ``mean``, or None if the estimator computes none.
    causality : measurements used by the estimate at an epoch: measurements up to this epoch
        (``filter``), up to this epoch plus a lag (``fixed-lag``), all measurements (``batch``), or
        no measurement (``none``).
    lag : the lag of a fixed-lag estimate [s], else None.
    info : counters and remarks of this run (iterations, repairs, ...).
    nis : (K,) normalised innovation squared, NaN without a measurement. A filter sets it only
        if its innovations cannot be computed from mean, cov and problem.
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

    A parameter is a field with a default. Its type is ``int``, ``float``, ``bool``, ``str`` or a
    ``Literal`` of strings, optionally with limits (:mod:`.parameters`). On the command line,
    ``name[parameter=value]`` sets a parameter. An estimator with the causality ``fixed-lag`` has a
    parameter ``lag`` [s]. An estimator that processes many runs at once is a
    :class:`.block.BlockEstimator`.

    Parameters
    ----------
    noise_scale : factor on the assumed standard deviations of gravity and gradient measurements.
        The R of the problem that ``estimate`` receives is already scaled (:mod:`.estimation`).

    Raises
    ------
    ValueError
        If a parameter is beyond its limits, or contradicts another parameter (:meth:`conflict`).
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
        """Causality: the measurements on which an estimate at an epoch may depend."""

    @property
    def exact_if_linear_gaussian(self) -> bool:
        """Whether the estimate of a linear Gaussian problem is exact.

        An exact estimate equals that of the Kalman filter or smoother with the same causality,
        except for rounding. Particles and grids are exact only in the limit of infinitely many
        points.
        """
        return True

    @abstractmethod
    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate the state at every epoch; ``rng`` is the only source of random numbers."""

    def conflict(self) -> str | None:
        """Return the reason why the parameters contradict each other, or None if they do not."""
        return None

    def skip(self, problem: Problem) -> str | None:
        """Return the reason why this estimator cannot process the problem, or None if it can.

        A campaign calls this method once per case, with the problem of run 0. The result must not
        depend on the run.
        """
        return None
