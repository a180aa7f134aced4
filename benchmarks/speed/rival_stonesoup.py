"""EKF and UKF of Stone Soup.

h and H are in NumPy. One call of h processes all sigma points.
"""

from __future__ import annotations

import datetime
from typing import Any

import numpy as np
from stonesoup.base import Property
from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
from stonesoup.predictor.kalman import KalmanPredictor, UnscentedKalmanPredictor
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState
from stonesoup.updater.kalman import ExtendedKalmanUpdater, UnscentedKalmanUpdater

from .numpy_model import NumpyModel
from .problem_file import Arrays

START = datetime.datetime(2020, 1, 1)


class Gradiometer(NonLinearGaussianMeasurement):
    """Measurement model of one epoch."""

    model: Any = Property()
    epoch: int = Property()

    @property
    def ndim_meas(self) -> int:
        """Number of channels."""
        return len(self.noise_covar)

    def function(self, state: Any, noise: Any = None, **kwargs: Any) -> Any:
        """Return h for one state or for all sigma points, without noise."""
        vectors = state.state_vector
        if isinstance(vectors, StateVectors):
            return self.model.predict_all(self.epoch, np.asarray(vectors).T).T.view(StateVectors)
        return StateVector(self.model.predict(self.epoch, np.asarray(vectors)[:, 0]))

    def jacobian(self, state: Any, **kwargs: Any) -> np.ndarray:
        """Return H."""
        return self.model.jacobian(self.epoch, np.asarray(state.state_vector)[:, 0])


class Ekf:
    """EKF by ExtendedKalmanUpdater, and by KalmanPredictor for linear dynamics."""

    runs_per_call = 1

    def __init__(self, arrays: Arrays) -> None:
        self.arrays = arrays
        self.models = [NumpyModel(arrays, run) for run in range(arrays.runs)]

    def predictor(self, transition: Any) -> Any:
        """Return the predictor of one epoch."""
        return KalmanPredictor(transition)

    def updater(self, measurement_model: Any) -> Any:
        """Return the updater of one epoch."""
        return ExtendedKalmanUpdater(measurement_model)

    def solve(self, run: int) -> np.ndarray:
        """Return the means (1, K, n) of a run."""
        a = self.arrays
        state: Any = GaussianState(StateVector(a.prior_mean), a.prior_cov, timestamp=START)
        mapping = tuple(range(len(a.prior_mean)))
        means = np.empty((len(a.times), len(mapping)))
        for k, time in enumerate(a.times):
            timestamp = START + datetime.timedelta(seconds=float(time))
            transition = LinearGaussianTimeInvariantTransitionModel(
                transition_matrix=a.transition[run, k], covariance_matrix=a.process_cov[run, k]
            )
            model = Gradiometer(
                ndim_state=len(mapping),
                mapping=mapping,
                noise_covar=a.noise_cov,
                model=self.models[run],
                epoch=k,
            )
            prediction = self.predictor(transition).predict(state, timestamp=timestamp)
            detection = Detection(StateVector(a.measurements[run, k]), timestamp=timestamp)
            state = self.updater(model).update(SingleHypothesis(prediction, detection))
            means[k] = np.asarray(state.state_vector)[:, 0]
        return means[None]


class Ukf(Ekf):
    """UKF by UnscentedKalmanPredictor and -Updater with the paper's sigma points."""

    def predictor(self, transition: Any) -> Any:
        """Return the predictor of one epoch."""
        return UnscentedKalmanPredictor(transition, alpha=1.0, beta=0.0)

    def updater(self, measurement_model: Any) -> Any:
        """Return the updater of one epoch."""
        return UnscentedKalmanUpdater(measurement_model, alpha=1.0, beta=0.0)
