"""JSON schemas of what ``--json`` prints, made from the types that it is made of."""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from hpe_rig.result.repeats import RepeatMean
from hpe_rig.result.values import DERIVED, Estimate, Result, ShotResult

NUMBER = {"type": ["number", "null"]}
"""Numbers that JSON cannot hold, such as an infinite ratio, are null."""


def result_schema() -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of a result; keys that it does not name do not occur."""
    schema = _object(Result)
    derived = {
        "means": {"type": "array", "items": _object(RepeatMean)},
        "left_out": type_schema(tuple[tuple[str, str], ...]),
    }
    schema["properties"] |= derived
    absent = {"means", "simulated_specimen", "imported", "profile"}
    schema["required"] = [name for name in schema["properties"] if name not in absent]
    return titled("Result of hpe-rig", schema)


def titled(title: str, schema: dict[str, Any]) -> dict[str, Any]:
    """Return ``schema`` as a document of its own."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title, **schema}


def dataclass_schema(kind: type, **changed: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of an object with the fields of the dataclass ``kind``, and with those that are ``changed``."""
    schema = _object(kind)
    schema["properties"] |= changed
    schema["required"] = list(schema["properties"])
    return schema


def _object(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind)
    left_out = {"motion"} if kind is ShotResult else set[str]()
    properties = {each.name: type_schema(hints[each.name]) for each in fields(kind) if each.name not in left_out}
    if kind is Estimate:
        properties |= dict.fromkeys(DERIVED, NUMBER)
    return object_schema((kind.__doc__ or "").partition("\n\n    >>>")[0], properties)


def object_schema(about: str, properties: Mapping[str, Any]) -> dict[str, Any]:
    """Return the schema of an object that has all ``properties``, each a schema or a type, and no others."""
    properties = {name: each if isinstance(each, dict) else type_schema(each) for name, each in properties.items()}
    return {
        "type": "object",
        "description": " ".join(about.split()),
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def type_schema(hint: Any) -> dict[str, Any]:
    """Return the schema of a value of the type ``hint``, as its annotation has it."""
    plain = {str: "string", bool: "boolean", int: "integer", Path: "string"}
    origin, inner = get_origin(hint), get_args(hint)
    if hint is float:
        return dict(NUMBER)
    if hint is Any:
        return {}
    if hint is datetime:
        return {"type": "string", "format": "date-time"}
    if hint in plain:
        return {"type": plain[hint]}
    if is_dataclass(hint) and isinstance(hint, type):
        return _object(hint)
    if origin is Literal:
        return {"enum": list(inner)}
    if origin is tuple and Ellipsis in inner:
        return {"type": "array", "items": type_schema(inner[0])}
    if origin is tuple:
        return {
            "type": "array",
            "prefixItems": [type_schema(each) for each in inner],
            "items": False,
            "minItems": len(inner),
        }
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {"type": "object", "additionalProperties": type_schema(inner[1])}
    if origin in (Union, types.UnionType):
        return {"anyOf": [{"type": "null"} if each is type(None) else type_schema(each) for each in inner]}
    raise TypeError(f"{hint} has no place in a JSON schema")
