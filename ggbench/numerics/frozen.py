"""Arrays that their holders cannot change: by no means, or not by mistake."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

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


def freeze_arrays(instance: Any, freeze: Callable[[np.ndarray], np.ndarray] = frozen) -> None:
    """Replace the arrays among the fields of a frozen dataclass: for its ``__post_init__``."""
    for item in fields(instance):
        value = getattr(instance, item.name)
        if isinstance(value, np.ndarray):
            object.__setattr__(instance, item.name, freeze(value))
