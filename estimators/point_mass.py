"""Point-mass filter on an adaptive grid.

The density of two or three states is represented by probability masses at the points of a grid. The
dynamics move the points, the process noise convolves the masses, and the likelihood of each
measurement multiplies them (Bucy & Senne 1971; Bergman 1999). There is no linearisation and no
sampling, so the posterior is a reference for other filters of the same problem. The number of
points grows exponentially with the number of states; an INS with biases has fifteen states.

The grid moves with the states, so the dynamics need no interpolation. The convolution with the
noise is a product of characteristic functions, which is exact for any noise covariance, including
singular covariances. Points of negligible mass are dropped. Cells are halved if the peak of the
density is narrower than a few cells, and doubled if it is much wider.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy import fft, ndimage

from ..engines.lattices import Lattice
from ..parameters import Positive
from ..problem import Estimate, Estimator, Problem

_REACH = 5.0
"""The first grid ends at this many standard deviations of the prior."""
_NEGLIGIBLE = 1e-10
"""Ratio of a mass to the largest mass below which its point is cropped."""
_MOST_STATES = 3
_MOST_POINTS = 4_000_000
"""Points that fit in memory with their transform."""
_WIDER = 2.0
"""Cells are doubled if the peak is wider than this factor times the ``resolution``."""
_ROUNDS = 12
"""Limit on the halvings of cells in one update.

The cells become up to 2000 times smaller. If more is needed, the first grid is far too coarse.
"""


@dataclass(frozen=True)
class PointMass(Estimator):
    """Point-mass (grid) filter of one to three states.

    Parameters
    ----------
    step : distance between points of the first grid, in the units of the states: metres for
        positions. It must resolve the likelihood of the first measurement. It is decreased if the
        prior is narrow.
    resolution : smallest number of cells per standard deviation. The standard deviation is that of
        the prior for the first grid. After an update it is that of the highest peak of the
        posterior density, see :func:`peak_cells`.
    """

    step: Positive = 20.0
    resolution: Annotated[float, Field(ge=1.0, le=20.0)] = 2.0

    name = "point-mass"
    family = "sampled"
    causality = "filter"
    exact_if_linear_gaussian = False  # in the limit of small cells only

    def skip(self, problem: Problem) -> str | None:
        """Return a reason to skip the problem, or None if there is none.

        The problem must have at most three states, and the first grid must fit in memory.
        """
        n = problem.dimension
        if n > _MOST_STATES:
            return (
                f"a grid may have at most {_MOST_STATES} states, and the problem has {n}: use "
                "reduced[filter=point-mass,states=position]"
            )
        sides = 2.0 * _REACH * np.sqrt(np.diag(problem.prior_cov)) / self._first_steps(problem) + 1
        if np.prod(sides) > _MOST_POINTS:
            return (
                f"with step = {self.step:g} this prior needs more than {_MOST_POINTS} grid points"
            )
        return None

    def _first_steps(self, problem: Problem) -> np.ndarray:
        """Return the step of the first grid along each axis (n,)."""
        return np.minimum(self.step, np.sqrt(np.diag(problem.prior_cov)) / self.resolution)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Filter one run: move, convolve and multiply the masses, epoch by epoch."""
        grid = _Grid(problem, self._first_steps(problem), self.resolution)
        n = problem.dimension
        mean, cov = np.empty((problem.epochs, n)), np.empty((problem.epochs, n, n))
        points = []
        for k in range(problem.epochs):
            grid.predict(k)
            if problem.present[k].any():
                points.append(grid.update(k))
            mean[k], cov[k] = grid.moments()
        info = {
            "mean_points": float(np.mean(points or [0])),
            "log_evidence": grid.evidence,
            "halvings": grid.halvings,
        }
        return Estimate(mean, cov, self.causality, info=info)


