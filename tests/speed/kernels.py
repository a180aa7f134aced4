"""Where the time of a run goes: the compiled kernels that Python calls, timed one by one."""

from __future__ import annotations

import contextlib
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

from numba.core.dispatcher import Dispatcher


class _Timed:
    """A kernel that adds up the time of its calls."""

    def __init__(self, kernel: Any, name: str, spent: dict[str, float]) -> None:
        self._kernel, self._name, self._spent = kernel, name, spent

    def __call__(self, *arguments: Any) -> Any:
        start = time.perf_counter()
        result = self._kernel(*arguments)
        self._spent[self._name] += time.perf_counter() - start
        return result


@contextlib.contextmanager
def timed() -> Iterator[dict[str, float]]:
    """Time every compiled kernel of ggbench while it is called from Python.

    Yields
    ------
    Seconds by kernel, ``module.function``. Kernels called by kernels are part of those.
    """
    spent: dict[str, float] = defaultdict(float)
    replaced = []
    for module in [m for name, m in sys.modules.items() if name.startswith("ggbench.")]:
        for name, value in list(vars(module).items()):
            if isinstance(value, Dispatcher):
                home = value.py_func.__module__.removeprefix("ggbench.")
                replaced.append((module, name, value))
                setattr(module, name, _Timed(value, f"{home}.{value.py_func.__name__}", spent))
    try:
        yield spent
    finally:
        for module, name, value in replaced:
            setattr(module, name, value)


def profile(work: Callable[[], object], runs: int, rounds: int) -> dict[str, float]:
    """Return the seconds per run of each kernel, of the best of some rounds; ``total`` of all."""
    best: dict[str, float] = {}
    work()  # compiled, and in memory
    for _ in range(rounds):
        with timed() as spent:
            start = time.perf_counter()
            work()
            total = time.perf_counter() - start
        if not best or total < best["total"]:
            best = {"total": total, **spent}
    return {name: seconds / runs for name, seconds in best.items()}
