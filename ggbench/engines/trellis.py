"""Hidden Markov model of position cells: forward sums, best paths and backward sums.

The cells belong to a lattice that is propagated like the INS error. The probability of a step by j
cells along an axis is Lindeberg's discrete Gaussian (1990), e^−t I_j(t), where t is the variance of
the process noise in cells². The variance of the steps is t, and two steps of variances t and u make
a step of variance t + u, even if t is small. Noise correlations between axes are neglected.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ive

from ..numerics.kernels import compiled
from ..problem import Problem
from .lattices import Lattice
from .position_grid import REACH

_NEGLIGIBLE = 1e-10
"""Probability, relative to the largest one, below which a cell is dropped."""
_DRAWN = 64
"""Number of cells at which the Jacobian is evaluated."""


class Layer(NamedTuple):
    """The cells of an epoch, in a box of a lattice.

    Attributes
    ----------
    low : (d,) lattice index of the first cell of the box.
    shape : (d,) number of cells of the box along each axis.
    cells : (A,) flat indices of the stored cells within the box, increasing.
    forward : (A,) probability of each cell, given the measurements up to the epoch.
    likelihood : (A,) likelihood of the measurement of the epoch at each cell, up to a common
        factor.
    kernels : probabilities of the steps from the previous epoch, one array for each axis.
    base, axes : corner and axes of the lattice, see :class:`.Lattice`.
    """

    low: np.ndarray
    shape: tuple[int, ...]
    cells: np.ndarray
    forward: np.ndarray
    likelihood: np.ndarray
    kernels: list[np.ndarray]
    base: np.ndarray
    axes: np.ndarray

    def indices(self, which: np.ndarray) -> np.ndarray:
        """Return the lattice indices (N, d) of N cells.

        ``which`` (N,) contains the positions of these cells in the array ``cells``.
        """
        return np.stack(np.unravel_index(self.cells[which], self.shape), axis=-1) + self.low

    def places(self, which: np.ndarray) -> np.ndarray:
        """Return the states (N, d) at the centres of N cells.

        ``which`` (N,) contains the positions of these cells in the array ``cells``.
        """
        return np.asarray(self.base + self.indices(which) @ self.axes.T)

    def boxed(self, values: np.ndarray, empty: float) -> np.ndarray:
        """Return an array of the whole box, with the values (A,) of the stored cells.

        All other cells of the box have the value ``empty``.
        """
        box = np.full(self.shape, empty)
        box.reshape(-1)[self.cells] = values
        return box

    def moments(self, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (d,) and covariance (d, d) of the state, for probabilities (A,) of the cells.

        The covariance includes the uniform distribution within a cell.
        """
        places = self.places(np.arange(len(self.cells)))
        mean = shares @ places
        away = places - mean
        return mean, (away.T * shares) @ away + self.axes @ self.axes.T / 12.0


