"""Lattices of positions that move with the INS error."""

from __future__ import annotations

import numpy as np


class Lattice:
    """Points base + A i with integers i (d,), and masses of a Gaussian in a box of them.

    Attributes
    ----------
    base : (d,) first corner of the box of masses.
    axes : (d, d) A, one axis per column.
    masses : (cells of each axis); they add up to one.

    Parameters
    ----------
    mean, cov : (d,), (d, d) of the Gaussian.
    steps : (d,) distance of the points along each state.
    reach : half side of the box in standard deviations.
    """

    def __init__(self, mean: np.ndarray, cov: np.ndarray, steps: np.ndarray, reach: float) -> None:
        sigma = np.sqrt(np.diag(cov))
        half = np.ceil(reach * sigma / steps).astype(int)
        self.axes = np.diag(steps)
        self.base = mean - steps * half
        self.masses = np.empty(tuple(2 * half + 1))
        away = self.places(np.indices(self.masses.shape).reshape(len(sigma), -1).T)
        away = away - mean
        squares = (away * np.linalg.solve(cov, away.T).T).sum(axis=1)
        self.masses[...] = np.exp(-0.5 * squares).reshape(self.masses.shape)
        self.masses /= self.masses.sum()

    def places(self, index: np.ndarray) -> np.ndarray:
        """Return the states (N, d) of points by their indices (N, d)."""
        return np.asarray(self.base + index @ self.axes.T)

    def move(self, transition: np.ndarray) -> None:
        """Propagate the points as states, by Φ (d, d); the masses stay with their points."""
        self.base, self.axes = transition @ self.base, transition @ self.axes

    def in_cells(self, cov: np.ndarray) -> np.ndarray:
        """Convert a covariance (d, d) of the states to one of indices."""
        back = np.linalg.inv(self.axes)
        return np.asarray(back @ cov @ back.T)
