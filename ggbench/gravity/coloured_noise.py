"""Coloured noise of gradiometer channels as a vector autoregression, and whitening of it.

The noise is n_k = Σ_i A_i n_{k−i} + e_k (i = 1 … p), where the e_k are independent and have the
covariance Σ across the channels. A measurement z_k = h_k + n_k of the gradient h_k is whitened by
subtraction of the predicted noise,

    w_k = V (z_k − Σ_i A_i z_{k−i}) = V (h_k − Σ_i A_i h_{k−i}) + V e_k,

where Σ = C Cᵀ (Cholesky), D is the diagonal of C and V = D C⁻¹. The noise of w_k has the diagonal
covariance D²: the unit of each channel is unchanged, and correlations between channels are removed.
At the start and after a gap some of the p earlier measurements are missing. Then the best linear
predictor from the last p available measurements replaces the A_i, and the Cholesky factor of the
prediction error covariance replaces C. Predictor and covariance follow from the autocovariance.
Without gaps, or for p ≤ 1, the likelihood of w equals that of z. With gaps and p > 1, measurements
before the last p available ones would add a little information, which is lost.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import GGBenchError
from ..files.writing import written_whole
from ..numerics.frozen import freeze_arrays, frozen

FORMAT = "ggbench coloured noise 1"
"""Value of the key ``format`` in files of noise models."""
_KEYS = (
    "format",
    "components",
    "interval_s",
    "coefficients",
    "innovation_cov_eotvos2",
    "provenance",
)
_MOST_ORDER = 64
_TIMING = 1e-3
"""Largest deviation of a time difference from a multiple of the interval [intervals]."""
_REACH = _MOST_ORDER
"""Longest memory of the prediction across a gap [intervals]; a longer gap restarts it."""


class ColouredNoiseError(GGBenchError):
    """A model of coloured noise is invalid, or its file cannot be read or written."""


class Whitening(NamedTuple):
    """Whitening of G measurements of m channels; each uses up to p earlier measurements.

    Attributes
    ----------
    weights : (G, p + 1, m, m) matrices that multiply each measurement and up to p available earlier
        measurements; zero for missing measurements.
    lags : (G, p + 1) lag l of each matrix in ``weights``: in row k the matrix multiplies
        measurement k − l. The index k also counts missing measurements. A lag of −1 marks an unused
        matrix, which is zero.
    """

    weights: np.ndarray
    lags: np.ndarray

    @property
    def of_constant(self) -> np.ndarray:
        """Return matrices (G, m, m) that map constant channel errors to whitened measurements."""
        return np.asarray(self.weights.sum(axis=1))

    def apply(self, readings: np.ndarray) -> np.ndarray:
        """Return the whitened measurements w (..., G, m) of z (..., G, m) at G epochs."""
        white = np.zeros(readings.shape)
        for weights, lags in zip(self.weights.swapaxes(0, 1), self.lags.T, strict=True):
            at = np.flatnonzero(lags >= 0)
            earlier = readings[..., at - lags[at], :]
            white[..., at, :] += np.einsum("gij,...gj->...gi", weights[at], earlier)
        return np.asarray(white)


@dataclass(frozen=True, eq=False)
class VectorAutoregression:
    """A stationary vector autoregression of order p over the m channels of a gradiometer.

    Attributes
    ----------
    components : names of the channels.
    interval : time between measurements [s].
    coefficients : (p, m, m) matrices A_i of the noise n_k = Σ_i A_i n_{k−i} + e_k. The order p = 0
        means noise without memory.
    innovation_cov : (m, m) covariance Σ of the innovations e_k [E²].
    provenance : source of the model, in words.

    Raises ColouredNoiseError if shapes are inconsistent, Σ is not positive definite, or the process
    is unstable.
    """

    components: tuple[str, ...]
    interval: float
    coefficients: np.ndarray
    innovation_cov: np.ndarray
    provenance: str = ""

    def __post_init__(self) -> None:
        m, shape = len(self.components), self.coefficients.shape
        if m == 0 or len(set(self.components)) != m:
            raise ColouredNoiseError("components must be names of channels without duplicates")
        if not 0.0 < self.interval < np.inf:
            raise ColouredNoiseError(f"interval_s is {self.interval:g} and must be positive")
        if len(shape) != 3 or shape[1:] != (m, m) or shape[0] > _MOST_ORDER:
            raise ColouredNoiseError(
                f"coefficients have shape {shape} and must be at most {_MOST_ORDER} matrices of "
                f"{m} by {m}, for {m} components"
            )
        cov = self.innovation_cov
        if cov.shape != (m, m) or not (np.isfinite(cov).all() and _is_covariance(cov)):
            raise ColouredNoiseError(
                f"innovation_cov_eotvos2 must be a covariance of {m} components: {m} by {m}, "
                "symmetric and positive definite"
            )
        if not (np.isfinite(self.coefficients).all() and self.spectral_radius < 1.0):
            raise ColouredNoiseError(
                f"the autoregression is not stable: its spectral radius is "
                f"{self.spectral_radius:.4g} and must be below 1"
            )
        freeze_arrays(self)

    @property
    def order(self) -> int:
        """Order p of the autoregression."""
        return len(self.coefficients)

    @cached_property
    def _companion(self) -> np.ndarray:
        """Companion matrix (p m, p m): transition matrix of the p latest values, newest first."""
        m = len(self.components)
        matrix = np.eye(self.order * m, k=-m)
        matrix[:m] = np.hstack([*self.coefficients])
        return matrix

    @cached_property
    def spectral_radius(self) -> float:
        """Largest modulus of the poles of the process; a stable process has a value below 1."""
        if self.order == 0:
            return 0.0
        if not np.isfinite(self.coefficients).all():
            return np.inf
        return float(np.abs(np.linalg.eigvals(self._companion)).max())

    def autocovariance(self, lags: int) -> np.ndarray:
        """Return the autocovariances (lags + 1, m, m) of the noise [E²] at lags 0 to ``lags``.

        The autocovariance of the noise n_k at lag l is Γ_l = E[n_k n_{k−l}ᵀ].
        """
        m, p = len(self.components), self.order
        covariances = np.zeros((max(lags + 1, p), m, m))
        if p == 0:
            covariances[0] = self.innovation_cov
        else:
            from scipy.linalg import solve_discrete_lyapunov  # not every flight needs it

            driven = np.zeros((p * m, p * m))
            driven[:m, :m] = self.innovation_cov
            joint = solve_discrete_lyapunov(self._companion, driven)
            covariances[:p] = joint[:m].reshape(m, p, m).swapaxes(0, 1)
            for lag in range(p, lags + 1):
                before = covariances[lag - 1 :: -1][:p]
                covariances[lag] = np.einsum("iab,ibc->ac", self.coefficients, before)
        return covariances[: lags + 1]

    @cached_property
    def stationary_cov(self) -> np.ndarray:
        """Stationary covariance (m, m) of the noise [E²]."""
        return frozen(self.autocovariance(0)[0])

    @property
    def rms(self) -> float:
        """RMS of the noise over the channels [E]."""
        return float(np.sqrt(np.diag(self.stationary_cov).mean()))

    @cached_property
    def deviations(self) -> np.ndarray:
        """Noise standard deviations D (m,) of whitened measurements [E]."""
        return frozen(np.diag(np.linalg.cholesky(self.innovation_cov)))

    @cached_property
    def _start_rows(self) -> list[np.ndarray]:
        """Whitening weights (k + 1, m, m) for k = 0, …, p consecutive earlier measurements."""
        return [self._row(tuple(range(1, known + 1))) for known in range(self.order + 1)]

    @cached_property
    def _reached(self) -> np.ndarray:
        """Autocovariances Γ_l for all lags l that a prediction may use."""
        return self.autocovariance(_REACH)

    def _row(self, lags: tuple[int, ...]) -> np.ndarray:
        """Return whitening weights (k + 1, m, m) of a measurement and of k earlier measurements.

        ``lags`` are the k lags of the earlier measurements [intervals].
        """
        predictor, remaining_cov = self.coefficients, self.innovation_cov
        if lags != tuple(range(1, self.order + 1)):
            predictor, remaining_cov = _predictor(self._reached, lags)
        scaled = self.deviations[:, np.newaxis] * np.linalg.inv(np.linalg.cholesky(remaining_cov))
        return np.concatenate([scaled[np.newaxis], -scaled @ predictor])

    def whitening(self, times: np.ndarray, missing: np.ndarray) -> Whitening:
        """Return the whitening of measurements at times (G,) [s]; ``missing`` (G,) is a mask.

        The noise of a measurement is predicted from the last p available measurements that are at
        most 64 intervals older. There is no prediction across a gap that is not a multiple of the
        interval.
        """
        m, taps = len(self.components), self.order + 1
        weights, lags = np.zeros((len(times), taps, m, m)), np.full((len(times), taps), -1)
        rows: dict[tuple[int, ...], np.ndarray] = {}
        steps = np.diff(times, prepend=times[:1]) / self.interval
        ticks = np.cumsum(np.round(steps).astype(int))
        stretches = np.cumsum(np.abs(steps - np.round(steps)) > _TIMING)
        before: list[int] = []
        for k in np.flatnonzero(~missing):
            before = [
                j for j in before if stretches[j] == stretches[k] and ticks[k] - ticks[j] <= _REACH
            ][: self.order]
            pattern = tuple(int(ticks[k] - ticks[j]) for j in before)
            if pattern not in rows:
                rows[pattern] = self._row(pattern)
            weights[k, : len(before) + 1] = rows[pattern]
            lags[k, : len(before) + 1] = [0, *(k - j for j in before)]
            before.insert(0, int(k))
        return Whitening(weights, lags)

    def simulate(self, white: np.ndarray) -> np.ndarray:
        """Return stationary noise (K, m) [E] from standard normal numbers (K, m)."""
        noise, rows, p = np.zeros(white.shape), self._start_rows, self.order
        inverse = [np.linalg.inv(row[0]) for row in rows]
        for k, drawn in enumerate(white):
            known = min(k, p)
            before = noise[k - known : k][::-1]
            predicted = np.einsum("iab,ib->a", rows[known][1:], before)
            noise[k] = inverse[known] @ (self.deviations * drawn - predicted)
        return noise

    def write(self, path: Path) -> None:
        """Write the model to a JSON file.

        Raises ColouredNoiseError if the file cannot be written.
        """
        content = {
            "format": FORMAT,
            "components": list(self.components),
            "interval_s": self.interval,
            "coefficients": self.coefficients.tolist(),
            "innovation_cov_eotvos2": self.innovation_cov.tolist(),
            "provenance": self.provenance,
        }
        with written_whole(path, ColouredNoiseError, "the noise model ") as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_noise(path: Path) -> VectorAutoregression:
    """Return the noise model of a JSON file; recently read files are cached.

    Raises ColouredNoiseError if the file cannot be read or a value is invalid; the message states
    the file, the value and the allowed values.
    """
    try:
        status = path.stat()
    except OSError as error:
        raise ColouredNoiseError(f"cannot read the noise model {path}: {error.strerror}") from None
    return _read(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=16)
def _read(path: Path, time: int, size: int) -> VectorAutoregression:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ColouredNoiseError(f"cannot read the noise model {path}: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise ColouredNoiseError(f"the noise model {path} is not JSON") from None
    try:
        return _model(content)
    except ColouredNoiseError as error:
        raise ColouredNoiseError(f"the noise model {path}: {error}") from None


def _model(content: Any) -> VectorAutoregression:
    """Return the noise model from the parsed content of a JSON file."""
    if not isinstance(content, Mapping) or content.get("format") != FORMAT:
        raise ColouredNoiseError(f'must be an object with "format": "{FORMAT}"')
    for key in _KEYS:
        if key not in content:
            raise ColouredNoiseError(f"has no {key}; its keys are {', '.join(_KEYS)}")
    names = content["components"]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ColouredNoiseError("components must be a list of names")
    m = len(names)
    coefficients = _numbers("coefficients", content["coefficients"])
    if coefficients.size == 0:
        coefficients = np.zeros((0, m, m))
    return VectorAutoregression(
        tuple(names),
        float(_numbers("interval_s", content["interval_s"]).sum()),
        coefficients,
        _numbers("innovation_cov_eotvos2", content["innovation_cov_eotvos2"]),
        str(content["provenance"]),
    )


def _numbers(key: str, values: Any) -> np.ndarray:
    """Return nested lists of numbers as an array."""
    try:
        return np.array(values, dtype=float)
    except (ValueError, TypeError):
        raise ColouredNoiseError(f"{key} must be numbers, in rows of equal length") from None


def _is_covariance(cov: np.ndarray) -> bool:
    """Return whether a matrix is symmetric, to rounding, and positive definite."""
    if not np.allclose(cov, cov.T, rtol=1e-9, atol=0.0):
        return False
    return bool(np.linalg.eigvalsh(cov).min() > 0.0)


def _predictor(covariance: np.ndarray, lags: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the best linear predictor (k, m, m) from k earlier values, and its error covariance.

    ``covariance`` (L, m, m) has the autocovariances Γ_l of the process. ``lags`` are the k
    ascending lags of the earlier values. The error covariance has the shape (m, m).
    """
    m, count = covariance.shape[1], len(lags)
    if count == 0:
        return np.zeros((0, m, m)), covariance[0]
    # Of n_{k−a} and n_{k−b}: E[n_{k−a} n_{k−b}ᵀ] is Γ of the lag b − a.
    among = np.block(
        [[covariance[b - a] if b >= a else covariance[a - b].T for b in lags] for a in lags]
    )
    across = np.hstack([covariance[lag] for lag in lags])
    gains = np.linalg.solve(among, across.T).T
    remaining_cov = covariance[0] - gains @ across.T
    return gains.reshape(m, count, m).swapaxes(0, 1), 0.5 * (remaining_cov + remaining_cov.T)
