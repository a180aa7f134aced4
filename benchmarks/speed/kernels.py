"""Where the time of a run goes: compiled kernels and Python functions, timed one by one."""

from __future__ import annotations

import contextlib
import sys
import time
import types
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

from numba.core.dispatcher import Dispatcher


class _Clock:
    """Adds up the time of calls, without that of the timed calls inside."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = defaultdict(float)
        self._inside: list[float] = []

    def timed(self, function: Callable[..., Any], name: str) -> Callable[..., Any]:
        """Return the function, timed under a name."""

        def call(*arguments: Any, **named: Any) -> Any:
            self._inside.append(0.0)
            start = time.perf_counter()
            try:
                return function(*arguments, **named)
            finally:
                elapsed = time.perf_counter() - start
                self.spent[name] += elapsed - self._inside.pop()
                if self._inside:
                    self._inside[-1] += elapsed

        return call


@contextlib.contextmanager
def timed() -> Iterator[dict[str, float]]:
    """Time every kernel of ggbench that Python calls, and every function of its modules.

    Yields
    ------
    Seconds by ``module.kernel`` and ``module.function (Python)``: its own lines, NumPy and methods.
    Kernels called by kernels are part of those.
    """
    clock, replaced = _Clock(), []
    for module in [m for name, m in sys.modules.items() if name.startswith("ggbench.")]:
        for name, value in list(vars(module).items()):
            new = _timed(clock, value)
            if new is not None:
                replaced.append((module, name, value))
                setattr(module, name, new)
    try:
        yield clock.spent
    finally:
        for module, name, value in replaced:
            setattr(module, name, value)


def _timed(clock: _Clock, value: Any) -> Any:
    """Return a timed kernel or function of ggbench or a table of kernels, None for all else."""
    if isinstance(value, Dispatcher):
        home, name = value.py_func.__module__, value.__name__
    elif isinstance(value, types.FunctionType):
        home, name = value.__module__, f"{value.__name__} (Python)"
    elif isinstance(value, dict) and any(isinstance(v, Dispatcher) for v in value.values()):
        return {key: _timed(clock, item) or item for key, item in value.items()}
    else:
        return None
    if not home.startswith("ggbench."):
        return None
    return clock.timed(value, f"{home.removeprefix('ggbench.')}.{name}")


def profile(work: Callable[[], object], runs: int, rounds: int) -> dict[str, float]:
    """Return the seconds per run of each kernel and function, of the best of some rounds.

    Parameters
    ----------
    work : does the runs; it looks its functions up in their modules when it is called.
    runs, rounds : how many runs it does, and how often it is called.

    Returns
    -------
    Seconds by name, and under ``total`` those of all.
    """
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
