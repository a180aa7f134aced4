"""Position grids along the principal axes of a prior, within an ellipsoid."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..block import ProblemBlock
from ..problem import Problem

REACH = 4.5
"""A grid ends at this many standard deviations of the prior: exp(−4.5²/2) = 4e-5 of all horizontal
positions lie outside, 1.6e-4 of all positions."""


class Axes(NamedTuple):
    """Principal axes of the position prior; the position states are all states in metres.

    Attributes
    ----------
    variances : (d,) variances of the prior along the axes [m²].
    gain : (n, d) [1/m] regression coefficients of all states, in units of the prior's standard
        deviations, on the coordinates along the axes.
    states : indices of the position states.
    vectors : (d, d) unit vectors of the axes, in columns.
    """

    variances: np.ndarray
    gain: np.ndarray
    states: list[int]
    vectors: np.ndarray


def position_axes(problem: Problem | ProblemBlock) -> Axes:
    """Return the principal axes of the position prior (of all states in metres)."""
    scale = np.sqrt(np.diag(problem.prior_cov))
    states = states_in_metres(problem)
    variances, vectors = np.linalg.eigh(problem.prior_cov[np.ix_(states, states)])
    gain = (problem.prior_cov[:, states] @ vectors) / variances / scale[:, None]
    return Axes(variances, gain, states, vectors)


def states_in_metres(problem: Problem | ProblemBlock) -> list[int]:
    """Return the indices of the states in metres."""
    return [
        i
        for block in problem.layout
        if block.unit == "m"
        for i in range(*block.slice.indices(problem.dimension))
    ]


def fits(sigma: np.ndarray, spacing: float, most: float) -> bool:
    """Return whether the bounding box of a grid's ellipsoid has at most ``most`` points.

    Parameters
    ----------
    sigma : (d,) standard deviations along the axes [m].
    spacing : distance between neighbouring points [m].
    most : largest number of points.
    """
    return bool(np.sum(np.log1p(2.0 * REACH * sigma / spacing)) <= np.log(most))


def grid(sigma: np.ndarray, spacing: float) -> np.ndarray:
    """Return the points (J, d) [m] of a grid within an ellipsoid.

    An axis along which σ is smaller than the spacing has one point.

    Parameters
    ----------
    sigma : (d,) standard deviations along the axes [m].
    spacing : distance between neighbouring points [m].
    """
    if not len(sigma):
        return np.zeros((1, 0))
    sides = [
        spacing * np.arange(-int(REACH * s / spacing), int(REACH * s / spacing) + 1)
        if s > spacing
        else np.zeros(1)
        for s in sigma
    ]
    points = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, len(sigma))
    return points[np.sum((points / sigma) ** 2, axis=1) <= REACH**2]
