"""The field of a terrain at all heights at once."""

from __future__ import annotations

import numpy as np

from ggbench.gravity.parker import terrain_layers


def terrain_field(*args, dtype=np.float64, **kwargs):
    """The tensor (n_lat, n_lon, n_h, 6) [E] and the vector (n_lat, n_lon, n_h, 3) [m/s²]."""
    tensors, vectors = zip(*terrain_layers(*args, dtype=dtype, **kwargs), strict=True)
    return np.stack(tensors, axis=2), np.stack(vectors, axis=2)
