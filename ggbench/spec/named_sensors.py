"""Tables of named sensors, ``[sensor.<name>]``, and their short forms.

``[gnss]`` is short for ``[sensor.gnss]`` with ``kind = "gnss"``; each of :data:`.aiding.KINDS` has
such a short form. After validation all sensors are in ``sensor``. Files, messages and
:meth:`pydantic.BaseModel.model_dump` use the short form if a sensor's name is that of its kind.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, TypeVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from .aiding import KINDS
from .tables import Section

T = TypeVar("T")
RESERVED = frozenset(
    (
        "gradiometer", "sensor", "imu", "ins", "imu_record", "altimeter", "initial_error",
        "field", "draw", "disturbance", "trajectory", "windows", "truth", "model", "reference",
        "name", "title", "description", "gyro", "accelerometer",
    )
)  # fmt: skip
"""Names of tables, records and states, which no sensor may have."""
SIDES = ("truth", "model")
"""Tables of a case that change its sensors for one side."""


def _checked_name(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,29}", name):
        raise ValueError(
            "the name of a sensor must consist of letters (without accents), digits and "
            "underscores, begin with a letter, and have at most 30 characters"
        )
    is_reserved = name.lower() in RESERVED or (name.lower() in KINDS and name not in KINDS)
    if is_reserved:
        raise ValueError("this name is already used: choose another name for the sensor")
    return name


class NamedSensors(Mapping[str, T]):
    """Hashable mapping from names of sensors to their tables, in the order of the channels.

    Sensors named like their kind come first, in the order of :data:`.aiding.KINDS`. All other
    sensors follow in the order of their names. In ``NamedSensors[GnssSpec | LogSpec]`` the key
    ``kind`` of a table selects the class of this table.
    """

    def __init__(self, tables: Mapping[str, T]) -> None:
        places = {kind: place for place, kind in enumerate(KINDS)}
        names = sorted(tables, key=lambda name: (places.get(name, len(KINDS)), name))
        self._tables = {name: tables[name] for name in names}

    def __getitem__(self, name: str) -> T:
        return self._tables[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._tables)

    def __len__(self) -> int:
        return len(self._tables)

    def __hash__(self) -> int:
        return hash(tuple(self._tables.items()))

    def __repr__(self) -> str:
        return f"NamedSensors({self._tables!r})"

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        annotated: Any = Annotated  # a variable, for mypy takes the tables for a type otherwise
        table = annotated[get_args(source)[0], Field(discriminator="kind")]
        by_name = core_schema.dict_schema(
            handler.generate_schema(Annotated[str, AfterValidator(_checked_name)]),
            handler.generate_schema(table),
        )
        return core_schema.no_info_before_validator_function(
            lambda value: dict(value) if isinstance(value, NamedSensors) else value,
            core_schema.no_info_after_validator_function(cls._of, by_name),
            serialization=core_schema.plain_serializer_function_ser_schema(
                dict, return_schema=by_name
            ),
        )

    @classmethod
    def _of(cls, tables: Mapping[str, Any]) -> NamedSensors[T]:
        for name in sorted(tables):
            table = tables[name]
            # Each has a file of its own, and some file systems take both for one.
            twice = [other for other in tables if other != name and other.lower() == name.lower()]
            if twice:
                raise ValueError(f"{name} and {twice[0]} differ only in capital letters")
            if name in KINDS and table.kind != name:
                raise ValueError(
                    f"a sensor named '{name}' must have kind = '{name}', found '{table.kind}'"
                )
        # A side that changes nothing of a sensor is the same case as one that does not name it.
        explicit = {name: table.model_dump(exclude_defaults=True) for name, table in tables.items()}
        return cls({name: table for name, table in tables.items() if explicit[name]})


NO_SENSORS: NamedSensors[Any] = NamedSensors({})


class WithSensors(Section):
    """Base of tables with a field ``sensor`` of type :class:`NamedSensors`."""

    @model_validator(mode="before")
    @classmethod
    def _in_one_mapping(cls, content: Any) -> Any:
        return in_one_mapping(content)

    @model_serializer(mode="wrap")
    def _in_short_forms(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        written: dict[str, Any] = {}
        for key, value in handler(self).items():
            if key != "sensor":
                written[key] = value
                continue
            written |= {name: table for name, table in value.items() if name in KINDS}
            others = {name: table for name, table in value.items() if name not in KINDS}
            written |= {"sensor": others} if others else {}
        return written

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Return the schema of a file, which has a table of each kind besides ``sensor``."""
        json = handler(schema)
        own = handler.resolve_ref_schema(json)
        properties: dict[str, Any] = {}
        for key, item in own["properties"].items():
            if key == "sensor":
                tables = zip(KINDS, item["additionalProperties"]["oneOf"], strict=True)
                properties |= dict(tables)
            properties[key] = item
        own["properties"] = properties
        return json


