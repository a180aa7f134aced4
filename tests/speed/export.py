"""The problem of the speed benchmark, taken out of ggbench as plain arrays."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from ggbench import scenario
from ggbench.earth import EVEN_ZONALS
from ggbench.flight import Flight, prepare
from ggbench.measurement_model import GradiometerModel
from ggbench.problem import Problem
from ggbench.simulation import simulate

from .problem_file import Arrays

SCENARIO, CASE = "wang2013", "0.01E-1Hz"


@cache
def flight() -> Flight:
    """Return the flight of the benchmark's case, made once in a process."""
    return prepare(scenario.load(SCENARIO).case(CASE))


def seed() -> int:
    """Return the seed of the scenario's campaign."""
    return int(scenario.load(SCENARIO).campaign.seed)


def problems(runs: Sequence[int]) -> list[Problem]:
    """Return the problems of some runs."""
    return [simulate(flight(), seed(), run)[0] for run in runs]


def arrays(runs: Sequence[int]) -> Arrays:
    """Return some runs as arrays."""
    found = problems(runs)
    models = [problem.model for problem in found]
    assert all(isinstance(model, GradiometerModel) for model in models)
    field, first = flight().model_field, found[0]

    def stack(name: str) -> np.ndarray:
        return np.stack([getattr(problem, name) for problem in found])

    def stack_of_models(name: str) -> np.ndarray:
        return np.stack([getattr(model, name) for model in models])

    return Arrays(
        times=first.times,
        measurements=stack("measurements"),
        noise_cov=first.noise_cov,
        transition=stack("transition"),
        process_cov=stack("process_cov"),
        prior_mean=first.prior_mean,
        prior_cov=first.prior_cov,
        reading_times=stack_of_models("_times")[0],
        references=stack_of_models("_references"),
        rows=stack_of_models("_rows")[:, :, :3],
        offsets=stack_of_models("_offset"),
        gains=stack_of_models("_gain")[0],
        origin=field.origin,
        step=field.step,
        coefficients=field.tensor_coefficients,
        even_zonals=EVEN_ZONALS,
    )
