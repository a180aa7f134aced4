"""Extended and unscented Kalman filters on many runs at once, compiled.

The same equations as filterpy's, which remain the reference: a test holds both together.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from . import kalman
from .block import ProblemBlock
from .gradiometer import STRAPDOWN
from .kernels import compiled, summed
from .measurement_kernels import ModelArrays, linearise_errors, predict_errors, run_arrays

SIZES = ((16, 3), (16, 6), (24, 9))
"""Numbers of states and of components that kernels are made for."""


@compiled
def whitened_reading(
    model: ModelArrays,
    k: int,
    x: np.ndarray,
    measurement: np.ndarray,
    noise_inverse: np.ndarray,
    moving: int,
    work: np.ndarray,
    rows: np.ndarray,
    innovation: np.ndarray,
) -> tuple[float, bool]:
    """Fill a reading's equations H δx = innovation + noise of unit variance, linearised at x.

    Parameters
    ----------
    model, k, x, measurement : arrays of one run, epoch, state (n,) or longer, reading (m,).
    noise_inverse : (m, m) inverse of the lower triangular root of R.
    moving : of how many errors (the first columns of B_k) h is a function.
    work : (3, 9, 9) scratch.
    rows, innovation : (channels, width), (channels,) outputs; ``channels`` may be ``moving`` if
        there are no biases: an orthogonal transformation leaves so many equations.

    Returns
    -------
    The sum of the squares of what that transformation leaves out, which no state explains; and
    whether there was a reading at all.
    """
    m, columns = measurement.shape[0], model.rows.shape[2]
    biased = model.bias >= 0
    raw, slope = work[0], work[1]
    error, residual, predicted = work[2, 0], work[2, 1], work[2, 2]
    b = model.rows[k]
    for i in range(moving):
        total = 0.0
        for j in range(columns):
            total += b[i, j] * x[j]
        error[i] = total
    linearise_errors(model, k, error, predicted, raw)
    gain = model.gain[k]
    present = False
    for i in range(m):
        predicted[i] = measurement[i] - predicted[i]
        if biased:
            predicted[i] -= gain * x[model.bias + i]
        present |= predicted[i] != 0.0 or raw[i, 0] != 0.0
    for i in range(m):
        total = 0.0
        for c in range(i + 1):
            total += noise_inverse[i, c] * predicted[c]
        residual[i] = total
        for j in range(moving):
            total = 0.0
            for c in range(i + 1):
                total += noise_inverse[i, c] * raw[c, j]
            slope[i, j] = total
    left = 0.0
    used = m
    if rows.shape[0] < m:
        left = kalman.compress(slope, residual, m, moving)
        used = moving
    for i in range(used):
        innovation[i] = residual[i]
        row = rows[i]
        for c in range(columns):
            total = 0.0
            for j in range(moving):
                total += slope[i, j] * b[j, c]
            row[c] = total
        if biased:
            for c in range(m):
                row[model.bias + c] = gain * noise_inverse[i, c]
    return left, present


def _make_extended(width: int, channels: int) -> Callable[..., Any]:
    """Return the kernel of the extended Kalman filter for up to so many states and components."""

    @compiled
    def extended(
        measurements: np.ndarray,
        noise_inverse: np.ndarray,
        transition: np.ndarray,
        process_cov: np.ndarray,
        prior_mean: np.ndarray,
        prior_cov: np.ndarray,
        model: ModelArrays,
        mean: np.ndarray,
        cov: np.ndarray,
        nis: np.ndarray,
    ) -> None:
        runs, epochs, m = measurements.shape
        n, m = prior_mean.shape[0], min(m, channels)
        moving = 6 if model.instrument == STRAPDOWN else 3
        phi, phi_t = np.zeros((width, width)), np.zeros((width, width))
        p, scratch = np.zeros((width, width)), np.zeros((width, width))
        rows, hp = np.zeros((channels, width)), np.zeros((channels, width))
        gain_t, spread_t = np.zeros((channels, width)), np.zeros((channels, width))
        half_t, s = np.zeros((channels, width)), np.zeros((channels, channels))
        root, inverse = np.zeros((channels, channels)), np.zeros((channels, channels))
        innovation, white = np.zeros(channels), np.zeros(channels)
        work = np.zeros((3, 9, 9))
        x = np.zeros(width)
        for run in range(runs):
            own = run_arrays(model, run)
            x[:n] = prior_mean
            p[:, :] = 0.0
            p[:n, :n] = prior_cov
            for k in range(epochs):
                changing = kalman.padded(transition[run, k], phi, phi_t)
                kalman.predict(phi, phi_t, changing, process_cov[run, k], x, p, scratch, width)
                squared, present = whitened_reading(
                    own, k, x, measurements[run, k], noise_inverse, moving, work, rows, innovation
                )
                kalman.project(rows, p, hp, s, m, width)
                kalman.invert_root(s, root, inverse, m)
                squared += kalman.whiten(inverse, innovation, white, m)
                nis[run, k] = squared if present else np.nan
                kalman.times(inverse, hp, half_t, m, channels, width)
                for j in range(width):
                    total = x[j]
                    for c in range(channels):
                        total += half_t[c, j] * white[c]
                    x[j] = total
                kalman.transpose_times(inverse, half_t, gain_t, m, channels, width)
                kalman.joseph(gain_t, hp, rows, p, scratch, spread_t, n, m, channels, width)
                mean[run, k] = x[:n]
                cov[run, k] = p[:n, :n]

    return extended


@compiled
def _root(matrix: np.ndarray, out: np.ndarray) -> bool:
    """Fill the upper triangular U (n, n) with Uᵀ U = P, or with its nearest positive part.

    Returns whether P had to be repaired, as :class:`.estimators.ukf.MatrixSquareRoot` does.
    """
    n = matrix.shape[0]
    for i in range(n):
        for j in range(i):
            out[i, j] = 0.0
        for j in range(i, n):
            out[i, j] = 0.5 * (matrix[i, j] + matrix[j, i])
    good = True
    for i in range(n):
        row = out[i]
        for k in range(i):
            other = out[k]
            factor = other[i]
            for j in range(i, n):
                row[j] -= factor * other[j]
        if not row[i] > 0.0:
            good = False
            break
        scale = 1.0 / math.sqrt(row[i])
        for j in range(i, n):
            row[j] *= scale
    if good:
        return False
    symmetric = 0.5 * (matrix + matrix.T)
    size = np.sqrt(np.abs(np.diag(symmetric)))
    for i in range(n):
        if size[i] == 0.0:
            size[i] = 1.0
    values, vectors = np.linalg.eigh(symmetric / np.outer(size, size))
    values = np.maximum(values, n * np.finfo(np.float64).eps * values[n - 1])
    half = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            half[j, i] = size[i] * vectors[i, j] * math.sqrt(values[j])
    out[:, :] = np.linalg.qr(half)[1]
    return True


def _make_unscented(width: int, channels: int) -> Callable[..., Any]:
    """Return the kernel of the unscented Kalman filter for up to so many states and components."""

    @compiled
    def unscented(
        measurements: np.ndarray,
        noise_cov: np.ndarray,
        noise_inverse: np.ndarray,
        transition: np.ndarray,
        process_cov: np.ndarray,
        prior_mean: np.ndarray,
        prior_cov: np.ndarray,
        model: ModelArrays,
        spread: float,
        weights: np.ndarray,
        mean: np.ndarray,
        cov: np.ndarray,
        nis: np.ndarray,
        repairs: np.ndarray,
    ) -> None:
        runs, epochs, m = measurements.shape
        n, columns = prior_mean.shape[0], model.rows.shape[3]
        centre_mean, centre_cov, weight = weights[0], weights[1], weights[2]
        moving = 6 if model.instrument == STRAPDOWN else 3
        phi, phi_t = np.zeros((width, width)), np.zeros((width, width))
        p, scratch = np.zeros((width, width)), np.zeros((width, width))
        root = np.zeros((width, width))
        cross_t = np.zeros((channels, width))
        s, inverse = np.zeros((channels, channels)), np.zeros((channels, channels))
        small = np.zeros((channels, channels))
        innovation, white = np.zeros(channels), np.zeros(channels)
        linear, linear_innovation = np.zeros((channels, channels)), np.zeros(channels)
        errors, found = np.zeros((6, 2 * n + 1)), np.zeros((m, 2 * n + 1))
        change = np.zeros((channels, width))
        work = np.zeros((3, 9, 9))
        rows, hp = np.zeros((channels, width)), np.zeros((channels, width))
        x = np.zeros(width)
        for run in range(runs):
            own = run_arrays(model, run)
            x[:n] = prior_mean
            p[:, :] = 0.0
            p[:n, :n] = prior_cov
            for k in range(epochs):
                changing = kalman.padded(transition[run, k], phi, phi_t)
                # The motion is linear: sigma points through Φ have the mean Φ x and the covariance
                # Φ P Φᵀ exactly.
                kalman.predict(phi, phi_t, changing, process_cov[run, k], x, p, scratch, width)
                repairs[run] += _root(p[:n, :n], root[:n, :n])
                # Sigma points x, x + U_i, x − U_i (rows of U), as errors B_k x.
                b = own.rows[k]
                for i in range(moving):
                    centre = 0.0
                    for j in range(columns):
                        centre += b[i, j] * x[j]
                    errors[i, 0] = centre
                    for q in range(n):
                        off = 0.0
                        for j in range(q, columns):
                            off += b[i, j] * root[q, j]
                        errors[i, 1 + q] = centre + spread * off
                        errors[i, 1 + n + q] = centre - spread * off
                predict_errors(own, k, errors, found)
                if own.bias >= 0:
                    gain = own.gain[k]
                    for c in range(m):
                        centre = gain * x[own.bias + c]
                        found[c, 0] += centre
                        for q in range(n):
                            off = gain * spread * root[q, own.bias + c]
                            found[c, 1 + q] += centre + off
                            found[c, 1 + n + q] += centre - off
                for c in range(m):
                    row = found[c]
                    total = 0.0
                    for q in range(1, 2 * n + 1):
                        total += row[q]
                    middle = centre_mean * row[0] + weight * total
                    innovation[c] = measurements[run, k, c] - middle
                    for q in range(2 * n + 1):
                        row[q] -= middle
                    for q in range(n):
                        change[c, q] = row[1 + q] - row[1 + n + q]
                for c in range(m):
                    for d in range(c + 1):
                        s[c, d] = s[d, c] = noise_cov[c, d] + _spread_of(
                            found[c], found[d], centre_cov, weight
                        )
                # Cross-covariance, transposed: Σ w (σ − x)(z − ẑ)ᵀ, in which ẑ cancels.
                scale = weight * spread
                for c in range(m):
                    for j in range(width):
                        total = 0.0
                        for q in range(width):
                            total += change[c, q] * root[q, j]
                        cross_t[c, j] = scale * total
                squared, present = whitened_reading(
                    own, k, x, measurements[run, k], noise_inverse, moving, work, rows,
                    linear_innovation,
                )  # fmt: skip
                # The square of the innovation is judged as that of every filter is, linearised.
                kalman.project(rows, p, hp, linear, m, width)
                kalman.invert_root(linear, small, inverse, m)
                squared += kalman.whiten(inverse, linear_innovation, white, m)
                nis[run, k] = squared if present else np.nan
                kalman.invert_root(s, small, inverse, m)
                kalman.whiten(inverse, innovation, white, m)
                kalman.times(inverse, cross_t, hp, m, channels, width)
                for j in range(width):
                    total = x[j]
                    for c in range(channels):
                        total += hp[c, j] * white[c]
                    x[j] = total
                for i in range(n):
                    for j in range(width):
                        total = p[i, j]
                        for c in range(channels):
                            total -= hp[c, i] * hp[c, j]
                        p[i, j] = total
                if _root(p[:n, :n], root[:n, :n]):
                    repairs[run] += 1
                    upper = root[:n, :n].copy()
                    p[:n, :n] = upper.T @ upper
                mean[run, k] = x[:n]
                cov[run, k] = p[:n, :n]

    return unscented


@summed
def _spread_of(one: np.ndarray, two: np.ndarray, centre: float, weight: float) -> float:
    """Return the weighted sum of the products of deviations (N,), the centre's first."""
    total = 0.0
    for q in range(1, one.shape[0]):
        total += one[q] * two[q]
    return centre * one[0] * two[0] + weight * total


