"""Reader of TOML files, with a limit on nesting depth and with the provenance of values.

A value is written plainly, or with its source as ``{ value = 33.5, provenance = "paper: Table 1"
}``.
"""

from __future__ import annotations

import tomllib
from importlib.resources.abc import Traversable
from typing import Any

from ..errors import text_of
from .validation_messages import ScenarioError

_MOST_NESTED = 16
"""Deepest nesting of tables and lists."""


def read_text(file: Traversable, origin: str) -> str:
    """Return the content of a text file; raise ScenarioError if it cannot be read."""
    try:
        return file.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ScenarioError(f"{origin}: is not UTF-8 text") from None
    except OSError as error:
        raise ScenarioError(f"{origin}: cannot be read: {error.strerror}") from None


def read_toml(source: str, origin: str) -> dict[str, Any]:
    """Parse a TOML text; raise ScenarioError if it is invalid."""
    try:
        document = tomllib.loads(source)
    except (ValueError, RecursionError) as error:  # ValueError: also of a number of any length
        raise ScenarioError(f"{origin}: is not valid TOML: {text_of(error)}") from None
    _require_shallow(document, origin)
    return document


def _require_shallow(document: dict[str, Any], origin: str) -> None:
    """Raise ScenarioError if tables and lists are nested deeper than scenarios need."""
    level: list[Any] = [document]
    for _ in range(_MOST_NESTED):
        level = [
            inner
            for node in level
            for inner in (node.values() if isinstance(node, dict) else node)
            if isinstance(inner, dict | list)
        ]
    if level:
        raise ScenarioError(f"{origin}: tables must be nested at most {_MOST_NESTED} deep")


def strip_provenance(node: Any, path: str, provenance: dict[str, str], origin: str) -> Any:
    """Return the content of a file with each ``{ value, provenance }`` replaced by its value.

    ``node`` is the content at the dotted key ``path``. This function adds each provenance to the
    dict ``provenance``, by dotted key. ``origin`` names the file in messages. Raise ScenarioError
    if a table with the key ``value`` has another form.
    """
    if isinstance(node, list):
        return [
            strip_provenance(item, f"{path}[{i}]", provenance, origin)
            for i, item in enumerate(node)
        ]
    if not isinstance(node, dict):
        return node
    if "value" in node:
        if set(node) != {"value", "provenance"} or not isinstance(node["provenance"], str):
            raise ScenarioError(
                f"{origin}: {path}: a value with provenance is written "
                '{ value = ..., provenance = "..." }'
            )
        provenance[path] = node["provenance"]
        return node["value"]
    return {
        key: strip_provenance(item, f"{path}.{key}" if path else key, provenance, origin)
        for key, item in node.items()
    }
