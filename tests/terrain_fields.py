"""Rough terrains, and the field of a terrain at all heights at once."""

from __future__ import annotations

import numpy as np

from ggbench.gravity.parker import terrain_layers
from ggbench.gravity.terrain import Terrain


def terrain_field(*args, dtype=np.float64, **kwargs):
    """The tensor (n_lat, n_lon, n_h, 6) [E] and the vector (n_lat, n_lon, n_h, 3) [m/s²]."""
    tensors, vectors = zip(*terrain_layers(*args, dtype=dtype, **kwargs), strict=True)
    return np.stack(tensors, axis=2), np.stack(vectors, axis=2)


def rough_terrain(count: int, relief: float, seed: int = 1, step_deg: float = 3.0 / 3600.0):
    """A square of ``count`` cells per side, with heights from 200 m up by so much [m]."""
    rng = np.random.default_rng(seed)
    k = np.hypot(np.fft.fftfreq(count)[:, np.newaxis], np.fft.rfftfreq(count))
    k[0, 0] = 1.0
    spectrum = np.fft.rfft2(rng.standard_normal((count, count))) * k**-2.0
    heights = np.fft.irfft2(spectrum, (count, count))
    heights = 200.0 + relief * (heights - heights.min()) / np.ptp(heights)
    return Terrain(45.0, 7.0, step_deg, step_deg, heights, "rough ground")
