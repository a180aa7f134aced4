"""What h and H cost inside a compiled engine: their kernels alone, over all epochs of some runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from ggbench.numerics.kernels import LANES, compiled
from ggbench.sensors.model_kernels import ModelArrays, predict_errors
from ggbench.sensors.model_lanes import linearise_lanes, linearising_work
from ggbench.simulation.runs import simulate_block

from . import export


@compiled
def _linearise_all(model: ModelArrays, errors: np.ndarray) -> float:
    """Linearise h of the eight runs of a block at every epoch."""
    channels = model.channels.shape[0]
    predicted, slope = np.empty(channels * LANES), np.empty(channels * 6 * LANES)
    work, group = linearising_work(), np.arange(LANES)
    total = 0.0
    for k in range(errors.shape[0]):
        linearise_lanes(model, group, LANES, k, errors[k], work, predicted, slope)
        total += predicted[0] + slope[0]
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


def measure(points: Sequence[int], rounds: int) -> dict[str, float]:
    """Return the best of some rounds' seconds per run, on eight runs.

    Parameters
    ----------
    points : for each number of points, h of that many at every epoch is timed: ``h of N``.

    Returns
    -------
    Those, and ``h and H``: both, at one state an epoch, of eight runs at once.
    """
    block, _ = simulate_block(export.flight(), export.seed(), range(LANES))
    models = [block.problem(run).model.arrays for run in range(LANES)]
    scale = np.sqrt(np.diag(block.prior_cov))
    rng = np.random.default_rng(0)

    def errors(count: int) -> np.ndarray:
        found = np.zeros((block.epochs, 6, count))
        found[:, :3] = scale[:3, np.newaxis] * rng.standard_normal((len(found), 3, count))
        return found

    def predictions(count: int) -> Callable[[], object]:
        drawn = errors(count)
        return lambda: [_predict_all(model, drawn) for model in models]

    at_once = errors(LANES).reshape(block.epochs, -1)
    work: dict[str, Callable[[], object]] = {
        "h and H": lambda: _linearise_all(block.model, at_once),
        **{f"h of {count}": predictions(count) for count in points},
    }
    best: dict[str, float] = {}
    for function in work.values():
        function()  # compiled
    for _ in range(rounds):
        for name, function in work.items():
            start = time.perf_counter()
            function()
            spent = (time.perf_counter() - start) / LANES
            best[name] = min(spent, best.get(name, spent))
    return best
