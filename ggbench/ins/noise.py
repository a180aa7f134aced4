"""Process noise of the INS error model."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..numerics.records import record
from .system_matrix import NAVIGATION_STATES


@record
class Noise:
    """Process noise of the INS error model, as square roots of its PSD matrix G q Gᵀ.

    Attributes
    ----------
    roots : (15,) square roots of the diagonal of G q Gᵀ, without the altimeter's noise.
    altimeter : (2,) factors by which the noise of the altimeter drives δh and δv_U. Both have the
        same source, so they are correlated.
    damped : whether an altimeter damps the vertical channel.
    wandering : whether biases vary.
    disturbance : (3,) noise of the gravity disturbance, ENU; empty if the disturbance is no state.
        Without integrated gradients it is √2 σ [m/s²]. The disturbance is then a Gauss–Markov
        process with the standard deviation σ and the correlation distance D. Its driving noise has
        the PSD 2 σ² |v|/D at the speed |v|. With integrated gradients ``disturbance`` is the root
        PSD of a random walk, per unit of speed [s⁻¹˙⁵].
    """

    roots: np.ndarray
    altimeter: np.ndarray
    damped: bool
    wandering: bool
    disturbance: np.ndarray

    def over(self, interval: float) -> Noise:
        """Return the noise accumulated over ``interval`` [s]: all arrays times √interval."""
        root = math.sqrt(interval)
        return replace(
            self,
            roots=self.roots * root,
            altimeter=self.altimeter * root,
            disturbance=self.disturbance * root,
        )


def noise_roots(noise: np.ndarray, decaying: bool, disturbance: tuple[float, ...] = ()) -> Noise:
    """Return the process noise as square roots of its PSD matrix G q Gᵀ.

    ``noise`` (15, 15) is this matrix. Only an altimeter causes elements off the diagonal.
    ``decaying`` is true if biases decay, as Gauss–Markov processes do. ``disturbance`` is
    :attr:`Noise.disturbance`.
    """
    altimeter, diagonal = np.zeros(2), np.diag(noise).copy()
    if noise[2, 2] > 0.0:
        altimeter = noise[2, [2, 5]] / math.sqrt(noise[2, 2])
        diagonal[[2, 5]] -= altimeter**2
    roots = np.sqrt(np.maximum(diagonal, 0.0))
    wandering = decaying or bool(roots[NAVIGATION_STATES:].any())
    driven = np.array(disturbance, dtype=float)
    return Noise(roots, altimeter, bool(altimeter.any()), wandering, driven)
