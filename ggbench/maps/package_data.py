"""Reader of NumPy archives among the data files of the package."""

from __future__ import annotations

import importlib.resources
from typing import Any

from ..errors import text_of
from ..files.archives import read_arrays
from ..gravity.gradient_map import MapError


def data_bytes(name: str) -> bytes:
    """Return the content of a data file of the package.

    Raises MapError if the file cannot be read.
    """
    try:
        return (importlib.resources.files("ggbench.scenarios") / "data" / name).read_bytes()
    except (OSError, ModuleNotFoundError) as error:
        raise MapError(
            f"Data file {name} of ggbench.scenarios cannot be read ({text_of(error)}): install "
            "the package again."
        ) from error


def data_arrays(name: str, keys: tuple[str, ...]) -> dict[str, Any]:
    """Return the arrays ``keys`` of a data file of the package.

    Raises MapError if the file is missing or damaged.
    """
    content = data_bytes(name)
    try:
        return read_arrays(content, MapError, "it", keys)
    except MapError as error:
        raise damaged(name, keys, error) from error


def damaged(name: str, keys: tuple[str, ...], error: Exception) -> MapError:
    """Return a MapError for a data file without usable arrays ``keys``."""
    return MapError(
        f"Data file {name} of ggbench.scenarios is damaged ({text_of(error)}; arrays needed: "
        f"{', '.join(keys)}): install the package again."
    )
