"""Map search for the position at the start of a window, and refinement of the best positions.

A window is a problem made of some consecutive epochs of a flight; its prior is the estimate before
these epochs (:meth:`.ProblemBlock.part`). A matcher compares the measurements with the map at many
displacements of the window's start (:class:`Search`). The other states follow from the displacement
by the correlations of the prior and by the dynamics. Gauss–Newton searches then start at the best
positions and find the most probable states of the whole window (:func:`refined`); no state is
fixed. The covariance at the window's end therefore includes the uncertainty of velocity, height,
attitude and biases.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..block import without_kernels
from ..problem import Problem
from ..reduced import horizontal
from ..sensors.aiding import corrected_positions
from . import position_grid
from .trajectory_search import TrajectorySearch

Criterion = Literal["cor", "mad", "msd", "ncc", "nccdm", "ml"]
_CHUNK = 8192
"""Number of states at which h is evaluated at once: the results stay in the cache."""
_BOX = 4e6
"""Largest number of grid points before points outside the map are dropped."""
_APART = 3.0
"""Least distance of two minima on the grid, in steps: nearer ones are the same minimum."""
_FINER = 5
_AROUND = 2
_DEEPEST = 2
"""Refinement of a minimum: steps of 1/5, up to two steps to all sides, two lowest points as starts.

