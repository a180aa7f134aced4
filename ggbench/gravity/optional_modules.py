"""Import of optional packages that a file format needs."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from .terrain import TerrainError


def imported(module: str, path: Path) -> Any:
    """Import and return an optional module.

    Raises TerrainError if the module is not installed; the message names the file ``path``.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise TerrainError(
            f"{path.name} needs the package {module.partition('.')[0]} ({error}): pip install "
            "'ggbench[terrain]'."
        ) from None
