"""What a manifest and a record must hold to be believed: a results folder may come from anyone."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NotRequired

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, with_config
from pydantic_core import from_json
from typing_extensions import TypedDict

from ..spec.limits import MOST_RUNS, MOST_SEED, SCENARIO_NAME

Count = Annotated[int, Field(ge=0)]


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
    estimators: dict[str, dict[str, Any]]
    cases: Annotated[list[str], Field(min_length=1)]
    assumptions: bool
    cells: list[_Cell]
    shared: dict[str, str]
    ggbench: str
    results_version: int
    versions: dict[str, str]
    inputs: list[_Input] = []
    date: str
    machine: _Machine


# Records are many: dictionaries are checked ten times as fast as models are made of them.
_STRICT = ConfigDict(strict=True)
_Positive = Annotated[float, Field(ge=0.0)]


@with_config(_STRICT)
class _Metrics(TypedDict):
    position_ms: _Positive
    velocity_ms: _Positive
    nees: float
    nis: float
    coverage: float
    bound_position_ms: _Positive
    bound_velocity_ms: _Positive
    oracle_position_ms: float
    oracle_velocity_ms: float


@with_config(_STRICT)
class _Windows(TypedDict):
    whole: _Metrics
    settled: _Metrics
    last20: _Metrics


@with_config(_STRICT)
class _Run(TypedDict):
    name: str
    parameters: str
    causality: Literal["none", "filter", "fixed-lag", "batch"]
    run: Annotated[int, Field(ge=0, le=MOST_RUNS)]
    seed: Annotated[int, Field(ge=0, le=MOST_SEED)]
    cold: NotRequired[bool]
    remark: NotRequired[str]


@with_config(_STRICT)
class _Failed(_Run):
    status: Literal["failed"]
    reason: str
    traceback: NotRequired[str]
    output: NotRequired[str]
    seconds: NotRequired[_Positive]


@with_config(_STRICT)
class _Fix(TypedDict):
    time_s: _Positive
    error_m: _Positive
    nees: _Positive
    statistic: float
    accepted: bool


@with_config(_STRICT)
class _Finished(_Run):
    status: Literal["ok"]
    seconds: _Positive
    bound: str
    map_evaluations: Count
    peak_memory_mb: float
    diverged: bool
    final_position_error_m: float
    final_ins_error_m: float
    windows: _Windows
    required_m: _Positive
    converged_s: _Positive | None
    false_fix: bool
    fixes: NotRequired[list[_Fix]]


_MANIFEST = TypeAdapter(_Manifest)
_Record = Annotated[_Failed | _Finished, Field(discriminator="status")]
_RECORD: TypeAdapter[Any] = TypeAdapter(_Record)
_RECORDS: TypeAdapter[Any] = TypeAdapter(list[_Record])


def flaw_of_manifest(content: Any) -> str | None:
    """Return what is wrong with a manifest, in a few words, or None."""
    return _flaw(_MANIFEST, content)


_UNKNOWN: dict[str, Any] = {"name": "?", "parameters": "", "causality": "none", "seed": 0}


def flaw_of_record(content: Any) -> str | None:
    """Return what is wrong with a record, in a few words, or None."""
    return _flaw(_RECORD, content)


def read_records(texts: Sequence[Any]) -> list[dict[str, Any] | str]:
    """Return each text's record, or in a few words why there is none."""
    try:
        records = from_json(f"[{','.join(texts)}]")
    except (ValueError, TypeError, RecursionError) as error:
        flaw: str | None = str(error)
    else:
        if len(records) == len(texts) and _flaw(_RECORDS, records) is None:  # at once: quicker
            return list(records)
        flaw = flaw_of_record(records[0]) if len(records) == 1 else "it is no single record"
    if len(texts) == 1:
        return [flaw or "it is no record"]
    return [found for text in texts for found in read_records([text])]


def stand_in(text: Any, run: int, reason: str, other: Mapping[str, Any]) -> dict[str, Any]:
    """Return the record of a run whose own cannot be read: it has failed.

    ``other`` is one of the same estimator; what can be made out of the text itself comes first.
    """
    found = dict(_UNKNOWN) | {name: other[name] for name in _UNKNOWN if name in other}
    try:
        held = json.loads(text)  # which is not as strict
    except (ValueError, TypeError, RecursionError):
        held = None
    record = {"run": run, "status": "failed", "reason": reason}
    if isinstance(held, dict):
        better = found | {name: held[name] for name in _UNKNOWN if name in held}
        if flaw_of_record(better | record) is None:
            found = better
    return found | record


_OF_GRAVITY = {"response": 9, "gravity": 8}
"""What is there where the INS does not know the gravity: columns of each."""
_OF_GRADIENTS = ("gradient_times", "vertical", "noisy", "filtered", "filtered_true")
"""What is there of a case with a gradiometer."""


def flaw_of_arrays(arrays: dict[str, np.ndarray]) -> str | None:
    """Return what is wrong with what all runs of a case share, in a few words, or None."""
    bounds = {name: 2 for name in arrays if name.startswith("bound-")}
    columns = {"times": 0, "kept": 0, "track": 3, "bound-filter": 2, "bound-batch": 2,
               "present": 0, "channels": 0} | bounds  # fmt: skip
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
    kept = arrays["kept"]
    if len(kept) == 0 or kept.min() < 0 or kept.max() >= len(arrays["times"]):
        return "its kept names other epochs than there are"
    if arrays["present"].min() < 0.0 or arrays["present"].max() > 1.0:
        return "its present holds more than shares"
    if arrays["channels"].min() < 0.0:
        return "its channels holds less than none"
    if "map_vertical" in arrays:
        sides = [arrays.get(f"map_{name}", np.empty(())) for name in ("latitude", "longitude")]
        if any(side.ndim != 1 or side.dtype.kind != "f" for side in sides):
            return "its map has no latitudes or longitudes"
        values = arrays["map_vertical"]
        if values.dtype.kind != "f" or values.shape != (len(sides[0]), len(sides[1])):
            return "its map has another size than its sides"
    return None


def _flaw(adapter: TypeAdapter[Any], content: Any) -> str | None:
    try:
        adapter.validate_python(content)
    except ValidationError as error:
        problem = error.errors()[0]
        where = ".".join(str(part) for part in problem["loc"])
        if problem["type"] == "missing":
            return f"it has no {where}"
        return f"its {where or 'content'} is not what it should be ({problem['msg']})"
    return None
