"""TITLE: an extended Kalman filter to begin with.

ggbench check NAME.py                         does it keep the contract of all estimators?
ggbench run wang2013 -n 3 -e NAME.py -e ekf   a campaign beside the benchmark's own filter
"""

from dataclasses import dataclass

import numpy as np

from ggbench.problem import Estimate, Estimator, Problem


@dataclass(frozen=True)
class Template(Estimator):
    """Extended Kalman filter, iterated if iterations is more than 1.

    The fields of the class are its parameters, each with a default: "NAME.py[iterations=3]".
    """

    iterations: int = 1

    name = "NAME"
    # Up to which readings an estimate at time t depends: "filter", "fixed-lag" (with a parameter
    # lag [s]), "batch" (all of them), "none". The contract holds an estimator to it.
    causality = "filter"

    @property
    def exact(self) -> bool:
        """Whether linear problems get the Kalman filter's answer: particles, grids say False."""
        return True

    def skip(self, problem: Problem) -> str | None:
        """Return why it cannot take a problem, or None if it can."""
        return None if self.iterations > 0 else f"iterations must be positive: {self.iterations}"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Return mean (K, n) and covariance (K, n, n) of the state at the K epochs.

        The state is the error of the INS: problem.layout names its parts and their units. Draw all
        that is random from rng. Do not write to the problem: its arrays are read-only.
        """
        x, p = problem.prior_mean, problem.prior_cov  # at the start, before the first step
        means, covs = [], []
        for k in range(problem.epochs):
            # Predict: transition[k] leads from the epoch before to times[k], from the start at k=0.
            phi = problem.transition[k]
            predicted, p = phi @ x, phi @ p @ phi.T + problem.process_cov[k]

            # Update. Where a channel delivers nothing (problem.present is False), its measurement,
            # h and H are zero, which changes nothing: gaps need no case of their own.
            noise = problem.noise_of(k)  # R (m, m)
            x = predicted
            for _ in range(self.iterations):
                h = problem.model.predict(k, x)  # (m,); of many states (..., n) at once (..., m)
                rows = problem.model.jacobian(k, x)  # H (m, n), likewise
                gain = np.linalg.solve(rows @ p @ rows.T + noise, rows @ p).T
                x = predicted + gain @ (problem.measurements[k] - h - rows @ (predicted - x))
            keep = np.eye(problem.dimension) - gain @ rows
            p = keep @ p @ keep.T + gain @ noise @ gain.T  # Joseph's form: never indefinite
            p = 0.5 * (p + p.T)
            means.append(x)
            covs.append(p)
        return Estimate(np.array(means), np.array(covs), self.causality)
