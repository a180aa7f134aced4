"""Isolation of the truth from estimators, and detection of names that lead to it.

This guards against mistakes: what an estimator finds by accident, or by looking through the objects
of its process. It is no prison: code that runs in a process can read all of its memory. So an
estimator whose source looks where only truth is to be found is named with its results.
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
    """An array that is no object of this process until it is looked at.

    What is put away is filled with NaN: memory is used again.
    """

    def __init__(self, array: np.ndarray) -> None:
        self._shape = array.shape
        self._memory = mmap.mmap(-1, max(array.nbytes, 1))
        with self.looked_at() as copy:
            copy[:] = array
        array.fill(np.nan)

    @contextlib.contextmanager
    def looked_at(self) -> Iterator[np.ndarray]:
        """Give the array (runs, ...), as long as no estimator runs."""
        count = int(np.prod(self._shape))
        yield np.frombuffer(self._memory, dtype=float, count=count).reshape(self._shape)


def suspicious_names(source: bytes) -> list[str]:
    """Return what a file uses that looks through the process that runs it, or simulates runs.

    ``import gc``, ``import inspect``, frames of the stack, the package's own simulation; sorted.
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
