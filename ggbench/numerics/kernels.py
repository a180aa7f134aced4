"""Decorators for compiled functions (kernels).

Kernels are cached on disk (:mod:`.compiling`) and release the GIL. Division by zero gives infinity
or NaN, as in NumPy, because a branch that raises an exception would prevent vector instructions.
The compiler may not fuse products and sums, so the results of a kernel are bitwise equal wherever
it is inlined; see :mod:`.vectors`. Arrays are copied in loops, because numba needs three seconds to
compile an assignment of one array to another.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numba import njit

from .compiling import Kernel


def _decorator(**options: Any) -> Any:
    # No kernel is called from C.
    options = {"nogil": True, "no_cfunc_wrapper": True, "error_model": "numpy"} | options

    def decorate(function: Callable[..., Any]) -> Any:
        return Kernel(function, partial(njit, **options))

    return decorate


compiled = _decorator()
"""A kernel."""
inlined = _decorator(forceinline=True)
"""Arithmetic that becomes part of the loops which call it, and is vectorised with them."""
copied = _decorator(inline="always")
"""A part of a kernel that is compiled as one with it. A part that a single kernel has is then not
optimised twice. In others, sizes that are constants where it is used make loops of known length,
which become vector instructions without a remainder."""
interpreted = _decorator(nogil=False)
"""A part that calls the interpreter, which one thread runs at a time."""

LANES = 8
"""Runs that go through a kernel together, in the lanes of vector registers: the last index."""


@compiled
def aligned(count: int) -> np.ndarray:
    """Return an unfilled array (count,) whose first element is at the start of a cache line.

    Each vector of eight numbers then lies within one cache line, which makes loops 1.5 times as
    fast.
    """
    array = np.empty(count + 7)
    start = -(array.ctypes.data // 8) % 8
    return array[start : start + count]
