"""Bounds and oracles for comparison with the estimates of a block of runs."""

from __future__ import annotations

import math

import numpy as np

from ..ins.error_model import POSITION, VELOCITY
from ..simulation.bound import Bound
from ..simulation.error_free_flight import Flight
from ..spec.case import WindowsSpec
from .bounds import bound_for, squared_bounds
from .oracle import oracle_states
from .run_errors import WINDOWS, window_mask

METRICS = {
    "bound_position_ms": True,
    "bound_velocity_ms": True,
    "oracle_position_ms": False,
    "oracle_velocity_ms": False,
}
"""Mean squares of a window; true if every run has a value.

Only runs with the right model have an oracle.
"""
DEFAULT_RATIO = 3.0
"""Default required final error, as a multiple of the RMS bound of a filter in the last window."""


class CaseBound:
    """Cramér–Rao bounds of one flight.

    The name of a bound is "filter", "batch" or, with a lag in epochs, "fixed-lag-30".
    """

    def __init__(self, flight: Flight, bound: Bound) -> None:
        self.bound = bound
        self._times, self._windows = flight.times, flight.case.windows
        self._squares: dict[str, np.ndarray] = {}

    def squares(self, name: str) -> np.ndarray:
        """Return the bounds (K, 2) on the squared errors of position [m²] and velocity [m²/s²]."""
        if name not in self._squares:
            cov = bound_for(self.bound, *parts(name))
            self._squares[name] = np.stack(squared_bounds(cov), axis=-1)
        return self._squares[name]

    def means(self, name: str) -> np.ndarray:
        """Return the means (W, 2) of :meth:`squares` over the W windows."""
        return _window_means(self.squares(name), self._times, self._windows)

    @property
    def final_m(self) -> float:
        """Bound of a filter on the 3-D position error at the last epoch [m]."""
        return math.sqrt(float(self.squares("filter")[-1, 0]))

    @property
    def required_m(self) -> float:
        """Required position error at the end of a run [m]."""
        if self._windows.required_m is not None:
            return self._windows.required_m
        last = self.means("filter")[WINDOWS.index("last20"), 0]
        return DEFAULT_RATIO * math.sqrt(float(last))


def metrics(name: str, bound: CaseBound, oracle: np.ndarray) -> np.ndarray:
    """Return the mean squares (R, W, 4) of bound and oracle for R runs and W windows.

    The last axis is :data:`METRICS`.

    Parameters
    ----------
    name : name of the bound; each causality (filter, smoother, fixed lag) has a bound.
    bound : bounds of the flight.
    oracle : (R, W, 2) mean squared errors of the oracle, from :func:`oracle_means`.
    """
    bounds = np.broadcast_to(bound.means(name), oracle.shape)
    return np.concatenate([bounds, oracle], axis=2)


def oracle_means(
    name: str,
    flight: Flight,
    bound: CaseBound,
    residuals: np.ndarray,
    error_state: np.ndarray,
    transition: np.ndarray,
) -> np.ndarray:
    """Return the mean squared errors (R, W, 2) of the oracle in W windows.

    The oracle is a filter or smoother linearised at the truth. The last axis is position [m²] and
    velocity [m²/s²]. The assumed model must equal the true model
    (:func:`.situations.is_right_model`).

    Parameters
    ----------
    name : name of the bound; each causality (filter, smoother, fixed lag) has a bound.
    flight : flight of the runs.
    bound : bounds of this flight.
    residuals : (R, K, m) measurements minus the measurement function h at the true states.
    error_state : (R, K, n) true error states.
    transition : (R, K, n, n) transition matrices.
    """
    causality, lag = parts(name)
    if lag is None:
        lag = 0 if causality == "filter" else bound.bound.whole
    errors = error_state - oracle_states(bound.bound, residuals, error_state, transition, lag)
    squares = [(errors[:, :, part] ** 2).sum(axis=2) for part in (POSITION, VELOCITY)]
    return _window_means(np.stack(squares, axis=2), flight.times, flight.case.windows)


def parts(name: str) -> tuple[str, int | None]:
    """Return the causality and the lag [epochs] from the name of a bound.

    The lag is None if the name contains no lag.
    """
    if name.startswith("fixed-lag-"):
        return "fixed-lag", int(name.removeprefix("fixed-lag-"))
    return name, None


def _window_means(squares: np.ndarray, times: np.ndarray, windows: WindowsSpec) -> np.ndarray:
    """Return means (..., W, 2) of squares (..., K, 2) over the windows."""
    masks = [window_mask(times, windows, name) for name in WINDOWS]
    return np.stack([squares[..., mask, :].mean(axis=-2) for mask in masks], axis=-2)
