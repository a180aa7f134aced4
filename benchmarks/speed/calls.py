"""Costs of evaluations: h and H in NumPy and compiled, and a field with level or draped layers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ggbench.gravity.field import Field
from ggbench.gravity.gradient_map import GradientMap

from . import export
from .numpy_model import NumpyModel

SIGMA_POINTS = 31


class Calls:
    """Calls of one function at all epochs of a run; each call counts as a run.

    The argument is the implementation, ``numpy`` or ``compiled``, and the function: ``h``, ``h31``
    (h of 31 states) or ``H``. An example is ``numpy-h31``.
    """

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
        """Call the function at every epoch; return an empty array instead of means."""
        for k in range(self.runs_per_call):
            self.function(k)
        return np.empty(0)


class FieldCalls:
    """Evaluations of the tensor, with or without derivatives, along a track in a random map.

    The level map and the draped map have the same values at their nodes. The tracks have the same
    heights relative to the nodes.
    """

    NODES = 160, 160, 13
    STEP = np.array([1.2e-5, 1.6e-5, 25.0])
    ORIGIN = np.array([0.7, 0.2, 25.0])

    def __init__(self, which: str) -> None:
        layers, _, self.what = which.partition("-")
        rng = np.random.default_rng(0)
        values = rng.standard_normal((*self.NODES, 9))
        base = 1500.0 + 30.0 * rng.standard_normal(self.NODES[:2])
        field = Field.from_map(
            GradientMap(
                *self.ORIGIN, *self.STEP, values[..., :6], values[..., 6:], "random", base=base
            )
        )
        self.field = field if layers == "draped" else field.flattened()
        self.runs_per_call = 2000
        share = np.linspace(0.1, 0.9, self.runs_per_call)[:, np.newaxis]
        places = field.lower + share * (field.upper - field.lower)
        self.places = np.stack(self.field.over_nodes(*places.T), axis=-1)

    def solve(self, run: int) -> object:
        """Evaluate the field at all places; each evaluation counts as a run."""
        if self.what == "tensor":
            return self.field.continued_tensor(self.places)
        return self.field.tensor_and_derivative(*self.places.T)
