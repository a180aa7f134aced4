"""The gradiometer's Butterworth low-pass, and what an estimator can do about it.

The instrument filters its readings by a causal difference equation, y = L x (L lower triangular,
the first ``order`` outputs equal the inputs). A measurement model sees ``filter(reading)`` minus
the same filter run over the readings predicted along the INS track, and answers its two effects,
delay and coloured noise, by one of two treatments:

``whitened``
    The filter is causal and invertible, so its output carries all the information of its input. A
    state augmented by the filter's own would recover it; since the filter is linear and known, the
    innovation form of that augmented filter can be run once, ahead of all estimators: y is
    multiplied by A = C⁻¹ with C Cᵀ = L Lᵀ + ρ² I (Cholesky). A y has white noise again, and a
    delay of a fraction of a sample remains. ρ is the noise allowed behind the filter, relative to
    the noise in front of it. The paper's instrument has none, but an exact inverse (ρ = 0)
    amplifies rounding without limit at the Nyquist frequency, where the filter passes nothing.

``delayed``
    y is taken as it is, as a measurement of the state one group delay ago with the noise of the
    unfiltered data (the paper's "fixed delay compensation", done consistently).

Both are the same formula: with W = A L (A = I for ``delayed``) a slowly varying error signal d(t)
appears as g_k d(t_k − τ_k), where g_k is the sum of row k of W and τ_k the centroid of its lags.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from scipy import signal
from scipy.linalg import qr, solve_triangular

from .errors import GGBenchError
from .problem import frozen

Treatment = Literal["whitened", "delayed"]


@dataclass(frozen=True)
class LowPass:
    """Digital Butterworth low-pass (bilinear transform).

    Attributes
    ----------
    order : number of poles.
    cutoff_hz : −3 dB frequency [Hz], below the Nyquist frequency.
    rate_hz : sampling rate [Hz].

    Raises
    ------
    GGBenchError
        If the cut-off is not below the Nyquist frequency: no such filter exists.
    """

    order: int
    cutoff_hz: float
    rate_hz: float

    def __post_init__(self) -> None:
        if not 0.0 < self.cutoff_hz < 0.5 * self.rate_hz:
            raise GGBenchError(
                f"a low-pass with cut-off {self.cutoff_hz:g} Hz cannot exist at {self.rate_hz:g} Hz"
                f": the cut-off must lie between 0 and the Nyquist frequency, "
                f"{0.5 * self.rate_hz:g} Hz"
            )

    def apply(self, samples: np.ndarray) -> np.ndarray:
        """Filter ``samples`` (K, ...) along the first axis; the first ``order`` pass unchanged."""
        numerator, denominator = signal.butter(self.order, self.cutoff_hz, fs=self.rate_hz)
        start = min(self.order, len(samples))
        filtered = np.array(samples, dtype=float)
        if len(samples) == start:
            return filtered
        flat = filtered.reshape(len(samples), -1)
        for column in flat.T:
            past = column[start - 1 :: -1]
            state = signal.lfiltic(numerator, denominator, y=past, x=past)
            column[start:], _ = signal.lfilter(numerator, denominator, column[start:], zi=state)
        return filtered

    def dc_delay(self) -> float:
        """Return the delay of a slow signal [samples]."""
        numerator, denominator = signal.butter(self.order, self.cutoff_hz, fs=self.rate_hz)
        # Not scipy.signal.group_delay: its response at DC is −d(phase)/dω, exactly this sum.
        lags = np.arange(self.order + 1)
        return float(lags @ numerator / numerator.sum() - lags @ denominator / denominator.sum())


@dataclass(frozen=True)
class Prefilter:
    """What turns the instrument's output into the measurements that estimators see.

    Attributes
    ----------
    matrix : (K, K) lower-triangular A, applied to each component's output sequence.
    gain, delay_samples : (K,) g_k and τ_k (in samples) of the chain filter + A for slow signals.
    """

    matrix: np.ndarray
    gain: np.ndarray
    delay_samples: np.ndarray


@lru_cache(maxsize=16)
def prefilter(lowpass: LowPass | None, count: int, treatment: Treatment, rho: float) -> Prefilter:
    """Return the treatment of ``count`` outputs of a low-pass (None: no filter, the identity).

    Parameters
    ----------
    lowpass : the instrument's filter.
    count : number of epochs K.
    treatment : ``whitened`` or ``delayed``, see the module's docstring.
    rho : noise behind the filter over noise in front of it, for ``whitened``.
    """
    identity = np.eye(count)
    if lowpass is None:
        return Prefilter(frozen(identity), frozen(np.ones(count)), frozen(np.zeros(count)))
    response = lowpass.apply(identity)
    if treatment == "delayed":
        matrix = identity
    else:
        # QR of [L, ρ I]ᵀ gives the Cholesky factor of L Lᵀ + ρ² I without squaring its condition.
        (factor,) = qr(np.vstack([response.T, rho * identity]), mode="r")
        factor = factor[:count] * np.sign(np.diag(factor[:count]))[:, None]
        matrix = solve_triangular(factor, identity, trans="T")
    chain = matrix @ response
    samples = np.arange(count)
    gain = chain.sum(axis=1)
    delay = np.maximum(samples - chain @ samples / gain, 0.0)
    return Prefilter(frozen(matrix), frozen(gain), frozen(delay))
