"""Posterior Cramér–Rao bounds for filters, fixed-lag smoothers and smoothers.

For linear dynamics with Gaussian noise the bound of Tichavský, Muravchik & Nehorai (1998) is
computed by the Riccati recursion with H at the truth. The bounds for smoothers follow from the same
matrices by the Rauch–Tung–Striebel recursion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Bound:
    """Bounds (K, n, n) on the error covariance at the measurement epochs.

    Attributes
    ----------
    filtering, predicted : (K, n, n) bounds after and before the measurement of each epoch.
    gain : (K, n, m) Kalman gains in the Riccati recursion.
    jacobians : (K, m, n) H at the truth.
    smoother_gain : (K, n, n) gains of the Rauch–Tung–Striebel recursion.
    ticks : (K,) times of the epochs in ticks, the common time unit of all sensors.
    """

    filtering: np.ndarray
    predicted: np.ndarray
    gain: np.ndarray
    jacobians: np.ndarray
    smoother_gain: np.ndarray
    ticks: np.ndarray

    @property
    def smoothing(self) -> np.ndarray:
        """Bound (K, n, n) for a smoother that uses all measurements."""
        return self.fixed_lag(self.whole)

    @property
    def whole(self) -> int:
        """Lag [ticks] from the first to the last epoch."""
        return int(self.ticks[-1] - self.ticks[0])

    def fixed_lag(self, lag: int) -> np.ndarray:
        """Return the bound (K, n, n) for a fixed-lag smoother with a lag of ``lag`` ticks."""

        def step_back(k: np.ndarray, after: np.ndarray) -> np.ndarray:
            gain = self.smoother_gain[k]
            change = gain @ (after - self.predicted[k + 1]) @ gain.transpose(0, 2, 1)
            return self.filtering[k] + change

        return self._smoothed(self.filtering, lag, step_back)

    def _smoothed(
        self, filtered: np.ndarray, lag: int, step_back: Callable[..., np.ndarray]
    ) -> np.ndarray:
        """Return smoothed values (K, ...), which use measurements up to ``lag`` ticks later.

        ``filtered`` (K, ...) are the filtered values. ``step_back`` computes the smoothed values at
        given epochs from those at the following epochs.
        """
        epochs = len(filtered)
        if lag >= self.ticks[-1] - self.ticks[0]:
            smoothed = filtered.copy()
            for k in range(epochs - 2, -1, -1):
                smoothed[k] = step_back(np.array([k]), smoothed[[k + 1]])[0]
            return smoothed
        # Start every epoch from the filter's at the end of its window, then step back.
        targets = np.arange(epochs)
        last = np.searchsorted(self.ticks, self.ticks + lag, side="right") - 1
        smoothed = filtered[last].copy()
        for back in range(int((last - targets).max(initial=0))):
            now = last - 1 - back
            active = now >= targets
            smoothed[active] = step_back(now[active], smoothed[active])
        return smoothed

    def oracle(
        self, residuals: np.ndarray, error_state: np.ndarray, transition: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the filtered and predicted states of the oracle, a filter linearised at the truth.

        The oracle is a Kalman filter with the gains of the bound. It processes the same
        measurements as the estimators.

        Parameters
        ----------
        residuals : (R, K, m) measurements minus h at the truth.
        error_state : (R, K, n) true states.
        transition : (R, K, n, n) transition matrices of each run.

        Returns
        -------
        Two arrays (K, R, n) of states.
        """
        filtered, predicted = np.empty((2, *np.swapaxes(error_state, 0, 1).shape))
        state = np.zeros_like(error_state[:, 0])
        for k, gain in enumerate(self.gain):
            state = _times(transition[:, k], state)
            predicted[k] = state
            innovations = residuals[:, k] + _times(self.jacobians[k], error_state[:, k] - state)
            state = state + _times(gain, innovations)
            filtered[k] = state
        return filtered, predicted

    def oracle_smoothed(self, filtered: np.ndarray, predicted: np.ndarray, lag: int) -> np.ndarray:
        """Return the smoothed states (K, R, n) of the oracle with a lag of ``lag`` ticks.

        ``filtered`` and ``predicted`` (K, R, n) come from :meth:`oracle`.
        """

        def step_back(k: np.ndarray, after: np.ndarray) -> np.ndarray:
            gain = self.smoother_gain[k][:, np.newaxis]
            return np.asarray(filtered[k] + _times(gain, after - predicted[k + 1]))

        return self._smoothed(filtered, lag, step_back)


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return the products of matrices (..., m, n) and vectors (..., n), computed one by one.

    The rounding of one product with all vectors depends on the number of vectors. The result of a
    run would then depend on the block.
    """
    return np.asarray((matrices @ vectors[..., np.newaxis])[..., 0])


def posterior_bound(
    transition: np.ndarray,
    process_cov: np.ndarray,
    prior_cov: np.ndarray,
    jacobians: np.ndarray,
    noise_cov: np.ndarray,
    ticks: np.ndarray | None = None,
) -> Bound:
    """Return the bounds for the system x_k = Φ_k x_{k−1} + w_k, z_k = h(x_k) + v_k.

    Parameters
    ----------
    transition, process_cov : (K, n, n) Φ_k and covariances of w_k.
    prior_cov : (n, n) covariance of the state before the first transition.
    jacobians : (K, m, n) H at the truth.
    noise_cov : (m, m) covariance of v_k.
    ticks : (K,) integer times of the epochs; by default 0, 1, 2, ...
    """
    epochs, _, n = jacobians.shape
    filtering = np.empty((epochs, n, n))
    predicted = np.empty((epochs, n, n))
    gains = np.empty((epochs, n, len(noise_cov)))
    smoother_gain = np.zeros((epochs, n, n))
    # Every state in units of its prior: the inverses below then see a healthy condition.
    scale = np.sqrt(np.diag(prior_cov))
    p = prior_cov / np.outer(scale, scale)
    for k in range(epochs):
        phi = transition[k] * scale / scale[:, None]
        prior = phi @ p @ phi.T + process_cov[k] / np.outer(scale, scale)
        if k > 0:
            smoother_gain[k - 1] = np.linalg.solve(prior, phi @ p).T
        h = jacobians[k] * scale
        k_gain = np.linalg.solve(h @ prior @ h.T + noise_cov, h @ prior).T
        keep = np.eye(n) - k_gain @ h
        p = keep @ prior @ keep.T + k_gain @ noise_cov @ k_gain.T
        predicted[k], filtering[k], gains[k] = prior, p, k_gain
    units = np.outer(scale, scale)
    ticks = np.arange(epochs) if ticks is None else ticks
    return Bound(
        filtering * units,
        predicted * units,
        gains * scale[:, None],
        jacobians,
        smoother_gain * (scale[:, None] / scale),
        ticks,
    )
