"""The tables and keys of a scenario file, for people: read off the specification objects.

Unit, type, default and limits are those of :mod:`ggbench.spec`; what a key means is its field's
description if it has one, else the text of ``key_meanings.toml``. The command ``ggbench keys`` and
the tables of ``docs/scenario_files.md`` are both made of this.
"""

from __future__ import annotations

import re
import tomllib
import types
import typing
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from typing import Annotated, Any, Literal

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from ..spec.aiding import AIDING
from ..spec.case import CampaignSpec, CaseSpec, SweepSpec
from ..spec.claims import ClaimSpec, ComparisonSpec
from ..spec.flight import FlightSpec
from ..spec.further import Named
from ..spec.oddities import limits_of

TOP = "file"
"""The table of the keys at the top of a file, outside all tables."""
FURTHER = "further.<name>"
REQUIRED = "must be given"
_UNITS = {
    "deg_per_sqrt_h": "°/√h", "deg_per_h": "°/h", "deg_per_s": "°/s", "deg": "°", "rad": "rad",
    "arcmin": "′", "ug_per_sqrt_hz": "µg/√Hz", "ng_per_sqrt_hz": "ng/√Hz", "ug": "µg",
    "eotvos_per_sqrt_hz": "E/√Hz", "eotvos_per_sqrt_h": "E/√h", "eotvos": "E", "mgal": "mGal",
    "ppm_per_sqrt_h": "ppm/√h", "ppm": "ppm", "m_per_sqrt_hz": "m/√Hz", "mps2": "m/s²",
    "mps": "m/s", "kg_m3": "kg/m³", "km": "km", "m": "m", "s": "s", "hz": "Hz",
}  # fmt: skip
"""Units by the ends of keys; the longest that fits counts."""
_SIDES = ("truth", "model")


@dataclass(frozen=True)
class Key:
    """A key of a table, in words.

    Attributes
    ----------
    name : of the key.
    unit : in which it is; "" without one.
    kind : what it may be, as "number", or its choices.
    default : a value or words; :data:`REQUIRED` if there is none.
    allowed, usual : limits of a number; "" without any.
    meaning : what it says.
    """

    name: str
    unit: str
    kind: str
    default: str
    allowed: str
    usual: str
    meaning: str


@dataclass(frozen=True)
class KeyTable:
    """A table of a scenario file, or of the file of a recorded flight.

    Attributes
    ----------
    name : dotted, as "truth.imu"; :data:`TOP` for the keys outside all tables.
    about : what it is for, a sentence.
    keys : its keys.
    recorded : keys that it has in the file of a recorded flight alone.
    listed : whether a file has a list of such tables.
    """

    name: str
    about: str
    keys: tuple[Key, ...]
    recorded: tuple[Key, ...] = ()
    listed: bool = False

    @property
    def heading(self) -> str:
        """The table as a file writes it."""
        if self.name == TOP:
            return "top of the file"
        return f"[[{self.name}]]" if self.listed else f"[{self.name}]"

    def all_keys(self) -> tuple[Key, ...]:
        """Return its keys, those of recorded flights behind the others."""
        return self.keys + self.recorded


@cache
def tables() -> dict[str, KeyTable]:
    """Return all tables by their dotted names: those of scenarios, then of recorded flights."""
    top = ("title", "text", REQUIRED), ("description", "text", REQUIRED), ("notes", "text", "none")
    texts = (
        Key(name, "", kind, default, "", "", _words(TOP, name)[0]) for name, kind, default in top
    )
    found = {TOP: KeyTable(TOP, _meanings()["about"][TOP], tuple(texts))}
    for name, model, listed in _of_scenarios():
        found[name] = KeyTable(name, _about(name, model), _keys(name, model), listed=listed)
        if name == "gravimeter":
            found[FURTHER] = _further()
    found["assumption"] = KeyTable(
        "assumption", _meanings()["about"]["assumption"], found["case"].keys, listed=True
    )
    for name, model, _ in _below("", FlightSpec):
        keys = _keys(name, model)
        if name in found:
            known = {key.name for key in found[name].keys}
            recorded = tuple(key for key in keys if key.name not in known)
            found[name] = replace(found[name], recorded=recorded)
        else:
            found[name] = KeyTable(name, _about(name, model), (), keys)
    return found


def named(name: str) -> str:
    """Return a dotted name as the tables have it: without brackets, sensors' names, numbers."""
    plain = re.sub(r"\[\d+\]", "", name).strip("[] ")
    return re.sub(r"^(truth\.|model\.)?further\.[^.]+", FURTHER, plain)


def find(name: str) -> list[tuple[KeyTable, Key]]:
    """Return the key of a dotted name, or every key that is called so, each with its table."""
    table, _, key = named(name).rpartition(".")
    if table == FURTHER and key != "kind":
        places = [tables()[kind] for kind in AIDING]
    elif table:
        places = [tables()[table]] if table in tables() else []
    else:
        places = [*tables().values()]
    return [(place, found) for place in places for found in place.all_keys() if found.name == key]


def every_name() -> list[str]:
    """Return the names of all tables, and of all keys alone and with their tables."""
    keys = [(table.name, key.name) for table in tables().values() for key in table.all_keys()]
    return sorted({*tables(), *(key for _, key in keys), *(f"{t}.{key}" for t, key in keys)})


def _of_scenarios() -> Iterator[tuple[str, type[BaseModel], bool]]:
    """Yield name and model of each table of a scenario, and whether a file has a list of them."""
    yield from _below("", CaseSpec)
    yield "campaign", CampaignSpec, False
    yield "case", CaseSpec, True
    yield "sweep", SweepSpec, False
    yield from _below("sweep.", SweepSpec)
    yield "claim", ClaimSpec, True
    yield "comparison", ComparisonSpec, True


