"""Isolation of the truth from estimators, and detection of names that give access to the truth.

The isolation protects against accidents, such as an estimator that finds the truth among the
objects of its process. It does not protect against intent, because code can read all memory of its
process. Therefore results list the estimators whose source uses functions that give access to the
truth.
"""

from __future__ import annotations

import ast
import contextlib
import mmap
from collections.abc import Iterator

import numpy as np

_MODULES = ("gc", "inspect", "ggbench.simulation", "ggbench.campaign.runner")
"""Modules that inspect a process or simulate runs; estimators do not need them."""
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
    """An array in hidden memory; it becomes a NumPy object only while :meth:`looked_at` is open.

    The original array is overwritten with NaN, so that its memory does not reveal the truth later.
    """

    def __init__(self, array: np.ndarray) -> None:
        self._shape = array.shape
        self._memory = mmap.mmap(-1, max(array.nbytes, 1))
        with self.looked_at() as copy:
            copy[:] = array
        array.fill(np.nan)

    @contextlib.contextmanager
    def looked_at(self) -> Iterator[np.ndarray]:
        """Yield the array (runs, ...), for use while no estimator runs."""
        count = int(np.prod(self._shape))
        yield np.frombuffer(self._memory, dtype=float, count=count).reshape(self._shape)


def suspicious_names(source: bytes) -> list[str]:
    """Return the names in a source file that inspect the process or simulate runs.

    The names are ``gc`` and ``inspect``, attributes of stack frames, and the modules of this
    package that simulate runs. They are sorted.
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
