"""How the hot loops are compiled: two decorators, and what their settings are for.

Kernels are kept on disk (see :mod:`ggbench.cache`), let other threads run, and divide as NumPy does:
by zero gives infinity or NaN, which is judged later, where Python's exception would be a branch that
keeps a loop from becoming vector instructions.
"""

from __future__ import annotations

from numba import njit

compiled = njit(cache=True, nogil=True, error_model="numpy")
"""A kernel."""
inlined = njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
"""Arithmetic on numbers that becomes part of the loops that call it, and is vectorised with them."""
