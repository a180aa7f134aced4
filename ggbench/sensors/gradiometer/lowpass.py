"""Butterworth low-pass filter of the gradiometer, and compensation of its effects.

The instrument filters samples x by a causal difference equation, y = L x, with a lower triangular
L; the first ``order`` outputs equal the inputs. The measurement model uses the filtered measurement
minus the filtered prediction along the INS track. Two treatments compensate the effects of the
filter, which are delay and coloured noise:

``whitened``
    The filter is causal and invertible, so its output contains all information of its input. A
    Kalman filter with the states of the low-pass as additional states would recover this
    information. The low-pass is linear and known, so its innovation form is computed once, for all
    estimators: y is multiplied by A = C⁻¹ with C Cᵀ = L Lᵀ + ρ² I (Cholesky). A delay of about one
    sample remains. If ρ is the noise after the low-pass in units of the noise before it, A y has
    white noise. Unmodelled noise is amplified by up to 1/ρ near the Nyquist frequency, where the
    low-pass passes no signal. Therefore ρ has a lower limit, the regularisation. If the actual
    noise after the low-pass is below this limit, the noise covariance of A y is at most the assumed
    unit covariance. If there is no noise after the low-pass, this covariance is smaller than
    assumed in directions without signal.

``delayed``
    y is a measurement of the state one group delay earlier, with the noise of the unfiltered
    samples ("fixed delay compensation" in Wang et al. 2013, made consistent). During the start of
    the filter some outputs are noisier than the inputs; they are scaled down to the noise of the
    inputs.

Both treatments have the same form. Let W = A L, with a diagonal A for ``delayed``. A slowly varying
error signal d(t) then appears in output k as g_k d(t_k − τ_k). The gain g_k is the sum of row k of
W, and the delay τ_k is the centroid of the lags in this row.

After the start of the filter, every row of A and W equals the previous row, shifted by one output.
Only the band of significant lags is stored, so the cost per output does not depend on the duration.
An equivalent difference equation would lose half the digits for a low cut-off frequency.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from scipy.linalg import hankel, qr, solve_triangular

from ...errors import GGBenchError
from ...numerics.frozen import frozen

Treatment = Literal["whitened", "delayed"]
_MOST_ROUNDING = 1e-9
"""Largest allowed rounding error of a filter, relative to its largest response."""
_FORGOTTEN = 2e-13
"""Largest negligible entry of A or W, relative to the largest entry."""
_SHORT = 512
"""Largest number of outputs for which A is always stored as one full matrix."""
_ROWS = 64
"""Smallest number of later outputs that are computed together from the band of A."""


@dataclass(frozen=True)
class LowPass:
    """Digital Butterworth low-pass (bilinear transform).

    Attributes
    ----------
    order : number of poles.
    cutoff_hz : −3 dB frequency [Hz], below the Nyquist frequency.
    rate_hz : sampling rate [Hz].
    """

    order: int
    cutoff_hz: float
    rate_hz: float

    def apply(self, samples: np.ndarray) -> np.ndarray:
        """Filter ``samples`` (K,) or (..., K, m) along time.

        The first ``order`` samples are unchanged.
        """
        from scipy.signal import lfilter  # takes half a second, and not every flight has a filter

        samples = np.asarray(samples, dtype=float)
        columns = samples[:, np.newaxis] if samples.ndim == 1 else samples
        first, later = np.split(columns, [self.order], axis=-2)
        if not later.size:
            return samples.copy()
        numerator, denominator = _difference_equation(self)
        # The state of the filter's transposed direct form after equal inputs and outputs.
        state = hankel((numerator - denominator)[1:]) @ first[..., ::-1, :]
        later, _ = lfilter(numerator, denominator, later, axis=-2, zi=state)
        return np.concatenate([first, later], axis=-2).reshape(samples.shape)


@lru_cache(maxsize=16)
def _difference_equation(lowpass: LowPass) -> tuple[np.ndarray, np.ndarray]:
    """Return the numerator and denominator coefficients (order + 1,) of the filter."""
    from scipy.signal import butter

    numerator, denominator = butter(lowpass.order, lowpass.cutoff_hz, fs=lowpass.rate_hz)
    return numerator, denominator


def _rounding(lowpass: LowPass, count: int) -> float:
    """Return a bound of the rounding errors in ``count`` outputs, relative to the largest response.

    The difference equation is D y = N x, and ε is the machine precision. The bound is the largest
    entry of |D⁻¹| (|N| + |D| |L|) ε. To first order, it contains the effect of rounded
    coefficients and rounded terms of each step on all later outputs. Large entries of L do not
    indicate rounding errors: a filter of high order has a true transient at the start.
    """
    from scipy.signal import lfilter

    order = lowpass.order
    if count <= order:
        return 0.0
    numerator, denominator = _difference_equation(lowpass)
    # The response to any later input is the last one's, shifted.
    inputs = np.eye(count, order + 1)
    outputs = lowpass.apply(inputs)
    echo = np.abs(lfilter([1.0], denominator, np.eye(1, count - order)[0]))
    past = np.append(0.0, np.abs(denominator[1:]))
    with np.errstate(all="ignore"):  # poles that rounding takes out of the unit circle
        errors = [
            _convolved(
                echo,
                np.convolve(np.abs(numerator), np.abs(x))[order:count]
                + np.convolve(past, np.abs(y))[order:count],
            )
            for x, y in zip(inputs.T, outputs.T, strict=True)
        ]
        return float(np.finfo(float).eps * np.max(errors) / np.abs(outputs).max())


def _convolved(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the first K terms of the convolution of two sequences (K,), by Fourier transforms."""
    count = 2 * len(one)
    return np.fft.irfft(np.fft.rfft(one, count) * np.fft.rfft(other, count), count)[: len(one)]


