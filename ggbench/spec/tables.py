"""What the tables of a scenario file are made of: the base of all models, and kinds of numbers."""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, field_validator

T = TypeVar("T")

Finite = Annotated[float, Field(allow_inf_nan=False)]
Listed = Annotated[tuple[T, ...], Field(strict=False)]
"""A list of a file, kept as a tuple."""


class Section(BaseModel):
    """Base of all tables of a scenario file: strict types, no unknown keys; hashable."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    @field_validator("*")
    @classmethod
    def _without_negative_zero(cls, value: Any) -> Any:
        # Equal tables share what a process keeps of them, so they must mean the same to a bit.
        return 0.0 if isinstance(value, float) and value == 0.0 else value


class Table(tuple[tuple[str, Any], ...]):
    """A table whose keys nobody knows beforehand, hashable: its keys with their values, sorted."""

    @classmethod
    def of(cls, table: Any) -> Table:
        """Return nested dicts and lists as tables and tuples.

        Raises
        ------
        ValueError
            If it is no dict.
        """
        if not isinstance(table, dict):
            raise ValueError(f"must be a table, found {table!r}")
        return cls((key, _hashable(table[key])) for key in sorted(table))

    def content(self) -> dict[str, Any]:
        """Return what it was made of."""
        return {key: _content(value) for key, value in self}


def _hashable(value: Any) -> Any:
    if isinstance(value, dict):
        return Table.of(value)
    return tuple(map(_hashable, value)) if isinstance(value, list) else value


def _content(value: Any) -> Any:
    if isinstance(value, Table):
        return value.content()
    return list(map(_content, value)) if isinstance(value, tuple) else value
