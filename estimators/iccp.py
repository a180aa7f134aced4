"""ICCP: rigid displacement of the INS track onto the map contours of the measurements.

ICCP stands for iterated closest contour point (Kamgar-Parsi & Kamgar-Parsi 1999). Every measurement
of a window restricts the vehicle to a contour of the map. For each point of the indicated track the
method finds the nearest point of the contour. Then it translates and rotates the whole track to fit
these contour points. Both steps are repeated until convergence (iterated closest point of Besl &
McKay 1992). With a scale factor the transform is a similarity (Zhang, Yang & Li 2019).

The nearest contour is correct only if the INS error is smaller than the width of the features of
the field. Therefore the method can track a position but cannot search for a position. In test runs,
the position errors at its fixes are several times those of Kalman filters that process the same
single channel. A contour belongs to one channel, so only one channel is used; ``info`` names the
channel.
The literature gives no covariance for the method. The estimate contains the least-squares
covariance at the solution, scaled by the misfit and increased by the errors of height and velocity.
This covariance does not include convergence to a wrong contour. The method is included for
completeness.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ..engines.contours import Contour, contour, feet, fitted_transform, track_metres
from ..engines.fix_fusion import Attempt, PropagatedEstimate, fixes_of
from ..parameters import Positive
from ..problem import Estimate, Estimator, Problem
from ..reduced import horizontal

_REST = 0.05
"""Convergence limit: largest displacement of the track in an iteration [m].

The limit is small because the iteration converges slowly.
"""
_ITERATIONS = 200
_REACH = 3.0
"""Search radius for contours, and limit on rotation and scale [standard deviations]."""
_SIDES = 40
"""Largest number of cells from the centre to the edge of the grid; cells are enlarged if needed."""
_FEWEST = 0.5
"""Smallest share of the measurements in a window that must have a contour within the grid."""


@dataclass(frozen=True)
class Iccp(Estimator):
    """Iterated closest contour point on windows of measurements of one channel.

    Parameters
    ----------
    window : number of measurements along the piece of track that is fitted to the contours.
    transform : ``rigid``: translation and rotation of the track. ``similarity``: also scaling. The
        rotation [rad] and the relative change of scale are at most 0.5, and at most 3 σ / v.
        Here σ is the standard deviation of the velocity error, and v is the speed.
    fusion : ``kalman``: consecutive windows, whose fixes update a Kalman filter. ``none``: a
        sliding window, in which each estimate uses only the last ``window`` measurements.
    channel : name of the channel [default: ``gradient zz``; ``gravity scalar`` if the problem has
        no channel ``gradient zz``].
    cell_m : step of the grid on which contours are computed [m]; increased if the prior is wide.
    misfit : largest χ² of the residuals at convergence, for an accepted fix. The χ² is divided by
        the number of measurements minus two.
    """

    window: Annotated[int, Field(ge=3)] = 20
    transform: Literal["rigid", "similarity"] = "rigid"
    fusion: Literal["none", "kalman"] = "kalman"
    channel: str = ""
    cell_m: Positive = 25.0
    misfit: Annotated[float, Field(gt=0.0)] = 25.0

    name = "iccp"
    family = "matching"
    causality = "filter"
    exact_if_linear_gaussian = False  # of one channel, and of points that are taken as nearest

    def skip(self, problem: Problem) -> str | None:
        """Return a reason to skip the problem, or None if there is none.

        The problem must have an INS track, errors of horizontal position and velocity, and the
        chosen channel.
        """
        if problem.track is None:
            return "the problem has no INS track"
        if len(horizontal(problem, velocity=True)) < 4:
            return "the problem has no errors of position and velocity"
        if _channel(problem, self.channel) is None:
            names = ", ".join(channel.name for channel in problem.channels) or "none with a name"
            wanted = self.channel or "gradient zz or gravity scalar"
            return f"there is no channel {wanted}: the problem has {names}"
        return None

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Match one window after the other, and propagate the estimate between fixes."""
        channel = _channel(problem, self.channel)
        assert channel is not None  # else it would have been skipped
        matcher = _Matcher(self, problem, channel)
        estimate, unaided = PropagatedEstimate(problem), PropagatedEstimate(problem)
        attempts: list[Attempt] = []
        window: list[int] = []
        contours: list[Contour] = []
        iterations = []
        for k in np.flatnonzero(problem.present[:, channel]).tolist():
            mean, cov = estimate.at(k)
            window.append(k)
            contours.append(matcher.contour(k, mean, cov))
            if len(window) < self.window:
                continue
            window, contours = window[-self.window :], contours[-self.window :]
            fix = matcher.match(window, contours, mean, cov)
            iterations.append(fix.iterations)
            attempts.append((k, fix.mean, fix.cov, fix.accepted, -fix.misfit))
            if self.fusion == "none":
                mean, cov = unaided.at(k)
            else:
                window, contours = [], []
            if fix.accepted:
                estimate.put(k, *_updated(mean, cov, matcher.position, fix.mean, fix.cov))
        mean, cov = estimate.whole()
        fixes = fixes_of(attempts)
        info = {
            "channel": problem.channels[channel].name,
            "fixes_tried": len(fixes),
            "fixes_accepted": int(fixes.accepted.sum()),
            "mean_iterations": float(np.mean(iterations or [0])),
        }
        nis = np.full(problem.epochs, np.nan)  # its innovations are those of fixes
        return Estimate(mean, cov, self.causality, info=info, nis=nis, fixes=fixes)


