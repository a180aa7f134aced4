"""Grids of positions across a prior: along its principal axes, within an ellipsoid."""

from __future__ import annotations

import numpy as np

from ..problem import Problem

REACH = 3.5
"""A grid ends at this many standard deviations of the prior."""


def position_axes(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Return the principal variances (d,) [m²] of the prior's states in metres.

    And the regression (n, d) [1/m] of all states, in units of the prior's standard deviations, on
    the coordinates along these axes.
    """
    scale = np.sqrt(np.diag(problem.prior_cov))
    axes = states_in_metres(problem)
    values, vectors = np.linalg.eigh(problem.prior_cov[np.ix_(axes, axes)])
    return values, (problem.prior_cov[:, axes] @ vectors) / values / scale[:, None]


def states_in_metres(problem: Problem) -> list[int]:
    """Return which states are in metres."""
    return [
        i
        for block in problem.layout
        if block.unit == "m"
        for i in range(*block.slice.indices(problem.dimension))
    ]


def fits(sigma: np.ndarray, spacing: float, most: float) -> bool:
    """Return whether the box around the ellipsoid of a grid has no more points than fit."""
    return bool(np.sum(np.log1p(2.0 * REACH * sigma / spacing)) <= np.log(most))


def grid(sigma: np.ndarray, spacing: float) -> np.ndarray:
    """Return the points (J, d) of a grid within an ellipsoid; an axis below the spacing has one.

    Parameters
    ----------
    sigma : (d,) standard deviations along the axes [m]. spacing : of the points [m].
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