class _Grid(Lattice):
    """Point masses on a lattice that is cropped, refined and coarsened."""

    def __init__(self, problem: Problem, steps: np.ndarray, resolution: float) -> None:
        super().__init__(problem.prior_mean, problem.prior_cov, steps, _REACH)
        self.problem, self.resolution = problem, resolution
        self.evidence, self.halvings = 0.0, 0

    def predict(self, k: int) -> None:
        """Propagate the points by Φ and convolve the masses with the process noise of epoch k."""
        phi, noise = self.problem.transition[k], self.problem.process_cov[k]
        self.move(phi)
        if not noise.any():
            return
        cells = self.in_cells(noise)
        margin = np.ceil(6.0 * np.sqrt(np.diag(cells))).astype(int) + 1
        self._widen(margin)
        frequencies = [2.0 * np.pi * fft.fftfreq(size) for size in self.masses.shape[:-1]]
        frequencies.append(2.0 * np.pi * fft.rfftfreq(self.masses.shape[-1]))
        omega = np.stack(np.meshgrid(*frequencies, indexing="ij"), axis=-1)
        damping = np.exp(-0.5 * np.einsum("...a,ab,...b", omega, cells, omega))
        smeared = fft.irfftn(fft.rfftn(self.masses) * damping, self.masses.shape)
        self.masses = np.maximum(smeared, 0.0)
        self._cut(self.masses)
        self.masses /= self.masses.sum()

    def _widen(self, margin: np.ndarray) -> None:
        """Pad the grid with empty points, at least ``margin`` (n,) on each side.

        The padded sizes are suitable for fast Fourier transforms.
        """
        sizes = np.array(self.masses.shape) + 2 * margin
        extra = [fft.next_fast_len(int(size), real=True) - int(size) for size in sizes]
        wide = [(int(m), int(m) + e) for m, e in zip(margin, extra, strict=True)]
        self.masses = np.pad(self.masses, wide)
        self.base = self.base - self.axes @ margin

    def update(self, k: int) -> int:
        """Multiply by the likelihood of measurement k; return the number of evaluations of h."""
        taken = 0
        for left in reversed(range(_ROUNDS)):
            index = np.argwhere(self.masses > _NEGLIGIBLE * self.masses.max())
            taken += len(index)
            told = self.problem.log_likelihood(k, self.places(index))
            logs = told + np.log(self.masses[tuple(index.T)])
            largest = logs.max()
            posterior = np.zeros_like(self.masses)
            posterior[tuple(index.T)] = np.exp(logs - largest)
            posterior = self._cut(posterior)
            narrow = peak_cells(posterior) < self.resolution
            fits = 2 ** int(narrow.sum()) * posterior.size <= _MOST_POINTS
            if not (narrow.any() and fits and left):
                break
            # The likelihood has to be seen by more points: those of the prediction, halved.
            self._halve(narrow)
        total = posterior.sum()
        self.evidence += float(largest + np.log(total))
        self.masses = posterior / total
        wide = peak_cells(self.masses) > _WIDER * self.resolution
        if wide.any() and self.masses.size > 1:
            self.masses = self.masses[tuple(slice(None, None, 2 if w else 1) for w in wide)]
            self.axes = self.axes * np.where(wide, 2.0, 1.0)
            self.masses = self.masses / self.masses.sum()
        return taken

    def _cut(self, weights: np.ndarray) -> np.ndarray:
        """Crop margins of the grid with negligible weights; return the cropped weights."""
        kept = np.argwhere(weights > _NEGLIGIBLE * weights.max())
        # A cell more on each side, for what lies between two points.
        first = np.maximum(kept.min(axis=0) - 1, 0)
        last = np.minimum(kept.max(axis=0) + 1, np.array(weights.shape) - 1)
        box = tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))
        self.masses, self.base = self.masses[box], self.base + self.axes @ first
        return weights[box]

    def _halve(self, which: np.ndarray) -> None:
        """Halve the cells along the axes in a mask; cubic splines interpolate the masses."""
        sizes = np.array(self.masses.shape)
        factors = np.where(which, (2 * sizes - 1) / sizes, 1.0)
        finer = ndimage.zoom(self.masses, factors, order=3, mode="nearest")
        self.masses = np.maximum(finer, 0.0)
        self.masses /= self.masses.sum()
        self.axes = self.axes * np.where(which, 0.5, 1.0)
        self.halvings += 1

    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (n,) and covariance (n, n) of the masses."""
        index = np.argwhere(self.masses > 0.0)
        share = self.masses[tuple(index.T)]
        places = self.places(index)
        mean = share @ places
        away = places - mean
        return mean, (away.T * share) @ away


def peak_cells(masses: np.ndarray) -> np.ndarray:
    """Return the width (n,) of the highest peak of a density along each axis, in cells.

    ``masses`` contains the probability mass at each of the grid points. The width is the standard
    deviation of a Gaussian that has the curvature of the log density at the largest mass. It is ∞
    if the largest mass is at the margin of the grid.
    """
    peak = np.array(np.unravel_index(masses.argmax(), masses.shape))
    out = np.full(masses.ndim, np.inf)
    for axis, size in enumerate(masses.shape):
        if not 0 < peak[axis] < size - 1:
            continue
        step = np.zeros(masses.ndim, dtype=int)
        step[axis] = 1
        with np.errstate(divide="ignore"):
            before, here, after = np.log([masses[tuple(peak + s * step)] for s in (-1, 0, 1)])
        curvature = 2.0 * here - before - after
        out[axis] = 1.0 / np.sqrt(curvature) if curvature > 0.0 else np.inf
    return out
