"""Cramér–Rao bounds for filters and smoothers."""

from __future__ import annotations

import numpy as np

from ..simulation.bound import Bound


def bound_for(bound: Bound, causality: str, lag_epochs: int | None) -> np.ndarray:
    """Return the Cramér–Rao bound (K, n, n) for the causality of an estimate.

    The bound is the covariance of a filter or smoother that is linearised at the truth. By Jensen's
    inequality the mean of this covariance over flights lies above the posterior Cramér–Rao bound.
    The bound is therefore no proven limit for nonlinear problems.

    An estimate without aiding is compared with the bound of a filter.
    """
    if causality == "batch":
        return bound.smoothing
    if causality == "fixed-lag" and lag_epochs is not None:
        return bound.fixed_lag(lag_epochs)
    return bound.filtering


def squared_bounds(cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two bounds (K,), on the squared 3-D errors of position [m²] and velocity [m²/s²].

    ``cov`` (K, n, n) is the Cramér–Rao bound on the covariance of the states.
    """
    return (
        np.trace(cov[:, :3, :3], axis1=1, axis2=2),
        np.trace(cov[:, 3:6, 3:6], axis1=1, axis2=2),
    )
