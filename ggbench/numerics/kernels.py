"""How the hot loops are compiled: four decorators, and what their settings are for.

Kernels are kept on disk (see :mod:`.compiling`) and let other threads run. They divide as
NumPy does: by zero gives infinity or NaN, which is judged later; Python's exception would be a
branch that keeps a loop from becoming vector instructions. A product and a sum may be one
instruction. Arrays are copied in loops: an assignment of one array to another has numba compile
three seconds of shapes and messages, in every process anew.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

from .compiling import keep


def _decorator(**options: Any) -> Any:
    # No kernel is called from C.
    options |= {"no_cfunc_wrapper": True, "error_model": "numpy", "fastmath": {"contract"}}
    jit = njit(**{"nogil": True} | options)

    def decorate(function: Callable[..., Any]) -> Any:
        return keep(jit(function))

    return decorate


compiled = _decorator()
"""A kernel."""
inlined = _decorator(forceinline=True)
"""Arithmetic that becomes part of the loops which call it, and is vectorised with them."""
copied = _decorator(inline="always")
"""A part of a kernel that is compiled anew where it is used: sizes that are constants there make
loops of known length, which become vector instructions without a remainder."""
interpreted = _decorator(nogil=False)
"""A part that calls the interpreter, which no thread runs beside another one."""

LANES = 8
"""Runs that go through a kernel together, in the lanes of vector registers: the last index."""


@compiled
def aligned(count: int) -> np.ndarray:
    """Return an array (count,), not yet filled, that begins where a line of the cache does.

    Vectors of eight numbers then are in one line each, which makes loops over them half as fast
    again.
    """
    array = np.empty(count + 7)
    start = -(array.ctypes.data // 8) % 8
    return array[start : start + count]
