"""Process noise of the INS error model."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..numerics.records import record
from .system_matrix import NAVIGATION_STATES


@record
class Noise:
    """What drives the error model: G q Gᵀ by its square roots.

    Attributes
    ----------
    roots : (15,) of the diagonal, without the altimeter's part.
    altimeter : (2,) in δh and δv_U, of what couples them.
    damped : whether there is an altimeter.
    wandering : whether biases decay or are driven.
    disturbance : (3,) what drives the gravity disturbance ENU, of no elements where it is no state:
        √2 σ [m/s²], whose PSD is 2 σ² |v|/D; or what the speed multiplies [s⁻¹˙⁵] where gradients
        are integrated, whose noise has the PSD of a walk.
    """

    roots: np.ndarray
    altimeter: np.ndarray
    damped: bool
    wandering: bool
    disturbance: np.ndarray

    def over(self, interval: float) -> Noise:
        """Return the noise that gathers over an interval [s]."""
        root = math.sqrt(interval)
        return replace(
            self,
            roots=self.roots * root,
            altimeter=self.altimeter * root,
            disturbance=self.disturbance * root,
        )


def noise_roots(noise: np.ndarray, decaying: bool, disturbance: tuple[float, ...] = ()) -> Noise:
    """Return the square roots of G q Gᵀ (15, 15): diagonal but for what an altimeter couples.

    ``decaying`` says that F makes biases decay; ``disturbance`` is :attr:`Noise.disturbance`.
    """
    altimeter, diagonal = np.zeros(2), np.diag(noise).copy()
    if noise[2, 2] > 0.0:
        altimeter = noise[2, [2, 5]] / math.sqrt(noise[2, 2])
        diagonal[[2, 5]] -= altimeter**2
    roots = np.sqrt(np.maximum(diagonal, 0.0))
    wandering = decaying or bool(roots[NAVIGATION_STATES:].any())
    driven = np.array(disturbance, dtype=float)
    return Noise(roots, altimeter, bool(altimeter.any()), wandering, driven)
