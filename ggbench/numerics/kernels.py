"""Decorators for compiled functions (kernels).

Kernels are cached on disk (:mod:`.compiling`) and release the GIL. Division by zero gives infinity
or NaN, as in NumPy, because a branch that raises an exception would prevent vector instructions.
The compiler must not fuse products and sums on its own. Therefore the results of a kernel are
bitwise equal wherever it is inlined; see :mod:`.vectors`. Arrays are copied in loops, because numba
needs three seconds to compile an assignment of one array to another.
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
"""Decorator of a kernel."""
inlined = _decorator(forceinline=True)
"""Decorator of arithmetic that is inlined into the calling loops and vectorised with them."""
copied = _decorator(inline="always")
"""Decorator of a part of a kernel that numba inlines before compilation. A part with a single
caller is then not optimised twice. In a part with several callers, array sizes that are constant in
a caller give loops of known length. Such loops become vector instructions without a remainder."""
interpreted = _decorator(nogil=False)
"""Decorator of a kernel that calls the Python interpreter and therefore holds the GIL."""

LANES = 8
"""Number of runs that a kernel processes together in the lanes of vector registers. The last axis
of arrays has this length."""


@compiled
def aligned(count: int) -> np.ndarray:
    """Return an unfilled array (count,) whose first element is at the start of a cache line.

    Each vector of eight numbers then lies within one cache line, which makes loops 1.5 times as
    fast.
    """
    array = np.empty(count + 7)
    start = -(array.ctypes.data // 8) % 8
    return array[start : start + count]
