"""JSON Schema of scenario files, for editors and for ``ggbench keys``."""

from __future__ import annotations

import json
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, models_json_schema
from pydantic_core import core_schema

from .axes import SweepSpec
from .campaign import CampaignSpec
from .case import CaseSpec
from .claims import ClaimSpec, ComparisonSpec

Schema = dict[str, Any]
_TEXTS = {
    "title": "Title of the scenario in one line.",
    "description": "Purpose of the scenario; it opens the report.",
    "notes": "Name of a markdown file in the scenario's folder. The report appends its text.",
}
TOP_TEXTS: Schema = {
    "properties": {
        key: {"type": "string", "description": text, "minLength": 1} for key, text in _TEXTS.items()
    },
    "required": ["title", "description"],
}
"""Texts at the top of a file, which :mod:`.scenario` reads by itself."""
_OF_A_CASE = ("name", "title", "reference")
"""Keys of a case that the file, assumptions' changes and axes do not have."""


class _Generator(GenerateJsonSchema):
    """Schema generator without titles, without null (absent in TOML) and without table defaults."""

    ignored_warning_kinds = {"non-serializable-default"}

    def nullable_schema(self, schema: core_schema.NullableSchema) -> Schema:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> Schema:
        json = super().default_schema(schema)
        if json.get("default") is None or isinstance(json["default"], dict):
            json.pop("default", None)
        return json

    def model_schema(self, schema: core_schema.ModelSchema) -> Schema:
        json = super().model_schema(schema)
        json.pop("title", None)
        return json

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def models_schema(*models: type[BaseModel]) -> dict[str, Schema]:
    """Return the JSON Schemas of models and of their inner models, by class name."""
    _, schemas = models_json_schema(
        [(model, "validation") for model in models], schema_generator=_Generator
    )
    return dict(schemas["$defs"])


def scenario_schema() -> Schema:
    """Return the JSON Schema (draft 7) of scenario files.

    The tables of a case may be split between file and ``[[case]]``, so none of their keys is
    required. A value is plain, or a table with ``value`` and ``provenance``.
    """
    tables = models_schema(CaseSpec, CampaignSpec, SweepSpec, ClaimSpec, ComparisonSpec)
    for name in models_schema(CaseSpec):
        tables[name].pop("required", None)
    tables["AxisSpec"]["properties"]["changes"]["items"] = {"$ref": "#/$defs/Changes"}
    for table in tables.values():
        table["properties"] = {key: _written(item) for key, item in table["properties"].items()}
    case = tables["CaseSpec"]
    changes = {key: item for key, item in case["properties"].items() if key not in _OF_A_CASE}
    case["required"] = ["name", "title"]
    tables["Changes"] = case | {"properties": changes, "required": []}
    texts = {key: _written(item) for key, item in TOP_TEXTS["properties"].items()}
    listed = {
        "case": "CaseSpec",
        "assumption": "CaseSpec",
        "claim": "ClaimSpec",
        "comparison": "ComparisonSpec",
    }
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "Scenario of ggbench",
        "type": "object",
        "properties": texts
        | changes
        | {"campaign": {"$ref": "#/$defs/CampaignSpec"}, "sweep": {"$ref": "#/$defs/SweepSpec"}}
        | {
            key: {"type": "array", "items": {"$ref": f"#/$defs/{model}"}}
            for key, model in listed.items()
        },
        "required": TOP_TEXTS["required"],
        "additionalProperties": False,
        "$defs": tables,
    }


def _written(schema: Schema) -> Schema:
    """Return the schema of a key; a value may be plain or have its provenance."""
    if "oneOf" in schema.get("additionalProperties", ()):
        # A change of a named sensor may leave out its kind, and then fit several.
        tables = {"anyOf": schema["additionalProperties"]["oneOf"]}
        return {"type": "object", "additionalProperties": tables}
    if "$ref" in schema or "$ref" in schema.get("items", ()):
        return schema
    words = {key: schema[key] for key in ("description", "default") if key in schema}
    value = {key: item for key, item in schema.items() if key not in words}
    sourced = {
        "type": "object",
        "properties": {"value": value, "provenance": {"type": "string"}},
        "required": ["value", "provenance"],
        "additionalProperties": False,
    }
    return words | {"anyOf": [value, sourced]}


def schema_text() -> str:
    """Return :func:`scenario_schema` as JSON text, with a line for each table and key."""
    schema = scenario_schema()
    inner = {key: f"{{\n{_lines(schema[key])}\n}}" for key in ("properties", "$defs")}
    outer = {key: json.dumps(item) for key, item in schema.items()} | inner
    return "{\n" + ",\n".join(f"{json.dumps(key)}: {text}" for key, text in outer.items()) + "\n}\n"


def _lines(table: Schema) -> str:
    return ",\n".join(
        f"{json.dumps(key)}: {json.dumps(item, ensure_ascii=False)}" for key, item in table.items()
    )
