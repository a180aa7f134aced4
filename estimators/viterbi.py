"""Map matching with a hidden Markov model: position cells and the most probable path.

The hidden states are the cells of a grid. Between two measurements the position error moves to
another cell because of INS drift. Each measurement has a likelihood in each cell. Viterbi's
algorithm finds the most probable path of cells (Li, Gilliam, Wang, Kealy, Greentree & Moran 2025).
A path has no covariance, so the forward-backward algorithm on the same trellis computes the
probability of each cell.

There is no linearisation, so the prior may be wide. The state is only the position. The drift of an
INS is a persistent velocity error. The model replaces it by a random walk of the position. The size
of the steps follows from the velocity error, and the measurements must correct every step. In a
batch estimate, earlier and later measurements bound the drift. A forward pass lags behind the
drift. Attitude, gradiometer biases and all other states are treated as noise.

The resolution is one cell. A precise gradiometer may resolve much less than a cell. Then the
estimate is as coarse as the cells, and the variation of the field within a cell adds to the noise.
A filter of all states is then better. In test runs this method found the position from kilometres
away, whereas a single Kalman filter did not. Its error was several times that of a bank of
filters that estimate all states.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ..engines.trellis import Trellis, cell_sides
from ..parameters import Positive
from ..problem import Causality, Estimate, Estimator, Problem, jacobian_along
from ..reduced import Reduction, displacing, horizontal, reduced

_LARGEST_STEP = 60.0
"""Largest standard deviation of the steps of the INS error [cells].

For larger steps the transitions would dominate the computing time.
"""
_TOLD = 0.3
"""Largest effect of the INS height error on a measurement [standard deviations of its noise].

Below this limit the axis up is omitted.
"""
_MOST = 5_000_000
"""Cells that fit in memory."""


@dataclass(frozen=True)
class Viterbi(Estimator):
    """Hidden Markov model over cells of the position east, north and up.

    The axis up is omitted if the INS height is more accurate than the measurements can resolve.

    Parameters
    ----------
    decode : ``path``: the most probable path given all measurements. ``marginal``: the mean of the
        cell probabilities given all measurements. ``forward``: the mean given the measurements up
        to each epoch.
    cell_m : side of a cell [m]; along an axis on which the prior's standard deviation is smaller,
        the side is this standard deviation.
    most : largest number of cells; if necessary, cells are enlarged along east and north. A cell
        needs 40 bytes at every epoch at which its probability is not negligible.
    drift : factor on the standard deviation of the modelled steps of the INS error; 1 gives the
        steps that follow from the prior. The modelled steps are independent, but the true drift
        persists. Therefore, with ``drift=1`` the forward pass lags behind the truth. The lag equals
        the standard deviation of a position that is estimated from a single measurement.
    """

    decode: Literal["path", "marginal", "forward"] = "path"
    cell_m: Positive = 20.0
    most: Annotated[int, Field(ge=1000, le=_MOST)] = 200_000
    drift: Positive = 4.0

    name = "viterbi"
    family = "matching"
    exact_if_linear_gaussian = False  # of another problem

    @property
    def causality(self) -> Causality:
        """Causality of the estimates: ``filter`` for ``decode=forward``, else ``batch``."""
        return "filter" if self.decode == "forward" else "batch"

    def skip(self, problem: Problem) -> str | None:
        """Return a reason to skip the problem, or None if there is none.

        The problem must have errors of position and velocity. The standard deviation of the INS
        error's steps between measurements must not exceed 60 cells.
        """
        if not horizontal(problem, velocity=True):
            return "the problem has no errors of position and velocity"
        reduction = self._reduction(problem)
        step = np.sqrt(reduction.problem.process_cov.max(axis=0).diagonal().max())
        if step > _LARGEST_STEP * self.cell_m:
            return (
                f"cells of {self.cell_m:g} m are too small for INS errors that change by "
                f"{step:.0f} m between measurements"
            )
        return None

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate one run: compute forward probabilities of the cells, then path or marginals."""
        reduction = self._reduction(problem)
        small = reduction.problem
        steps = cell_sides(small.prior_cov, self.cell_m, self.most)
        trellis = Trellis(small, steps, self.most, _unknown(problem, reduction))
        layers = trellis.layers
        if self.decode == "forward":
            shares = [layer.forward for layer in layers]
        else:
            shares = trellis.smoothed()
        found = [layer.moments(each) for layer, each in zip(layers, shares, strict=True)]
        mean, cov = (np.array(values[1:]) for values in zip(*found, strict=True))
        if self.decode == "path":
            path = trellis.best_path()
            best = [layer.places(np.array([c]))[0] for layer, c in zip(layers, path, strict=True)]
            off = mean - np.array(best[1:])
            # About the path, not about the mean.
            mean, cov = mean - off, cov + off[:, :, np.newaxis] * off[:, np.newaxis, :]
        info = {
            "cell_m": float(steps[0]),
            "mean_cells": float(np.mean([len(layer.cells) for layer in layers[1:]])),
        }
        return reduction.embedded(Estimate(mean, cov, self.causality, info=info))

    def _reduction(self, problem: Problem) -> Reduction:
        """Return the problem reduced to the position; other INS errors become process noise.

        The height is omitted if the measurements cannot improve it.
        """
        block = next(block for block in problem.layout if block.unit == "m")
        position = range(*block.slice.indices(problem.dimension))[:3]
        flat = self._reduced(problem, position[:2])
        known = _height_is_known(problem, flat, position)
        return flat if known else self._reduced(problem, position)

    def _reduced(self, problem: Problem, states: range) -> Reduction:
        return reduced(problem, states, self.drift**2 * displacing(problem, states))


def _height_is_known(problem: Problem, flat: Reduction, position: range) -> bool:
    """Return whether the INS height error affects every measurement by much less than its noise."""
    for up in position[2:]:
        sigma = np.sqrt(flat.cov[:, up, up])
        told = jacobian_along(problem.model, np.arange(problem.epochs), flat.mean)[:, :, up]
        noise = np.diagonal(problem.noise_cov, axis1=-2, axis2=-1)
        if (np.abs(told * sigma[:, np.newaxis]) > _TOLD * np.sqrt(noise)).any():
            return False
    return True


def _unknown(problem: Problem, reduction: Reduction) -> np.ndarray:
    """Return the covariance (K, m, m) that errors of the omitted states cause in measurements."""
    others = [i for i in range(problem.dimension) if i not in reduction.states]
    rows = jacobian_along(problem.model, np.arange(problem.epochs), reduction.mean)[:, :, others]
    cov = reduction.cov[:, others][:, :, others]
    return np.asarray(rows @ cov @ rows.transpose(0, 2, 1))
