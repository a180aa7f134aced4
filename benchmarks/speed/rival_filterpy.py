"""EKF and UKF of filterpy in their usual form.

h and H are in NumPy. The UKF calls fx and hx once per sigma point.
"""

from __future__ import annotations

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, JulierSigmaPoints, UnscentedKalmanFilter

from .numpy_model import NumpyModel
from .problem_file import Arrays


class Ekf:
    """EKF by ExtendedKalmanFilter.predict and .update."""

    runs_per_call = 1

    def __init__(self, arrays: Arrays) -> None:
        self.arrays = arrays
        self.models = [NumpyModel(arrays, run) for run in range(arrays.runs)]

    def solve(self, run: int) -> np.ndarray:
        """Return the means (1, K, n) of a run."""
        a, model = self.arrays, self.models[run]
        n, m = len(a.prior_mean), a.measurements.shape[-1]
        ekf = ExtendedKalmanFilter(dim_x=n, dim_z=m)
        ekf.x, ekf.P, ekf.R = a.prior_mean.copy(), a.prior_cov.copy(), a.noise_cov
        means = np.empty((len(a.times), n))
        covs = np.empty((len(a.times), n, n))

        def h(x: np.ndarray, k: int) -> np.ndarray:
            return model.predict(k, x)

        def jacobian(x: np.ndarray, k: int) -> np.ndarray:
            return model.jacobian(k, x)

        for k in range(len(a.times)):
            ekf.F, ekf.Q = a.transition[run, k], a.process_cov[run, k]
            ekf.predict()
            ekf.update(a.measurements[run, k], jacobian, h, args=(k,), hx_args=(k,))
            means[k], covs[k] = ekf.x, ekf.P
        return means[None]


class Ukf(Ekf):
    """UKF by UnscentedKalmanFilter with the paper's sigma points, κ = 3 − n."""

    def solve(self, run: int) -> np.ndarray:
        """Return the means (1, K, n) of a run."""
        a, model = self.arrays, self.models[run]
        n, m = len(a.prior_mean), a.measurements.shape[-1]

        def fx(x: np.ndarray, dt: float, k: int) -> np.ndarray:
            return a.transition[run, k] @ x

        def hx(x: np.ndarray, k: int) -> np.ndarray:
            return model.predict(k, x)

        points = JulierSigmaPoints(n, kappa=3.0 - n)
        ukf = UnscentedKalmanFilter(dim_x=n, dim_z=m, dt=1.0, hx=hx, fx=fx, points=points)
        ukf.x, ukf.P, ukf.R = a.prior_mean.copy(), a.prior_cov.copy(), a.noise_cov
        means = np.empty((len(a.times), n))
        covs = np.empty((len(a.times), n, n))
        for k in range(len(a.times)):
            ukf.Q = a.process_cov[run, k]
            ukf.predict(k=k)
            ukf.update(a.measurements[run, k], k=k)
            means[k], covs[k] = ukf.x, ukf.P
        return means[None]
