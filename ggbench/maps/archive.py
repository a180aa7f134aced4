"""Gravity-gradient maps as NumPy archives, ``*.npz``."""

from __future__ import annotations

import dataclasses
import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import text_of
from ..files import written_whole
from ..gravity.gradient_map import GradientMap, MapError
from . import checks
from .netcdf import FEWEST_NODES
from .shipped_regions import read_arrays


def read(path: Path) -> GradientMap:
    """Return the map in an archive that :func:`write` wrote.

    Raises MapError if there is no such file, or it is no complete map; the message says what is
    missing.
    """
    fields = dataclasses.fields(GradientMap)
    names = [item.name for item in fields if item.default_factory is dataclasses.MISSING]
    optional = [item.name for item in fields if item.name not in names]
    try:
        content = path.read_bytes()
        with zipfile.ZipFile(io.BytesIO(content)) as zipped:
            unpacked = sum(entry.file_size for entry in zipped.infolist())
            stored = {entry.filename.removesuffix(".npy") for entry in zipped.infolist()}
        if unpacked > checks.MOST_BYTES_READ:
            raise MapError(
                f"{path} unpacks to {unpacked / 1e9:.3g} GB; at most "
                f"{checks.MOST_BYTES_READ / 1e9:.3g} GB can be read"
            )
        arrays = read_arrays(content, [*names, *(key for key in optional if key in stored)])
    except OSError as error:
        raise MapError(f"cannot read the map {path}: {error.strerror}") from None
    except MapError:
        raise
    except Exception as error:  # whatever a damaged archive makes of itself
        raise MapError(
            f"{path} is not a gradient map: {text_of(error)}; "
            f"it must hold the arrays {', '.join(names)}"
        ) from None
    tensor, disturbance = arrays["tensor"], arrays["gravity_disturbance"]
    shape = tensor.shape
    grids = (
        len(shape) == 4
        and min(shape[:3]) >= FEWEST_NODES
        and shape[3] == 6
        and disturbance.shape == (*shape[:3], 3)
        and all(a.dtype.kind == "f" and np.isfinite(a).all() for a in (tensor, disturbance))
    )
    if not grids:
        raise MapError(
            f"{path} is not a gradient map: tensor must be (n_lat, n_lon, n_h, 6) and "
            f"gravity_disturbance (n_lat, n_lon, n_h, 3), finite numbers at no less than "
            f"{FEWEST_NODES} nodes per axis; found {shape} and {disturbance.shape}"
        )
    scalars = {key: arrays[key] for key in names if key.endswith(("0", "_step"))}
    for key, value in scalars.items():
        if value.shape != () or value.dtype.kind not in "fi" or not np.isfinite(value):
            raise MapError(f"{path} is not a gradient map: {key} must be one finite number")
        if key.endswith("_step") and value <= 0:
            raise MapError(f"{path} is not a gradient map: {key} must be positive, not {value}")
    checks.require_possible(str(path), tensor, disturbance)
    errors = {key: arrays[key] for key in optional if key in arrays}
    for key, value in errors.items():
        if value.shape != (9,) or value.dtype.kind != "f" or (value < 0.0).any():
            raise MapError(f"{path} is not a gradient map: {key} must be nine numbers or NaN")
    found: dict[str, Any] = {key: float(value) for key, value in scalars.items()} | errors
    return GradientMap(
        **found,
        tensor=tensor.astype(float),
        gravity_disturbance=disturbance.astype(float),
        provenance=checks.clean_text(str(arrays["provenance"])),
    )


def write(path: Path, gradient_map: GradientMap) -> None:
    """Write a map in double precision. Raises MapError if the file cannot be written."""
    size = sum(np.asarray(part).nbytes for part in vars(gradient_map).values())
    with (
        written_whole(path, MapError, "the map ", size) as temporary,
        temporary.open("wb") as file,
    ):
        np.savez(file, allow_pickle=False, **vars(gradient_map))
