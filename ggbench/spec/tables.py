"""Building blocks of pydantic models: base class, lists, free tables, tables of changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, TypeVar, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    WithJsonSchema,
    create_model,
    field_validator,
)

T = TypeVar("T")
S = TypeVar("S", bound="Section")

Finite = Annotated[float, Field(allow_inf_nan=False)]
Listed = Annotated[tuple[T, ...], Field(strict=False)]
"""A list of a file, kept as a tuple."""
Three = Annotated[tuple[T, ...], Field(strict=False, min_length=3, max_length=3)]
"""A list of three."""
Several = Annotated[tuple[T, ...], Field(strict=False, min_length=1)]
"""A list that is not empty."""


class Section(BaseModel):
    """Base of all tables of a scenario file: strict types, no unknown keys, hashable.

    The docstring of a field is its description in ``ggbench keys`` and in the JSON schema.
    """

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, use_attribute_docstrings=True
    )

    @field_validator("*")
    @classmethod
    def _without_negative_zero(cls, value: Any) -> Any:
        # Equal tables share what a process keeps of them, so they must mean the same to a bit.
        return 0.0 if isinstance(value, float) and value == 0.0 else value


def distinct(item: str) -> AfterValidator:
    """Return a validator that raises ValueError if a list has duplicates.

    ``item`` describes an element of the list in the message, for example "a component".
    """

    def check(values: tuple[Any, ...]) -> tuple[Any, ...]:
        if len(set(values)) != len(values):
            raise ValueError(f"names {item} twice")
        return values

    return AfterValidator(check)


def changes(spec: type[Section], but: Sequence[str] = ()) -> Callable[[type[S]], type[S]]:
    """Return a class decorator that adds the keys of another table as optional keys.

    Types, limits and descriptions are those of the other table. The default of each key is None.
    Only ``kind`` keeps the default of the other table, because the kind cannot be changed.

    Parameters
    ----------
    spec : Section class
        Table whose keys are added.
    but : sequence of str
        Keys that cannot be changed.
    """
    hints = get_type_hints(spec, include_extras=True)
    fields: dict[str, Any] = {
        key: (hints[key], field)
        if key == "kind"
        else (hints[key] | None, Field(default=None, description=field.description))
        for key, field in spec.model_fields.items()
        if key not in but
    }

    def decorated(table: type[S]) -> type[S]:
        return create_model(
            table.__name__,
            __base__=table,
            __module__=table.__module__,
            __doc__=table.__doc__,
            **fields,
        )

    return decorated


def nested(key: str, value: Any) -> dict[str, Any]:
    """Return nested tables that contain one value at a dotted key."""
    for part in reversed(key.split(".")):
        value = {part: value}
    return dict(value)


class Table(tuple[tuple[str, Any], ...]):
    """A hashable table with any keys: sorted pairs of key and value."""

    @classmethod
    def of(cls, table: Any) -> Table:
        """Convert nested dicts and lists to tables and tuples.

        Raises
        ------
        ValueError
            If the argument is no dict.
        """
        if not isinstance(table, dict):
            raise ValueError(f"must be a table, found {table!r}")
        return cls((key, _hashable(table[key])) for key in sorted(table))

    def content(self) -> dict[str, Any]:
        """Return the nested dicts and lists from which :meth:`of` made the table."""
        return {key: _content(value) for key, value in self}


def _hashable(value: Any) -> Any:
    if isinstance(value, dict):
        return Table.of(value)
    return tuple(map(_hashable, value)) if isinstance(value, list) else value


def _content(value: Any) -> Any:
    if isinstance(value, Table):
        return value.content()
    return list(map(_content, value)) if isinstance(value, tuple) else value


FreeTable = Annotated[Any, BeforeValidator(Table.of), WithJsonSchema({"type": "object"})]
Title = Annotated[str, Field(min_length=1)]