def keys_of(model: type[BaseModel]) -> list[str]:
    """Return the keys that a table may have in a file, including short forms of sensors."""
    keys = list(model.model_fields)
    if issubclass(model, WithSensors):
        place = keys.index("sensor")
        keys[place:place] = KINDS
    return keys


def in_one_mapping(content: Any) -> Any:
    """Move all sensor tables of a file into ``sensor``, each with its ``kind``.

    A table of truth or model that changes a sensor gets the kind of this sensor. A sensor with the
    value None is omitted.

    Parameters
    ----------
    content : Any
        Tables of a case, of its truth or model, or of a recorded flight. A value that is
        no table is unchanged; a later check of the key refuses this value.

    Raises
    ------
    ValueError
        If a sensor has both the short and the long form.
        If a table of truth or model changes a sensor that the case does not have, or changes the
        kind of a sensor.
    """
    if not isinstance(content, Mapping) or not _is_table(content.get("sensor", {})):
        return content
    tables = {key: value for key, value in content.items() if key not in KINDS}
    sensors = dict(content.get("sensor", {}))
    for kind in KINDS:
        if content.get(kind) is None:
            continue
        if kind in sensors:
            raise ValueError(f"[{kind}] and [sensor.{kind}] are the same table: write one of them")
        sensors[kind] = content[kind]
    tables["sensor"] = {
        name: {"kind": name} | table if name in KINDS and _is_table(table) else table
        for name, table in sensors.items()
        if table is not None
    }
    for side in SIDES:
        if _is_table(tables.get(side)):
            tables[side] = _with_kinds(side, tables[side], tables["sensor"])
    return tables


def _with_kinds(side: str, changes: Mapping[str, Any], sensors: Mapping[str, Any]) -> Any:
    """Return the changes of one side with the kinds of the named sensors."""
    if not _is_table(changes.get("sensor")):
        return changes
    named = dict(changes["sensor"])
    for name, change in named.items():
        if name not in sensors:
            raise not_on_board(f"{side}.{table_of(name)}")
        kind = _kind_of(sensors[name])
        if _is_table(change) and kind is not None:
            if change.get("kind", kind) != kind:
                raise ValueError(
                    f"{side}.sensor.{name}.kind is {change['kind']!r}, but sensor.{name}.kind is "
                    f"{kind!r}: they must be equal; remove the first"
                )
            named[name] = {**change, "kind": kind}
    return {**changes, "sensor": named}


def sensors_of(tables: Any) -> dict[str, Any]:
    """Return the tables of the gradiometer and of all aiding sensors, by name of the sensor.

    The gradiometer comes first. The IMU and the altimeter are not included.

    Parameters
    ----------
    tables : CaseSpec, FlightSpec or Side
        Object with the tables as attributes.
    """
    gradiometer = tables.gradiometer
    own = {} if gradiometer is None else {"gradiometer": gradiometer}
    return own | dict(tables.sensor)


def table_of(sensor: str) -> str:
    """Return the name of a sensor's table in a file: the short form if there is one."""
    return sensor if sensor in ("gradiometer", *KINDS) else f"sensor.{sensor}"


def short_key(key: str) -> str:
    """Return a dotted key in the short form if its sensor is named like its kind.

    The short form omits ``sensor.``. All other keys are unchanged.
    """
    return re.sub(rf"^(truth\.|model\.)?sensor\.({'|'.join(KINDS)})(?=\.|$)", r"\1\2", key)


def not_on_board(table: str) -> ValueError:
    """Return the error for a table that changes a sensor that the case does not have."""
    return ValueError(f"{table} changes a sensor that is not on board")


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping)


def _kind_of(table: Any) -> Any:
    return table.get("kind") if isinstance(table, Mapping) else getattr(table, "kind", None)