_UNSCENTED = {size: _make_unscented(*size) for size in SIZES[1:]}
_EXTENDED = {size: _make_extended(*size) for size in SIZES}


def size_of(block: ProblemBlock) -> tuple[int, int]:
    """Return the sizes of the kernel that takes a block."""
    n, m = block.dimension, block.measurements.shape[2]
    if block.model.bias < 0 and block.model.instrument != STRAPDOWN:
        m = min(m, 3)  # what a reading says about a position is three numbers
    return next(size for size in SIZES if n <= size[0] and m <= size[1])


def noise_inverse(block: ProblemBlock) -> np.ndarray:
    """Return the inverse (m, m) of the lower triangular root of R."""
    return np.linalg.inv(np.linalg.cholesky(block.noise_cov))


def extended(block: ProblemBlock) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run the extended Kalman filter; return mean (R, K, n), cov (R, K, n, n) and NIS (R, K)."""
    runs, epochs, n = block.runs, block.epochs, block.dimension
    mean, cov = np.empty((runs, epochs, n)), np.empty((runs, epochs, n, n))
    nis = np.empty((runs, epochs))
    _EXTENDED[size_of(block)](
        block.measurements, noise_inverse(block), block.transition, block.process_cov,
        block.prior_mean, block.prior_cov, block.model, mean, cov, nis,
    )  # fmt: skip
    return mean, cov, nis


def unscented(
    block: ProblemBlock, spread: float, centre_mean: float, centre_cov: float, weight: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Run the unscented Kalman filter.

    Parameters
    ----------
    block : the runs.
    spread : by how much the rows of the root of P are stretched.
    centre_mean, centre_cov, weight : of the centre in means and in covariances, of all others.

    Returns
    -------
    mean (R, K, n), cov (R, K, n, n), NIS (R, K), and how often a covariance was repaired (R,).
    """
    runs, epochs, n = block.runs, block.epochs, block.dimension
    mean, cov = np.empty((runs, epochs, n)), np.empty((runs, epochs, n, n))
    nis, repairs = np.empty((runs, epochs)), np.zeros(runs, dtype=np.int64)
    m = block.measurements.shape[2]
    size = next(size for size in _UNSCENTED if n <= size[0] and m <= size[1])
    _UNSCENTED[size](
        block.measurements, block.noise_cov, noise_inverse(block), block.transition,
        block.process_cov, block.prior_mean, block.prior_cov, block.model, spread,
        np.array([centre_mean, centre_cov, weight]), mean, cov, nis, repairs,
    )  # fmt: skip
    return mean, cov, nis, repairs