@dataclass(frozen=True)
class Prefilter:
    """Linear map from the instrument's output to the measurements of the estimators.

    The map is a lower-triangular matrix A (K, K) for the K outputs of each channel, see
    :mod:`.gradiometer.lowpass`.

    Attributes
    ----------
    matrix : (S, S) first S rows and columns of A; None if A is the identity. If the effect of the
        start decays, S covers the start of the filter; otherwise S is K.
    later : (C, C + B − 1) block of A for C successive outputs after the first S. The same block
        applies to the next C outputs, and so on. Row i is zero outside the columns i to i + B − 1:
        an output depends on B inputs. The array is empty if S is K.
    gain, delay_samples : (K,) gain g_k and delay τ_k [samples] of the low-pass followed by A, for
        slow signals.
    """

    matrix: np.ndarray | None
    later: np.ndarray
    gain: np.ndarray
    delay_samples: np.ndarray

    def apply(self, output: np.ndarray) -> np.ndarray:
        """Return A times the output sequences (K,) or (..., K, m) of the instrument."""
        if self.matrix is None:
            return output
        sequences = output[:, np.newaxis] if output.ndim == 1 else output
        head, count, (rows, width) = len(self.matrix), sequences.shape[-2], self.later.shape
        parts = [self.matrix @ sequences[..., :head, :]]
        for first in range(head, count, max(rows, 1)):
            last = min(first + rows, count)
            seen = sequences[..., first + rows - width : last, :]
            parts.append(self.later[: last - first, : seen.shape[-2]] @ seen)
        return np.concatenate(parts, axis=-2).reshape(output.shape)


def _head(
    lowpass: LowPass, count: int, treatment: Treatment, rho: float
) -> tuple[np.ndarray | None, np.ndarray, int]:
    """Return A and W for ``count`` outputs, and the number of significant lags in their last rows.

    The number is ``count`` if the effect of the start has not decayed.
    """
    identity = np.eye(count)
    response = lowpass.apply(identity)
    matrix = None
    chain = response
    noise = np.linalg.norm(response, axis=1)
    if treatment == "delayed" and (noise > 1.0 + _MOST_ROUNDING).any():
        matrix = np.diag(1.0 / np.maximum(noise, 1.0))
        chain = matrix @ response
    if treatment == "whitened":
        # QR of [L, ρ I]ᵀ gives the Cholesky factor of L Lᵀ + ρ² I without squaring its condition.
        (factor,) = qr(np.vstack([response.T, rho * identity]), mode="r")
        factor = factor[:count] * np.sign(np.diag(factor[:count]))[:, None]
        matrix = solve_triangular(factor, identity, trans="T")
        chain = matrix @ response
    known = [chain] if matrix is None else [matrix, chain]
    return matrix, chain, max(map(_reach, known))


def _reach(rows: np.ndarray) -> int:
    """Return the number of significant lags in the last row of a triangular matrix (H, H).

    The number is H if the rows have not converged. They have converged if the row at three quarters
    of H equals the last row, and at most half of the lags are significant.
    """
    count = len(rows)
    last, before = rows[-1, ::-1], rows[3 * count // 4, 3 * count // 4 :: -1]
    least = _FORGOTTEN * np.abs(rows).max()
    reach = int(np.flatnonzero(np.abs(last) > least)[-1]) + 1
    if 2 * reach > count or np.abs(last[: len(before)] - before).max() > least:
        return count
    return reach


@lru_cache(maxsize=16)
def prefilter(lowpass: LowPass | None, count: int, treatment: Treatment, rho: float) -> Prefilter:
    """Return the linear map that compensates a low-pass, for ``count`` outputs.

    Parameters
    ----------
    lowpass : low-pass filter of the instrument; None gives the identity.
    count : number K of outputs of the instrument.
    treatment : ``whitened`` or ``delayed``, see :mod:`.gradiometer.lowpass`.
    rho : noise after the filter in units of the noise before the filter; used for ``whitened``.

    Raises
    ------
    GGBenchError
        If the difference equation of the filter cannot be computed in double precision.
    """
    nothing = np.empty((0, 0))
    if lowpass is None:
        return Prefilter(None, nothing, frozen(np.ones(count)), frozen(np.zeros(count)))
    rounding = _rounding(lowpass, count)
    if not rounding < _MOST_ROUNDING:
        raise GGBenchError(
            f"the low-pass of order {lowpass.order} at {lowpass.cutoff_hz:g} Hz cannot be computed "
            f"at a rate of {lowpass.rate_hz:g} Hz: rounding errors may reach {rounding:.0e} of its "
            f"response, and {_MOST_ROUNDING:.0e} is allowed; use a lower order, or a cut-off "
            f"farther from 0 and from the Nyquist frequency, {0.5 * lowpass.rate_hz:g} Hz"
        )
    size = min(count, _SHORT)
    matrix, chain, reach = _head(lowpass, size, treatment, rho)
    while size < count and reach == size:
        size = min(count, 2 * size)
        matrix, chain, reach = _head(lowpass, size, treatment, rho)
    samples = np.arange(size)
    gain = chain.sum(axis=1)
    # The first outputs may extrapolate: to before the first reading, or beyond their own.
    delay = np.clip(samples - chain @ samples / gain, 0.0, samples)
    later = nothing
    if matrix is not None and size < count:
        lags = matrix[-1, size - reach :]
        rows = max(reach, _ROWS)
        later = np.zeros((rows, rows + reach - 1))
        for row in range(rows):
            later[row, row : row + reach] = lags
    on = (0, count - size)
    return Prefilter(
        None if matrix is None else frozen(matrix),
        frozen(later),
        frozen(np.pad(gain, on, mode="edge")),
        frozen(np.pad(delay, on, mode="edge")),
    )
