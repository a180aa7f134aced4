"""Random models of a gravity field by spherical harmonics."""

from __future__ import annotations

import numpy as np

from ggbench.gravity import ellipsoid
from ggbench.gravity.harmonics import HarmonicCoefficients


def random_model(degree: int, seed: int) -> HarmonicCoefficients:
    """A model with a spectrum like the Earth's (Kaula's rule)."""
    n = np.maximum(np.arange(degree + 1), 2)[:, np.newaxis]
    lower = np.tril(np.ones((degree + 1, degree + 1)))
    draws = np.random.default_rng(seed).normal(size=(2, degree + 1, degree + 1))
    cosine, sine = draws * 1e-5 / n**2 * lower
    sine[:, 0] = 0.0
    cosine[:2], sine[:2] = 0.0, 0.0
    return HarmonicCoefficients(ellipsoid.GM, 6378136.3, cosine, sine)