The valleys of a criterion are curved and long. Gauss–Newton from a point at the edge of a valley
ends near the lowest point."""
ITERATIONS = 30
"""Largest number of Gauss–Newton steps to a position."""
MOST = 1_000_000
"""Points of a grid that fit in memory."""


def unmatchable(problem: Problem) -> str | None:
    """Return the reason why windows of a problem cannot be searched; None if they can."""
    if not horizontal(problem, velocity=False):
        return "the problem has no horizontal position: two states in metres are needed"
    return without_kernels(problem)


class Search:
    """Comparison of a window's measurements with the map, for displacements of its start on a grid.

    The grid lies along the principal axes of the position prior and reaches to 4.5 standard
    deviations. An axis whose standard deviation is smaller than a step has one point. A
    displacement is dropped when its track leaves the map by more than a step.

    Measurements are processed epoch by epoch and divided by the standard deviations of their noise,
    so channels of different units are comparable. Missing measurements are ignored. Let r = z −
    h(d) be the residuals of N measurements at the displacement d. P is the diagonal prior
    covariance of d. Let z' and h' be z and h minus
    the mean of h over the grid at the same epoch; this mean is the part common to all positions,
    for example the normal field. The criteria are:

    - ``msd``: Σ r² / N.
    - ``mad``: Σ |r| / N.
    - ``ml``: ½ Σ r² + ½ dᵀ P⁻¹ d.
    - ``cor``: − Σ z' h' / N.
    - ``ncc``: − Σ z' h' / √(Σ z'² Σ h'²).
    - ``nccdm``: ``ncc`` after the means of z' and h' over the window are subtracted from each
      channel, so a constant bias has no influence. The literature does not define ``nccdm``.

    The smallest value is the best.

    Parameters
    ----------
    problem : the window, or a problem that begins with the window.
    spacing_m : step of the grid [m].
    most : largest number of grid points; the step is increased if necessary.
    criterion : name of the criterion.
    points : (J, d) displacements along the axes [m] instead of a grid.

    Attributes
    ----------
    points : (J, d) displacements along the axes [m] within the map.
    spacing : step of the grid [m], at least ``spacing_m``.
    evaluations : number of evaluations of h so far.
    """

    _kept: tuple[str, ...] = ("points", "_sums", "_crossed", "_squares", "_totals")
    """What has a row for each point, and loses those of points that leave the map."""

    def __init__(
        self,
        problem: Problem,
        spacing_m: float,
        most: int,
        criterion: Criterion = "msd",
        points: np.ndarray | None = None,
    ) -> None:
        self.problem, self.criterion = problem, criterion
        self.scale = np.sqrt(np.diag(problem.prior_cov))
        self._axes = axes = position_grid.position_axes(problem)
        # By transposes, so that a displacement of the start stays one product however long it goes.
        self._moved, self._gain = problem.prior_mean, axes.gain * self.scale[:, np.newaxis]
        self._epoch = self.evaluations = 0
        self.spacing, self._most = spacing_m, most
        if points is None:
            self._lay()
        else:
            self.points = points
        self._count = 0.0
        self._sums = np.zeros(len(self.points))
        channels = problem.measurements.shape[1]
        self._crossed, self._squares, self._totals = np.zeros((3, len(self.points), channels))
        self._own_squares, self._own_totals, self._counts = np.zeros((3, channels))

    def _lay(self) -> None:
        """Create the grid, without points that are outside the map at the first epoch."""
        sigma, phi = np.sqrt(self._axes.variances), self.problem.transition[0]
        while not position_grid.fits(sigma, self.spacing, _BOX):
            self.spacing *= 1.1
        while True:
            self.points = position_grid.grid(sigma, self.spacing)
            self.points = self.points[self._inside(0, phi @ self._moved, phi @ self._gain)]
            if len(self.points) <= self._most:
                return
            self.spacing *= 1.1

    def _inside(self, k: int, moved: np.ndarray, gain: np.ndarray) -> np.ndarray:
        """Return a mask (J,) of the points whose track is on the map at epoch ``k``.

        A margin of one step is allowed. ``moved`` (n,) is the state of the displacement zero, and
        ``gain`` (n, d) the derivative of the state with respect to the displacement.
        """
        track, field = self.problem.track, self.problem.map
        if track is None or field is None:
            return np.ones(len(self.points), dtype=bool)
        errors = np.zeros((len(self.points), 3))
        errors[:, :2] = moved[:2] + self.points @ gain[:2].T
        there = corrected_positions(track.positions[k], errors)
        # A step's slack, from the metres of the track's own latitude: the best point of the grid
        # for a place at the border may lie beyond it.
        slack = np.abs(
            corrected_positions(track.positions[k], np.array([self.spacing, self.spacing, 0.0]))
            - track.positions[k]
        )
        inside = (field.lower - slack <= there) & (there <= field.upper + slack)
        return np.asarray(inside[:, :2].all(axis=1))

    def take(self, stop: int) -> None:
        """Process the measurements of the epochs before ``stop`` that are not processed yet."""
        for k in range(self._epoch, stop):
            phi = self.problem.transition[k]
            self._moved, self._gain = phi @ self._moved, phi @ self._gain
            if self.problem.present[k].any():
                self._take(k)
        self._epoch = stop

    def _take(self, k: int) -> None:
        problem = self.problem
        inside = self._inside(k, self._moved, self._gain)
        if not inside.all():
            for name in self._kept:
                setattr(self, name, getattr(self, name)[inside])
        if not len(self.points):
            return
        self.evaluations += len(self.points)
        root = np.linalg.inv(np.linalg.cholesky(problem.noise_of(k)))
        h = np.concatenate(
            [
                problem.model.predict(k, self._moved + part @ self._gain.T) @ root.T
                for part in np.array_split(self.points, -(-len(self.points) // _CHUNK))
            ]
        )
        self._compare(k, root @ problem.measurements[k], h)

    def _compare(self, k: int, z: np.ndarray, h: np.ndarray) -> None:
        """Add whitened measurements z (m,) and predictions h (J, m) of epoch ``k`` to the sums."""
        problem = self.problem
        self._count += float(problem.present[k].sum())
        if self.criterion in ("msd", "ml"):
            self._sums += ((z - h) ** 2).sum(axis=1)
        elif self.criterion == "mad":
            self._sums += np.abs(z - h).sum(axis=1)
        else:
            common = h.mean(axis=0)
            z, h = z - common, h - common
            self._crossed += z * h
            self._squares += h**2
            self._totals += h
            self._own_squares += z**2
            self._own_totals += z
            self._counts += problem.present[k]

    def values(self) -> np.ndarray:
        """Return the criterion (J,) of each point; the smallest value is the best."""
        if self.criterion == "ml":
            return 0.5 * self._sums + 0.5 * (self.points**2 / self._axes.variances).sum(axis=1)
        if self.criterion in ("msd", "mad"):
            return self._sums / max(self._count, 1.0)
        crossed, squares, own = self._crossed, self._squares, self._own_squares
        if self.criterion == "nccdm":
            counts = np.maximum(self._counts, 1.0)
            crossed = crossed - self._own_totals * self._totals / counts
            squares = squares - self._totals**2 / counts
            own = own - self._own_totals**2 / counts
        total = crossed.sum(axis=1)
        if self.criterion == "cor":
            return np.asarray(-total / max(self._count, 1.0))
        size = np.sqrt(np.maximum(squares.sum(axis=1) * own.sum(), 0.0))
        return np.asarray(-np.divide(total, size, out=np.zeros_like(total), where=size > 0.0))

    def best(self, count: int) -> list[int]:
        """Return the indices of up to ``count`` minima of the criterion, best first.

        The minima are at least three steps apart.
        """
        values = self.values()
        if not np.isfinite(values).any():
            return []
        steps = np.round(self.points / self.spacing).astype(int)
        minima = np.flatnonzero(_lowest(steps, values))
        found: list[int] = []
        for index in minima[np.argsort(values[minima], kind="stable")]:
            away = self.points[found] - self.points[index]
            if (np.sum(away**2, axis=1) >= (_APART * self.spacing) ** 2).all():
                found.append(int(index))
            if len(found) == count:
                break
        return found

    def starts(self, count: int) -> list[np.ndarray]:
        """Return the multipliers λ (n,) of the best positions, see :meth:`multipliers`.

        The neighbourhoods of up to ``count`` minima are searched again in finer steps. The
        positions are the points with the smallest criterion in each neighbourhood.
        """
        hollows = self.points[self.best(count)]
        if not len(hollows):
            return []
        split = np.ptp(self.points, axis=0) > 0.0
        if not split.any():
            return [self.multipliers(point) for point in hollows]
        fine = self.spacing / _FINER
        side = fine * np.arange(-_AROUND * _FINER, _AROUND * _FINER + 1)
        sides = [side if axis else np.zeros(1) for axis in split]
        patch = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, len(split))
        points = (hollows[:, np.newaxis] + patch).reshape(-1, len(split))
        within = Search(self.problem, self.spacing, self._most, self.criterion, points)
        within.take(self._epoch)
        self.evaluations += within.evaluations
        # Points beyond the map are gone: whose hollow a point is of is found again.
        away = within.points[:, np.newaxis] - hollows
        own = np.argmin(np.sum(away**2, axis=-1), axis=1)
        steps = np.round((within.points - hollows[own]) / fine).astype(int)
        apart = 2 * own[:, np.newaxis]  # so that the neighbour of a point is of its own hollow
        values = within.values()
        minima = np.flatnonzero(_lowest(np.hstack([apart, steps]), values))
        minima = minima[np.lexsort((values[minima], own[minima]))]
        rank = np.arange(len(minima)) - np.searchsorted(own[minima], own[minima])
        return [self.multipliers(point) for point in within.points[minima[rank < _DEEPEST]]]

    def multipliers(self, point: np.ndarray) -> np.ndarray:
        """Return the multipliers λ (n,) of a displacement (d,) along the axes [m].

        The state with this displacement is prior_mean + P_0 λ. The state, prior_mean and P_0 are in
        units of the prior's standard deviations.
        """
        start = np.zeros(self.problem.dimension)
        axes = self._axes
        start[axes.states] = axes.vectors @ (point / axes.variances)
        return start * self.scale


def _lowest(steps: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return a mask (J,) of the points of a grid without a lower neighbour.

    Parameters
    ----------
    steps : (J, d) grid indices of the points.
    values : (J,) criterion at the points.
    """
    steps = steps - steps.min(axis=0)
    box = np.full(steps.max(axis=0) + 3, np.inf)  # a border, so that all have neighbours
    box[tuple(steps.T + 1)] = values
    lowest = np.ones(len(values), dtype=bool)
    for shift in np.ndindex(*(3,) * steps.shape[1]):
        lowest &= values <= box[tuple((steps + shift).T)]
    return lowest


