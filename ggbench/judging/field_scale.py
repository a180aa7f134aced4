"""How far the field along a track goes without forgetting itself."""

from __future__ import annotations

import math

import numpy as np

from ..areas.statistics import correlation_length
from ..gravity.ellipsoid import metres_along


def correlation_m(positions: np.ndarray, vertical: np.ndarray) -> float:
    """Return the correlation length ℓ [m] of the field along a track.

    The lag at which the autocorrelation of the vertical gradient, less its mean along the track,
    first falls to 1/e (:func:`.areas.statistics.correlation_length`). NaN of fewer than three
    readings, of a field that does not change, or of a track that stands still.

    Parameters
    ----------
    positions : (K, 3) latitude, longitude [rad], height [m] at which it is read.
    vertical : (K,) Γ_UU there [E].
    """
    if len(vertical) < 3 or np.ptp(vertical) == 0.0:  # less its mean it may be rounding
        return math.nan
    steps = np.diff(positions[:, [1, 0]], axis=0) * metres_along(positions[:-1])
    step = float(np.hypot(*steps.T).mean())
    found = correlation_length((vertical - vertical.mean())[np.newaxis], step)
    return found if found > 0.0 else math.nan
