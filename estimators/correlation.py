"""Correlation matching of measurement differences (Li, Wu & Ma 2011).

Gravimeter measurements are reduced with the INS solution. Therefore INS velocity errors (Eötvös
effect) and latitude errors (normal gravity) appear as a slowly changing bias. Li's method matches
differences of consecutive measurements, which have no constant bias. Earlier differences have
larger weights, because the INS is more accurate at the start of the window: J = Σ p_i [(z_{i+1} −
z_i) − (h_{i+1} − h_i)]². Here z are the measurements and h the predictions at a position of the
map. The weights p decrease linearly to one half of the first weight, and Σ p = 1. The method keeps
the five positions with the smallest J. Nearest-neighbour association uses the best of the five.
Probabilistic data association (PDAF) uses the mean x̂ = Σ β_j x_j of the five positions x_j, with
β_j ∝ 1/J_j.

Weaknesses of the method:

* Consecutive differences of measurements with white noise have a correlation of −½, so J is not a
  log-likelihood. A least-squares criterion with this correlation equals the mean squared difference
  (MSD) of z and h after subtraction of their mean difference. J loses the information in
  differences of measurements that are far apart.
* Decreasing weights suit an estimate of the position at the start of the window. A fix is the
  position at the end.
* 1/J is not a probability. With twenty measurements J is ten to a thousand times larger at a wrong
  hill than at the right hill. A wrong hill, kilometres away, can therefore have a weight of
  several per cent. The probability of a position is proportional to exp(−½ χ²) times
  the width of the minimum (``association=likelihood``).
* Five neighbouring grid points in one minimum of J are a single candidate. Their mean only smooths
  the grid and contains no information on other positions.

The covariance of the estimate is Σ β_j (P_j + (x_j − x̂)(x_j − x̂)ᵀ). The covariance P_j of
candidate j includes the uncertainty of all other states of the window.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from scipy.special import softmax

from ..block import ProblemBlock, by_block
from ..engines.banks import mixture
from ..engines.fix_fusion import FixFusion, Fusion
from ..engines.position_grid import position_axes
from ..engines.window_search import MOST, Search, WindowSearch, distinct, unmatchable
from ..parameters import AtLeastOne, Positive
from ..problem import Estimate, Estimator, Problem
from ..reduced import horizontal

_LEAST = 3
"""Smallest window: three measurements have two differences."""
_FALL = 0.5
"""Ratio of the last to the first weight, if the weights decrease along the window."""


@dataclass(frozen=True)
class Correlation(Estimator):
    """Matching of measurement differences, with association of several candidates.

    Parameters
    ----------
    association : ``nearest``: the candidate with the smallest J. ``reciprocal``: all candidates,
        with weights 1/J (Li's PDAF). ``likelihood``: all candidates, with their posterior
        probabilities. With ``candidates=nodes`` the probabilities are proportional to exp(−½ χ²),
        which neglects the correlation between the terms of J.
    candidates : ``basins``: local minima of J, each refined to the most probable states of the
        window. ``nodes``, as in Li, Wu & Ma 2011: the grid points with the smallest J, without
        refinement.
    window : number of epochs with measurements in one match.
    differenced : whether differences of measurements are matched instead of the measurements.
    descending : whether the weights decrease along the window instead of being equal.
    fusion : use of the fixes, see :mod:`ggbench.engines.fix_fusion`.
    keep : number of candidates.
    spacing_m : grid step [m]; in Li, Wu & Ma 2011 the distance between nodes of the map.
    most : largest number of grid points; the step is increased if necessary.
    misfit : χ² per measurement that an accepted fix must not exceed; 1 is expected. With
        ``candidates=nodes`` it is χ² per term of J.
    odds : log odds that an accepted fix must exceed. The odds compare the candidate of the largest
        weight with the most probable other position.
    """

    association: Literal["nearest", "reciprocal", "likelihood"] = "likelihood"
    candidates: Literal["basins", "nodes"] = "basins"
    window: Annotated[int, Field(ge=_LEAST)] = 20
    differenced: bool = True
    descending: bool = True
    fusion: Fusion = "kalman"
    keep: AtLeastOne = 5
    spacing_m: Positive = 370.0
    most: Annotated[int, Field(ge=1, le=MOST)] = 50_000
    misfit: Annotated[float, Field(gt=0.0)] = 3.0
    odds: Annotated[float, Field(ge=0.0)] = 3.0

    name = "correlation"
    family = "matching"
    causality = "filter"
    exact_if_linear_gaussian = False  # between its fixes it takes no reading

    def skip(self, problem: Problem) -> str | None:
        """Return a reason to skip the problem, or None if there is none.

        The problem must have a horizontal position, and its model must have compiled kernels.
        """
        return unmatchable(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Match one window after the other, and propagate the estimate between fixes."""
        return by_block(problem, self._match)

    def _match(self, block: ProblemBlock) -> Estimate:
        flight = FixFusion(block, self.fusion, horizontal(block.problem(0), velocity=False))
        read = np.flatnonzero(block.present[0].any(axis=1))
        last = -1  # the last epoch whose readings are spent
        for end in map(int, read[self.window - 1 :: self.window]):
            fix = self._fix(flight, flight.window(last, end))
            last = end
            if fix is not None:
                flight.add(last, fix.mean, fix.cov, fix.accepted, fix.statistic)
        return flight.estimate()

    def _fix(self, flight: FixFusion, window: ProblemBlock) -> _Fix | None:
        """Return the fix of a window, or None without terms of J or without grid points."""
        search = Sequences(
            window.problem(0), self.spacing_m, self.most, self.differenced, self.descending
        )
        search.take(window.epochs)
        flight.evaluations += search.evaluations
        if search.terms == 0 or not len(search.points):
            return None
        if self.candidates == "nodes":
            flight.evaluations += self.keep * window.epochs
            return self._of_nodes(search)
        smoother = self._search(window)
        fix = self._of_basins(search, smoother)
        flight.evaluations += int(smoother.evaluations[0])
        return fix

    def _search(self, window: ProblemBlock) -> WindowSearch:
        return WindowSearch(window)

    def _of_basins(self, search: Sequences, window: WindowSearch) -> _Fix | None:
        part, mismatch, basins = search.problem, search.values(), search.best(self.keep)
        places_of_basins = window.places([search.multipliers(search.points[i]) for i in basins])
        found = [
            (mismatch[index], place)
            for index, place in zip(basins, places_of_basins, strict=True)
            if place is not None
        ]
        if not found:
            return None
        different = distinct(part, [place for _, place in found], search.spacing)
        if self.association == "likelihood":
            places = different
            share = softmax([place.log_share for place in places])
        else:
            places = [place for _, place in found]
            share = self._shares(np.array([j for j, _ in found]))
        chosen = places[int(np.argmax(share))]
        # Another candidate within a step of it is the same place, and no rival.
        others = [
            place.log_share
            for place in different
            if len(distinct(part, [place, chosen], search.spacing)) == 2
        ]
        surer = chosen.log_share - max(others, default=-np.inf)
        fits = 2.0 * chosen.cost <= self.misfit * part.present.sum()
        mean, cov = mixture(
            share, np.array([p.mean for p in places]), np.array([p.cov for p in places])
        )
        return self._judged(mean, cov, bool(fits), surer)

    def _of_nodes(self, search: Sequences) -> _Fix:
        mismatch = search.values()
        nodes = np.argsort(mismatch, kind="stable")[: self.keep]
        if self.association == "likelihood":
            share = softmax(-0.5 * search.chi_squared * mismatch[nodes])
        else:
            share = self._shares(mismatch[nodes])
        means, covs = zip(*(at_node(search, node) for node in nodes), strict=True)
        mean, cov = mixture(share, np.array(means), np.array(covs))
        best, *others = mismatch[search.best(2)]
        surer = 0.5 * search.chi_squared * (others[0] - best) if others else np.inf
        fits = search.chi_squared * best <= self.misfit * search.terms
        return self._judged(mean, cov, bool(fits), float(surer))

    def _shares(self, mismatch: np.ndarray) -> np.ndarray:
        """Return the weights of the candidates from their values of the criterion, ``mismatch``."""
        if self.association == "nearest":
            return np.eye(len(mismatch))[int(np.argmin(mismatch))]
        inverse = 1.0 / np.maximum(mismatch, np.finfo(float).tiny)
        return np.asarray(inverse / inverse.sum())

    def _judged(self, mean: np.ndarray, cov: np.ndarray, fits: bool, surer: float) -> _Fix:
        cov = 0.5 * (cov + cov.T)
        if not fits:
            return _Fix(mean, cov, False, -np.inf)
        return _Fix(mean, cov, surer > self.odds, surer)


@dataclass(frozen=True)
class _Fix:
    """State (n,) at the end of a window, its covariance (n, n), and whether it is accepted."""

    mean: np.ndarray
    cov: np.ndarray
    accepted: bool
    statistic: float


class Sequences(Search):
    """Map search with Li's criterion J = Σ_c r_cᵀ W_c r_c, for residuals r_c of channel c.

    The weights of all terms of J add up to one. Differences are taken between consecutive
    measurements of the same channel; measurements of other channels may lie in between.

    Attributes
    ----------
    form : (m, K, K) matrix W_c of each channel, for a window of K epochs.
    terms : number of terms of J.
    chi_squared : factor that converts J to a χ² with ``terms`` terms. The factor is half as large
        for differences, because a difference has the noise variance of two measurements.
    """

    _kept = (*Search._kept, "_total", "_last")

    def __init__(
        self, problem: Problem, spacing_m: float, most: int, differenced: bool, descending: bool
    ) -> None:
        super().__init__(problem, spacing_m, most)
        there = problem.present
        epochs, channels = there.shape
        self._differenced = differenced
        # The weight of the term that ends with each reading; a channel's first one ends none.
        self._weights = np.zeros((epochs, channels))
        self.form = np.zeros((channels, epochs, epochs))
        self.terms = 0
        for c in range(channels):
            read = np.flatnonzero(there[:, c])
            ends = read[1:] if differenced else read
            p = np.linspace(1.0, _FALL if descending else 1.0, len(ends))
            self._weights[ends, c] = p
            rows = np.eye(epochs)[read]
            if differenced:
                rows = np.diff(rows, axis=0)
            self.form[c] = (rows.T * p) @ rows
            self.terms += len(ends)
        total = max(self._weights.sum(), np.finfo(float).tiny)
        self._weights /= total
        self.form /= total
        self.chi_squared = self.terms / (2.0 if differenced else 1.0)
        self._total = np.zeros(len(self.points))
        self._last = np.zeros((len(self.points), channels))

    def _compare(self, k: int, z: np.ndarray, h: np.ndarray) -> None:
        off = z - h
        term = off - self._last if self._differenced else off
        self._total += term**2 @ self._weights[k]
        self._last = np.where(self.problem.present[k], off, self._last)

    def values(self) -> np.ndarray:
        """Return the criterion J at each point of the grid, as an array (points,)."""
        return self._total


def at_node(search: Sequences, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (n,) and covariance (n, n) of the states at the window's end for a grid point.

    ``index`` is the index of the grid point. The gradient of J is assumed to be zero there. The
    displacement δd is relative to the trajectory that passes through the grid point. The optimal δd
    minimises the sum of the χ² of J and the χ² of the prior. Near this trajectory δd is linear in
    the residuals r_k of the epochs k: δd = Σ M_k r_k, with constant matrices M_k. This displacement
    is processed as a measurement of the states, with errors from noise, INS and grid. The
    correlation of these errors with the final state is computed by propagating both through the
    window. The covariance therefore accounts for the information that J does not use.
    """
    problem = search.problem
    variances, gain, *_ = position_axes(problem)
    # In units of the prior's deviations.
    scale, point = np.sqrt(np.diag(problem.prior_cov)), search.points[index]
    units = np.outer(scale, scale)
    transition = problem.transition * scale / scale[:, np.newaxis]
    n, d = gain.shape
    rows, white = [], []
    x, moved = problem.prior_mean / scale + gain @ point, gain
    for k, phi in enumerate(transition):
        x, moved = phi @ x, phi @ moved
        h = problem.model.jacobian(k, x * scale) * scale
        white.append(np.linalg.solve(np.linalg.cholesky(problem.noise_of(k)), h))
        rows.append(white[-1] @ moved)
    pull = np.einsum("vcd,cvk->kdc", np.array(rows), search.chi_squared * search.form)
    prior = np.diag(1.0 / variances)
    normal = np.einsum("kdc,kce->de", pull, np.array(rows)) + prior
    pull = np.linalg.solve(normal, pull)
    mean = np.concatenate([-gain @ point, np.zeros(d)])
    cov = np.zeros((n + d, n + d))
    cov[:n, :n] = problem.prior_cov / units
    step, add = np.eye(n + d), np.eye(n + d)
    for k, m in enumerate(pull):
        step[:n, :n], add[n:, :n] = transition[k], m @ white[k]
        cov = step @ cov @ step.T
        cov[:n, :n] += problem.process_cov[k] / units
        mean, cov = add @ step @ mean, add @ cov @ add.T
        cov[n:, n:] += m @ m.T
    coarse = np.where(variances > search.spacing**2, search.spacing**2 / 12.0, 0.0)
    # Along an axis that no reading feels δd does not vary, and tells nothing.
    weight = cov[:n, n:] @ np.linalg.pinv(cov[n:, n:] + np.diag(coarse), hermitian=True)
    least = np.linalg.solve(normal, prior @ point)
    end = x + mean[:n] + weight @ (least - mean[n:])
    left = cov[:n, :n] - weight @ cov[n:, :n]
    return end * scale, left * units