@dataclass(frozen=True)
class Place:
    """A refined position of a window: the state at the last epoch of the window.

    Attributes
    ----------
    mean, cov : (n,), (n, n) mean and covariance of the state.
    cost : negative logarithm of the posterior density of the trajectory, without the constant.
        Without a loss it is ½ χ² of prior, process noise and measurements.
    log_share : logarithm of the posterior probability of all trajectories near this trajectory,
        without the constant (Laplace's approximation): −cost + ½ ln (det of the posterior
        covariance / det of the prior covariance).
    """

    mean: np.ndarray
    cov: np.ndarray
    cost: float
    log_share: float


class WindowSearch(TrajectorySearch):
    """Gauss–Newton searches within a window of one run."""

    def places(self, starts: Sequence[np.ndarray]) -> list[Place | None]:
        """Return one position for each start; None for a start without a finite cost.

        Parameters
        ----------
        starts : start points, each as multipliers λ (n,) of :meth:`Search.multipliers`.
        """
        if not len(starts):
            return []
        runs = np.zeros(len(starts), dtype=int)
        searches = self.from_prior(runs, np.array(starts) / self.scale)
        self.search(searches, ITERATIONS)
        means, covs, log_widths = self.ends(searches)
        return [
            Place(mean, cov, float(cost), float(log_width - cost)) if np.isfinite(cost) else None
            for mean, cov, cost, log_width in zip(
                means, covs, searches.cost, log_widths, strict=True
            )
        ]


def refined(window: WindowSearch, starts: Sequence[np.ndarray], apart: float) -> list[Place]:
    """Return the positions found by Gauss–Newton from several starts, the most probable first.

    Parameters
    ----------
    window : searches within the window of one run.
    starts : start points, each as multipliers λ (n,) of :meth:`Search.multipliers`.
    apart : smallest distance between returned positions at the window's end [m]. A position within
        this distance of a more probable one is dropped.
    """
    places = [place for place in window.places(starts) if place is not None]
    return distinct(window.block.problem(0), places, apart)


def distinct(problem: Problem, places: Sequence[Place], apart: float) -> list[Place]:
    """Return the positions that have no more probable position within ``apart`` [m], best first."""
    means = np.array([place.mean for place in places]).reshape(len(places), problem.dimension)
    costs = np.array([place.cost for place in places])
    return [places[i] for i in best_apart(problem, means, costs, apart)]


def best_apart(problem: Problem, means: np.ndarray, costs: np.ndarray, apart: float) -> list[int]:
    """Return the indices of states without a better state within ``apart`` [m], best first.

    ``means`` (J, n) are the states and ``costs`` (J,) their costs; a smaller cost is better.
    """
    positions = means[:, position_grid.states_in_metres(problem)]
    found: list[int] = []
    for index in np.argsort(costs, kind="stable"):
        away = np.linalg.norm(positions[found] - positions[index], axis=1)
        if (away > apart).all():
            found.append(int(index))
    return found
