"""Cost of one call of h or H, in NumPy and compiled."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from . import export
from .numpy_model import NumpyModel

SIGMA_POINTS = 31


class Calls:
    """Calls of one function at all epochs of a run: a call counts as a run."""

    def __init__(self, which: str) -> None:
        maker, _, function = which.partition("-")
        arrays = export.arrays([0])
        model = NumpyModel(arrays, 0) if maker == "numpy" else export.problems([0])[0].model
        rng = np.random.default_rng(0)
        shape = (SIGMA_POINTS, len(arrays.prior_mean))
        states = arrays.prior_mean + arrays.scale * rng.standard_normal(shape)
        one, all_at_once = states[0], getattr(model, "predict_all", model.predict)
        functions: dict[str, Callable[[int], np.ndarray]] = {
            "h": lambda k: model.predict(k, one),
            "h31": lambda k: all_at_once(k, states),
            "H": lambda k: model.jacobian(k, one),
        }
        self.function, self.runs_per_call = functions[function], len(arrays.times)

    def solve(self, run: int) -> np.ndarray:
        """Call it at every epoch; there are no means."""
        for k in range(self.runs_per_call):
            self.function(k)
        return np.empty(0)
