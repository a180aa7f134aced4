"""Posterior Cramér–Rao bounds for filters, fixed-lag smoothers and smoothers.

For linear dynamics with Gaussian noise the bound of Tichavský, Muravchik & Nehorai (1998) is
computed by the Riccati recursion. In this recursion the measurement Jacobian H is evaluated at the
true states. The bounds for smoothers follow from the same matrices by the Rauch–Tung–Striebel
recursion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Bound:
    """Bounds (K, n, n) on the error covariance at the measurement epochs.

    Attributes
    ----------
    filtering : (K, n, n) bounds after the measurement of each epoch.
    predicted : (K, n, n) bounds before the measurement of each epoch.
    gain : (K, n, m) Kalman gains in the Riccati recursion.
    jacobians : (K, m, n) measurement Jacobians H at the true states.
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
        """Lag [ticks] of a smoother over the whole flight, from the first to the last epoch."""
        return int(self.ticks[-1] - self.ticks[0])

    def fixed_lag(self, lag: int) -> np.ndarray:
        """Return the bound (K, n, n) for a fixed-lag smoother with a lag of ``lag`` ticks."""
        if lag >= self.whole:
            smoothed = self.filtering.copy()
            for k in range(len(smoothed) - 2, -1, -1):
                smoothed[k] = self._stepped_back(np.array([k]), smoothed[[k + 1]])[0]
            return smoothed
        # Start every epoch from the filter's at the end of its window, then step back.
        targets, last = np.arange(len(self.ticks)), self.last_epochs(lag)
        smoothed = self.filtering[last].copy()
        for back in range(int((last - targets).max(initial=0))):
            now = last - 1 - back
            active = now >= targets
            smoothed[active] = self._stepped_back(now[active], smoothed[active])
        return smoothed

    def _stepped_back(self, k: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Return smoothed covariances (k, n, n) at epochs (k,) from those one epoch later."""
        gain = self.smoother_gain[k]
        change = gain @ (after - self.predicted[k + 1]) @ gain.transpose(0, 2, 1)
        return np.asarray(self.filtering[k] + change)

    def last_epochs(self, lag: int) -> np.ndarray:
        """Return, for each epoch, the index (K,) of the last epoch at most ``lag`` ticks later."""
        return np.searchsorted(self.ticks, self.ticks + lag, side="right") - 1


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
    jacobians : (K, m, n) Jacobians H of h at the true states.
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
