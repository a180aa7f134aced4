"""Closed-loop Kalman filter: corrections reset the INS during the flight.

Open-loop filters estimate the error of an INS that is never corrected. The error equations of an
INS are linear only while the error is small. The closed-loop filter resets the mechanization to the
filter's estimate at regular intervals, so the error stays small (Groves 2013, sec. 14.1.1:
closed-loop integration).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..block import block_of
from ..parameters import Positive
from ..problem import Estimate, Estimator, Problem
from .ekf import ExtendedKalmanFilter
from .ukf import UnscentedKalmanFilter

_FILTERS = {
    "ekf": ExtendedKalmanFilter(),
    "ukf": UnscentedKalmanFilter(points="cubature"),
}


@dataclass(frozen=True)
class ClosedLoop(Estimator):
    """Kalman filter with feedback to the mechanization, compiled.

    Parameters
    ----------
    filter : ``ekf``, or ``ukf`` (with cubature points).
    interval_s : time between corrections of the mechanization [s]; at least one epoch.
    """

    filter: Literal["ekf", "ukf"] = "ekf"
    interval_s: Positive = 60.0

    name = "closed-loop"
    family = "kalman"
    causality = "filter"

    def skip(self, problem: Problem) -> str | None:
        """Return a reason to skip the problem if it has no inertial measurements, else None."""
        if problem.replay is None:
            return (
                "feedback needs inertial measurements; a delayed or filtered gradiometer, coloured "
                "noise, or an INS that integrates gradients, is not supported"
            )
        return None

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Filter one interval after the other; each interval starts from the corrected INS."""
        assert problem.replay is not None  # skip() says so
        loop = problem.replay.start(problem)
        means, covs, nis = [], [], []
        evaluations = 0
        for last in self._ends(problem.times):
            found = _FILTERS[self.filter].estimate_block(block_of(loop.ahead(last)))
            evaluations += int(found.info["map_evaluations"][0])
            means.append(loop.correct(found.mean[0], found.cov[0]))
            covs.append(found.cov[0])
            nis.append(np.asarray(found.nis)[0])
        return Estimate(
            np.concatenate(means), np.concatenate(covs), self.causality,
            info={"corrections": len(means), "map_evaluations": evaluations},
            nis=np.concatenate(nis),
        )  # fmt: skip

    def _ends(self, times: np.ndarray) -> list[int]:
        """Return the last epoch of each part."""
        part = np.floor((times - 1e-9) / self.interval_s)
        return [*np.flatnonzero(np.diff(part)).tolist(), len(times) - 1]
