"""particles (Chopin), its bootstrap filter of a Feynman–Kac model; h in NumPy.

Its state-space models take noise with a density, which noise of less than full rank has not: so the
model says how particles move and what a reading weighs, and the library does all else.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import particles
from particles import collectors, resampling

from . import numpy_model
from .problem_file import Arrays, Linear


class Errors(particles.FeynmanKac):
    """The INS errors of one run, observed by its readings."""

    def __init__(self, arrays: Arrays | Linear, run: int, rng: np.random.Generator) -> None:
        super().__init__(T=len(arrays.times))
        self.transition, self.roots = arrays.transition[run], arrays.noise_roots[run]
        self.measurements = arrays.measurements[run]
        self.model, self.rng = numpy_model.model_of(arrays, run), rng
        self.prior_mean, self.prior_root = arrays.prior_mean, np.linalg.cholesky(arrays.prior_cov)
        self.white = np.linalg.inv(np.linalg.cholesky(arrays.noise_cov))

    def M0(self, N: int) -> np.ndarray:
        """Draw N states (N, n) at the first epoch."""
        start = self.rng.standard_normal((N, len(self.prior_mean))) @ self.prior_root.T
        return self.M(0, self.prior_mean + start)

    def M(self, t: int, xp: np.ndarray) -> np.ndarray:
        """Carry states (N, n) to epoch t."""
        root = self.roots[t]
        noise = self.rng.standard_normal((len(xp), root.shape[1])) @ root.T
        return np.asarray(xp @ self.transition[t].T + noise)

    def logG(self, t: int, xp: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the log likelihoods (N,) of states, but for a constant."""
        residuals = self.measurements[t] - self.model.predict_all(t, x)
        return np.asarray(-0.5 * ((residuals @ self.white.T) ** 2).sum(axis=1))


class Bootstrap:
    """SMC with systematic resampling below ESS = N/2; the seed is the run's number."""

    runs_per_call = 1

    def __init__(self, arrays: Arrays | Linear, count: int) -> None:
        self.arrays, self.count = arrays, count
        self.checked_runs = arrays.runs

    def solve(self, run: int) -> np.ndarray:
        """Return the means (1, K, n) of a run."""
        np.random.seed(run)  # noqa: NPY002  (the library resamples by the global generator)
        model: Any = Errors(self.arrays, run, np.random.default_rng(run))
        moments = collectors.Moments(mom_func=resampling.wmean_and_cov)
        smc = particles.SMC(
            fk=model, N=self.count, resampling="systematic", ESSrmin=0.5, collect=[moments]
        )
        smc.run()
        return np.stack([mean for mean, _ in smc.summaries.moments])[None]
