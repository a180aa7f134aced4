"""Messages for validation errors of pydantic."""

from __future__ import annotations

import difflib
import math
import re
import typing
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ..errors import GGBenchError
from .aiding import KINDS
from .named_sensors import NamedSensors, keys_of

T = TypeVar("T", bound=BaseModel)


class ScenarioError(GGBenchError):
    """A scenario file cannot be found or read, or its content is invalid."""


def validate(model: type[T], content: Any, label: str) -> T:
    """Validate the content of a table.

    Raises
    ------
    ScenarioError
        If the content is invalid; the message begins with ``label`` and states the key and the
        allowed values.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        problems = error.errors()
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise ScenarioError(f"{label}: {sentence(model, problems[0], content)}{more}") from None


def sentence(model: type[BaseModel], problem: Any, content: Any) -> str:
    """Return the sentence for a validation error: key, value, allowed values.

    ``problem`` is an item of pydantic's error list. ``content`` is the validated table as in the
    file.
    """
    parts = [part for part in problem["loc"] if part not in ("float", "int", "[key]")]
    path = _as_written(parts, content)
    key = re.sub(r"\.(\d+)(?=\.|$)", r"[\1]", ".".join(str(part) for part in path)) or "it"
    value = problem["input"]
    kind = problem["type"]
    if kind == "extra_forbidden":
        allowed = _known_keys(model, problem["loc"][:-1])
        return f"unknown key '{key}'{suggest(str(path[-1]), allowed)}; known: {', '.join(allowed)}"
    if kind == "missing":
        return f"'{key}' is missing"
    if kind == "value_error":
        return f"{key}: {problem['ctx']['error']}" if path else str(problem["ctx"]["error"])
    if kind.startswith("union_tag"):
        tag = value.get("kind")
        kind_written = "missing" if tag is None else repr(tag)
        more = "; only one gradiometer is allowed" if tag == "gradiometer" else ""
        return (
            f"{key}: kind is {kind_written}; allowed: " + ", ".join(f'"{k}"' for k in KINDS) + more
        )
    if isinstance(value, float) and math.isnan(value):
        return f"{key} is not a number (NaN)"
    demand = problem["msg"].replace("Input should be ", "must be ").replace("input", "value")
    demand = demand.replace("String should have", "must have")
    least = problem.get("ctx", {}).get("min_length", 1)
    demand = {
        "float_type": "must be a plain number in the unit that the key names",
        "int_type": "must be a whole number",
        "model_type": "must be a table of keys",
        "model_attributes_type": "must be a table of keys",
        "dict_type": "must be a table of keys",
        "tuple_type": "must be a list",
        "too_short": f"must have at least {least} items" if least > 1 else "must not be empty",
        "string_too_short": "must not be empty",
        "string_pattern_mismatch": "must consist of letters, digits, '.', '_' and '-'",
    }.get(kind, demand)
    return f"{key} is {value!r} and {demand}"


def _as_written(path: list[Any], content: Any) -> list[Any]:
    """Return the path of a key in the form of the scenario file.

    In pydantic's path of a sensor's key, the kind follows the name, and the short form is not used.
    """
    if "sensor" not in path[:-1]:
        return path
    place = path.index("sensor")
    name, key = path[place + 1], path[place + 3 :]
    for part in path[: place + 1]:
        content = content.get(part) if isinstance(content, Mapping) else None
    short = name in KINDS and not (isinstance(content, Mapping) and name in content)
    return [*path[:place], *([] if short else ["sensor"]), name, *key]


def _known_keys(model: type[BaseModel], path: Sequence[Any]) -> list[str]:
    """Return the keys allowed in the table at ``path`` of a model; the path includes kinds."""
    parts = [part for part in path if not isinstance(part, int)]
    while parts:
        annotation = model.model_fields[parts.pop(0)].annotation
        candidates = [annotation, *typing.get_args(annotation)]
        if typing.get_origin(annotation) is NamedSensors:
            _, kind = parts.pop(0), parts.pop(0)
            tables = typing.get_args(candidates[1])
            candidates = [t for t in tables if t.model_fields["kind"].default == kind]
        model = next(c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel))
    return keys_of(model)


def suggest(word: str, allowed: list[str]) -> str:
    """Return a hint with the most similar allowed word, or "" if no word is similar."""
    close = difflib.get_close_matches(word, allowed, n=1)
    return f" (did you mean '{close[0]}'?)" if close else ""
