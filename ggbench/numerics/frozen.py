"""Arrays that their holders cannot change: by no means, or not by mistake."""

from __future__ import annotations

import numpy as np


def frozen(array: np.ndarray) -> np.ndarray:
    """Return an immutable copy: backed by bytes, it cannot be made writeable again."""
    contiguous = np.ascontiguousarray(array, dtype=float)
    return np.frombuffer(contiguous.tobytes()).reshape(contiguous.shape)


def read_only(array: np.ndarray) -> np.ndarray:
    """Return an array, contiguous, that its holders cannot change by mistake; no copy if it is."""
    contiguous = np.ascontiguousarray(array, dtype=float)
    if contiguous.flags.writeable:
        contiguous = contiguous.view()
        contiguous.flags.writeable = False
    return contiguous
