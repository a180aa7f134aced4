"""Banks of filters across a wide prior, as arrays of means and covariances.

The prior is approximated by a sum of narrow Gaussians on a grid of positions, one for each filter.
The estimator that uses a bank defines its updates and the selection of filters.
"""

from __future__ import annotations

import numpy as np

from ..block import ProblemBlock
from ..problem import Problem
from . import position_grid


class Bank:
    """J filters: log weights (J,), means (J, n), covariances (J, n, n).

    States are in units of the prior's standard deviations, ``scale`` (n,). The Gaussians of
    :func:`split_prior` are the initial filters.
    """

    def __init__(self, problem: Problem, spacing_m: float, most: int, width: float) -> None:
        self.problem = problem
        self.scale = scale = np.sqrt(np.diag(problem.prior_cov))
        self.transition = problem.transition * scale / scale[:, None]
        self.process_cov = problem.process_cov / np.outer(scale, scale)
        self.weights, self.means, self.covs = split_prior(problem, spacing_m, most, width)

    def predict(self, k: int) -> None:
        """Propagate all filters from epoch k − 1 to epoch k."""
        phi = self.transition[k]
        self.means = self.means @ phi.T
        self.covs = phi @ self.covs @ phi.T + self.process_cov[k]


def mixture(
    share: np.ndarray, means: np.ndarray, covs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (n,) and covariance (n, n) of a mixture of J Gaussians.

    Parameters
    ----------
    share : (J,) weights that sum to one.
    means, covs : (J, n), (J, n, n).
    """
    mean = share @ means
    off = means - mean
    return mean, np.einsum("j,jab->ab", share, covs) + (off.T * share) @ off


def updated_covs(
    covs: np.ndarray, rows: np.ndarray, projected: np.ndarray, s: np.ndarray
) -> np.ndarray:
    """Return the covariances (J, n, n) after a measurement, in Joseph's form.

    Parameters
    ----------
    covs : (J, n, n) covariances P before the measurement.
    rows : (J, m, n) H of the measurement. The measurement is whitened, so R = I.
    projected : (J, m, n) H P.
    s : (J, m, m) H P Hᵀ + I.
    """
    gain = np.linalg.solve(s, projected).transpose(0, 2, 1)
    keep = np.eye(covs.shape[1]) - gain @ rows
    out = keep @ covs @ keep.transpose(0, 2, 1) + gain @ gain.transpose(0, 2, 1)
    return np.asarray(0.5 * (out + out.transpose(0, 2, 1)))


def split_prior(
    problem: Problem | ProblemBlock, spacing_m: float, most: int, width: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the prior as a grid of Gaussians: log weights (J,), means (J, n), covs (J, n, n).

    The grid lies along the principal axes of the position prior. Every state with the unit metre is
    a position state. A split axis has several grid points. Along it each Gaussian has a smaller
    standard deviation than the prior. The regression of the other states on the position is that of
    the prior. Means and covariances are in units of the prior's standard deviations.

    Parameters
    ----------
    problem : problem or block with the prior to split.
    spacing_m : distance between neighbouring Gaussians [m]. An axis is not split if the prior's
        standard deviation along it is smaller than this distance.
    most : largest number of Gaussians; a grid that needs more is made coarser.
    width : standard deviation of each Gaussian along a split axis, in units of the spacing.
    """
    scale = np.sqrt(np.diag(problem.prior_cov))
    mean = problem.prior_mean / scale
    cov = problem.prior_cov / np.outer(scale, scale)
    values, gain, *_ = position_grid.position_axes(problem)
    sigma = np.sqrt(values)
    spacing_m = fitting_spacing(sigma, spacing_m, most)
    grid = position_grid.grid(sigma, spacing_m)
    split = sigma > spacing_m
    grid = grid[:, split]
    narrowing = values[split] - (width * spacing_m) ** 2
    gain = gain[:, split]
    weights = -0.5 * np.sum(grid**2 / narrowing, axis=1)
    narrow = cov - (gain * narrowing) @ gain.T
    return weights, mean + grid @ gain.T, np.tile(narrow, (len(grid), 1, 1))


def fitting_spacing(sigma: np.ndarray, spacing_m: float, most: int) -> float:
    """Return a spacing [m], ``spacing_m`` or larger, with at most ``most`` grid points.

    The spacing is increased in steps of 10 %.

    Parameters
    ----------
    sigma : (d,) standard deviations of the prior along the axes of the grid [m].
    spacing_m : requested spacing [m].
    most : largest number of points.
    """
    # The box around the ellipsoid has to fit in memory, too.
    while not position_grid.fits(sigma, spacing_m, 4.0 * most):
        spacing_m *= 1.1
    while len(position_grid.grid(sigma, spacing_m)) > most:
        spacing_m *= 1.1
    return spacing_m
