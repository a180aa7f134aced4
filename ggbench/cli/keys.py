"""``ggbench keys``: tables and keys of scenario files, from the JSON schema."""

from __future__ import annotations

import difflib
import json
import re
import textwrap
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import click

from ..errors import GGBenchError
from .screen import console

TOP = "file"
"""The table of the keys at the top of a file, outside all tables."""
NAMED = "sensor.<name>"
REQUIRED, OPTIONAL = "must be given", "optional"
_UNITS = {
    "deg_per_sqrt_h": "°/√h",
    "deg_per_h": "°/h",
    "deg_per_s": "°/s",
    "deg": "°",
    "rad": "rad",
    "arcmin": "′",
    "ug_per_sqrt_hz": "µg/√Hz",
    "ng_per_sqrt_hz": "ng/√Hz",
    "ug": "µg",
    "eotvos_per_sqrt_hz": "E/√Hz",
    "eotvos_per_sqrt_h": "E/√h",
    "eotvos": "E",
    "mgal": "mGal",
    "ppm_per_sqrt_h": "ppm/√h",
    "ppm": "ppm",
    "m_per_sqrt_hz": "m/√Hz",
    "mps2": "m/s²",
    "mps": "m/s",
    "kg_m3": "kg/m³",
    "km": "km",
    "m": "m",
    "s": "s",
    "hz": "Hz",
}
"""Units by suffix of a key; the longest matching suffix counts."""
_KINDS = {
    "number": "number",
    "integer": "whole number",
    "boolean": "true or false",
    "string": "text",
    "object": "table",
}
_MOST_NEAR = 3
Schema = dict[str, Any]


class KeyNameError(GGBenchError):
    """A table or key does not exist."""


class Key(NamedTuple):
    """Description of a key; ``unit``, ``allowed`` and ``usual`` are "" if the key has none."""

    name: str
    meaning: str
    unit: str
    kind: str
    default: str
    allowed: str
    usual: str


class KeyTable(NamedTuple):
    """Description of a table; ``recorded`` has additional keys of recorded flights."""

    name: str
    about: str
    keys: tuple[Key, ...] = ()
    recorded: tuple[Key, ...] = ()
    listed: bool = False

    @property
    def heading(self) -> str:
        """Heading of the table in a file."""
        if self.name == TOP:
            return "top of the file"
        return f"[[{self.name}]]" if self.listed else f"[{self.name}]"

    def all_keys(self) -> tuple[Key, ...]:
        """Return the keys of the table, then the additional keys of recorded flights."""
        return self.keys + self.recorded


@cache
def tables() -> dict[str, KeyTable]:
    """Return all tables by dotted name: tables of scenarios, then of recorded flights."""
    from ..spec.axes import SweepSpec
    from ..spec.campaign import CampaignSpec
    from ..spec.case import CaseSpec
    from ..spec.claims import ClaimSpec, ComparisonSpec
    from ..spec.flight import FlightSpec
    from ..spec.json_schema import TOP_TEXTS, models_schema

    models = models_schema(CaseSpec, CampaignSpec, SweepSpec, ClaimSpec, ComparisonSpec, FlightSpec)
    tables_by_name = {TOP: KeyTable(TOP, "Texts about the scenario.", _keys(TOP_TEXTS))}
    schemas: dict[str, Schema] = {}
    for top, model, listed in (
        ("", "CaseSpec", True),
        ("campaign", "CampaignSpec", False),
        ("sweep", "SweepSpec", False),
        ("claim", "ClaimSpec", True),
        ("comparison", "ComparisonSpec", True),
    ):
        for path, schema, is_list in _below(models, top, model, listed):
            name = {"": "case", "reference": "case.reference"}.get(path, path)
            shared = re.sub(r"^(truth|model)\.", "", name)
            # The errors of one side's map replace those of the case as a whole.
            base = tables_by_name.get(shared) if schemas.get(shared) is not schema else None
            tables_by_name[name] = KeyTable(
                name, _about(schema), _keys(schema, base), listed=is_list
            )
            schemas[name] = schema
    tables_by_name["assumption"] = KeyTable(
        "assumption",
        "A change of all cases that have published numbers; applied by `--assumptions`.",
        tables_by_name["case"].keys,
        listed=True,
    )
    for path, schema, _ in _below(models, "", "FlightSpec"):
        table = tables_by_name.get(path or TOP, KeyTable(path, _about(schema)))
        names = [key.name for key in table.keys]
        recorded = tuple(key for key in _keys(schema) if key.name not in names)
        tables_by_name[table.name] = table._replace(recorded=recorded)
    return {name: table for name, table in tables_by_name.items() if table.all_keys()}