@dataclass(frozen=True)
class _Fix:
    """Result of a window: position error (2,) at its end, and its acceptance."""

    mean: np.ndarray
    cov: np.ndarray
    misfit: float
    accepted: bool
    iterations: int


class _Matcher:
    """Contours of one flight and the track to align with them."""

    def __init__(self, settings: Iccp, problem: Problem, channel: int) -> None:
        self.settings, self.problem, self.channel = settings, problem, channel
        states = horizontal(problem, velocity=True)
        self.position, self.velocity = list(states[:2]), list(states[2:])

    def contour(self, k: int, mean: np.ndarray, cov: np.ndarray) -> Contour:
        """Return the contour of position errors at which h equals measurement k.

        The contour is computed on a grid around ``mean``. The half side of the grid is
        :data:`_REACH` standard deviations of the position, but at least four cells.
        """
        at = self.position
        radius = max(_REACH * float(np.sqrt(np.diag(cov)[at].max())), 4.0 * self.settings.cell_m)
        cell = max(self.settings.cell_m, radius / _SIDES)
        side = np.arange(-np.ceil(radius / cell), np.ceil(radius / cell) + 1.0)
        states = np.broadcast_to(mean, (len(side), len(side), len(mean))).copy()
        states[:, :, at[0]] += cell * side[:, np.newaxis]
        states[:, :, at[1]] += cell * side
        values = self.problem.model.predict(k, states)[..., self.channel]
        reading = float(self.problem.measurements[k, self.channel])
        return contour(values, reading, states[0, 0, at], cell)

    def match(
        self, window: list[int], contours: list[Contour], mean: np.ndarray, cov: np.ndarray
    ) -> _Fix:
        """Align the track of a window with its contours.

        The first displacement comes from ``mean`` (n,), the estimate at the end of the window, with
        the covariance ``cov`` (n, n).
        """
        problem, track = self.problem, self.problem.track
        assert track is not None
        indicated = track_metres(track, window[-1])[window]
        since = problem.times[window] - problem.times[window[-1]]
        errors = mean[self.position] + since[:, np.newaxis] * mean[self.velocity]
        start = indicated - errors
        # Contours of errors are contours of places, seen from where the INS says it is.
        placed = [
            Contour(here - each.points, -each.slopes)
            for here, each in zip(indicated, contours, strict=True)
        ]
        speed = max(float(np.linalg.norm(track.velocities[window[-1], :2])), 1e-9)
        axes = self._along_and_across(window[-1])[self.velocity]
        sigma = np.sqrt(np.diag(axes @ cov @ axes.T))
        stretch, turn = np.minimum(_REACH * sigma / speed, 0.5).tolist()
        similar = self.settings.transform == "similarity"
        moved, rests, iterations = start, False, 0
        while not rests and iterations < _ITERATIONS:
            iterations += 1
            found = feet(placed, moved, self.settings.cell_m)
            if found.found.mean() < _FEWEST:
                break
            x, y = start[found.found], found.points[found.found]
            matrix, shift = fitted_transform(x, y, similar, turn, stretch)
            before, moved = moved, start @ matrix.T + shift
            rests = bool(np.linalg.norm(moved - before, axis=1).max() < _REST)
        return self._judged(window, indicated - moved, mean, cov, rests, iterations)

    def _judged(
        self,
        window: list[int],
        errors: np.ndarray,
        mean: np.ndarray,
        cov: np.ndarray,
        rests: bool,
        iterations: int,
    ) -> _Fix:
        """Return the fix of a window, with the least-squares covariance at convergence.

        A rotation of the track corresponds to a velocity error across the track, and a scale factor
        to a velocity error along the track. Both have the velocity error of the estimate as prior.
        The covariance is scaled by the misfit. Errors of all other states affect the measurements
        of the window and therefore the fit. Their effect on the fix is added to the covariance (a
        consider covariance, Schmidt 1966).
        """
        problem, at, c = self.problem, self.position, self.channel
        along, across = self.velocity
        fitted = [*at, across, along] if self.settings.transform == "similarity" else [*at, across]
        others = [i for i in range(len(mean)) if i not in fitted]
        rows, total = np.empty((len(window), len(mean))), 0.0
        back, last = np.eye(len(mean)), window[-1]
        for i in reversed(range(len(window))):
            for k in range(window[i] + 1, last + 1):
                back = np.linalg.solve(problem.transition[k], back)
            k = last = window[i]
            state = mean.copy()
            state[at] = errors[i]
            root = np.sqrt(problem.noise_of(k)[c, c])
            residual = problem.measurements[k, c] - problem.model.predict(k, state)[c]
            rows[i] = problem.model.jacobian(k, state)[c] @ back / root
            total += float(residual / root) ** 2
        misfit = total / (len(window) - 2)
        axes = self._along_and_across(window[-1])
        rows, known = rows @ axes.T, axes @ cov @ axes.T
        # A direction in which the readings say nothing is known no better than before.
        prior = np.linalg.inv(known[np.ix_(fitted, fitted)])
        prior[:2] *= 1e-6
        prior[:, :2] *= 1e-6
        inverse = np.linalg.inv(rows[:, fitted].T @ rows[:, fitted] / max(1.0, misfit) + prior)
        seen = inverse @ rows[:, fitted].T @ rows[:, others] / max(1.0, misfit)
        after = (inverse + seen @ known[np.ix_(others, others)] @ seen.T)[:2, :2]
        rests = rests and bool(np.isfinite(misfit))
        return _Fix(
            errors[-1], 0.5 * (after + after.T), misfit if rests else np.inf,
            rests and misfit < self.settings.misfit, iterations,
        )  # fmt: skip

    def _along_and_across(self, k: int) -> np.ndarray:
        """Return the rotation (n, n) that maps east and north velocity errors to along and across.

        Along and across refer to the direction of the INS velocity at epoch ``k``.
        """
        assert self.problem.track is not None
        east, north = self.problem.track.velocities[k, :2]
        heading = np.arctan2(north, east)
        axes = np.eye(self.problem.dimension)
        axes[np.ix_(self.velocity, self.velocity)] = [
            [np.cos(heading), np.sin(heading)],
            [-np.sin(heading), np.cos(heading)],
        ]
        return axes


def _channel(problem: Problem, name: str) -> int | None:
    """Return the index of the channel ``name``, or of the default channel if the name is empty.

    The result is None if the problem has no such channel.
    """
    names = [channel.name for channel in problem.channels]
    for wanted in (name,) if name else ("gradient zz", "gravity scalar"):
        if wanted in names:
            return names.index(wanted)
    return None


def _updated(
    mean: np.ndarray, cov: np.ndarray, at: list[int], fix: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and covariance after a Kalman update with a fix, in Joseph form.

    ``at`` are the indices of the states that the fix determines, with the covariance ``noise``.
    """
    rows = np.eye(len(mean))[at]
    gain = np.linalg.solve(cov[np.ix_(at, at)] + noise, cov[at]).T
    keep = np.eye(len(mean)) - gain @ rows
    after = keep @ cov @ keep.T + gain @ noise @ gain.T
    return mean + gain @ (fix - mean[at]), 0.5 * (after + after.T)
