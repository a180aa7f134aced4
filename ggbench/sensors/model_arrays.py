"""Arrays of the measurement equation, and the parameters of one epoch for eight runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..gravity.field import DisturbanceMap
from ..gravity.spline import TENSOR_WORK
from ..numerics import lanes
from ..numerics.kernels import compiled
from ..numerics.records import record
from .gradiometer.instrument import STRAPDOWN


@record
class ModelArrays:
    """Measurement equation of all channels of all sensors, as arrays.

    h_k(x) = offset_k + C_k x + gain_k Σ_i S_ki T(p̂_{k−lag_i} − B_k x) + W_k δg(p̂_k − x)

    The m channels are the g channels of the gradiometer, then those of the other sensors. T is the
    gravity-gradient tensor of the field in mount axes, [xx, xy, xz, yy, yz, zz] in E. δg is the
    gravity disturbance of the map, ENU [m/s²]. Both are evaluated at INS positions p̂ minus
    position errors ENU [m]. If the mount is fixed to the body, T is also rotated by the INS
    attitude minus the attitude error [rad]. The sum is over the measurements that the whitening of
    coloured noise combines; without whitening there is one term with lag 0. For sensors other than
    the gradiometer the rows of S_ki are zero.

    The sensor states have columns in C_k (gravity disturbance, biases and lever arms) or in B_k
    (mounting angles). Constant biases of the gradiometer are whitened like its measurements. A
    missing measurement has a zero offset and zero rows.

    In a block of runs the arrays in :data:`OF_A_RUN` have the run as leading axis.

    Attributes
    ----------
    dimension : number of states n. The first three are the position error ENU [m].
    instrument : index of :data:`.instrument.INSTRUMENTS`; strapdown if mounting angles are states,
        see :mod:`.gradiometer.mounting`.
    channels : (g, 6) S, from the tensor in the mount to the gradiometer's channels.
    combined : (1 or K, T, g, 6) S_ki, one for all epochs or one for each epoch. In shapes, T is the
        number of terms of the sum.
    lags : (1 or K, T) lag_i of each term [epochs]; −1 for an unused term.
    origin, step, coefficients, base : map of T, see :class:`.field.Field`.
    times : (K,) t_k − τ_k, measurement times of the gradiometer [s].
    references : (K, 3) INS positions at these times [rad, rad, m].
    attitudes : (K, 3, 3) INS attitudes C_nb, or attitudes of the mount, at these times; only for
        ``STRAPDOWN``.
    rows : (K, 6, 15 to n) B_k, which maps x to the errors of position, ENU [m], and attitude [rad]
        at these times; states without columns have no effect.
    offset : (K, m) constant term of h [unit of the channel].
    gain : (K,) gain of the gradiometer's low-pass and prefilter; zero for a missing measurement.
    linear : (K, m, n) C_k [unit of the channel per unit of the state].
    first_linear : first channel with non-zero C_k or W_k; m if there is none.
    columns : (s,) indices of the states that affect C_k x + W_k δg, ascending; see
        :func:`linear_reach`.
    weights : (K, m, 3) W_k [unit of the channel per m/s²].
    places : (K, 3) INS positions at the epochs [rad, rad, m].
    gravity : map of δg; empty if all W_k are zero.
    """

    dimension: int
    instrument: int
    channels: np.ndarray
    combined: np.ndarray
    lags: np.ndarray
    origin: np.ndarray
    step: np.ndarray
    coefficients: np.ndarray
    base: np.ndarray
    times: np.ndarray
    references: np.ndarray
    attitudes: np.ndarray
    rows: np.ndarray
    offset: np.ndarray
    gain: np.ndarray
    linear: np.ndarray
    first_linear: int
    columns: np.ndarray
    weights: np.ndarray
    places: np.ndarray
    gravity: DisturbanceMap

    def of_run(self, run: int) -> ModelArrays:
        """Return the arrays of one run of a block."""
        return self.mapped(lambda array: array[run])

    def as_block(self) -> ModelArrays:
        """Return the arrays of one run as a block with one run."""
        return self.mapped(lambda array: array[np.newaxis])

    def mapped(self, change: Callable[..., np.ndarray], *others: ModelArrays) -> ModelArrays:
        """Return a copy in which a function replaces each array that is specific to a run.

        Parameters
        ----------
        change : function that returns the new array (...), given the array of this model and the
            corresponding array of each of ``others``.
        others : models with arrays to combine with those of this model.
        """
        models = (self, *others)
        own: dict[str, Any] = {
            name: change(*(getattr(model, name) for model in models)) for name in OF_A_RUN
        }
        if others:
            own["first_linear"] = min(model.first_linear for model in models)
            columns = np.unique(np.concatenate([model.columns for model in models]))
            own["columns"] = immutable(columns)
        return replace(self, **own)


OF_A_RUN = (
    "references",
    "attitudes",
    "rows",
    "offset",
    "gain",
    "linear",
    "weights",
    "places",
)
"""Names of the arrays that have the run as leading axis in a block."""


def linear_reach(linear: np.ndarray, weights: np.ndarray) -> tuple[int, np.ndarray]:
    """Return the attributes ``first_linear`` and ``columns`` (s,) of :class:`ModelArrays`.

    ``linear`` (..., m, n) is C_k, and ``weights`` (..., m, 3) is W_k.
    """
    m, n = linear.shape[-2:]
    used = np.asarray(linear.reshape(-1, m, n).any(axis=0))
    weighed = np.asarray(weights.reshape(-1, m, 3).any(axis=(0, 2)))
    used[:, :3] |= weighed[:, np.newaxis]
    channels = np.flatnonzero(used.any(axis=1))
    return int(channels[0]) if len(channels) else m, immutable(np.flatnonzero(used.any(axis=0)))


def immutable(indices: np.ndarray) -> np.ndarray:
    """Return a read-only copy of an array (...) of integers."""
    return np.frombuffer(indices.tobytes(), indices.dtype).reshape(indices.shape)


@record
class EpochContext:
    """Parameters of h at one epoch for eight runs, one run per lane.

    Attributes
    ----------
    references : (T, 3, lanes) INS positions at the times of the T combined measurements
        [rad, rad, m].
    attitudes : (1, 9, lanes) attitude C_nb of the INS or of the mount, row by row; filled only for
        ``STRAPDOWN``.
    offset : (1, m, lanes) constant term of h [unit of the channel].
    gain : (1, 1, lanes) gain of the gradiometer.
    """

    references: np.ndarray
    attitudes: np.ndarray
    offset: np.ndarray
    gain: np.ndarray


@record
class PointScratch:
    """Scratch for the evaluation of h at S vectors of eight points.

    Attributes
    ----------
    places : (3, S, lanes) latitude, longitude [rad], height [m].
    tensors : (24, S, lanes) tensors and their derivatives.
    work : scratch of the spline evaluation.
    """

    places: np.ndarray
    tensors: np.ndarray
    work: np.ndarray


@compiled
def epoch_context(model: ModelArrays) -> EpochContext:
    """Return an unfilled :class:`EpochContext` for a block."""
    new, m = lanes.lanes, model.offset.shape[2]
    return EpochContext(new(model.lags.shape[1], 3), new(1, 9), new(1, m), new(1, 1))


@compiled
def point_scratch(count: int) -> PointScratch:
    """Return scratch for ``count`` ≥ 1 vectors of eight points."""
    new = lanes.lanes
    return PointScratch(new(3, count), new(24, count), np.empty(TENSOR_WORK))


@compiled
def load_epoch(model: ModelArrays, group: np.ndarray, k: int, out: EpochContext) -> None:
    """Fill ``out`` with the parameters of h at epoch ``k`` for the runs ``group`` (lanes,)."""
    lags = model.lags[min(k, model.lags.shape[0] - 1)]
    for i in range(lags.shape[0]):
        if lags[i] >= 0:
            lanes.gather_row(model.references, group, k - lags[i], out.references[i : i + 1])
    lanes.gather_row(model.offset, group, k, out.offset)
    for r in range(group.shape[0]):
        out.gain[0, 0, r] = model.gain[group[r], k]
    if model.instrument == STRAPDOWN:
        for r in range(group.shape[0]):
            attitude = model.attitudes[group[r], k]
            for i in range(3):
                for j in range(3):
                    out.attitudes[0, 3 * i + j, r] = attitude[i, j]
