"""Key ``columns``: names of the columns in a file."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer, WithJsonSchema

from ..trajectory.column_names import PRESETS
from .tables import Table


def _checked(value: Any) -> Any:
    """Return the name of a preset, or a hashable table; raise ValueError for other values."""
    if isinstance(value, Table):
        return value
    if isinstance(value, str):
        if value not in PRESETS:
            raise ValueError(f"must be a table of names or one of {', '.join(PRESETS)}")
        return value
    table = Table.of(value)
    for key, name in table:
        if not isinstance(name, str) or not name.strip():
            raise ValueError(f"{key} must be a name, as in {key} = 'NAME [UNIT]'")
    return table


def called(columns: Any) -> Any:
    """Return the value of ``columns`` in the form that :func:`.column_names.names_of` accepts.

    A table of names becomes a dict. The name of a preset and None are unchanged.
    """
    return columns.content() if isinstance(columns, Table) else columns


ColumnNames = Annotated[
    Any,
    BeforeValidator(_checked),
    PlainSerializer(called),
    WithJsonSchema({"anyOf": [{"type": "object"}, {"type": "string", "enum": [*PRESETS]}]}),
]
"""A table from keys to column names, optionally with a unit in brackets; or a preset."""
