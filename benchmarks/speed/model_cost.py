"""What h and H cost inside a compiled engine: their kernels alone, over all epochs of some runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from ggbench.numerics import lanes
from ggbench.numerics.kernels import LANES, compiled
from ggbench.sensors.model_arrays import ModelArrays, epoch_context, load_epoch, point_scratch
from ggbench.sensors.model_kernels import linearise_reading, read
from ggbench.simulation.runs import simulate_block

from . import export


@compiled
def _linearise_all(model: ModelArrays, errors: np.ndarray) -> float:
    """Linearise h of the eight runs of a block at every epoch."""
    channels = model.channels.shape[0]
    predicted, slope = lanes.lanes(1, channels), lanes.lanes(channels, 6)
    context, points, group = epoch_context(model), point_scratch(1), lanes.members(0, LANES)
    total = 0.0
    for k in range(errors.shape[0]):
        load_epoch(model, group, k, context)
        linearise_reading(model, k, context, errors[k], LANES, points, predicted, slope)
        total += predicted[0, 0, 0] + slope[0, 0, 0]
    return total


@compiled
def _predict_all(model: ModelArrays, errors: np.ndarray) -> float:
    """Evaluate h of the eight runs of a block at every epoch, at as many points in each run."""
    channels, vectors = model.channels.shape[0], errors.shape[2]
    out, context, points = (
        lanes.lanes(channels, vectors),
        epoch_context(model),
        point_scratch(vectors),
    )
    group = lanes.members(0, LANES)
    total = 0.0
    for k in range(errors.shape[0]):
        load_epoch(model, group, k, context)
        read(model, k, context, errors[k], vectors, vectors * LANES, points, out)
        total += out[0, 0, 0]
    return total


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
    scale = np.sqrt(np.diag(block.prior_cov))
    rng = np.random.default_rng(0)

    def errors(count: int) -> np.ndarray:
        found = np.zeros((block.epochs, 6, count, LANES))
        drawn = rng.standard_normal((block.epochs, 3, count, LANES))
        found[:, :3] = scale[:3, np.newaxis, np.newaxis] * drawn
        return found

    def timed(kernel: Callable[..., float], count: int) -> Callable[[], object]:
        drawn = errors(count)
        return lambda: kernel(block.model, drawn)

    work: dict[str, Callable[[], object]] = {
        "h and H": timed(_linearise_all, 1),
        **{f"h of {count}": timed(_predict_all, count) for count in points},
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
