"""Posterior Cramér–Rao bound of filters, fixed-lag smoothers and smoothers.

For linear dynamics with Gaussian noise the bound of Tichavský, Muravchik & Nehorai (1998) is the
Riccati recursion with H at the truth. The smoothing bounds are the Rauch–Tung–Striebel recursion
over the same matrices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Bound:
    """Covariance bounds (K, n, n) of the state at the measurement epochs.

    ``ticks`` (K,) are the times of the epochs, in whole units.
    """

    filtering: np.ndarray
    predicted: np.ndarray
    smoother_gain: np.ndarray
    ticks: np.ndarray

    @property
    def smoothing(self) -> np.ndarray:
        """Bound given all measurements, (K, n, n)."""
        return self.fixed_lag(int(self.ticks[-1] - self.ticks[0]))

    def fixed_lag(self, lag: int) -> np.ndarray:
        """Bound given the measurements up to ``lag`` ticks after each epoch, (K, n, n)."""
        epochs = len(self.filtering)
        bound = self.filtering.copy()
        if lag >= self.ticks[-1] - self.ticks[0]:
            for k in range(epochs - 2, -1, -1):
                bound[k] = self._step_back(np.array([k]), bound[[k + 1]])[0]
            return bound
        # Start every epoch from the filtering bound at the end of its window, then step back.
        targets = np.arange(epochs)
        last = np.searchsorted(self.ticks, self.ticks + lag, side="right") - 1
        bound = self.filtering[last].copy()
        for back in range(int((last - targets).max(initial=0))):
            now = last - 1 - back
            active = now >= targets
            bound[active] = self._step_back(now[active], bound[active])
        return bound

    def _step_back(self, k: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Smooth epochs ``k`` given the smoothed bounds of the epochs that follow them."""
        gain = self.smoother_gain[k]
        change = gain @ (after - self.predicted[k + 1]) @ gain.transpose(0, 2, 1)
        return self.filtering[k] + change


def posterior_bound(
    transition: np.ndarray,
    process_cov: np.ndarray,
    prior_cov: np.ndarray,
    jacobians: np.ndarray,
    noise_cov: np.ndarray,
    ticks: np.ndarray | None = None,
) -> Bound:
    """Return the bounds of x_k = Φ_k x_{k−1} + w_k, z_k = h(x_k) + v_k.

    Parameters
    ----------
    transition, process_cov : (K, n, n).
    prior_cov : (n, n) before the first transition.
    jacobians : (K, m, n), H at the truth.
    noise_cov : (m, m).
    ticks : (K,) times of the epochs, in whole units; one after the other if not given.
    """
    epochs, _, n = jacobians.shape
    filtering = np.empty((epochs, n, n))
    predicted = np.empty((epochs, n, n))
    gain = np.zeros((epochs, n, n))
    # Every state in units of its prior: the inverses below then see a healthy condition.
    scale = np.sqrt(np.diag(prior_cov))
    p = prior_cov / np.outer(scale, scale)
    for k in range(epochs):
        phi = transition[k] * scale / scale[:, None]
        prior = phi @ p @ phi.T + process_cov[k] / np.outer(scale, scale)
        if k > 0:
            gain[k - 1] = np.linalg.solve(prior, phi @ p).T
        h = jacobians[k] * scale
        k_gain = np.linalg.solve(h @ prior @ h.T + noise_cov, h @ prior).T
        keep = np.eye(n) - k_gain @ h
        p = keep @ prior @ keep.T + k_gain @ noise_cov @ k_gain.T
        predicted[k], filtering[k] = prior, p
    units = np.outer(scale, scale)
    ticks = np.arange(epochs) if ticks is None else ticks
    return Bound(filtering * units, predicted * units, gain * (scale[:, None] / scale), ticks)
