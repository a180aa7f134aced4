"""SITAN: extended Kalman filters with stochastic linearisation of the map.

SITAN stands for Sandia inertial terrain-aided navigation (Hostetler & Andreas 1983). The Jacobian
is the slope of a plane that is fitted to the map over the position uncertainty (stochastic
linearisation). An extended Kalman filter uses the derivative at the estimate instead. The residuals
of the plane are added to the noise. Therefore the gain is small if the field is nonlinear within
the position uncertainty. If the field is linear, the filter equals the extended Kalman filter.

One plane is valid over a region up to the width of a hill. For a wider prior, AFTI/SITAN (Boozer &
Fellerhoff 1988) acquires the position with a bank of filters on a grid; the uncertainty of each
filter is so small that a plane is valid. All filters run in parallel until one filter is selected.
The residuals of this filter must have the expected size over several measurements, and must be
smaller than those of the filters at other positions. Then only this filter continues. Unlike in the
Gaussian sum (``gaussian-sum``), filters are neither merged nor weighted. Before the decision no
filter is used for the estimate, after the decision only the selected filter. Decisions are reported
as fixes. The statistic of a fix is a ratio of squared residuals: the smallest value of the filters
at other positions, divided by the value of the best filter.

Measured results over hills: if the standard deviation of the prior is a tenth of the width of a
hill, a single filter equals the extended Kalman filter. At a third of the width the single filter
has smaller errors than the extended Kalman filter in most runs. At one width it finds the position
more often, but in less than half of the runs. From three widths on it diverges. The bank finds the
position as often as the Gaussian sum. The Gaussian sum estimates the position from the first
measurements on, whereas the bank has no estimate before its decision.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from ..engines.banks import Bank, fitting_spacing, updated_covs
from ..engines.fix_fusion import Attempt, fixes_of
from ..engines.position_grid import position_axes
from ..parameters import AtLeastOne, Positive
from ..problem import Estimate, Estimator, Problem

_SPACINGS = 3.0
"""Distance between neighbouring filters of the bank [standard deviations of one filter]."""
_MOST = 100_000
"""Filters that fit in memory."""


@dataclass(frozen=True)
class Sitan(Estimator):
    """SITAN: one filter with stochastic linearisation, or a bank that selects one filter.

    Parameters
    ----------
    bank : ``none``: one filter. ``auto``: a bank of filters across the prior if the position prior
        is wider than three ``sigma_m``, else one filter.
    sigma_m : standard deviation of the position in each filter of a bank [m]. The distance between
        filters is three times ``sigma_m``. The prior is not split in directions in which its
        standard deviation is smaller than this distance.
    most : largest number of filters; the distance is increased if necessary.
    readings : number of measurements over which normalised squared residuals are smoothed. The bank
        decides after this number at the earliest.
    largest : limit on the squared residual of a selected filter. The squared residual is
        normalised, divided by the number of channels, and smoothed; 1 is expected.
    ratio : smallest ratio of smoothed squared residuals at which a filter is selected. The ratio is
        the smallest value of the filters at other positions, divided by the value of this filter.
    """

    bank: Literal["none", "auto"] = "none"
    sigma_m: Positive = 75.0
    most: Annotated[int, Field(ge=1, le=_MOST)] = 4000
    readings: AtLeastOne = 20
    largest: Positive = 1.5
    ratio: Annotated[float, Field(ge=1.0, allow_inf_nan=False)] = 1.3

    name = "sitan"
    family = "matching"
    causality = "filter"

    @property
    def exact_if_linear_gaussian(self) -> bool:
        """Whether the parameters exclude a bank of filters (``bank=none``).

        A bank is not exact: after its decision the estimate comes from one cell of the prior.
        """
        return self.bank == "none"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Run all filters until one filter is selected, then only the selected filter.

        Before the selection the estimate is that of the INS: the propagated prior.
        """
        spacing = _SPACINGS * self.sigma_m if self.bank == "auto" else np.inf
        filters = SitanFilters(problem, spacing, self.most)
        started, scale = len(filters.means), filters.scale
        x, p = problem.prior_mean / scale, problem.prior_cov / np.outer(scale, scale)
        mean = np.empty((problem.epochs, problem.dimension))
        cov = np.empty((problem.epochs, problem.dimension, problem.dimension))
        nis = np.full(problem.epochs, np.nan)
        attempts: list[Attempt] = []
        accepted_at = np.nan
        for k in range(problem.epochs):
            filters.predict(k)
            squares = filters.update(k, self.readings)
            phi = filters.transition[k]
            x, p = phi @ x, phi @ p @ phi.T + filters.process_cov[k]
            mean[k], cov[k] = x, 0.5 * (p + p.T)
            if len(filters.means) > 1:
                if filters.seen < self.readings or not problem.present[k].any():
                    continue
                best, statistic = filters.best(self.largest)
                accepted = statistic > self.ratio
                attempts.append((k, *filters.place(best), accepted, statistic))
                if not accepted:
                    continue
                accepted_at = float(problem.times[k])
                filters.keep(best)
            elif problem.present[k].any():
                nis[k] = squares[0]
            mean[k], cov[k] = filters.means[0], filters.covs[0]
        info: dict[str, Any] = {"filters": started}
        if started > 1:
            info |= {"accepted": bool(np.isfinite(accepted_at)), "accepted_at_s": accepted_at}
        return Estimate(
            mean * scale, cov * np.outer(scale, scale), self.causality, info=info, nis=nis,
            fixes=fixes_of(attempts) if started > 1 and tuple(filters.places) == (0, 1) else None,
        )  # fmt: skip


