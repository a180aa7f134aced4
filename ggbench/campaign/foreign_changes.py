"""Detection and reversal of changes that a user's file makes to other modules.

The main process of a campaign imports a user's file to read the estimator's parameters and
causality and to call ``skip``. The same process computes bounds. Therefore functions, classes and
methods that the file replaces are restored, and the file is refused. The working directory, the
rounding mode and NumPy's handling of floating-point errors are restored too. This detects
accidents. It does not protect against a file that hides its changes, starts threads, or changes the
environment.
"""

from __future__ import annotations

import ctypes
import os
import sys
import types
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

OWN_MODULE = "ggbench_user_"
"""Prefix of the module names of users' files."""
_GUARDED = {"builtins", "json", "math", "os", "pickle", "random", "sqlite3", "struct", "time"}
_GUARDED |= {"ggbench", "numba", "numpy", "pandas", "scipy"}
"""Packages whose functions and classes must stay as they are."""
_METHODS = {"ggbench", "pandas"}
"""Packages whose classes must keep their methods; classes of compiled packages cannot change."""
_KINDS = (types.FunctionType, classmethod, staticmethod, property)


@contextmanager
def put_back(replaced: list[str]) -> Iterator[None]:
    """Restore the functions, classes and methods that code in the ``with`` block replaces.

    Parameters
    ----------
    replaced : list to which the dotted names of the replaced objects are appended.
    """
    import numpy as np  # not at the top: lists of estimators need no numbers

    before = _present()
    folder = Path.cwd()
    try:
        with np.errstate(), _same_rounding():
            yield
    finally:
        os.chdir(folder)
        for (name, owner), functions in before.items():
            # A module that was removed or imported anew is another object than the one of before.
            if isinstance(owner, types.ModuleType) and sys.modules.get(name) is not owner:
                continue
            present = vars(owner)
            for key, function in functions.items():
                if key in present and present[key] is not function:
                    setattr(owner, key, function)
                    replaced.append(f"{name}.{key}")


@contextmanager
def _same_rounding() -> Iterator[None]:
    """Restore the rounding mode of floating-point numbers, which applies to the whole process."""
    modes = ctypes.CDLL(None)
    before = modes.fegetround()
    try:
        yield
    finally:
        modes.fesetround(before)


def _present() -> dict[tuple[str, Any], dict[str, Any]]:
    """Return the functions, classes and methods of guarded modules.

    Keys are the dotted name and the object of a module or class.
    """
    guarded: dict[tuple[str, Any], dict[str, Any]] = {}
    for name, module in list(sys.modules.items()):
        package = name.partition(".")[0]
        if package not in _GUARDED or module is None:
            continue
        content = {key: value for key, value in vars(module).items() if callable(value)}
        guarded[name, module] = content
        if package not in _METHODS:
            continue
        for cls in content.values():
            if isinstance(cls, type) and cls.__module__ == name:
                methods = {k: v for k, v in vars(cls).items() if isinstance(v, _KINDS)}
                guarded[f"{name}.{cls.__qualname__}", cls] = methods
    return guarded
