"""Bound and oracle that the estimates of a block of runs are compared with."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..ins.error_model import POSITION, VELOCITY
from ..problem import Problem, predict_along
from ..simulation.bound import Bound
from ..simulation.error_free_flight import Flight
from ..spec.case import WindowsSpec
from .bounds import bound_for, squared_bounds
from .run_errors import WINDOWS, window_mask
from .situations import is_right_model

METRICS = ("bound_position_ms", "bound_velocity_ms", "oracle_position_ms", "oracle_velocity_ms")
"""Mean squares of a window: of the bound, and of the oracle's errors where the model is right."""
DEFAULT_RATIO = 3.0
"""Required final error where a case states none, in RMS filtering bounds over the last window."""


class CaseBound:
    """The bounds of one flight, by name ("filter", "batch", "fixed-lag-30") and window."""

    def __init__(self, flight: Flight, bound: Bound) -> None:
        self.bound = bound
        self._times, self._windows = flight.times, flight.case.windows
        self._squares: dict[str, np.ndarray] = {}

    def squares(self, name: str) -> np.ndarray:
        """Return bounds (K, 2) on the squared position and velocity error."""
        if name not in self._squares:
            cov = bound_for(self.bound, *parts(name))
            self._squares[name] = np.stack(squared_bounds(cov), axis=-1)
        return self._squares[name]

    def means(self, name: str) -> np.ndarray:
        """Return their means (W, 2) over the windows."""
        return _window_means(self.squares(name), self._times, self._windows)

    @property
    def final_m(self) -> float:
        """Bound on the spherical position error at the last epoch [m]."""
        return math.sqrt(float(self.squares("filter")[-1, 0]))

    @property
    def required_m(self) -> float:
        """Position error within which a run must end to succeed [m]."""
        if self._windows.required_m is not None:
            return self._windows.required_m
        last = self.means("filter")[WINDOWS.index("last20"), 0]
        return DEFAULT_RATIO * math.sqrt(float(last))


def metrics(
    name: str,
    flight: Flight,
    bound: CaseBound,
    problems: Sequence[Problem],
    error_state: np.ndarray,
) -> np.ndarray:
    """Return :data:`METRICS` of each run and window (R, W, 4).

    Parameters
    ----------
    name : of the bound that their estimates are compared with.
    flight, bound : of the runs.
    problems : of the R runs.
    error_state : (R, K, n) the truth.
    """
    found = np.full((len(problems), len(WINDOWS), len(METRICS)), np.nan)
    found[:, :, :2] = bound.means(name)
    case, times = flight.case, flight.times
    if is_right_model(case):
        errors = error_state - np.swapaxes(_oracle(name, bound.bound, problems, error_state), 0, 1)
        squares = np.stack(
            [(errors[:, :, part] ** 2).sum(axis=2) for part in (POSITION, VELOCITY)], axis=2
        )
        for r, of_run in enumerate(squares):
            found[r, :, 2:] = _window_means(of_run, times, case.windows)
    return found


def _oracle(
    name: str, bound: Bound, problems: Sequence[Problem], error_state: np.ndarray
) -> np.ndarray:
    """Return the states (K, R, n) that an estimator linearised at the truth finds."""
    residuals = [
        problem.measurements - predict_along(problem.model, np.arange(problem.epochs), state)
        for problem, state in zip(problems, error_state, strict=True)
    ]
    transition = np.stack([problem.transition for problem in problems])
    filtered, predicted = bound.oracle(np.stack(residuals), error_state, transition)
    causality, lag = parts(name)
    if causality == "filter":
        return filtered
    return bound.oracle_smoothed(filtered, predicted, bound.whole if lag is None else lag)


def parts(name: str) -> tuple[str, int | None]:
    """Return causality and lag [ticks] of the name of a bound."""
    if name.startswith("fixed-lag-"):
        return "fixed-lag", int(name.removeprefix("fixed-lag-"))
    return name, None


def _window_means(squares: np.ndarray, times: np.ndarray, windows: WindowsSpec) -> np.ndarray:
    """Return means (W, 2) of squares (K, 2) over the windows."""
    return np.stack([squares[window_mask(times, windows, name)].mean(axis=0) for name in WINDOWS])
