"""Stone Soup: extended and unscented Kalman filters, Kalman smoother.

A class of a few lines adds a filter of Stone Soup to campaigns::

    @dataclass(frozen=True)
    class Mine(StoneSoupEstimator):
        name = "stonesoup-ekf"

        def filter(self, transition, measurement):
            return KalmanPredictor(transition), ExtendedKalmanUpdater(measurement)

Install the extra ``stonesoup``: ``pip install 'ggbench[stonesoup]'``.
"""

from __future__ import annotations

import contextlib
import datetime
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..problem import Causality, Estimate, Estimator, Family, Problem

try:
    from stonesoup.base import Property
    from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
    from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
    from stonesoup.predictor.kalman import KalmanPredictor, UnscentedKalmanPredictor
    from stonesoup.smoother.kalman import KalmanSmoother
    from stonesoup.types.array import CovarianceMatrix, StateVector, StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState
    from stonesoup.types.track import Track
    from stonesoup.updater.kalman import ExtendedKalmanUpdater, UnscentedKalmanUpdater
except ImportError as error:
    raise ImportError(
        f"{__name__} needs Stone Soup ({error}): pip install 'ggbench[stonesoup]'"
    ) from error

LIBRARIES = ("stonesoup",)
"""Distributions on whose versions the estimators' results depend."""
_START = datetime.datetime(2000, 1, 1)
"""Arbitrary date of the start of a flight, which Stone Soup requires."""


class Transition(LinearGaussianTimeInvariantTransitionModel):
    """Transition model of one epoch k: x_k = Φ_k x_{k−1} + w_k, w_k ~ N(0, Q_k).

    Parameters
    ----------
    transition_matrix, covariance_matrix : (n, n) Φ_k and Q_k.
    problem, epoch : problem and epoch index k of the two matrices.
    generator : random numbers of the noise.
    """

    problem: Problem = Property()
    epoch: int = Property()
    generator: np.random.Generator = Property()

    def rvs(self, num_samples: int = 1, **kwargs: Any) -> StateVectors:
        """Return N samples (n, N) of the process noise w_k; Q_k may be singular."""
        root = self.problem.noise_root(self.epoch)
        return (root @ self.generator.standard_normal((root.shape[1], num_samples))).view(
            StateVectors
        )


class Measurement(NonLinearGaussianMeasurement):
    """Measurement model of one epoch k: z_k = h(k, x_k) + v_k, v_k ~ N(0, R_k).

    h is evaluated at all points in one call. If a channel is missing, its measurement, h and H are
    zero, so the update with this channel has no effect.

    Parameters
    ----------
    noise_covar : (m, m) R_k.
    problem, epoch : problem and epoch index k of h and H.
    generator : random numbers of the noise.
    """

    problem: Problem = Property()
    epoch: int = Property()
    generator: np.random.Generator = Property()

    @property
    def ndim_meas(self) -> int:
        """Number m of measurement channels."""
        return len(self.noise_covar)

    def rvs(self, num_samples: int = 1, **kwargs: Any) -> StateVectors:
        """Return N samples (m, N) of the measurement noise v_k."""
        root = np.linalg.cholesky(self.noise_covar)
        return (root @ self.generator.standard_normal((len(root), num_samples))).view(StateVectors)

    def function(self, state: Any, noise: Any = False, **kwargs: Any) -> Any:
        """Return h (m, N) at N states, optionally with noise; N = 1 for a single state."""
        vectors = state.state_vector
        points = np.asarray(vectors, dtype=float)
        kind = StateVectors if isinstance(vectors, StateVectors) else StateVector
        predicted = self.problem.model.predict(self.epoch, points.T).T.view(kind)
        if noise is None or noise is False:
            return predicted
        return predicted + (self.rvs(points.shape[1]) if noise is True else noise)

    def jacobian(self, state: Any, **kwargs: Any) -> np.ndarray:
        """Return the Jacobian H (m, n) at a state."""
        x = np.asarray(state.state_vector, dtype=float)[:, 0]
        return self.problem.model.jacobian(self.epoch, x)


