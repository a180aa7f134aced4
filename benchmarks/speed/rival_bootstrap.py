"""ggbench's own ``particle`` on the exported problem: with the h that the others are given, too."""

from __future__ import annotations

import numpy as np

from ggbench.campaign.registry import choose
from ggbench.problem import MeasurementModel, Problem, StateBlock

from . import clouds, export, numpy_model
from .problem_file import Arrays, Linear


class NumpyH:
    """``particle`` with h in NumPy, a run a call; the seed is the run's number."""

    runs_per_call = 1

    def __init__(self, arrays: Arrays | Linear, count: int) -> None:
        self.estimator = choose(f"particle[particles={count}]").estimator
        self.problems = [self.problem(arrays, run) for run in range(arrays.runs)]
        self.checked_runs = arrays.runs

    def problem(self, arrays: Arrays | Linear, run: int) -> Problem:
        """Return the problem that a run of the file is."""
        return Problem(
            times=arrays.times,
            measurements=arrays.measurements[run],
            noise_cov=arrays.noise_cov,
            transition=arrays.transition[run],
            process_cov=arrays.process_cov[run],
            prior_mean=arrays.prior_mean,
            prior_cov=arrays.prior_cov,
            model=self.model(arrays, run),
            layout=(StateBlock("errors", slice(0, len(arrays.prior_mean)), "SI"),),
        )

    def model(self, arrays: Arrays | Linear, run: int) -> MeasurementModel:
        """Return h of a run."""
        return _Readings(numpy_model.model_of(arrays, run))

    def solve(self, run: int) -> np.ndarray:
        """Return the means (1, K, n) of a run."""
        return self.estimator.estimate(self.problems[run], np.random.default_rng(run)).mean[None]


class CompiledH(NumpyH):
    """The same with the compiled h of ggbench, of the flight that the file was made of."""

    def model(self, arrays: Arrays | Linear, run: int) -> MeasurementModel:
        """Return h of a run."""
        (problem,) = export.problems([clouds.RUN])
        return problem.model


class _Readings:
    """h of NumPy behind ggbench's interface."""

    def __init__(self, model: numpy_model.NumpyModel | numpy_model.LinearModel) -> None:
        self.predict, self.jacobian = model.predict_all, model.jacobian
