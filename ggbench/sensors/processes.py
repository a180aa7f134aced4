"""Random processes of biases, faults and mounts at the times of measurements.

Times increase and count from the start of the flight. Each process begins at time zero.
"""

from __future__ import annotations

import numpy as np


def random_walk(
    times: np.ndarray, root_psd: float, width: int, rng: np.random.Generator
) -> np.ndarray:
    """Return random walks (K, width) that start at 0, with a root PSD [1/√s]."""
    steps = np.sqrt(np.diff(times, prepend=0.0))[:, np.newaxis]
    return np.cumsum(root_psd * steps * rng.standard_normal((len(times), width)), axis=0)


def gauss_markov(
    times: np.ndarray, correlation_time: float, width: int, rng: np.random.Generator
) -> np.ndarray:
    """Return first-order Gauss–Markov processes (K, width) of variance 1.

    They are stationary: x_k = e^(−Δt/T) x_{k−1} + √(1 − e^(−2Δt/T)) w_k with the correlation time T
    and w_k ~ N(0, 1).
    """
    drawn = rng.standard_normal((len(times) + 1, width))
    out, last = np.empty((len(times), width)), drawn[0]
    for k, kept in enumerate(remaining(times, correlation_time)):
        last = kept * last + np.sqrt(1.0 - kept**2) * drawn[k + 1]
        out[k] = last
    return out


def remaining(times: np.ndarray, correlation_time: float) -> np.ndarray:
    """Return the decay factor (K,) of a Gauss–Markov process from the previous time to each time.

    The factor is e^(−Δt/T), with the interval Δt and the correlation time T. The first interval is
    that from time zero to the first time.
    """
    return np.asarray(np.exp(-np.diff(times, prepend=0.0) / correlation_time))


def bursts(
    times: np.ndarray, share: float, duration: float, width: int, rng: np.random.Generator
) -> np.ndarray:
    """Return a mask (K, width) of the times at which two-state Markov chains are on.

    A chain is on for a fraction ``share`` of the time, in intervals with the mean ``duration`` [s].
    The rate of switching off is 1/duration, and the rate of switching on is share/((1 − share)
    duration). Therefore the correlation decays as e^(−Δt/((1 − share) duration)). With a duration
    of 0 all times are independent.
    """
    forgotten = np.zeros(len(times))
    if duration > 0.0:
        forgotten[1:] = np.exp(-np.diff(times) / ((1.0 - share) * duration))
    enters = (share * (1.0 - forgotten))[:, np.newaxis]
    stays = (share + (1.0 - share) * forgotten)[:, np.newaxis]
    drawn = rng.random((len(times), width))
    # One number decides: below both probabilities it is struck, above both it is not, between
    # them it goes on as it was.
    struck, decided = drawn < enters, (drawn < enters) | (drawn >= stays)
    rows = np.arange(len(times))[:, np.newaxis]
    last = np.maximum.accumulate(np.where(decided, rows, 0), axis=0)
    return np.asarray(np.take_along_axis(struck, last, axis=0))
