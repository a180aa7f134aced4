"""Steps of a Kalman filter on matrices that fill a known size, compiled.

States n and components m of a reading are padded with zeros to a ``width`` and a number of
``channels`` that the compiler knows: loops of constant length become vector instructions. A padded
state has no variance, a padded component a row of zeros in H. Readings are whitened: R is 1.
"""

from __future__ import annotations

import math

import numpy as np

from ..block import ProblemBlock
from ..numerics.kernels import compiled, copied
from ..sensors.gradiometer.instrument import STRAPDOWN
from ..sensors.model_kernels import ModelArrays, linearise_errors


@copied
def padded(matrix: np.ndarray, out: np.ndarray, transposed: np.ndarray) -> int:
    """Copy Φ (n, n) into the corner of padded matrices, as it is and transposed.

    Returns how many of its first rows there are before those of the identity (constant biases).
    """
    moving = 0
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            value = matrix[i, j]
            out[i, j] = value
            transposed[j, i] = value
            if value != (1.0 if i == j else 0.0):
                moving = i + 1
    return moving


@copied
def predict(
    phi: np.ndarray,
    phi_t: np.ndarray,
    moving: int,
    noise: np.ndarray,
    x: np.ndarray,
    p: np.ndarray,
    scratch: np.ndarray,
    width: int,
) -> None:
    """Replace x and P by Φ x and Φ P Φᵀ + Q; only ``moving`` rows of Φ; Q (n, n) not padded."""
    for i in range(moving):
        for j in range(width):
            total = 0.0
            for k in range(width):
                total += phi[i, k] * p[k, j]
            scratch[i, j] = total
    for i in range(moving):
        for j in range(width):
            total = 0.0
            for k in range(width):
                total += scratch[i, k] * phi_t[k, j]
            p[i, j] = total
    n = noise.shape[0]
    for i in range(moving):
        for j in range(i):
            p[i, j] = p[j, i] = 0.5 * (p[i, j] + p[j, i])
        for j in range(moving, width):
            p[j, i] = p[i, j]
    for i in range(n):
        for j in range(n):
            p[i, j] += noise[i, j]
    for i in range(width):
        scratch[0, i] = x[i]
    for j in range(width):
        total = 0.0
        for k in range(width):
            total += phi_t[k, j] * scratch[0, k]
        x[j] = total


@copied
def compress(slope: np.ndarray, residual: np.ndarray, m: int, columns: int) -> float:
    """Turn m equations slope · e = residual + noise of unit variance into ``columns`` of them.

    By an orthogonal transformation (Householder): the first rows, upper triangular, hold all that
    the equations say about e. Returns the sum of the squares of the residuals that say nothing.
    """
    for j in range(columns):
        norm = 0.0
        for i in range(j, m):
            norm += slope[i, j] * slope[i, j]
        if norm == 0.0:
            continue
        norm = math.sqrt(norm)
        if slope[j, j] > 0.0:
            norm = -norm
        # v = column − norm e_j; vᵀv / 2 = norm² − norm · slope[j, j]
        half = norm * norm - norm * slope[j, j]
        slope[j, j] -= norm
        for c in range(j + 1, columns):
            along = 0.0
            for i in range(j, m):
                along += slope[i, j] * slope[i, c]
            along /= half
            for i in range(j, m):
                slope[i, c] -= along * slope[i, j]
        along = 0.0
        for i in range(j, m):
            along += slope[i, j] * residual[i]
        along /= half
        for i in range(j, m):
            residual[i] -= along * slope[i, j]
        slope[j, j] = norm
        for i in range(j + 1, m):
            slope[i, j] = 0.0
    left = 0.0
    for i in range(columns, m):
        left += residual[i] * residual[i]
    return left


@compiled
def invert_root(matrix: np.ndarray, root: np.ndarray, out: np.ndarray, m: int) -> bool:
    """Fill L⁻¹, lower triangular, of L Lᵀ = a symmetric matrix of m rows.

    ``root`` (m, m) is scratch. Returns whether the matrix is positive definite.
    """
    good = True
    for j in range(m):
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= root[j, k] * root[j, k]
        good &= pivot > 0.0
        inverse = 1.0 / math.sqrt(pivot)
        out[j, j] = inverse
        for i in range(j + 1, m):
            total = matrix[i, j]
            for k in range(j):
                total -= root[i, k] * root[j, k]
            root[i, j] = total * inverse
    for j in range(m):
        for i in range(j + 1, m):
            total = 0.0
            for k in range(j, i):
                total -= root[i, k] * out[k, j]
            out[i, j] = total * out[i, i]
    return good


@copied
def times(
    small: np.ndarray, right: np.ndarray, out: np.ndarray, m: int, channels: int, width: int
) -> None:
    """Fill the first m rows of a small matrix (channels, channels) times B (channels, width)."""
    for c in range(m):
        for j in range(width):
            total = 0.0
            for d in range(channels):
                total += small[c, d] * right[d, j]
            out[c, j] = total


