"""A small map of random gradients."""

from __future__ import annotations

import math

import numpy as np

from ggbench.gravity.gradient_map import GradientMap

SHAPE = (9, 11, 5)


def some_map(dtype: type = np.float64) -> GradientMap:
    rng = np.random.default_rng(7)
    tensor, vector = rng.normal(size=(*SHAPE, 6)), 1e-4 * rng.normal(size=(*SHAPE, 3))
    tensor[..., 5] = -tensor[..., 0] - tensor[..., 3]
    return GradientMap(
        latitude0=math.radians(33.0),
        longitude0=math.radians(107.5),
        height0=2500.0,
        latitude_step=math.radians(0.01),
        longitude_step=math.radians(0.02),
        height_step=125.0,
        tensor=tensor.astype(dtype).astype(float),
        gravity_disturbance=vector.astype(dtype).astype(float),
        provenance="drawn at random",
    )
