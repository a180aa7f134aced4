"""Any number of sensors of a kind: those that tables ``[further.<name>]`` take on board.

A case has one gradiometer, and of the other kinds (:data:`.aiding.AIDING`) one each in the table of
the kind's name; any number more have names of their own. Here is the one list of a case's sensors.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, TypeVar, get_args

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from .aiding import AIDING

T = TypeVar("T")
RESERVED = frozenset(
    (
        *AIDING, "gradiometer", "further", "imu", "ins", "imu_record", "altimeter", "initial_error",
        "field", "disturbance", "trajectory", "windows", "truth", "model", "reference", "name",
        "title", "description", "gyro", "accelerometer",
    )
)  # fmt: skip
"""No names of further sensors: those of tables, of records, of states."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,29}")


class Named(tuple[tuple[str, T], ...]):
    """Tables of sensors by their names, hashable: in the order of the names.

    ``Named[GnssSpec | LogSpec]`` is what a file may have: of tables with a ``kind``, each is of the
    class of that kind.
    """

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        (tables,) = get_args(source)
        kinds = {table.kind: table for table in get_args(tables)}
        of_kind = core_schema.tagged_union_schema(
            {
                kind: core_schema.no_info_before_validator_function(_without_kind, handler(table))
                for kind, table in kinds.items()
            },
            _kind_of,
        )
        one = core_schema.no_info_before_validator_function(_with_a_kind_of(kinds), of_kind)
        name = core_schema.no_info_after_validator_function(_checked_name, core_schema.str_schema())
        return core_schema.no_info_before_validator_function(
            lambda given: dict(given) if isinstance(given, Named) else given,
            core_schema.no_info_after_validator_function(
                cls._of, core_schema.dict_schema(name, one)
            ),
            serialization=core_schema.plain_serializer_function_ser_schema(_content, info_arg=True),
        )

    @classmethod
    def _of(cls, tables: Mapping[str, Any]) -> Named[T]:
        names = sorted(tables)
        for name in names:
            # Each has a file of its own, and some file systems take both for one.
            twice = [other for other in names if other != name and other.lower() == name.lower()]
            if twice:
                raise ValueError(f"{name} and {twice[0]} differ in capitals alone")
        # What a side changes in nothing is as if it were not there, also for a case's identity.
        said = {name: tables[name].model_dump(exclude_defaults=True) for name in names}
        return cls((name, tables[name]) for name in names if said[name])


def aiding_of(tables: Any) -> dict[str, Any]:
    """Return the tables of the sensors beside the gradiometer, by name, in the channels' order.

    Those of the kinds' own tables first, then the further ones in the order of their names.

    Parameters
    ----------
    tables : what has them as attributes: a case, a recorded flight, a side, what a side changes.
    """
    found = {name: getattr(tables, name) for name in AIDING} | dict(tables.further)
    return {name: table for name, table in found.items() if table is not None}


def sensors_of(tables: Any) -> dict[str, Any]:
    """Return the tables of all sensors on board but the IMU, by name: the gradiometer's first."""
    gradiometer = tables.gradiometer
    own = {} if gradiometer is None else {"gradiometer": gradiometer}
    return own | aiding_of(tables)


def table_of(sensor: str) -> str:
    """Return what the table of a sensor is called in a file."""
    return sensor if sensor in ("gradiometer", *AIDING) else f"further.{sensor}"


def with_kinds(content: Any) -> Any:
    """Return a case's content where what a side changes of a further sensor says its kind, too.

    Raises
    ------
    ValueError
        If a side changes a sensor that is not on board, or makes another kind of one.
    """
    if not isinstance(content, dict):
        return content
    kinds = {name: _kind_of(table) for name, table in _items(content.get("further"))}
    found = dict(content)
    for side in ("truth", "model"):
        changes = content.get(side)
        if not isinstance(changes, dict) or not isinstance(changes.get("further"), dict):
            continue
        further = {}
        for name, change in changes["further"].items():
            if name not in kinds:
                raise not_on_board(f"{side}.further.{name}")
            kind = kinds[name]
            if isinstance(change, dict) and kind is not None:
                if change.get("kind", kind) != kind:
                    raise ValueError(
                        f"{side}.further.{name}.kind is {change['kind']!r}, and "
                        f"further.{name}.kind {kind!r}"
                    )
                change = change | {"kind": kind}
            further[name] = change
        found[side] = changes | {"further": further}
    return found


def not_on_board(table: str) -> ValueError:
    """Return the error of a table that changes what is not there."""
    return ValueError(f"{table} changes a sensor that is not on board")


def _items(tables: Any) -> list[tuple[str, Any]]:
    return [*dict(tables).items()] if isinstance(tables, dict | Named) else []


def _kind_of(table: Any) -> Any:
    return table.get("kind") if isinstance(table, dict) else getattr(table, "kind", None)


def _without_kind(table: Any) -> Any:
    if isinstance(table, dict):
        return {key: value for key, value in table.items() if key != "kind"}
    return table


def _with_a_kind_of(kinds: Mapping[str, Any]) -> Callable[[Any], Any]:
    """Return a validator of tables that must be of one of these kinds."""
    allowed = ", ".join(f'"{kind}"' for kind in kinds)

    def checked(table: Any) -> Any:
        kind = _kind_of(table)
        if not isinstance(table, (dict, *kinds.values())):
            raise ValueError(f"is {table!r} and must be a table of keys")
        if kind is None:
            raise ValueError(f"kind is missing; allowed: {allowed}")
        if not isinstance(kind, str) or kind not in kinds:
            more = "; a flight has one gradiometer" if kind == "gradiometer" else ""
            raise ValueError(f"kind is {kind!r}; allowed: {allowed}{more}")
        return table

    return checked


def _checked_name(name: str) -> str:
    if not _NAME.fullmatch(name):
        raise ValueError(
            "the name of a further sensor must consist of letters (without accents), digits and "
            "underscores, begin with a letter, and have at most 30 characters"
        )
    if name.lower() in RESERVED:
        raise ValueError("a further sensor must have a name of its own, and this one is taken")
    return name


def _content(tables: Named[Any], info: core_schema.SerializationInfo) -> dict[str, Any]:
    """Return what the tables were made of."""
    return {
        name: {"kind": table.kind}
        | table.model_dump(
            mode=info.mode, exclude_defaults=info.exclude_defaults,
            exclude_none=info.exclude_none, exclude_unset=info.exclude_unset,
        )
        for name, table in tables
    }  # fmt: skip