def _below(prefix: str, model: type[BaseModel]) -> Iterator[tuple[str, type[BaseModel], bool]]:
    """Yield the tables within a table, each before what is within it."""
    for key, field in model.model_fields.items():
        inner = _model_in(field)
        if inner is None:
            continue
        # Published numbers are those of a case; a recorded flight has another table of that name.
        name = "case.reference" if model is CaseSpec and key == "reference" else prefix + key
        if name not in _SIDES:
            yield name, inner, typing.get_origin(_plain(field.annotation)) is tuple
        yield from _below(f"{name}.", inner)


def _further() -> KeyTable:
    kinds = ", ".join(f'"{kind}"' for kind in AIDING)
    kind = Key("kind", "", kinds, REQUIRED, "", "", _words("further", "kind")[0])
    return KeyTable(FURTHER, _meanings()["about"][FURTHER], (kind,))


def _keys(table: str, model: type[BaseModel]) -> tuple[Key, ...]:
    """Return the keys of a table that are no tables themselves."""
    return tuple(
        _key(table, name, field)
        for name, field in model.model_fields.items()
        if _model_in(field) is None and typing.get_origin(field.annotation) is not Named
    )


def _key(table: str, name: str, field: FieldInfo) -> Key:
    meaning, default = _words(table, name)
    limits = limits_of(field)
    if limits is not None:
        allowed = str(limits).replace("lie between ", "").replace("be 0", "0")
        allowed = allowed.replace("and", "to").replace("e+", "e")
        usual = limits.oddity(float("inf")).removesuffix(" is usual")
    else:
        ends = [(bound, end) for bound in field.metadata for end in ("ge", "le")]
        allowed = " to ".join(
            str(getattr(bound, end)) for bound, end in ends if hasattr(bound, end)
        )
        usual = ""
    return Key(
        name, unit_of(name), _kind(field.annotation), _default(table, name, field, default),
        allowed, usual, field.description or meaning,
    )  # fmt: skip


def unit_of(name: str) -> str:
    """Return the unit that a key's name ends with; "" if with none."""
    ends = [end for end in _UNITS if name.endswith(f"_{end}")]
    return _UNITS[max(ends, key=len)] if ends else ""


def _default(table: str, name: str, field: FieldInfo, words: str) -> str:
    side, _, shared = table.partition(".")
    if field.is_required():
        return REQUIRED
    if side in _SIDES and field.default is None and name in _fields(shared):
        return f"as in [{shared}]"
    return words or _written(field.default)


@cache
def _fields(table: str) -> frozenset[str]:
    """Return the keys of a table of a case."""
    models = {name: model for name, model, _ in _below("", CaseSpec)}
    return frozenset(models[table].model_fields) if table in models else frozenset()


def _written(value: Any) -> str:
    """Return a default as a file would have it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(_written, value))}]" if value else "none"
    if isinstance(value, str):
        return f'"{value}"' if value else "none"
    return "none" if value is None else f"{value:g}"


def _plain(annotation: Any) -> Any:
    """Return an annotation without its metadata, and without None."""
    if typing.get_origin(annotation) is Annotated:
        return _plain(typing.get_args(annotation)[0])
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return _plain(next(a for a in typing.get_args(annotation) if a is not type(None)))
    return annotation


def _model_in(field: FieldInfo) -> type[BaseModel] | None:
    """Return the model of a key that is a table, or a list of tables."""
    plain = _plain(field.annotation)
    if typing.get_origin(plain) is tuple:
        plain = _plain(typing.get_args(plain)[0])
    return plain if isinstance(plain, type) and issubclass(plain, BaseModel) else None


def _kind(annotation: Any) -> str:
    """Return in words what a value may be."""
    plain = _plain(annotation)
    if typing.get_origin(plain) is Literal:
        return ", ".join(f'"{choice}"' for choice in typing.get_args(plain))
    if typing.get_origin(plain) is tuple:
        inner = _kind(typing.get_args(plain)[0])
        one = inner.startswith(("number", "text", "table", "list"))
        return "list of " + (re.sub(r"^\w+", r"\g<0>s", inner) if one else inner)
    names: dict[Any, str] = {
        float: "number", int: "whole number", bool: "true or false", str: "text", Any: "table",
    }  # fmt: skip
    return names[plain]


def _words(table: str, key: str) -> tuple[str, str]:
    """Return what a key of a table means, and its default if that needs words."""
    shared = re.sub(r"^(truth|model)\.", "", table)
    texts = _meanings()
    entry = texts.get(shared, {}).get(key) or texts["recorded"].get(key, "")
    return (entry, "") if isinstance(entry, str) else (entry["meaning"], entry["default"])


@cache
def _meanings() -> dict[str, dict[str, Any]]:
    """Return the texts by table and key; nested tables under their dotted names."""
    text = resources.files(__package__).joinpath("key_meanings.toml").read_text(encoding="utf-8")
    found: dict[str, dict[str, Any]] = {}

    def spread(name: str, table: dict[str, Any]) -> None:
        own = found.setdefault(name, {})
        for key, value in table.items():
            if isinstance(value, dict) and "meaning" not in value:
                spread(f"{name}.{key}" if name else key, value)
            else:
                own[key] = value

    spread("", tomllib.loads(text))
    return found


def _about(name: str, model: type[BaseModel]) -> str:
    """Return what a table is for: a text, or the first sentence of the docstring of its model."""
    if name in _meanings()["about"]:
        return str(_meanings()["about"][name])
    text = " ".join((model.__doc__ or "").split())
    said = re.sub(r"^``\S+``: ", "", text).partition(". ")[0].replace("``", "`").rstrip(".")
    return f"{said[:1].upper()}{said[1:]}."
