"""What h and H cost inside a compiled engine: their kernels alone, over all epochs of some runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from ggbench.kernels import compiled
from ggbench.measurement_kernels import ModelArrays, linearise_errors, predict_errors

from . import export


@compiled
def _linearise_all(model: ModelArrays, errors: np.ndarray) -> float:
    channels = model.channels.shape[0]
    predicted, slope = np.empty(channels), np.empty((channels, 6))
    total = 0.0
    for k in range(errors.shape[0]):
        linearise_errors(model, k, errors[k], predicted, slope)
        total += predicted[0] + slope[0, 0]
    return total


@compiled
def _predict_all(model: ModelArrays, errors: np.ndarray) -> float:
    out = np.empty((model.channels.shape[0], errors.shape[2]))
    total = 0.0
    for k in range(errors.shape[0]):
        predict_errors(model, k, errors[k], out)
        total += out[0, 0]
    return total


def _called(kernel: Callable[..., float], errors: np.ndarray, model: ModelArrays) -> float:
    return kernel(model, errors)


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

    def errors(count: int) -> np.ndarray:
        found = np.zeros((problems[0].epochs, 6, count))
        found[:, :3] = scale[:3, np.newaxis] * rng.standard_normal((len(found), 3, count))
        return found

    work: dict[str, Callable[[ModelArrays], float]] = {
        "h and H": partial(_called, _linearise_all, errors(1)[:, :, 0].copy()),
        **{f"h of {count}": partial(_called, _predict_all, errors(count)) for count in points},
    }
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
