"""Gravity-gradient maps: built from shipped data, read from files and written to files.

The command ``ggbench map build`` builds a map from users' data. The names of this module are
imported at first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..gravity.gradient_map import GradientMap as GradientMap
    from ..gravity.gradient_map import MapError as MapError
    from .recipe import MapRecipe as MapRecipe
    from .recipe import build as build
    from .recipe import load_or_build as load_or_build
    from .recipe import read as read
    from .recipe import write as write

_MODULES = {
    "GradientMap": "ggbench.gravity.gradient_map",
    "MapError": "ggbench.gravity.gradient_map",
    "MapRecipe": "ggbench.maps.recipe",
    "build": "ggbench.maps.recipe",
    "load_or_build": "ggbench.maps.recipe",
    "read": "ggbench.maps.recipe",
    "write": "ggbench.maps.recipe",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_MODULES])
