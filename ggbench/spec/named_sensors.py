"""Any number of sensors of a kind: the tables ``[sensor.<name>]``, and a list of all sensors.

A case has one gradiometer, and one sensor of each other kind (:data:`.aiding.AIDING`) in the table
of the kind's name; further ones have names of their own.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar, get_args

from pydantic import AfterValidator, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from .aiding import AIDING

T = TypeVar("T")
RESERVED = frozenset(
    (
        *AIDING, "gradiometer", "sensor", "imu", "ins", "imu_record", "altimeter", "initial_error",
        "field", "draw", "disturbance", "trajectory", "windows", "truth", "model", "reference",
        "name", "title", "description", "gyro", "accelerometer",
    )
)  # fmt: skip
"""Names of tables, records and states, which no sensor of ``[sensor.<name>]`` may have."""


def _checked_name(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,29}", name):
        raise ValueError(
            "the name of a sensor must consist of letters (without accents), digits and "
            "underscores, begin with a letter, and have at most 30 characters"
        )
    if name.lower() in RESERVED:
        raise ValueError("a sensor must have a name of its own, and this one is taken")
    return name


class NamedSensors(tuple[tuple[str, T], ...]):
    """Tables of sensors by their names, hashable: in the order of the names.

    ``NamedSensors[GnssSpec | LogSpec]`` has tables of these classes, chosen by their ``kind``.
    """

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        annotated: Any = Annotated  # a variable, for mypy takes the tables for a type otherwise
        table = annotated[get_args(source)[0], Field(discriminator="kind")]
        by_name = core_schema.dict_schema(
            handler.generate_schema(Annotated[str, AfterValidator(_checked_name)]),
            handler.generate_schema(table),
        )
        return core_schema.no_info_before_validator_function(
            lambda given: dict(given) if isinstance(given, NamedSensors) else given,
            core_schema.no_info_after_validator_function(cls._of, by_name),
            serialization=core_schema.plain_serializer_function_ser_schema(
                dict, return_schema=by_name
            ),
        )

    @classmethod
    def _of(cls, tables: Mapping[str, Any]) -> NamedSensors[T]:
        names = sorted(tables)
        for name in names:
            # Each has a file of its own, and some file systems take both for one.
            twice = [other for other in names if other != name and other.lower() == name.lower()]
            if twice:
                raise ValueError(f"{name} and {twice[0]} differ in capitals alone")
        # A side that changes nothing of a sensor is the same case as one that does not name it.
        said = {name: tables[name].model_dump(exclude_defaults=True) for name in names}
        return cls((name, tables[name]) for name in names if said[name])


def aiding_of(tables: Any) -> dict[str, Any]:
    """Return the tables of the aiding sensors, by name, in the order of the channels.

    Those of the kinds' own tables come first, then the named ones in the order of their names.

    Parameters
    ----------
    tables : CaseSpec, FlightSpec, Side, TruthSpec or ModelSpec
        Has the tables as attributes.
    """
    found = {name: getattr(tables, name) for name in AIDING} | dict(tables.sensor)
    return {name: table for name, table in found.items() if table is not None}


def sensors_of(tables: Any) -> dict[str, Any]:
    """Return the tables of all sensors on board but the IMU, by name: the gradiometer's first."""
    gradiometer = tables.gradiometer
    own = {} if gradiometer is None else {"gradiometer": gradiometer}
    return own | aiding_of(tables)


def table_of(sensor: str) -> str:
    """Return the name of a sensor's table in a file."""
    return sensor if sensor in ("gradiometer", *AIDING) else f"sensor.{sensor}"


def with_kinds(content: Any) -> Any:
    """Return a case's content in which changes of a named sensor have its kind, too.

    Raises
    ------
    ValueError
        If a side changes a sensor that is not on board, or its kind.
    """
    if not isinstance(content, dict):
        return content
    sensors = content.get("sensor")
    sensors = dict(sensors) if isinstance(sensors, dict | NamedSensors) else {}
    found = dict(content)
    for side in ("truth", "model"):
        changes = content.get(side)
        if not isinstance(changes, dict) or not isinstance(changes.get("sensor"), dict):
            continue
        found[side] = changes | {"sensor": dict(changes["sensor"])}
        for name, change in changes["sensor"].items():
            if name not in sensors:
                raise not_on_board(f"{side}.sensor.{name}")
            kind = _kind_of(sensors[name])
            if isinstance(change, dict) and kind is not None:
                if change.get("kind", kind) != kind:
                    raise ValueError(
                        f"{side}.sensor.{name}.kind is {change['kind']!r}, and "
                        f"sensor.{name}.kind {kind!r}"
                    )
                found[side]["sensor"][name] = change | {"kind": kind}
    return found


def not_on_board(table: str) -> ValueError:
    """Return the error of a table that changes a sensor which is not on board."""
    return ValueError(f"{table} changes a sensor that is not on board")


def _kind_of(table: Any) -> Any:
    return table.get("kind") if isinstance(table, dict) else getattr(table, "kind", None)
