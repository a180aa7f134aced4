"""What h and H cost inside a compiled engine: their kernels alone, over all epochs of some runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from ggbench.kernels import compiled
from ggbench.measurement_model import ModelArrays, linearise, predict_errors

from . import export


@compiled
def _linearise_all(model: ModelArrays, states: np.ndarray) -> float:
    channels = model.channels.shape[0]
    predicted, jacobian = np.empty(channels), np.empty((channels, states.shape[1]))
    total = 0.0
    for k in range(states.shape[0]):
        linearise(model, k, states[k], predicted, jacobian)
        total += predicted[0] + jacobian[0, 0]
    return total


@compiled
def _predict_all(model: ModelArrays, errors: np.ndarray) -> float:
    out = np.empty((model.channels.shape[0], errors.shape[2]))
    total = 0.0
    for k in range(errors.shape[0]):
        predict_errors(model, k, errors[k], out)
        total += out[0, 0]
    return total


def measure(runs: Sequence[int], points: Sequence[int], rounds: int) -> dict[str, float]:
    """Return the best of some rounds' seconds per run.

    Parameters
    ----------
    runs : whose tracks are used, in turn.
    points : for each number of points, h of that many at every epoch is timed: ``h of N``.

    Returns
    -------
    Those, and ``h and H``: both, at one state an epoch.
    """
    problems = export.problems(runs)
    models = [export.model_arrays_of(problem) for problem in problems]
    scale = np.sqrt(np.diag(problems[0].prior_cov))
    rng = np.random.default_rng(0)
    shape = (problems[0].epochs, len(scale))
    states = scale * rng.standard_normal(shape)
    work: dict[str, Callable[[ModelArrays], float]] = {
        "h and H": lambda model: _linearise_all(model, states)
    }
    for count in points:
        errors = np.zeros((len(states), 6, count))
        errors[:, :3] = scale[:3, np.newaxis] * rng.standard_normal((len(states), 3, count))
        work[f"h of {count}"] = lambda model, errors=errors: _predict_all(model, errors)
    best: dict[str, float] = {}
    for function in work.values():
        function(models[0])  # compiled
    for _ in range(rounds):
        for name, function in work.items():
            start = time.perf_counter()
            for model in models:
                function(model)
            spent = (time.perf_counter() - start) / len(models)
            best[name] = min(spent, best.get(name, spent))
    return best
