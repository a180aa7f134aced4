"""Multiple-model filter: a bank of filters with different hypotheses about the model.

The hypotheses are noise larger or smaller than assumed, map errors, constant channel biases,
gravity that the INS does not compensate, and outliers. The weight of a hypothesis is its prior
weight times the predicted density of the measurements (Magill 1965; Bar-Shalom, Li & Kirubarajan
2001, sec. 11.6). The estimate is the mean and covariance of the mixture of all filters.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product
from typing import Annotated

import numpy as np
from pydantic import Field

from ..block import BlockEstimator, EstimateBlock, ProblemBlock
from ..engines.model_hypotheses import Hypothesis, heavy_tails, map_error
from ..engines.multiple_model import SearchOptions, cell_spacing, multiple_model
from ..parameters import AtLeastOne, Positive

_MOST = 100_000
_AS_ASSUMED = 10.0
"""Prior weight of the assumed model; each kind of hypotheses except gravity has the weight 1."""
_UNKNOWN_GRAVITY = 100.0
"""Prior weight of all gravity hypotheses together.

It is large because gravity always differs from normal gravity. A wrong gravity hypothesis reduces
the accuracy only slightly.
"""
_NOISES = (
    *(0.25, 0.3, 0.36, 0.43, 0.51, 0.6, 0.72, 0.85),
    *(1.18, 1.4, 1.65, 1.95, 2.3, 2.75, 3.25, 3.85, 4.55, 5.4, 6.4, 7.6, 9.0, 10.7),
)
_CONSTANTS = (5.0, 30.0)
_SIZES, _LENGTHS = (1.2, 2.4, 5.0, 10.0, 20.0), (400.0, 1000.0, 2500.0, 6000.0)
_GRAVITIES, _DISTANCES, _INTEGRATED = (10.0, 30.0, 100.0), (20.0, 80.0), (60.0, 150.0)
_HEAVY_TAILED = (1.0, 1.6, 2.5)


@dataclass(frozen=True)
class MultipleModel(BlockEstimator):
    """Multiple-model filter.

    Parameters
    ----------
    noise : whether to include hypotheses of 0.25 to 10.7 times the assumed noise standard deviation
        of gravity and gradient channels.
    errors : whether to include hypotheses of constant errors of gravity and gradient channels, and
        of map errors that vary along the track.
    gravity : whether to include hypotheses of a gravity disturbance that the INS does not
        compensate.
    outliers : whether to include hypotheses of noise with heavy tails.
    spacing_m : distance between the Gaussians of a wide prior [m], as in ``gaussian-sum``. By
        default the distance follows from the map and the noise.
    most : largest number of Gaussians of a wide prior, as in ``gaussian-sum``.
    iterations : largest number of linearisations of h in each update (see ``ekf``).
    """

    noise: bool = True
    errors: bool = True
    gravity: bool = True
    outliers: bool = True
    spacing_m: Positive | None = field(default=None, kw_only=True)
    most: Annotated[int, Field(ge=1, le=_MOST)] = field(default=4000, kw_only=True)
    iterations: AtLeastOne = field(default=1, kw_only=True)

    name = "multiple-model"
    family = "mixture"
    causality = "filter"

    @property
    def exact_if_linear_gaussian(self) -> bool:
        """Whether the filter is exact for linear problems: with the assumed model alone."""
        return not (self.noise or self.errors or self.gravity or self.outliers)

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Hypotheses of the filter bank, according to the parameters."""
        return _bank(self.noise, self.errors, self.gravity, self.outliers)

    def estimate_block(
        self, block: ProblemBlock, rngs: Sequence[np.random.Generator] = ()
    ) -> EstimateBlock:
        """Filter all runs of a block."""
        spacing = cell_spacing(block) if self.spacing_m is None else self.spacing_m
        options = SearchOptions(spacing, self.most, self.iterations)
        return multiple_model(block, self.hypotheses, options)


@lru_cache
def _bank(noise: bool, errors: bool, gravity: bool, outliers: bool) -> tuple[Hypothesis, ...]:
    """Return the hypotheses of the chosen kinds, see :class:`MultipleModel`."""
    bank = [Hypothesis("as_assumed", prior=_AS_ASSUMED)]
    if noise:
        bank += _evenly(Hypothesis("noise", noise=factor) for factor in _NOISES)
    if errors:
        sizes, constants = tuple(product(_SIZES, _LENGTHS)), (0.0, _CONSTANTS[-1])
        bank += _evenly(Hypothesis("constants", constant=size) for size in _CONSTANTS)
        bank += _evenly(
            map_error("map_errors", size, length, constant)
            for constant, (size, length) in product(constants, sizes)
        )
    if gravity:
        bank += _evenly(
            [
                *(
                    Hypothesis("gravity", gravity_mgal=size, gravity_km=distance)
                    for size, distance in product(_GRAVITIES, _DISTANCES)
                ),
                *(Hypothesis("gravity", gravity_mgal=g, integrated=True) for g in _INTEGRATED),
            ],
            _UNKNOWN_GRAVITY,
        )
    if outliers:
        bank += _evenly(heavy_tails("outliers", factor) for factor in _HEAVY_TAILED)
    return tuple(bank)


def _evenly(hypotheses: Iterable[Hypothesis], total: float = 1.0) -> list[Hypothesis]:
    """Return hypotheses with equal prior weights that add up to ``total``."""
    bank = list(hypotheses)
    return [replace(hypothesis, prior=total / len(bank)) for hypothesis in bank]
