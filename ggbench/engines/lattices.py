"""Lattices of position errors that are propagated like the INS error."""

from __future__ import annotations

import numpy as np


class Lattice:
    """Lattice of points base + A i, i ∈ ℤᵈ, with probabilities of a Gaussian in a box of cells.

    Attributes
    ----------
    base : (d,) first corner of the box.
    axes : (d, d) A, one axis per column.
    masses : probability of each cell of the box, with one dimension per axis; the sum is one.

    Parameters
    ----------
    mean, cov : (d,), (d, d) mean and covariance of the Gaussian.
    steps : (d,) distance between neighbouring points in each state.
    reach : half the side of the box, in standard deviations.
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
        """Return the states (N, d) at the lattice points i that ``index`` (N, d) contains."""
        return np.asarray(self.base + index @ self.axes.T)

    def move(self, transition: np.ndarray) -> None:
        """Multiply the positions of all points by Φ (d, d); the probabilities are unchanged."""
        self.base, self.axes = transition @ self.base, transition @ self.axes

    def in_cells(self, cov: np.ndarray) -> np.ndarray:
        """Convert a covariance (d, d) of the states to a covariance of the indices i."""
        back = np.linalg.inv(self.axes)
        return np.asarray(back @ cov @ back.T)
