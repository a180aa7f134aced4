"""Normal field in the measurements of a gradiometer."""

from __future__ import annotations

import numpy as np

from ..gravity.field import Field
from ..sensors.gradiometer.instrument import INSTRUMENTS, readings_along


def normal_readings(
    instrument: str, positions: np.ndarray, times: np.ndarray, attitudes: np.ndarray
) -> np.ndarray:
    """Return the normal field's tensors (N, 6) [E] in a mount at positions (N, 3) and times (N,).

    ``attitudes`` are C_nb (N, 3, 3).
    """
    kind = INSTRUMENTS.index(instrument)
    return readings_along(kind, positions, times, attitudes, Field.normal())