@dataclass(frozen=True)
class StoneSoupEstimator(Estimator):
    """Base of estimators that use predictors, updaters and smoothers of Stone Soup.

    A derived class defines ``name`` and :meth:`filter`. A particle filter also defines
    :meth:`start`; a smoother also defines :meth:`smooth` and ``causality = "batch"``. During an
    estimate the generator of the run replaces NumPy's global generator.
    """

    @property
    def causality(self) -> Causality:
        """Causality ``filter``: an estimate uses the measurements up to its epoch."""
        return "filter"

    @abstractmethod
    def filter(self, transition: Transition, measurement: Measurement) -> tuple[Any, Any]:
        """Return the predictor and the updater of one epoch, made from the models of that epoch."""

    def start(self, prior: GaussianState, rng: np.random.Generator) -> Any:
        """Return the initial state, by default the prior."""
        return prior

    def smooth(self, track: Track) -> Track:
        """Return the smoothed track; by default the filtered track, unchanged."""
        return track

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Predict and update at every epoch; return means and covariances."""
        with _drawn_from(rng):
            track = self.smooth(Track(list(self._updates(problem, rng))))
        mean = np.array([np.asarray(state.mean, dtype=float).ravel() for state in track])
        cov = np.array([np.asarray(state.covar, dtype=float) for state in track])
        return Estimate(mean, 0.5 * (cov + cov.transpose(0, 2, 1)), self.causality)

    def _updates(self, problem: Problem, rng: np.random.Generator) -> Iterator[Any]:
        """Yield the updated state of every epoch."""
        first = float(problem.times[0])
        # The start is the zero of time; where the first epoch is not behind it, a second before.
        start = _time(0.0 if first > 0.0 else first - 1.0)
        prior = GaussianState(
            StateVector(problem.prior_mean), CovarianceMatrix(problem.prior_cov), timestamp=start
        )
        state = self.start(prior, rng)
        mapping = tuple(range(problem.dimension))
        for k, time in enumerate(problem.times):
            of_epoch = {"problem": problem, "epoch": k, "generator": rng}
            predictor, updater = self.filter(
                Transition(
                    transition_matrix=problem.transition[k],
                    covariance_matrix=CovarianceMatrix(problem.process_cov[k]),
                    **of_epoch,
                ),
                Measurement(
                    ndim_state=len(mapping),
                    mapping=mapping,
                    noise_covar=CovarianceMatrix(problem.noise_of(k)),
                    **of_epoch,
                ),
            )
            prediction = predictor.predict(state, timestamp=_time(float(time)))
            detection = Detection(
                StateVector(problem.measurements[k]),
                timestamp=_time(float(time)),
                measurement_model=updater.measurement_model,
            )
            state = updater.update(SingleHypothesis(prediction, detection))
            yield state


def _time(seconds: float) -> datetime.datetime:
    return _START + datetime.timedelta(seconds=seconds)


@contextlib.contextmanager
def _drawn_from(rng: np.random.Generator) -> Iterator[None]:
    """Seed NumPy's global generator, which Stone Soup uses to resample; restore it afterwards."""
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(rng.integers(2**32))  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(before)  # noqa: NPY002


@dataclass(frozen=True)
class StoneSoupEkf(StoneSoupEstimator):
    """Extended Kalman filter of Stone Soup."""

    name = "stonesoup-ekf"
    family: ClassVar[Family] = "kalman"

    def filter(self, transition: Transition, measurement: Measurement) -> tuple[Any, Any]:
        """Return the Kalman predictor and the extended Kalman updater."""
        return KalmanPredictor(transition), ExtendedKalmanUpdater(measurement)


@dataclass(frozen=True)
class StoneSoupUkf(StoneSoupEstimator):
    """Unscented Kalman filter of Stone Soup, with the sigma points of the estimator ``ukf``."""

    name = "stonesoup-ukf"
    family: ClassVar[Family] = "sigma-point"

    def filter(self, transition: Transition, measurement: Measurement) -> tuple[Any, Any]:
        """Return the unscented Kalman predictor and updater."""
        return (
            UnscentedKalmanPredictor(transition, alpha=1.0, beta=0.0),
            UnscentedKalmanUpdater(measurement, alpha=1.0, beta=0.0),
        )


@dataclass(frozen=True)
class StoneSoupSmoother(StoneSoupEkf):
    """Kalman smoother of Stone Soup, applied to the result of the extended Kalman filter."""

    name = "stonesoup-smoother"
    family: ClassVar[Family] = "smoother"
    causality = "batch"

    def smooth(self, track: Track) -> Track:
        """Return the smoothed track."""
        return KalmanSmoother(None).smooth(track)
