"""Validation of manifests and arrays of untrusted results folders."""

from __future__ import annotations

import re
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from ..errors import line_of
from ..spec.limits import MOST_RUNS, MOST_SEED, SCENARIO_NAME

_MOST_ESTIMATORS, _MOST_CELLS = 1000, 1_000_000


class _Part(BaseModel):
    model_config = ConfigDict(strict=True, extra="allow")


class _Cell(_Part):
    model_config = ConfigDict(strict=True, extra="forbid")

    assumption: str
    case: str
    problem: str
    estimator: str
    key: str


class _Input(_Part):
    role: str
    name: str
    sha256: str


class _Machine(_Part):
    system: str
    architecture: str
    processors: int | None


class _Manifest(_Part):
    scenario: Annotated[str, Field(min_length=1, pattern=SCENARIO_NAME)]
    scenario_hash: str
    scenario_text: str
    argument: str
    title: str
    notes: str
    seed: Annotated[int, Field(ge=0, le=MOST_SEED)]
    runs: Annotated[int, Field(ge=1, le=MOST_RUNS)]
    estimators: Annotated[dict[str, dict[str, Any]], Field(max_length=_MOST_ESTIMATORS)]
    families: dict[str, str]
    cases: Annotated[list[str], Field(min_length=1)]
    assumptions: bool
    cells: Annotated[list[_Cell], Field(max_length=_MOST_CELLS)]
    shared: dict[str, str]
    ggbench: str
    results_version: int
    versions: dict[str, str]
    inputs: list[_Input] = []
    date: str
    machine: _Machine


_MANIFEST = TypeAdapter(_Manifest)


def flaw_of_manifest(content: Any) -> str | None:
    """Return the first fault of a manifest in a few words; None if it has no fault."""
    try:
        _MANIFEST.validate_python(content)
    except ValidationError as error:
        problem = error.errors()[0]
        where = ".".join(str(part) for part in problem["loc"])
        if problem["type"] == "missing":
            return f"it has no {where}"
        return f"its {where or 'content'} is invalid ({problem['msg']})"
    return _flaw_of_cells(content)


def _flaw_of_cells(manifest: dict[str, Any]) -> str | None:
    """Return the first fault of a manifest's cells, or None; all types must be correct."""
    cells = manifest["cells"]
    places = {(cell["assumption"], cell["case"], cell["estimator"]) for cell in cells}
    if len(places) < len(cells):
        return "its cells contain the same estimator and case twice"
    if len(set(manifest["cases"])) < len(manifest["cases"]):
        return "its list of cases contains a name twice"
    declared = {cell["case"] for cell in cells if not cell["assumption"]}
    if unknown := sorted(declared - set(manifest["cases"])):
        return f"its cells have an unknown case {line_of(unknown[0], 60)}"
    own = {cell["estimator"] for cell in cells if not cell["assumption"]}
    if unknown := sorted(own - set(manifest["estimators"])):
        return f"its cells have an unknown estimator {line_of(unknown[0], 60)}"
    if unknown := sorted(set(manifest["estimators"]) - set(manifest["families"])):
        return f"it has no family of the estimator {line_of(unknown[0], 60)}"
    return None


_OF_GRAVITY = {"response": 9, "gravity": 8}
"""Arrays of cases with an unknown gravity disturbance, and their numbers of columns."""
_OF_GRADIENTS = ("gradient_times", "vertical", "noisy", "filtered", "filtered_true")
"""Possible arrays of a case with a gradiometer."""


def flaw_of_arrays(arrays: dict[str, np.ndarray]) -> str | None:
    """Return the first fault of a case's shared arrays (K,) or (K, m); None if there is none."""
    bounds = {name: 2 for name in arrays if name.startswith("bound-")}
    columns = {
        "times": 0,
        "kept": 0,
        "track": 3,
        "bound-filter": 2,
        "bound-batch": 2,
        "present": 0,
        "channels": 0,
    } | bounds
    gradients = {name for name in _OF_GRADIENTS if name in arrays}
    if gradients:
        gradients |= {"gradient_times", "vertical", "noisy"}
    columns |= dict.fromkeys(gradients, 0)
    columns |= {name: width for name, width in _OF_GRAVITY.items() if name in arrays}
    for name, width in columns.items():
        if name not in arrays:
            return f"it has no {name}"
        if name.startswith("bound-") and not re.fullmatch(
            r"bound-(filter|batch|unfiltered|fixed-lag-\d+)", name
        ):
            return f"it has an unknown {name}"
        along = name if name == "kept" else "gradient_times" if name in gradients else "times"
        length = len(np.atleast_1d(arrays[along]))
        if arrays[name].shape != ((length, width) if width else (length,)):
            return f"its {name} has the shape {arrays[name].shape}"
        if arrays[name].dtype.kind != ("i" if name == "kept" else "f"):
            return f"its {name} holds {arrays[name].dtype}"
        if not np.isfinite(arrays[name]).all():
            return f"its {name} is not finite"
    stored = arrays["kept"]
    if len(stored) == 0 or stored.min() < 0 or stored.max() >= len(arrays["times"]):
        return "its array kept contains epochs that do not exist"
    if arrays["present"].min() < 0.0 or arrays["present"].max() > 1.0:
        return "its array present contains values outside 0 to 1"
    if arrays["channels"].min() < 0.0:
        return "its array channels contains negative numbers"
    if "map_vertical" in arrays:
        sides = [arrays.get(f"map_{name}", np.empty(())) for name in ("latitude", "longitude")]
        if any(side.ndim != 1 or side.dtype.kind != "f" for side in sides):
            return "its map has no latitudes or longitudes"
        values = arrays["map_vertical"]
        if values.dtype.kind != "f" or values.shape != (len(sides[0]), len(sides[1])):
            return "its map does not match the numbers of latitudes and longitudes"
    return None
