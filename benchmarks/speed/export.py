"""Problem of the speed benchmark as plain arrays."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from ggbench.gravity.ellipsoid import EVEN_ZONALS
from ggbench.problem import Problem
from ggbench.sensors.model import SensorModel
from ggbench.sensors.model_arrays import ModelArrays
from ggbench.simulation.error_free_flight import Flight, prepare
from ggbench.simulation.runs import simulate
from ggbench.spec import scenario

from .problem_file import Arrays

SCENARIO, CASE = "wang2013", "0.01E-1Hz"


@cache
def flight() -> Flight:
    """Return the flight of the benchmark's case; it is prepared once per process."""
    return prepare(scenario.load(SCENARIO).case(CASE))


def seed() -> int:
    """Return the seed of the scenario's campaign."""
    return int(scenario.load(SCENARIO).campaign.seed)


def problems(runs: Sequence[int]) -> list[Problem]:
    """Return the problems of some runs."""
    return [simulate(flight(), seed(), run)[0] for run in runs]


def model_arrays_of(problem: Problem) -> ModelArrays:
    """Return the arrays of h and H of a problem."""
    model = problem.model
    if not isinstance(model, SensorModel):
        raise TypeError(f"the model is a {type(model).__name__}, not a SensorModel")
    return model.arrays


def arrays(runs: Sequence[int]) -> Arrays:
    """Return the problems of some runs as arrays."""
    found = problems(runs)
    models = [model_arrays_of(problem) for problem in found]
    first, model = found[0], models[0]

    def stack(items: Sequence[object], name: str) -> np.ndarray:
        return np.stack([getattr(item, name) for item in items])

    return Arrays(
        times=first.times,
        measurements=stack(found, "measurements"),
        noise_cov=first.noise_cov,
        transition=stack(found, "transition"),
        process_cov=stack(found, "process_cov"),
        prior_mean=first.prior_mean,
        prior_cov=first.prior_cov,
        reading_times=model.times,
        references=stack(models, "references"),
        rows=stack(models, "rows")[:, :, :3],
        offsets=stack(models, "offset"),
        gains=model.gain,
        origin=model.origin,
        step=model.step,
        coefficients=model.coefficients,
        even_zonals=EVEN_ZONALS,
    )
