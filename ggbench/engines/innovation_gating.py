"""Compiled innovation gates and underweighted updates of eight runs.

A gate rejects a measurement whose normalised innovation squared yᵀ S⁻¹ y exceeds a quantile of its
χ² distribution (Bar-Shalom, Li & Kirubarajan 2001, sec. 5.4). Underweighting uses S = (1 + β) H P
Hᵀ + R for the gain (Lear 1985; Carpenter & D'Souza 2018, NASA/TP-2018-219822). The reason is that
with a wide prior and a nonlinear field the innovation covariance exceeds H P Hᵀ + R. The posterior
covariance is Joseph's form with R and this gain.

If gating and underweighting are combined, the gate uses the underweighted S.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from ..block import ProblemBlock
from ..numerics.kernels import compiled
from ..numerics.records import record
from ..numerics.vectors import load, splat, store


@record
class GateOptions:
    """Gate limits and underweighting of the updates of a block.

    Attributes
    ----------
    limits : (R, K) largest accepted yᵀ S⁻¹ y, from :func:`gate_limits`; shape (0, 0) without a
        gate.
    underweighting : β; 0 for none.
    """

    limits: np.ndarray
    underweighting: float


def gate_options(block: ProblemBlock, gate: float, underweighting: float) -> GateOptions:
    """Return the gate options of a block.

    Parameters
    ----------
    gate : probability that the gate accepts a measurement with the assumed noise; 0: no gate.
    underweighting : β; 0 for no underweighting.
    """
    limits = gate_limits(gate, block.present)
    return GateOptions(limits if gate else np.empty((0, 0)), underweighting)


def gate_limits(gate: float, present: np.ndarray) -> np.ndarray:
    """Return the largest accepted value of yᵀ S⁻¹ y for each measurement.

    The limit is the quantile of χ² with one degree of freedom per available channel. It is ∞ if no
    channel is available or there is no gate. The result has the shape of ``present`` without the
    last axis.

    Parameters
    ----------
    gate : probability that the gate accepts a measurement with the assumed noise; 0: no gate.
    present : (..., m) mask of available channels.
    """
    channels = np.count_nonzero(present, axis=-1)
    if not gate:
        return np.full(channels.shape, np.inf)
    return np.where(channels > 0, chdtri(np.maximum(channels, 1), 1.0 - gate), np.inf)


@compiled
def underweight(
    s: np.ndarray, noise_cov: np.ndarray, underweighting: float, spread: np.ndarray
) -> None:
    """Add β H P Hᵀ to the lower half of S (m, m), and fill ``spread`` with H P Hᵀ.

    Parameters
    ----------
    s : (m, m, lanes) the covariance of h(x) plus R.
    noise_cov : (m, m) R.
    spread : (m, m, lanes) output, the covariance of h(x).
    """
    beta = splat(underweighting)
    for c in range(s.shape[0]):
        for d in range(c + 1):
            value = load(s, c, d) - splat(noise_cov[c, d])
            store(spread, c, d, value)
            store(spread, d, c, value)
            store(s, c, d, load(s, c, d) + beta * value)


@compiled
def reject(
    squared: np.ndarray,
    limits: np.ndarray,
    first: int,
    count: int,
    k: int,
    half_gain: np.ndarray,
    rejected: np.ndarray,
) -> None:
    """Set the gain of measurements beyond the gate to zero, and count them.

    Parameters
    ----------
    squared : (1, 1, lanes) yᵀ S⁻¹ y.
    limits : (R, K) from :func:`gate_limits`.
    first : index of the run in the first lane.
    count : number of runs in the group.
    k : epoch.
    half_gain : (m, n, lanes) L⁻¹ times the cross-covariance, with the Cholesky factor L of S. It is
        set to zero for rejected measurements.
    rejected : (R,) number of rejected measurements, increased.
    """
    for r in range(count):
        if squared[0, 0, r] > limits[first + r, k]:
            half_gain[:, :, r] = 0.0
            rejected[first + r] += 1