@copied
def transpose_times(
    small: np.ndarray, right: np.ndarray, out: np.ndarray, m: int, channels: int, width: int
) -> None:
    """Fill the first m rows of the transposed small matrix times B (channels, width)."""
    for c in range(m):
        for j in range(width):
            total = 0.0
            for d in range(channels):
                total += small[d, c] * right[d, j]
            out[c, j] = total


@compiled
def whiten(inverse: np.ndarray, residual: np.ndarray, out: np.ndarray, m: int) -> float:
    """Fill L⁻¹ y (m,) and return the sum of its squares."""
    squared = 0.0
    for c in range(m):
        total = 0.0
        for d in range(c + 1):
            total += inverse[c, d] * residual[d]
        out[c] = total
        squared += total * total
    return squared


@copied
def project(
    rows: np.ndarray, p: np.ndarray, hp: np.ndarray, s: np.ndarray, m: int, width: int
) -> None:
    """Fill H P and S = H P Hᵀ + 1 of m components."""
    for c in range(m):
        for j in range(width):
            total = 0.0
            for k in range(width):
                total += rows[c, k] * p[k, j]
            hp[c, j] = total
    for c in range(m):
        for d in range(c + 1):
            total = 1.0 if c == d else 0.0
            for k in range(width):
                total += hp[c, k] * rows[d, k]
            s[c, d] = s[d, c] = total


@copied
def joseph(
    gain_t: np.ndarray,
    hp: np.ndarray,
    rows: np.ndarray,
    p: np.ndarray,
    scratch: np.ndarray,
    spread_t: np.ndarray,
    n: int,
    m: int,
    channels: int,
    width: int,
) -> None:
    """Replace P by (I − K H) P (I − K H)ᵀ + K Kᵀ, symmetrised; K is given as Kᵀ, R is 1.

    With M = P − K (H P) that is M − (M Hᵀ − K) Kᵀ: two products of rank m instead of two whole
    ones. All of it is transposed, so that each loop runs along rows.
    """
    for i in range(n):
        for j in range(width):
            total = p[i, j]
            for c in range(channels):
                total -= hp[c, i] * gain_t[c, j]
            scratch[i, j] = total
    for c in range(m):
        for j in range(width):
            total = gain_t[c, j]
            for k in range(width):
                total -= rows[c, k] * scratch[k, j]
            spread_t[c, j] = total
    for i in range(n):
        for j in range(width):
            total = scratch[i, j]
            for c in range(channels):
                total += gain_t[c, i] * spread_t[c, j]
            p[i, j] = total
    for i in range(n):
        for j in range(i):
            p[i, j] = p[j, i] = 0.5 * (p[i, j] + p[j, i])


@compiled
def to_target(rows: np.ndarray, x: np.ndarray, innovation: np.ndarray, target: np.ndarray) -> float:
    """Fill H x + y, the reading of a linear problem; return the sum of the squares of y."""
    squared = 0.0
    for c in range(target.shape[0]):
        total = innovation[c]
        squared += total * total
        for j in range(x.shape[0]):
            total += rows[c, j] * x[j]
        target[c] = total
    return squared


@compiled
def quadratic(matrix: np.ndarray, x: np.ndarray) -> float:
    """Return xᵀ M x of a symmetric matrix (n, n) and the first n of a vector."""
    squared = 0.0
    for i in range(matrix.shape[0]):
        row = matrix[i]
        total = 0.0
        for j in range(i):
            total += row[j] * x[j]
        squared += x[i] * (2.0 * total + row[i] * x[i])
    return squared


@copied
def square(
    middle: np.ndarray, a: np.ndarray, scratch: np.ndarray, out: np.ndarray, n: int, width: int
) -> None:
    """Fill Aᵀ M A of padded matrices, M symmetric; the rows beyond n are zero."""
    for i in range(n):
        for j in range(width):
            total = 0.0
            for k in range(width):
                total += middle[i, k] * a[k, j]
            scratch[i, j] = total
    for i in range(n, width):
        scratch[i] = 0.0
    for i in range(n):
        for j in range(width):
            total = 0.0
            for k in range(width):
                total += a[k, i] * scratch[k, j]
            out[i, j] = total


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
        left = compress(slope, residual, m, moving)
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


SIZES = ((16, 3), (16, 6), (24, 9))
"""Numbers of states and of components that kernels are made for."""


def size_of(block: ProblemBlock) -> tuple[int, int]:
    """Return the sizes of the kernel that takes a block."""
    n, m = block.dimension, block.measurements.shape[2]
    if block.model.bias < 0 and block.model.instrument != STRAPDOWN:
        m = min(m, 3)  # what a reading says about a position is three numbers
    return next(size for size in SIZES if n <= size[0] and m <= size[1])