def named(name: str) -> str:
    """Convert a dotted name to the form of the names in :func:`tables`.

    Brackets and indices are removed. The table of a named sensor becomes ``sensor.<name>``. If the
    name of a sensor is that of its kind, the table becomes this name, such as ``gnss`` for
    ``sensor.gnss``.
    """
    from ..spec.named_sensors import short_key

    plain = short_key(re.sub(r"\[\d+\]", "", name).strip("[] "))
    return re.sub(r"^(truth\.|model\.)?sensor\.[^.]+", NAMED, plain)


def find(name: str) -> list[tuple[KeyTable, Key]]:
    """Return all keys that have a given name, each with its table.

    The name may be dotted, ``TABLE.KEY``. If it has no table, the keys of all tables are searched.
    For a named sensor, the tables of all kinds of sensors are searched.
    """
    from ..spec.aiding import KINDS

    table, _, key = named(name).rpartition(".")
    names = KINDS if table == NAMED and key != "kind" else [table] if table else tables()
    places = [tables()[place] for place in names if place in tables()]
    return [
        (place, candidate)
        for place in places
        for candidate in place.all_keys()
        if candidate.name == key
    ]


def _below(
    models: dict[str, Schema], name: str, model: str, listed: bool = False
) -> Iterator[tuple[str, Schema, bool]]:
    """Yield each table and its subtables: name, schema, and whether the table is in a list."""
    yield name, models[model], listed
    for key, item in models[model]["properties"].items():
        path = f"{name}.{key}".lstrip(".")
        inner = item.get("$ref") or item.get("items", {}).get("$ref")
        if inner:
            yield from _below(models, path, inner.rpartition("/")[2], "items" in item)
        elif path == "sensor":
            kind = {
                "enum": [*item["additionalProperties"]["discriminator"]["mapping"]],
                "description": "Kind of the sensor; the table of that kind lists the other keys.",
            }
            about = "A further sensor of any of the kinds above, under its own name."
            sensor = {"description": about, "properties": {"kind": kind}, "required": ["kind"]}
            yield NAMED, sensor, False


def _keys(schema: Schema, base: KeyTable | None = None) -> tuple[Key, ...]:
    """Return the keys of a table, without its subtables.

    ``base`` is the table whose keys this table changes, such as ``imu`` for ``truth.imu``.
    """
    shared = () if base is None else [key.name for key in base.keys]
    rows = []
    for name, item in schema["properties"].items():
        if "$ref" in str(item) or "const" in item:  # a table, or the kind of a sensor
            continue
        if name in schema.get("required", ()):
            default = REQUIRED
        elif base is not None and name in shared and "default" not in item:
            default = f"as in [{base.name}]"
        else:
            default = _written(item.get("default"))
        value = _value(item)
        while "items" in value:
            value = _value(value["items"])
        limits = [value[end] for end in ("minimum", "maximum") if end in value]
        zero = "0 or " if "{'const': 0}" in str(item) else ""
        meaning = " ".join(item.get("description", "").split())
        allowed, usual = zero + _range(limits), _range(value.get("x-usual", ()))
        rows.append(
            Key(
                name=name,
                meaning=meaning,
                unit=unit_of(name),
                kind=_kind(item),
                default=default,
                allowed=allowed,
                usual=usual,
            )
        )
    return tuple(rows)


def unit_of(name: str) -> str:
    """Return the unit in the suffix of a key's name; "" if the suffix is no unit."""
    ends = [end for end in _UNITS if name.endswith(f"_{end}")]
    return _UNITS[max(ends, key=len)] if ends else ""


def _value(schema: Schema) -> Schema:
    """Return the schema of the number among alternatives, or the schema itself."""
    return next((each for each in schema.get("anyOf", ()) if each.get("type") == "number"), schema)


def _kind(schema: Schema) -> str:
    """Return the allowed type of a value in words."""
    schema = _value(schema)
    if "anyOf" in schema and "type" not in schema:
        return " or ".join(map(_kind, schema["anyOf"]))
    if "enum" in schema:
        return ", ".join(f'"{choice}"' for choice in schema["enum"])
    if schema["type"] != "array":
        return _KINDS[schema["type"]]
    inner = _kind(schema["items"])
    return "list of " + (inner if inner.startswith('"') else re.sub(r"^\w+", r"\g<0>s", inner))


