"""Cramér–Rao bound of an estimate's causality."""

from __future__ import annotations

import numpy as np

from ..simulation.bound import Bound


def bound_for(bound: Bound, causality: str, lag_epochs: int | None) -> np.ndarray:
    """Return the bound (K, n, n) for estimates of a causality, linearised at the truth.

    It is the covariance of a filter or smoother that is linearised at the truth. By Jensen's
    inequality its mean over flights is above the posterior bound, so it is no proven limit of
    nonlinear problems.

    An estimate without aiding is compared with the filtering bound.
    """
    if causality == "batch":
        return bound.smoothing
    if causality == "fixed-lag" and lag_epochs is not None:
        return bound.fixed_lag(lag_epochs)
    return bound.filtering


def squared_bounds(cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds (K,) on the squared spherical position and velocity error."""
    return (
        np.trace(cov[:, :3, :3], axis1=1, axis2=2),
        np.trace(cov[:, 3:6, 3:6], axis1=1, axis2=2),
    )
