"""Immutable and read-only arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np


def frozen(array: np.ndarray) -> np.ndarray:
    """Return an immutable copy of an array of any shape (...).

    The copy is stored in a ``bytes`` object, so it cannot be made writeable.
    """
    contiguous = _contiguous(array)
    return np.frombuffer(contiguous.tobytes(), contiguous.dtype).reshape(contiguous.shape)


def read_only(array: np.ndarray) -> np.ndarray:
    """Return an array (...) as a read-only, contiguous array; copy it only if necessary."""
    contiguous = _contiguous(array)
    if contiguous.flags.writeable:
        contiguous = contiguous.view()
        contiguous.flags.writeable = False
    return contiguous


def _contiguous(array: np.ndarray) -> np.ndarray:
    """Return a contiguous array: bool if ``array`` is bool, else float."""
    kind = bool if array.dtype.kind == "b" else float
    return np.ascontiguousarray(array, dtype=kind)


def freeze_arrays(instance: Any, freeze: Callable[[np.ndarray], np.ndarray] = frozen) -> None:
    """Replace each array in the fields of a frozen dataclass by the result of ``freeze``.

    Call it in ``__post_init__``.

    Parameters
    ----------
    instance : instance of the dataclass.
    freeze : function that is called with an array of any shape (...). It returns the array to
        store, by default an immutable copy.
    """
    for item in fields(instance):
        value = getattr(instance, item.name)
        if isinstance(value, np.ndarray):
            object.__setattr__(instance, item.name, freeze(value))
