"""Normal field as a gradiometer measures it."""

from __future__ import annotations

import numpy as np

from ..gravity.field import Field
from ..sensors.gradiometer.instrument import INSTRUMENTS, readings_along


def normal_readings(
    instrument: str, positions: np.ndarray, times: np.ndarray, attitudes: np.ndarray
) -> np.ndarray:
    """Return the gradient tensors (N, 6) [E] of the normal field in a gradiometer's axes.

    ``instrument`` is the mount of the gradiometer: ``platform``, ``local-level`` or ``strapdown``.
    ``positions`` (N, 3) are in [rad, rad, m], ``times`` (N,) in seconds, and ``attitudes``
    (N, 3, 3) are C_nb.
    """
    kind = INSTRUMENTS.index(instrument)
    return readings_along(kind, positions, times, attitudes, Field.normal())