class SitanFilters(Bank):
    """J filters with stochastic linearisation, and their smoothed squared residuals (J,)."""

    def __init__(self, problem: Problem, spacing_m: float, most: int) -> None:
        super().__init__(problem, spacing_m, most, 1.0 / _SPACINGS)
        self.near_m = fitting_spacing(np.sqrt(position_axes(problem).variances), spacing_m, most)
        self.places = _places(problem)
        self.offsets, self.shares, self.spread = _region(len(self.places))
        self.squares, self.seen = np.zeros(len(self.means)), 0

    def update(self, k: int, memory: int) -> np.ndarray:
        """Update all filters with measurement k; return their normalised innovations squared (J,).

        The attribute ``squares`` (J,) is updated, too. It contains the normalised innovation
        squared of each filter, divided by the number of available channels, and smoothed over
        ``memory`` measurements.
        """
        rows, predicted, noise = self.fitted_planes(k)
        root = np.linalg.cholesky(noise)
        rows = np.linalg.solve(root, rows)
        off = self.problem.measurements[k] - predicted
        innovation = np.linalg.solve(root, off[..., None])
        projected = rows @ self.covs
        s = projected @ rows.transpose(0, 2, 1) + np.eye(rows.shape[1])
        solved = np.linalg.solve(s, innovation)
        self.means = self.means + (projected.transpose(0, 2, 1) @ solved)[..., 0]
        self.covs = updated_covs(self.covs, rows, projected, s)
        squares = np.einsum("jmi,jmi->j", innovation, solved)
        there = int(self.problem.present[k].sum())
        if there:
            self.seen += 1
            self.squares += (squares / there - self.squares) / min(self.seen, memory)
        return squares

    def fitted_planes(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fit a plane to h over the position uncertainty of each filter.

        Returns
        -------
        Jacobian H (J, m, n) with the slopes of the planes; predictions (J, m) of the planes at the
        means; noise covariance (J, m, m) including the residuals of the planes.
        """
        model, places = self.problem.model, self.places
        region = self.covs[:, places[:, None], places]
        values, vectors = np.linalg.eigh(region)
        sigma = np.sqrt(np.maximum(values, np.finfo(float).tiny))
        points = np.repeat(self.means[:, None], len(self.shares), axis=1)
        points[:, :, places] += np.einsum("qd,jd,jed->jqe", self.offsets, sigma, vectors)
        h = model.predict(k, points * self.scale)
        predicted = np.einsum("q,jqm->jm", self.shares, h)
        left = h - predicted[:, None]
        along = np.einsum("q,qd,jqm->jmd", self.shares / self.spread, self.offsets, left)
        left = left - np.einsum("qd,jmd->jqm", self.offsets, along)
        rows = model.jacobian(k, self.means * self.scale) * self.scale
        rows[:, :, places] = np.einsum("jmd,jd,jed->jme", along, 1.0 / sigma, vectors)
        noise = np.einsum("q,jqa,jqb->jab", self.shares, left, left)
        return rows, predicted, noise + self.problem.noise_of(k)

    def best(self, largest: float) -> tuple[int, float]:
        """Return the index of the best filter, and the ratio on which the decision is based.

        The best filter has the smallest smoothed square of residuals. The ratio is the smallest
        smoothed square of the other filters, divided by that of the best filter. Filters within one
        spacing of the best filter are excluded. The ratio is ∞ if no other filters remain. It is −∞
        if the smoothed square of the best filter is not below ``largest``.
        """
        best = int(np.argmin(self.squares))
        if not self.squares[best] < largest:
            return best, -np.inf
        metres = (self.means - self.means[best])[:, self.places] * self.scale[self.places]
        away = np.linalg.norm(metres, axis=1) > self.near_m
        return best, float(np.min(self.squares[away], initial=np.inf) / self.squares[best])

    def place(self, which: int) -> tuple[np.ndarray, np.ndarray]:
        """Return position (d,) [m] and position covariance (d, d) [m²] of the filter ``which``."""
        chosen, unit = self.places, self.scale[self.places]
        cov = self.covs[which][np.ix_(chosen, chosen)] * np.outer(unit, unit)
        return self.means[which, chosen] * unit, cov

    def keep(self, chosen: int) -> None:
        """Drop all filters except the filter ``chosen``."""
        only = slice(chosen, chosen + 1)
        self.weights, self.squares = self.weights[only], self.squares[only]
        self.means, self.covs = self.means[only], self.covs[only]


def _places(problem: Problem) -> np.ndarray:
    """Return the state indices (d,) of the position in which planes are fitted, d ≤ 2.

    They are the first two states, or the only state, of the first block in metres.
    """
    blocks = [block for block in problem.layout if block.unit == "m"]
    inside = range(*blocks[0].slice.indices(problem.dimension)) if blocks else range(0)
    return np.array(inside[:2], dtype=int)


def _region(axes: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the points of the plane fit, their weights, and their variance along an axis.

    The points (3^d, d) are in standard deviations along the d principal axes. The weights (3^d,)
    are proportional to the Gaussian density at the points.
    """
    offsets = np.array(list(product((-1.0, 0.0, 1.0), repeat=axes)))
    shares = np.exp(-0.5 * (offsets**2).sum(axis=1))
    shares /= shares.sum()
    return offsets, shares, float(2.0 * np.exp(-0.5) / (1.0 + 2.0 * np.exp(-0.5)))
