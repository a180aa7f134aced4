"""The measurement model as arrays, and what kernels of eight runs keep of an epoch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..gravity.spline import TENSOR_WORK
from ..numerics import lanes
from ..numerics.kernels import compiled
from ..numerics.records import record
from . import aiding_kernels
from .aiding_kernels import Aiding
from .gradiometer.instrument import STRAPDOWN


@record
class ModelArrays:
    """The measurement model as arrays: all that the kernels of h and H are given.

    The first g channels are the gradiometer's, if there is one: h(k, x) = offset_k + gain_k ·
    (Σ_i S_ki reading(reference_{k−lag_i} − B_k x) + b), where i counts the readings that the
    whitening of coloured noise combines. Without any it is one, S_k0 = S and lag_0 = 0. The others
    are those of :class:`.Aiding`. For many runs at once (a block) the arrays that differ from run
    to run have the run as leading axis.

    Attributes
    ----------
    dimension : number of states n.
    instrument : index of :data:`.instrument.INSTRUMENTS`; strapdown where mounting angles are
        states, see :mod:`.gradiometer.mounting`.
    channels : (g, 6) S, from the tensor in the mount to the gradiometer's channels.
    combined : (1 or K, T, g, 6) S_ki, of all epochs or of each.
    lags : (1 or K, T) by how many epochs each of the T readings is earlier; −1 where there is none.
    bias : index of the first of the g biases b among the states; −1 for none.
    origin, step, coefficients : the map, see :class:`.field.Field`.
    times : (K,) t_k − τ_k [s].
    references : (K, 3) INS positions then [rad, rad, m].
    attitudes : (K, 3, 3) INS attitudes C_nb then, or those of the mount; only of ``STRAPDOWN``.
    rows : (K, 6, 15 or more) B_k, see :class:`SensorModel`; to mounting angles, if they are states.
    offset : (K, m) in units of the channels.
    gain : (K,) of the gradiometer; zero where its reading is missing.
    aiding : the other channels.
    """

    dimension: int
    instrument: int
    channels: np.ndarray
    combined: np.ndarray
    lags: np.ndarray
    bias: int
    origin: np.ndarray
    step: np.ndarray
    coefficients: np.ndarray
    times: np.ndarray
    references: np.ndarray
    attitudes: np.ndarray
    rows: np.ndarray
    offset: np.ndarray
    gain: np.ndarray
    aiding: Aiding

    def of_run(self, run: int) -> ModelArrays:
        """Return the arrays of one run of a block."""
        return self.mapped(lambda array: array[run])

    def as_block(self) -> ModelArrays:
        """Return the arrays of one run as a block of one."""
        return self.mapped(lambda array: array[np.newaxis])

    def mapped(self, change: Callable[..., np.ndarray], *others: ModelArrays) -> ModelArrays:
        """Return the same with the arrays that differ from run to run changed.

        ``change`` is given an array, and behind it that of each of the others.
        """
        models = (self, *others)
        aiding: dict[str, Any] = {
            name: change(*(getattr(model.aiding, name) for model in models))
            for name in aiding_kernels.OF_A_RUN
        }
        own: dict[str, Any] = {
            name: change(*(getattr(model, name) for model in models)) for name in OF_A_RUN
        }
        return replace(self, **own, aiding=replace(self.aiding, **aiding))


OF_A_RUN = ("references", "attitudes", "rows", "offset", "gain")
"""The arrays that differ from run to run, as do those of the aiding sensors."""


@record
class EpochContext:
    """INS solution and channel gains of eight runs at an epoch.

    Attributes
    ----------
    references : (T, 3, lanes) positions at the readings that are combined [rad, rad, m].
    attitudes : (1, 9, lanes) C_nb, row by row.
    offset : (1, m, lanes) in units of the channels.
    gain : (1, 1, lanes) of the gradiometer.
    there : (1, 1, lanes) one where any channel delivers a measurement.
    """

    references: np.ndarray
    attitudes: np.ndarray
    offset: np.ndarray
    gain: np.ndarray
    there: np.ndarray


@record
class PointScratch:
    """Scratch for S vectors of points at which h is evaluated.

    Attributes
    ----------
    places : (3, S, lanes) latitude, longitude [rad], height [m].
    tensors : (24, S, lanes) tensors and their slopes.
    work : scratch of the spline.
    """

    places: np.ndarray
    tensors: np.ndarray
    work: np.ndarray


@compiled
def epoch_context(model: ModelArrays) -> EpochContext:
    """Return an unfilled context of a block."""
    new, m = lanes.lanes, model.offset.shape[2]
    return EpochContext(new(model.lags.shape[1], 3), new(1, 9), new(1, m), new(1, 1), new(1, 1))


@compiled
def point_scratch(count: int) -> PointScratch:
    """Return scratch for ``count`` vectors of points, at least one."""
    new = lanes.lanes
    return PointScratch(new(3, count), new(24, count), np.empty(TENSOR_WORK))


@compiled
def load_epoch(model: ModelArrays, group: np.ndarray, k: int, out: EpochContext) -> None:
    """Fill the context of a group of runs (lanes,) of a block at epoch ``k``."""
    lags = model.lags[min(k, model.lags.shape[0] - 1)]
    for i in range(lags.shape[0]):
        if lags[i] >= 0:
            lanes.gather_row(model.references, group, k - lags[i], out.references[i : i + 1])
    lanes.gather_row(model.offset, group, k, out.offset)
    for r in range(group.shape[0]):
        out.gain[0, 0, r] = model.gain[group[r], k]
        there = out.gain[0, 0, r] != 0.0
        present = model.aiding.present[group[r], k]
        for c in range(present.shape[0]):
            there = there or present[c] != 0.0
        out.there[0, 0, r] = 1.0 if there else 0.0
    if model.instrument == STRAPDOWN:
        for r in range(group.shape[0]):
            attitude = model.attitudes[group[r], k]
            for i in range(3):
                for j in range(3):
                    out.attitudes[0, 3 * i + j, r] = attitude[i, j]
