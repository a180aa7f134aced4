"""Tests of a particle cloud for Gaussian shape, and of h for linearity over the cloud."""

from __future__ import annotations

import numpy as np
from numpy.polynomial.hermite_e import hermevander

from ..numerics.positive import ranked_root
from .resampling import moments

_SHAPE = 1.0
"""Limit of the normalised Hermite moments of a Gaussian cloud, times N^{1/4}."""
_NORMS = np.sqrt([1.0, 1.0, 2.0, 6.0, 24.0, 120.0, 720.0])
"""Standard deviations of the Hermite polynomials of a standard normal number, orders 0 to 6."""


def bending(weights: np.ndarray, drawn: np.ndarray, read: np.ndarray) -> float:
    """Return a measure of the nonlinearity of h over a cloud of particles.

    It is the largest residual variance, over the channels, of a weighted linear regression of the
    predicted measurements on the states.

    Parameters
    ----------
    weights : (N,) normalised weights.
    drawn : (N, d) sampled states of the particles.
    read : (N, m) predicted measurements, in standard deviations of the noise.

    Returns
    -------
    Largest residual variance of any channel, in noise variances.
    """
    d = drawn.shape[1]
    _, joint = moments(weights, np.hstack([drawn, read]))
    _, inverse = ranked_root(joint[:d, :d])
    explained = inverse.T @ joint[:d, d:]
    return float((np.diag(joint)[d:] - (explained**2).sum(axis=0)).max())


def is_gaussian(weights: np.ndarray, drawn: np.ndarray) -> bool:
    """Return whether a cloud has the shape of a Gaussian.

    The test uses the weighted means of the Hermite polynomials of orders 3 to 6. They are computed
    along the axes of the states and along the principal axes of the cloud. For a Gaussian these
    means are zero, with a sampling error of N^{−1/2}. Order 6 detects a cloud of three modes whose
    skewness and kurtosis equal those of a Gaussian.

    Parameters
    ----------
    weights : (N,) normalised weights.
    drawn : (N, d) sampled states of the particles.
    """
    mean, cov = moments(weights, drawn)
    axes = np.hstack([np.eye(len(cov)), np.linalg.eigh(cov)[1]])
    sigma = np.sqrt(np.einsum("ia,ij,ja->a", axes, cov, axes))
    along = (drawn - mean) @ (axes[:, sigma > 0.0] / sigma[sigma > 0.0])
    found = np.einsum("i,ian->an", weights, hermevander(along, 6)) / _NORMS
    return bool(np.abs(found[:, 3:]).max(initial=0.0) < _SHAPE * len(weights) ** -0.25)
