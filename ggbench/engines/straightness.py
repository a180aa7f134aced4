"""Tests of a particle cloud: Gaussian shape, and linearity of h over it."""

from __future__ import annotations

import numpy as np
from numpy.polynomial.hermite_e import hermevander

from ..numerics.positive import ranked_root
from .resampling import moments

_SHAPE = 1.0
"""Hermite moments of a cloud shaped like a Gaussian are smaller, times N^{1/4}."""
_NORMS = np.sqrt([1.0, 1.0, 2.0, 6.0, 24.0, 120.0, 720.0])
"""Deviations of the Hermite polynomials of a normal number, from order 0 on."""


def bending(weights: np.ndarray, drawn: np.ndarray, read: np.ndarray) -> float:
    """Return the residual variance of a measurement over a cloud after a linear regression.

    Parameters
    ----------
    weights : (N,) normalised.
    drawn : (N, d) states of the particles.
    read : (N, m) predicted measurements, in units of the noise.
    """
    d = drawn.shape[1]
    _, joint = moments(weights, np.hstack([drawn, read]))
    _, inverse = ranked_root(joint[:d, :d])
    explained = inverse.T @ joint[:d, d:]
    return float((np.diag(joint)[d:] - (explained**2).sum(axis=0)).max())


def is_gaussian(weights: np.ndarray, drawn: np.ndarray) -> bool:
    """Return whether a cloud has the shape of a Gaussian.

    The test uses the moments of the Hermite polynomials of order 3 to 6, along the axes of the
    states and the principal axes. They are zero for a Gaussian, with a sampling error of N^{−1/2}.
    Order 6 detects three modes with the skewness and kurtosis of a Gaussian.

    Parameters
    ----------
    weights : (N,) normalised.
    drawn : (N, d) states of the particles.
    """
    mean, cov = moments(weights, drawn)
    axes = np.hstack([np.eye(len(cov)), np.linalg.eigh(cov)[1]])
    sigma = np.sqrt(np.einsum("ia,ij,ja->a", axes, cov, axes))
    along = (drawn - mean) @ (axes[:, sigma > 0.0] / sigma[sigma > 0.0])
    found = np.einsum("i,ian->an", weights, hermevander(along, 6)) / _NORMS
    return bool(np.abs(found[:, 3:]).max(initial=0.0) < _SHAPE * len(weights) ** -0.25)
