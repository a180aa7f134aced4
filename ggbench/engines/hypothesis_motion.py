"""Distances along INS tracks, and changes of gravity from integrated gradients."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..block import ProblemBlock
from ..gravity.ellipsoid import EOTVOS, normal_gradient_of
from ..numerics.kernels import compiled
from ..sensors.gradiometer.instrument import LOCAL_LEVEL

_EARTH_RADIUS = 6.371e6
_COMPONENTS = np.array([0, 1, 2, 1, 3, 4, 2, 4, 5])
"""Those of a tensor's matrix, row by row."""
_WITHOUT_TRACE = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0])


class Motion(NamedTuple):
    """Track data of a block at each epoch, for hypotheses with spatially correlated errors.

    Attributes
    ----------
    ways : (R, K) distance flown since the previous epoch [m]. At the first epoch it is the distance
        since the start. It is zero without a track.
    known : (R, K, 3) change of the acceleration error −δg since the start of the flight, ENU
        [m/s²]. δg is the gravity that the INS does not compensate. The change is integrated from
        measured gradients. The entry of epoch k is the mean of the changes at the epochs k − 1 and
        k. All entries are zero without a track or without gradients of the whole tensor.
    walked : (R, K) variance that gradient noise adds to the integral at each epoch [m²/s⁴].
    """

    ways: np.ndarray
    known: np.ndarray
    walked: np.ndarray


def motion_of(block: ProblemBlock) -> Motion:
    """Return the track data of all epochs of a block."""
    runs, epochs = block.runs, block.epochs
    known, walked = np.zeros((runs, epochs, 3)), np.zeros((runs, epochs))
    if block.tracks is None:
        return Motion(np.zeros((runs, epochs)), known, walked)
    if whole_tensor(block):
        change, walked = _integrated_gradients(block)
        known = 0.5 * change
        known[:, 1:] += 0.5 * change[:, :-1]
    speeds = np.linalg.norm(block.tracks[..., 3:6], axis=2)
    return Motion(speeds * np.diff(block.times, prepend=0.0), known, walked)


def whole_tensor(block: ProblemBlock) -> bool:
    """Return whether the gradiometer measures the whole tensor in local-level axes.

    The result is False without a track. It is also False if the measurements are filtered or late.
    """
    model = block.model
    if block.tracks is None or model.instrument != LOCAL_LEVEL or len(model.lags) > 1:
        return False
    if model.lags.shape[1] != 1 or model.lags[0, 0] != 0 or not len(model.channels):
        return False
    return bool(np.linalg.matrix_rank(np.vstack([model.channels, _WITHOUT_TRACE])) == 6)


def _integrated_gradients(block: ProblemBlock) -> tuple[np.ndarray, np.ndarray]:
    """Return the change (R, K, 3) of the acceleration error of the INS, ENU [m/s²].

    The change is integrated from measured gradients along the INS track. The second result (R, K)
    is the variance that measurement noise adds at each epoch [m²/s⁴].
    """
    assert block.tracks is not None
    model, tracks = block.model, block.tracks
    g = len(model.channels)
    covs = block.noise_cov.reshape(-1, *block.noise_cov.shape[-2:])
    sigma = math.sqrt(np.mean(covs[0].diagonal()[:g]))
    inverse = np.linalg.pinv(np.vstack([model.channels, _WITHOUT_TRACE * 1e3]))[:, :g]
    normal = np.zeros((*tracks.shape[:2], 6))
    _fill_normal(tracks, normal)
    gain = model.gain[..., np.newaxis]
    readings = block.measurements[..., :g] - model.offset[..., :g]
    readings = readings - gain * (normal @ model.channels.T)
    change = np.zeros((*tracks.shape[:2], 3))
    steps = np.diff(block.times, prepend=0.0)
    _integrate(
        tensors=EOTVOS * (readings @ inverse.T)[..., _COMPONENTS],
        there=block.present[..., :g].all(axis=2),
        tracks=tracks,
        steps=steps,
        change=change,
    )
    velocity = tracks[..., 3:6].copy()
    velocity[:, 1:] += tracks[:, :-1, 3:6]
    velocity[:, 0] += tracks[:, 0, 3:6]
    ways = steps * np.linalg.norm(0.5 * velocity, axis=2)
    return change, (EOTVOS * sigma * ways) ** 2


@compiled
def _fill_normal(tracks: np.ndarray, normal: np.ndarray) -> None:
    """Fill the normal gradient (R, K, 6) [E] along tracks (R, K, 15)."""
    for r in range(tracks.shape[0]):
        for k in range(tracks.shape[1]):
            sine, cosine = math.sin(tracks[r, k, 0]), math.cos(tracks[r, k, 0])
            ee, nn, nu, uu = normal_gradient_of(sine, cosine, tracks[r, k, 2])
            normal[r, k, 0], normal[r, k, 3] = ee, nn
            normal[r, k, 4], normal[r, k, 5] = nu, uu


@compiled
def _integrate(
    tensors: np.ndarray,
    there: np.ndarray,
    tracks: np.ndarray,
    steps: np.ndarray,
    change: np.ndarray,
) -> None:
    """Fill ``change`` (R, K, 3) with −∫ (T v + ω × change) dt along tracks.

    T is the disturbing gradient, v the velocity, and ω the transport rate.

    Parameters
    ----------
    tensors : (R, K, 9) disturbing gradients T [s⁻²] ENU, row by row.
    there : (R, K) mask of the measured gradients; a missing one is replaced by the previous one.
    tracks : (R, K, 15) indicated position, velocity and C_nb (row by row).
    steps : (K,) time since the previous epoch [s].
    """
    held, velocity, total = np.empty(9), np.empty(3), np.empty(3)
    for r in range(tensors.shape[0]):
        total[:] = 0.0
        for i in range(9):
            held[i] = tensors[r, 0, i]
        for k in range(tensors.shape[1]):
            new = tensors[r, k] if there[r, k] else held
            for i in range(3):
                velocity[i] = 0.5 * (tracks[r, max(k - 1, 0), 3 + i] + tracks[r, k, 3 + i])
            # To the flattening of the Earth.
            east, north = velocity[0] / _EARTH_RADIUS, velocity[1] / _EARTH_RADIUS
            w_0, w_1, w_2 = -north, east, east * math.tan(tracks[r, k, 0])
            t_0, t_1, t_2 = total[0], total[1], total[2]
            total[0] -= steps[k] * (w_1 * t_2 - w_2 * t_1)
            total[1] -= steps[k] * (w_2 * t_0 - w_0 * t_2)
            total[2] -= steps[k] * (w_0 * t_1 - w_1 * t_0)
            for i in range(3):
                rate = 0.0
                for j in range(3):
                    rate += 0.5 * (new[3 * i + j] + held[3 * i + j]) * velocity[j]
                total[i] -= steps[k] * rate
                change[r, k, i] = total[i]
            for i in range(9):
                held[i] = new[i]
