"""Standard error of a map of survey lines, and correlation of the error along a track.

Lines that the map was fitted to ("fitted lines") and held-back lines have noise with the same
autocovariance N:

- the residuals of held-back lines have the autocovariance N + E, where E is the autocovariance of
  the map error;
- the residuals of fitted lines have N − E, because the map has fitted part of the noise (exact for
  an optimal map: Rasmussen & Williams 2006, section 2.2).

Half the difference of the two is the estimate of E; the noise N cancels. E differs between fitted
lines and held-back lines, which lie one line spacing away. The estimate is the mean of both values.
At the correlation distance, E is 1/e of its value at lag zero.

The errors of tensor components that were not measured follow from an isotropic field. In such a
field the variances of Γ_EE, Γ_EN, Γ_EU, Γ_NN, Γ_NU and Γ_UU have the ratio 3 : 1 : 4 : 3 : 4 : 8.

If the difference is not positive, the error is unknown. The mean residual of each line is removed
first. The error therefore does not contain a constant map error along a line.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .equivalent_sources import metres_along, weights_of
from .survey_fit import SurveyFit

Array = NDArray[np.float64]

_LAGS = 60  # samples, in which the correlation must have fallen
_TRACE = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def _isotropic() -> Array:
    """Return the covariance (9, 9) of an isotropic harmonic field.

    The variances of UU and of upward gravity are 1.
    """
    angle = 2.0 * np.pi * (np.arange(16) + 0.5) / 16.0
    c, s, one = np.cos(angle), np.sin(angle), np.ones(16)
    real = np.array([-c * c, -c * s, 0 * c, -s * s, 0 * c, one, 0 * c, 0 * c, one])
    odd = np.array([0 * c, 0 * c, c, 0 * c, s, 0 * c, c, s, 0 * c])
    covariance: Array = (real @ real.T + odd @ odd.T) / angle.size
    covariance[:6, 6:] = covariance[6:, :6] = 0.0  # of other wavelengths
    return covariance


def map_error(fit: SurveyFit) -> tuple[Array, Array]:
    """Return the standard errors of the nine components of a map, and correlation distances.

    The errors (9,) are those of the tensor [EE, EN, EU, NN, NU, UU] [E] and of gravity [m/s²]; the
    distances are (9,) [m]. If gradients were measured, the results for gravity are NaN. If gravity
    was measured, the results for the tensor are NaN. The results of a measured component are NaN if
    its residuals are not larger on held-back lines than on fitted lines. In this case, components
    that the measured components do not determine are NaN, too. A distance is NaN if the
    autocovariance never falls to 1/e of its value at lag zero.
    """
    measured = weights_of(fit.lines)
    basis = np.vstack([measured, _TRACE]) if fit.lines.quantity == "gradient" else measured
    # What the components of the map are of those that were measured: zz is −xx − yy.
    mixing = np.linalg.lstsq(basis.T, np.eye(9), rcond=None)[0]
    is_determined = np.abs(basis.T @ mixing - np.eye(9)).max(axis=0) < 1e-9
    mixing = mixing[: len(measured)]
    covariance = _autocovariance(fit)
    isotropic = _isotropic()
    shares = np.diag(measured @ isotropic @ measured.T)
    scale = np.mean(_positive(np.diag(covariance[0])) / shares)
    of_gravity = np.arange(9) >= 6
    alike = of_gravity == (fit.lines.quantity == "disturbance")
    variance = np.where(alike, scale * np.diag(isotropic), np.nan)
    of_components = np.einsum("ck,lcd,dk->lk", mixing, covariance, mixing)
    variance[is_determined] = _positive(of_components[0, is_determined])
    metres = np.mean([_step(fit, index) for index in fit.held_back])
    distance = np.full(9, np.nan)
    distance[is_determined] = [
        metres * _fall(of_components[:, k]) for k in np.flatnonzero(is_determined)
    ]
    mean = metres * _fall(np.einsum("lcc->l", covariance / shares[:, np.newaxis]))
    return np.sqrt(variance), np.where(np.isfinite(variance) & ~is_determined, mean, distance)


def _positive(variance: Array) -> Array:
    """Return variances with NaN in place of values that are not positive."""
    return np.where(variance > 0.0, variance, np.nan)


def _autocovariance(fit: SurveyFit) -> Array:
    """Return the autocovariance E (lags, components, components) of the map error along a line."""
    counts = [len(rows) for rows in fit.held_back.values()]
    lags = min(_LAGS, min(counts) // 2)
    return 0.5 * (_lagged(fit.held_back, lags) - _lagged(fit.fitted, lags))


def _lagged(series: dict[int, Array], lags: int) -> Array:
    """Return the symmetrised autocovariance (lags, components, components) from lag 0 on."""
    out = []
    for lag in range(lags):
        total = sum(rows[: len(rows) - lag].T @ rows[lag:] for rows in series.values())
        count = sum(len(rows) - lag for rows in series.values())
        out.append(0.5 * (total + np.transpose(total)) / count)
    return np.array(out)


def _step(fit: SurveyFit, index: int) -> float:
    """Return the mean distance between samples of the line ``index`` [m]."""
    distance = metres_along(fit.lines, index)
    return float(distance[-1] / (len(distance) - 1))


def _fall(covariance: Array) -> float:
    """Return the lag at which an autocovariance first is 1/e of its value at 0; NaN if none."""
    if not covariance[0] > 0.0:
        return float("nan")
    share = covariance / covariance[0]
    below = np.flatnonzero(share <= 1.0 / math.e)
    if not below.size:
        return float("nan")
    last = int(below[0])
    return float(last - (1.0 / math.e - share[last]) / (share[last - 1] - share[last]))