class Trellis:
    """Layers of position cells: one for the prior and one for each epoch.

    Raises FloatingPointError if no cell has a finite likelihood at an epoch.

    Parameters
    ----------
    problem : problem with d states; d must be small.
    steps : (d,) sides of a cell.
    most : largest number of cells at an epoch; cells with small probability are dropped.
    extra_noise : (K, m, m) covariance added to R for measurement errors from states that are not in
        the problem.
    """

    def __init__(
        self, problem: Problem, steps: np.ndarray, most: int, extra_noise: np.ndarray
    ) -> None:
        self.problem, self.most, self.extra_noise = problem, most, extra_noise
        lattice = Lattice(problem.prior_mean, problem.prior_cov, steps, REACH)
        masses, low = lattice.masses, np.zeros(len(steps), dtype=int)
        ones = [np.ones(1)] * len(steps)
        self.layers = [self._layer(masses, low, np.ones(masses.size), ones, lattice)]
        for k in range(problem.epochs):
            lattice.move(problem.transition[k])
            variances = np.diag(lattice.in_cells(problem.process_cov[k]))
            kernels = [step_probabilities(float(t)) for t in variances]
            last = self.layers[-1]
            masses = last.boxed(last.forward, 0.0)
            for axis, kernel in enumerate(kernels):
                masses = _sums_along(masses, kernel, axis)
            low = last.low - [len(kernel) // 2 for kernel in kernels]
            self.layers.append(self._updated(k, masses, low, kernels, lattice))

    def _updated(
        self,
        k: int,
        masses: np.ndarray,
        low: np.ndarray,
        kernels: list[np.ndarray],
        lattice: Lattice,
    ) -> Layer:
        """Return the layer of epoch k, updated with its measurement.

        ``masses`` are the predicted probabilities in a box, and ``low`` is its first lattice index.
        """
        flat = masses.reshape(-1)
        cells = np.flatnonzero(flat > _NEGLIGIBLE * flat.max())
        index = np.stack(np.unravel_index(cells, masses.shape), axis=-1) + low
        logs = self._log_likelihoods(k, lattice, lattice.places(index), flat[cells])
        if not np.isfinite(logs).any():
            raise FloatingPointError(f"no cell has a finite likelihood at epoch {k}")
        logs = np.where(np.isfinite(logs), logs, -np.inf)
        likelihood = np.zeros_like(flat)
        likelihood[cells] = np.exp(logs - (logs + np.log(flat[cells])).max())
        masses = masses * likelihood.reshape(masses.shape)
        return self._layer(masses, low, likelihood, kernels, lattice)

    def _layer(
        self,
        masses: np.ndarray,
        low: np.ndarray,
        likelihood: np.ndarray,
        kernels: list[np.ndarray],
        lattice: Lattice,
    ) -> Layer:
        """Return a layer with the cells of significant probability, in the smallest box."""
        flat = masses.reshape(-1)
        limit = _NEGLIGIBLE * flat.max()
        if np.count_nonzero(flat > limit) > self.most:
            limit = np.partition(flat, -self.most - 1)[-self.most - 1]
        cells = np.flatnonzero(flat > limit)
        index = np.stack(np.unravel_index(cells, masses.shape), axis=-1)
        first, last = index.min(axis=0), index.max(axis=0)
        shape = tuple(int(size) for size in last - first + 1)
        forward = flat[cells] / flat[cells].sum()
        return Layer(
            low=low + first,
            shape=shape,
            cells=np.ravel_multi_index(tuple((index - first).T), shape),
            forward=forward,
            likelihood=likelihood[cells],
            kernels=kernels,
            base=lattice.base,
            axes=lattice.axes,
        )

    def _log_likelihoods(
        self, k: int, lattice: Lattice, places: np.ndarray, masses: np.ndarray
    ) -> np.ndarray:
        """Return the log likelihoods (N,) of measurement k, averaged over each cell.

        The average assumes that h is linear within a cell: the covariance of h for a uniform
        position is added to R. This covariance is the mean over up to 64 cells, which are drawn
        systematically from the prediction.
        """
        problem = self.problem
        there = problem.present[k]
        if not there.any():
            return np.zeros(len(places))
        shares = np.cumsum(masses)
        drawn = np.searchsorted(shares, shares[-1] * (np.arange(_DRAWN) + 0.5) / _DRAWN)
        drawn = np.unique(np.minimum(drawn, len(places) - 1))
        rows = problem.model.jacobian(k, places[drawn])[:, there] @ lattice.axes
        within = np.einsum("jma,jna->mn", rows, rows) / (12.0 * len(drawn))
        noise = (problem.noise_of(k) + self.extra_noise[k])[np.ix_(there, there)] + within
        residual = (problem.measurements[k] - problem.model.predict(k, places))[:, there]
        white = np.linalg.solve(np.linalg.cholesky(noise), residual.T)
        return np.asarray(-0.5 * (white**2).sum(axis=0))

    def best_path(self) -> list[int]:
        """Return the most probable path (Viterbi 1967) as one cell of each layer.

        A cell is given by its position in the array ``cells`` of the layer.
        """
        with np.errstate(divide="ignore"):
            scores = np.log(self.layers[0].forward)
            before: list[np.ndarray] = []
            for last, layer in zip(self.layers[:-1], self.layers[1:], strict=True):
                box, chosen = last.boxed(scores, -np.inf), []
                for axis, kernel in enumerate(layer.kernels):
                    box, steps = _best_along(box, np.log(kernel), axis)
                    chosen.append(steps)
                halves = np.array([len(kernel) // 2 for kernel in layer.kernels])
                index = layer.indices(np.arange(len(layer.cells))) - (last.low - halves)
                scores = box[tuple(index.T)] + np.log(layer.likelihood)
                # Where each cell was come to from: back along the axes, the last one first.
                for axis in reversed(range(len(halves))):
                    index[:, axis] -= chosen[axis][tuple(index.T)]
                came = np.ravel_multi_index(tuple(index.T), last.shape)
                before.append(np.searchsorted(last.cells, came))
        path = [int(np.argmax(scores))]
        for came in reversed(before):
            path.append(int(came[path[-1]]))
        return path[::-1]

    def smoothed(self) -> list[np.ndarray]:
        """Return for each layer the probabilities (A,) of its cells, given all measurements.

        The method is the forward-backward algorithm (Baum et al. 1970).
        """
        backward = np.ones(len(self.layers[-1].cells))
        out = [self.layers[-1].forward]
        for layer, later in zip(self.layers[-2::-1], self.layers[:0:-1], strict=True):
            box = later.boxed(later.likelihood * backward, 0.0)
            for axis, kernel in enumerate(later.kernels):
                box = _sums_along(box, kernel, axis)
            halves = np.array([len(kernel) // 2 for kernel in later.kernels])
            index = layer.indices(np.arange(len(layer.cells))) - (later.low - halves)
            inside = ((index >= 0) & (index < box.shape)).all(axis=1)
            backward = np.zeros(len(layer.cells))
            backward[inside] = box[tuple(index[inside].T)]
            backward /= backward.max()
            shares = layer.forward * backward
            out.append(shares / shares.sum())
        return out[::-1]


def step_probabilities(variance: float) -> np.ndarray:
    """Return the probabilities (2r + 1,) of steps of −r to r cells.

    ``variance`` is the variance t of the discrete Gaussian [cells²]; r covers all steps of
    significant probability.
    """
    reach = int(8.0 * np.sqrt(variance)) + 4
    steps = ive(np.arange(reach + 1), variance)
    steps = steps[steps > _NEGLIGIBLE * steps[0]]
    both = np.concatenate([steps[:0:-1], steps])
    return np.asarray(both / both.sum())


def cell_sides(cov: np.ndarray, side: float, most: int) -> np.ndarray:
    """Return the sides (d,) of cells such that at most ``most`` cells cover a prior.

    ``side`` is the requested side; it is increased if more than ``most`` cells are needed. If the
    prior's standard deviation along an axis is smaller than ``side``, the side along this axis is
    the standard deviation. Such an axis has eleven cells. With eleven cells along every axis,
    ``most`` may be exceeded. ``cov`` (d, d) is the covariance of the prior.
    """
    sigma = np.sqrt(np.diag(cov))
    sides = np.minimum(side, sigma)
    while np.prod(2.0 * np.ceil(REACH * sigma / sides) + 1.0) > most and side < sigma.max():
        side *= 1.1
        sides = np.minimum(side, sigma)
    return np.asarray(sides)


def _sums_along(box: np.ndarray, kernel: np.ndarray, axis: int) -> np.ndarray:
    """Return a box convolved with a kernel (2r + 1,) along an axis, which grows by 2r cells."""
    shape = (*box.shape[:axis], box.shape[axis] + len(kernel) - 1, *box.shape[axis + 1 :])
    return np.asarray(_sums(_parts(box, axis), kernel).reshape(shape))


def _parts(box: np.ndarray, axis: int) -> np.ndarray:
    """Reshape a box to three axes: all axes before ``axis``, ``axis`` itself, and all after."""
    before = int(np.prod(box.shape[:axis]))
    return np.ascontiguousarray(box).reshape(before, box.shape[axis], -1)


def _best_along(box: np.ndarray, logs: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Return :func:`_maxima` along an axis of a box of scores."""
    shape = (*box.shape[:axis], box.shape[axis] + len(logs) - 1, *box.shape[axis + 1 :])
    best, steps = _maxima(_parts(box, axis), logs)
    return best.reshape(shape), steps.reshape(shape)


@compiled
def _sums(masses: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """Convolve masses (a, n, b) with a kernel (2r + 1,) along the middle axis: (a, n + 2r, b)."""
    outer, size, inner = masses.shape
    out = np.zeros((outer, size + len(kernel) - 1, inner))
    for a in range(outer):
        for s in range(size):
            for j in range(len(kernel)):
                for b in range(inner):
                    out[a, s + j, b] += masses[a, s, b] * kernel[j]
    return out


@compiled
def _maxima(scores: np.ndarray, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return for each cell the largest sum of a previous score and the log step probability.

    The scores are (a, n, b), and ``logs`` (2r + 1,) are the log probabilities of the steps. The
    second result is the index in ``logs`` of the best step. Both results are (a, n + 2r, b).
    """
    outer, size, inner = scores.shape
    shape = (outer, size + len(logs) - 1, inner)
    best, steps = np.full(shape, -np.inf), np.zeros(shape, dtype=np.int16)
    for a in range(outer):
        for s in range(size):
            for j in range(len(logs)):
                for b in range(inner):
                    value = scores[a, s, b] + logs[j]
                    if value > best[a, s + j, b]:
                        best[a, s + j, b] = value
                        steps[a, s + j, b] = j
    return best, steps
