"""Isolation of the truth from estimators, and detection of names that lead to it.

This protects against mistakes: an estimator that finds the truth by accident, or among the objects
of its process. It is no protection against intent, because code can read all memory of its process.
Therefore results name estimators whose source uses functions that lead to the truth.
"""

from __future__ import annotations

import ast
import contextlib
import mmap
from collections.abc import Iterator

import numpy as np

_MODULES = ("gc", "inspect", "ggbench.simulation", "ggbench.campaign.runner")
"""What an estimator has no use for: it looks through a process, or simulates runs."""
_NAMES = {
    "_getframe",
    "_current_frames",
    "f_back",
    "f_locals",
    "tb_frame",
    "gi_frame",
    "get_referrers",
}


class HiddenArray:
    """An array that is no object of this process until it is accessed.

    The original is filled with NaN, because its memory is used again.
    """

    def __init__(self, array: np.ndarray) -> None:
        self._shape = array.shape
        self._memory = mmap.mmap(-1, max(array.nbytes, 1))
        with self.looked_at() as copy:
            copy[:] = array
        array.fill(np.nan)

    @contextlib.contextmanager
    def looked_at(self) -> Iterator[np.ndarray]:
        """Return the array (runs, ...) as long as no estimator runs."""
        count = int(np.prod(self._shape))
        yield np.frombuffer(self._memory, dtype=float, count=count).reshape(self._shape)


def suspicious_names(source: bytes) -> list[str]:
    """Return the names in a file that inspect its process or simulate runs.

    ``import gc``, ``import inspect``, stack frames, and the simulation of this package; sorted.
    """
    suspicious: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Attribute):
            names = [node.attr]
        elif isinstance(node, ast.Constant):  # getattr(sys, "_getframe")
            names = [node.value] if node.value in _NAMES else []
        for name in names:
            suspicious.update(module for module in _MODULES if f"{name}.".startswith(f"{module}."))
            suspicious.update(_NAMES & {name.rpartition(".")[2]})
    return sorted(suspicious)
