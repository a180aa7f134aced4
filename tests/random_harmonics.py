"""Random models of a gravity field by spherical harmonics."""

from __future__ import annotations

from pathlib import Path

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


def write_gfc(path: Path, degree: int, seed: int = 1) -> None:
    """Write a random model as ICGEM's text."""
    model = random_model(degree, seed)
    model.cosine[2, 0] = -4.8416e-4
    lines = [
        f"gfc {n} {m} {model.cosine[n, m]:.15e} {model.sine[n, m]:.15e}"
        for n in range(2, degree + 1)
        for m in range(n + 1)
    ]
    head = ["earth_gravity_constant 3.986004418e14", f"radius {model.radius}"]
    path.write_text("\n".join([*head, f"max_degree {degree}", "end_of_head", *lines, ""]))
