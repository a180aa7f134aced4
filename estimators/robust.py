"""Parameters of robust losses and of innovation gates."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ..block import BlockEstimator
from ..parameters import NonNegative
from ..problem import Estimator

Loss = Literal["none", "huber", "cauchy"]

THRESHOLDS = {"none": np.inf, "huber": 1.345, "cauchy": 2.385}
"""Default thresholds; with Gaussian noise they increase the variance by 5 % (Zhang 1997)."""


@dataclass(frozen=True)
class RobustLoss(Estimator):
    """Parameters of a robust loss on each component of a whitened residual.

    Parameters
    ----------
    loss : ``none``, ``huber`` or ``cauchy``. A loss reduces the weight of components whose
        residual is large after the update, see :mod:`ggbench.engines.robust_weights`.
    threshold : residual [standard deviations of the noise] above which the loss reduces weights
        [default: 1.345 for ``huber`` and 2.385 for ``cauchy``].
    """

    loss: Loss = field(default="none", kw_only=True)
    threshold: Annotated[float, Field(gt=0.0)] | None = field(default=None, kw_only=True)

    @property
    def limit(self) -> float:
        """Threshold of the loss [standard deviations of the noise].

        If ``threshold`` is None, it is the default threshold of the chosen loss.
        """
        return THRESHOLDS[self.loss] if self.threshold is None else self.threshold

    def conflict(self) -> str | None:
        """Return an error text if a threshold is given without a loss; else None."""
        if self.loss == "none" and self.threshold is not None:
            return "threshold needs a loss: huber or cauchy"
        return None


@dataclass(frozen=True)
class GatedUpdate(RobustLoss, BlockEstimator):
    """Parameters of a gate on innovations and of an underweighted gain.

    Both limit the influence of single measurements on a linear update, see
    :mod:`ggbench.engines.innovation_gating`.

    Parameters
    ----------
    gate : probability that a measurement is accepted if its noise is as assumed. A measurement is
        rejected if its normalised innovation squared exceeds the quantile of χ² at this
        probability. 0: no gate.
    underweighting : β of S = (1 + β) H P Hᵀ + R, which is used only for the gain; 0: optimal gain.
    """

    gate: Annotated[float, Field(ge=0.0, lt=1.0)] = field(default=0.0, kw_only=True)
    underweighting: NonNegative = field(default=0.0, kw_only=True)

    causality = "filter"

    @property
    def exact_if_linear_gaussian(self) -> bool:
        """Whether the update is exact for linear problems: no gate and no underweighting."""
        return not self.gate and not self.underweighting

    def conflict(self) -> str | None:
        """Return an error text if a gate or underweighting is combined with a loss; else None."""
        if (self.gate or self.underweighting) and self.loss != "none":
            name = "gate" if self.gate else "underweighting"
            return f"{name} and loss cannot be combined: choose one"
        return super().conflict()