def _written(value: Any) -> str:
    """Return a default value as it is written in a scenario file."""
    if value in (None, [], ""):
        return OPTIONAL
    return f"{value:g}" if isinstance(value, float) else json.dumps(value)


def _range(ends: Sequence[float]) -> str:
    from ..spec.quantities import short

    return " to ".join(str(end) if isinstance(end, int) else short(end) for end in ends)


def _about(schema: Schema) -> str:
    """Return the purpose of a table: the first sentence of its description."""
    text = " ".join(schema.get("description", "").split())
    sentence = re.sub(r"^``\S+``: ", "", text).partition(". ")[0].replace("``", "`").rstrip(".")
    return f"{sentence[:1].upper()}{sentence[1:]}."


@click.command()
@click.argument("name", metavar="[TABLE[.KEY]]", required=False)
@click.option("--schema", is_flag=True, help="Print the JSON schema of scenario files.")
def keys(name: str | None, schema: bool) -> None:
    """Explain the keys of a scenario file.

    Without an argument, the command lists all tables. For a table, such as imu, it lists the keys
    with unit, type, default and limits. For a key of a table, such as imu.period_s, it explains
    this key. For a key without a table, such as period_s, it explains the key in every table that
    has it. Text editors can use the JSON schema that --schema prints.
    """
    if schema:
        from ..spec.json_schema import schema_text

        click.echo(schema_text(), nl=False)
        return
    if name is None:
        for each in tables().values():
            _say(each.heading, each.about)
        _say("", "'ggbench keys TABLE' lists the keys of a table, for example: ggbench keys imu")
        return
    table = tables().get(named(name))
    matches = find(name)
    if table is not None:
        _say_table(table)
    elif not matches:
        raise _unknown(name)
    else:
        for place, key in matches:
            _say_key(key, f"{place.name}.", key in place.recorded)


def presets_of(table: str) -> list[tuple[str, str]]:
    """Return a pair of texts for each preset of a table.

    The first text is the line of a file that selects the preset, such as ``grade = "tactical"``.
    The second text contains the numbers of the preset and their source.
    """
    from ..spec.presets import PRESETS

    key, presets = PRESETS.get(table, ("", {}))
    return [
        (
            f'{key} = "{name}"',
            ", ".join(f"{k} = {_written(v)}" for k, v in preset.values.items())
            + f". Source: {preset.source}.",
        )
        for name, preset in presets.items()
    ]


def _unknown(name: str) -> KeyNameError:
    both = [(table.name, key.name) for table in tables().values() for key in table.all_keys()]
    names = {*tables(), *(key for _, key in both), *(f"{table}.{key}" for table, key in both)}
    near = difflib.get_close_matches(named(name), sorted(names), n=_MOST_NEAR, cutoff=0.7)
    meant = f"; did you mean {' or '.join(map(repr, near))}?" if near else "."
    return KeyNameError(
        f"a scenario file has no table and no key '{name}'{meant} 'ggbench keys' lists the tables"
    )


def _say_table(table: KeyTable) -> None:
    _say(table.heading, table.about)
    for key in table.all_keys():
        _say_key(key, recorded=key in table.recorded)
    for head, text in presets_of(table.name):
        _say(head, text)
    within = [t.heading for t in tables().values() if t.name.startswith(f"{table.name}.")]
    if within:
        _say("", f"Subtables: {', '.join(within)}.")


def _say_key(key: Key, prefix: str = "", recorded: bool = False) -> None:
    facts = [", ".join(filter(None, (key.unit, key.kind)))]
    is_word = key.default in (REQUIRED, OPTIONAL)
    facts.append(key.default if is_word else f"default: {key.default}")
    if key.allowed:
        facts.append(f"allowed: {key.allowed}" + (f", usual: {key.usual}" if key.usual else ""))
    if recorded:
        facts.append("only in the file of a recorded flight")
    _say(prefix + key.name, "; ".join(facts))
    _say("", key.meaning)


def _say(head: str, text: str) -> None:
    """Print a heading, and below it a text in lines that fit the terminal."""
    if head:
        click.secho(head, bold=True)
    width = max(console.width, 40)
    plain = re.sub(r"\*([\w ]+)\*|`", r"\1", text)
    for line in textwrap.wrap(plain, width - 4, break_long_words=False):
        click.echo(f"    {line}")
