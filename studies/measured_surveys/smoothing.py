"""Batch smoother for the INS error of a flight along a survey line.

The error is a polynomial in time: errors of position, velocity and acceleration, each to the east
and to the north. Levenberg–Marquardt iterations from several starts find the most probable error.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import NdBSpline, make_interp_spline
from scipy.optimize import least_squares

from ggbench.gravity.coloured_noise import VectorAutoregression, Whitening
from ggbench.gravity.point_masses import fields
from ggbench.maps.equivalent_sources import EquivalentSources, weights_of
from ggbench.maps.survey_lines import SurveyLines

Array = NDArray[np.float64]

UNCERTAINTY = np.array([[300.0, 300.0], [0.5, 0.5], [2e-3, 2e-3]])
"""Standard deviations (3, 2) of the INS error, each to the east and to the north.

The rows are position [m], velocity [m/s] and acceleration [m/s²]."""
_STEP_M, _MARGIN_M = 100.0, 1800.0  # spacing and margin of a gridded map
_LAYERS_M = np.array([65.0, 110.0])  # layers; exact values between them reduce the NEES by 2 %
_POSITIONS_M, _VELOCITIES = np.arange(-750.0, 751.0, 125.0), np.array([-0.5, 0.0, 0.5])
_STARTS = 6  # most probable points of the grid above
_APART_M, _APART_M_S = 130.0, 0.6  # closer starts are neighbours (sums over both axes)


class GriddedMap:
    """Components of a map as splines: cubic to the east and north, linear in height."""

    def __init__(self, sources: EquivalentSources, lines: SurveyLines) -> None:
        points = sources.plane.metres(lines)
        east, north = (
            np.arange(axis.min() - _MARGIN_M, axis.max() + _MARGIN_M + _STEP_M, _STEP_M)
            for axis in points[:2]
        )
        axes = (east, north, _LAYERS_M)
        nodes = np.array([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")])
        nine = np.empty((nodes.shape[1], 9))
        fields(nodes, sources.places, sources.masses, nine)
        values = (nine @ weights_of(lines).T).reshape(*map(len, axes), -1)
        degrees, knots = (3, 3, 1), []
        for number, (axis, degree) in enumerate(zip(axes, degrees, strict=True)):
            spline = make_interp_spline(axis, values, degree, axis=number)
            knots.append(spline.t)
            values = np.moveaxis(spline.c, 0, number)
        self._spline = NdBSpline(tuple(knots), np.ascontiguousarray(values), degrees)
        self._lower, self._upper = np.array([[axis[0], axis[-1]] for axis in axes[:2]]).T

    def at(self, places: Array, up: Array, derivative: tuple[int, int] = (0, 0)) -> Array:
        """Return the components (..., n, m) [E], or a derivative [E/m].

        Parameters
        ----------
        places : (..., n, 2) east and north [m]; places outside the grid are moved to its border.
        up : (n,) heights [m].
        derivative : order of the derivative to the east and to the north.
        """
        inside = np.clip(places, self._lower, self._upper)
        heights = np.broadcast_to(up, inside.shape[:-1])[..., np.newaxis]
        found: Array = self._spline(np.concatenate([inside, heights], axis=-1), nu=(*derivative, 0))
        return found


def drift(errors: Array, seconds: Array) -> Array:
    """Return the position errors (..., n, 2) [m] to the east and north at times (n,) [s].

    ``errors`` (..., 6) are INS errors in units of their standard deviations.
    """
    polynomial = np.stack([np.ones_like(seconds), seconds, 0.5 * seconds**2], axis=1)
    scaled = errors.reshape(*errors.shape[:-1], 3, 2) * UNCERTAINTY
    return np.asarray(polynomial @ scaled)


@dataclass(frozen=True)
class Smoother:
    """Batch smoother of one flight. INS errors (..., 6) are in units of their standard deviations.

    Attributes
    ----------
    field : map.
    noise : noise model of the measurements.
    readings : (n, m) measurements [E].
    ins : (n, 3) east, north and up, as indicated by the INS [m]; the height is exact.
    """

    field: GriddedMap
    noise: VectorAutoregression
    readings: Array
    ins: Array

    @cached_property
    def _seconds(self) -> Array:
        return self.noise.interval * np.arange(len(self.readings))

    @cached_property
    def _whitening(self) -> Whitening:
        return self.noise.whitening(self._seconds, np.zeros(len(self.readings), dtype=bool))

    def _white(self, values: Array) -> Array:
        """Return measurements (..., n m), whitened to unit variance, from (..., n, m)."""
        white = self._whitening.apply(values) / self.noise.deviations
        return white.reshape(*values.shape[:-2], -1)

    def _corrected(self, errors: Array) -> Array:
        """Return east and north (..., n, 2) [m], corrected for INS errors (..., 6)."""
        return self.ins[:, :2] - drift(errors, self._seconds)

    def residuals(self, errors: Array) -> Array:
        """Return residuals (..., n m + 6): whitened measurement minus map, and the INS errors."""
        expected = self.field.at(self._corrected(errors), self.ins[:, 2])
        return np.concatenate([self._white(self.readings - expected), errors], axis=-1)

    def jacobian(self, errors: Array) -> Array:
        """Return the Jacobian (n m + 6, 6) of the residuals with respect to INS errors (6,)."""
        places, up = self._corrected(errors), self.ins[:, 2]
        slopes = np.array([self.field.at(places, up, axis) for axis in ((1, 0), (0, 1))])
        shifts = drift(np.eye(6), self._seconds)  # (6, n, 2)
        rows = self._white(np.einsum("qna,anm->qnm", shifts, slopes))
        return np.concatenate([rows, np.eye(6)], axis=1).T

    def solved(self) -> tuple[Array, Array]:
        """Return the most probable INS errors (6,) and their information matrix (6, 6)."""
        descents = [
            least_squares(self.residuals, start, self.jacobian, method="lm")
            for start in self._likeliest_starts()
        ]
        best = min(descents, key=lambda descent: float(descent.cost))
        return best.x, best.jac.T @ best.jac

    def _likeliest_starts(self) -> Iterator[Array]:
        """Yield the most probable INS errors (6,) of a grid, without neighbours of earlier ones."""
        axes = (_POSITIONS_M, _POSITIONS_M, _VELOCITIES, _VELOCITIES, [0.0], [0.0])
        grid = np.array([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")]).T
        errors = grid / UNCERTAINTY.ravel()
        cost = np.concatenate(
            [np.sum(self.residuals(some) ** 2, axis=-1) for some in np.array_split(errors, 20)]
        )
        for _ in range(_STARTS):
            best = np.argmin(cost)
            yield errors[best]
            away = np.abs(grid - grid[best])
            near = (away[:, :2].sum(axis=1) < _APART_M) & (away[:, 2:4].sum(axis=1) < _APART_M_S)
            cost[near] = np.inf


def fly(
    field: GriddedMap, noise: VectorAutoregression, places: Array, readings: Array, drawn: Array
) -> tuple[float, float]:
    """Return the RMS error [m] and the NEES of a flight with given INS errors.

    Parameters
    ----------
    field : map.
    noise : noise model of the measurements.
    places : (n, 3) true east, north and up [m].
    readings : (n, m) measurements [E].
    drawn : (6,) INS errors, in units of their standard deviations.
    """
    seconds = noise.interval * np.arange(len(places))
    ins = places + np.pad(drift(drawn, seconds), ((0, 0), (0, 1)))
    found, information = Smoother(field, noise, readings, ins).solved()
    error = found - drawn
    squared = np.sum(drift(error, seconds) ** 2, axis=1)
    return float(np.sqrt(squared.mean())), float(error @ information @ error)
