"""Functions of other modules that a user's file replaces.

A campaign's own process imports a user's file for its parameters, its causality and its ``skip``,
and also computes bounds. Therefore replaced functions are restored, and the file is refused. This
detects accidents. It is no protection against a file that hides its changes.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

OWN_MODULE = "ggbench_user_"
"""How the module names of users' files begin."""
_GUARDED = {"builtins", "json", "math", "pickle", "random", "struct", "time"}
_GUARDED |= {"ggbench", "numba", "numpy", "pandas", "scipy"}
"""Packages whose functions and classes must stay as they are."""


@contextmanager
def put_back(replaced: list[str]) -> Iterator[None]:
    """Restore the functions and classes that are replaced within the context.

    Parameters
    ----------
    replaced : receives their dotted names.
    """
    before = {
        name: {key: value for key, value in vars(module).items() if callable(value)}
        for name, module in list(sys.modules.items())
        if name.partition(".")[0] in _GUARDED and module is not None
    }
    try:
        yield
    finally:
        for name, functions in before.items():
            module = sys.modules.get(name)
            present: dict[str, Any] = {} if module is None else vars(module)
            for key, function in functions.items():
                if key in present and present[key] is not function:
                    present[key] = function
                    replaced.append(f"{name}.{key}")
