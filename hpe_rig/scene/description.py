"""Description of settings files: every key with its kind, unit, default and bounds, read from a JSON schema.

`described` serves the reference of the documentation, `annotated` the file with every key that ``hpe-rig new --full``
writes. Both read the schema that validates the file, so that neither can disagree with it.
What a key means stands below it in the source, and is read from there when a schema is asked for: no measurement is.
"""

from __future__ import annotations

import ast
import inspect
import json
import math
import re
import sys
import textwrap
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

from pydantic import BaseModel

from hpe_rig.scene.validation import models_in, unit_of

JsonSchema = Mapping[str, Any]
WIDTH = 110


@dataclass(frozen=True, slots=True)
class DescribedKey:
    """One key of a settings file, in words and as TOML.

    ``kind`` is such as ``number`` or ``list of 3 numbers``, ``unit`` empty where the name of the key has none;
    ``default`` is TOML, or None where the key is absent unless set; ``bounds`` is empty where there are none.
    """

    name: str
    kind: str
    unit: str
    required: bool
    default: str | None
    bounds: str
    text: str

    @property
    def summary(self) -> str:
        """Kind, unit, bounds and default on one line."""
        unit, bounds = f" in {self.unit}" if self.unit else "", f", {self.bounds}" if self.bounds else ""
        presence = "required" if self.required else f"default {self.default or 'absent'}"
        return f"{self.kind}{unit}{bounds}; {presence}"


@dataclass(frozen=True, slots=True)
class DescribedTable:
    """One table of a settings file with its keys; ``repeated`` where it is a list of tables, ``[[path]]``."""

    path: tuple[str, ...]
    repeated: bool
    required: bool
    text: str
    keys: tuple[DescribedKey, ...]

    @property
    def header(self) -> str:
        """The line that begins the table; empty at the top of a file."""
        name = ".".join(self.path)
        return f"[[{name}]]" if self.repeated else f"[{name}]" if name else ""


def settings_schema(model: type[BaseModel]) -> dict[str, Any]:
    """Return the JSON schema of ``model`` and all models in it, each key described by the docstring below it."""
    schema = model.model_json_schema()
    tables = {model.__name__: schema, **schema.get("$defs", {})}
    for found in {model, *_models_under(model)}:
        keys = tables[found.__name__]["properties"]
        for name, text in _texts_of_keys(found).items():
            keys[name] = dict(sorted({"description": text, **keys[name]}.items()))
    return schema


def _models_under(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    for field in model.model_fields.values():
        for inner in models_in(field.annotation):
            yield inner
            yield from _models_under(inner)


def _texts_of_keys(model: type[BaseModel]) -> dict[str, str]:
    """Return the docstrings below the fields of ``model`` and of what it inherits from."""
    texts: dict[str, str] = {}
    for kind in reversed(model.__mro__):
        if issubclass(kind, BaseModel) and kind is not BaseModel:
            texts |= _texts_in_module(kind.__module__).get(kind.__name__, {})
    return {name: text for name, text in texts.items() if name in model.model_fields}


@cache
def _texts_in_module(name: str) -> dict[str, dict[str, str]]:
    """Return the docstrings below the annotated attributes of every class of a module, none where it has no source."""
    texts: dict[str, dict[str, str]] = {}
    with suppress(OSError):
        for node in ast.parse(inspect.getsource(sys.modules[name])).body:
            if isinstance(node, ast.ClassDef):
                texts[node.name] = {
                    before.target.id: inspect.cleandoc(after.value.value)
                    for before, after in pairwise(node.body)
                    if isinstance(before, ast.AnnAssign) and isinstance(before.target, ast.Name)
                    if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
                    if isinstance(after.value.value, str)
                }
    return texts


def described(schema: JsonSchema, path: tuple[str, ...] = (), text: str = "") -> list[DescribedTable]:
    """Return the tables of the settings that the JSON ``schema`` describes, in its order, each before those inside."""
    return list(_tables(schema, schema, path, text, repeated=False, required=True))


def annotated(tables: list[DescribedTable], values: Mapping[str, Any]) -> str:
    """Return a TOML file that sets ``values`` and names every other key of ``tables`` in a comment.

    A key that ``values`` leaves out stands there with its default, commented out: taking the ``#`` away changes
    nothing. Where there is no default, nothing stands behind the equals sign.
    """
    return "\n".join(line for table in tables for line in _annotated_table(table, values)).strip() + "\n"


def toml_value(value: Any) -> str:
    """Return ``value`` as TOML; numbers as people write them, with powers of ten in steps of three."""
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{key} = {toml_value(inner)}' for key, inner in value.items())} }}"
    return str(value) if isinstance(value, int) else _number(value)


def _number(value: float) -> str:
    if not 1e-15 < abs(value) < 1e15 or 1e-2 <= abs(value) < 1e5:
        return repr(value)
    power = 3 * math.floor(math.log10(abs(value)) / 3)
    text = f"{value / 10.0**power:.12g}e{power}"
    # Shorter must not round: the file has to give the same number back.
    return text if float(text) == value else repr(value)


def _tables(
    root: JsonSchema, schema: JsonSchema, path: tuple[str, ...], text: str, repeated: bool, required: bool
) -> Iterator[DescribedTable]:
    needed, inner = set(schema.get("required", ())), []
    keys = []
    for name, entry in schema["properties"].items():
        found = _table_inside(root, entry)
        if found is None:
            keys.append(_key(name, entry, name in needed))
        else:
            table, many = found
            about = _sentence(_text_of_table(root, entry, table))
            inner.append(_tables(root, table, (*path, name), about, repeated=many, required=name in needed))
    yield DescribedTable(path, repeated, required, text, tuple(keys))
    for tables in inner:
        yield from tables


def _text_of_table(root: JsonSchema, entry: JsonSchema, table: JsonSchema) -> str:
    """Return what a table is for: its own words, or those of its place where there are several tables of its kind."""
    own = str(table.get("description", ""))
    alike = json.dumps(root).count(f'"#/$defs/{table["title"]}"') > 1
    return str(entry.get("description") or own) if alike else own or str(entry.get("description", ""))


def _table_inside(root: JsonSchema, entry: JsonSchema) -> tuple[JsonSchema, bool] | None:
    """Return the schema of the table that ``entry`` stands for and whether it is a list of them; None for a value."""
    for choice in entry.get("anyOf", [entry]):
        many = choice.get("type") == "array" and isinstance(choice.get("items"), Mapping)
        one = choice["items"] if many else choice
        if "$ref" in one:
            return root["$defs"][one["$ref"].rpartition("/")[2]], many
    return None


def _key(name: str, entry: JsonSchema, required: bool) -> DescribedKey:
    choices = [choice for choice in entry.get("anyOf", [entry]) if choice.get("type") != "null"]
    kind, bounds = " or ".join(map(_kind, choices)), _bounds(choices[0])
    default = entry.get("default")
    shown = None if default is None else toml_value(default)
    return DescribedKey(name, kind, unit_of(name), required, shown, bounds, _sentence(entry.get("description", "")))


_KINDS = {"number": "number", "integer": "whole number", "boolean": "true or false", "string": "text"}


def _kind(choice: JsonSchema) -> str:
    if "enum" in choice or "const" in choice:
        return "one of " + ", ".join(map(toml_value, choice.get("enum", [choice.get("const")])))
    if choice.get("type") == "array":
        parts, items = choice.get("prefixItems"), choice.get("items", {})
        one = _KINDS.get((parts[0] if parts else items).get("type", ""), "value")
        return f"list of {f'{len(parts)} ' if parts else ''}{one}s"
    return _KINDS.get(choice.get("type", ""), "table")


def _bounds(choice: JsonSchema) -> str:
    if choice.get("type") == "array":
        parts = choice.get("prefixItems")
        each = _bounds(parts[0] if parts else choice.get("items", {}))
        return f"each {each}" if each else ""
    limits = {"minimum": "at least", "exclusiveMinimum": "above", "maximum": "at most", "exclusiveMaximum": "below"}
    words = [f"{word} {_plain(choice[key])}" for key, word in limits.items() if key in choice]
    both = "minimum" in choice and "maximum" in choice
    return f"{_plain(choice['minimum'])} to {_plain(choice['maximum'])}" if both else " and ".join(words)


def _plain(bound: float) -> str:
    """Return a bound as people write it: 1e9, not 1e+09."""
    return re.sub(r"e\+?(-?)0*", r"e\1", f"{bound:g}")


def _sentence(text: str) -> str:
    """Return a docstring on one line, code marks of docstrings as those of Markdown."""
    return " ".join(text.split()).replace("``", "`")


def _annotated_table(table: DescribedTable, values: Mapping[str, Any]) -> Iterator[str]:
    found: Any = values
    for name in table.path:
        found = found.get(name) if isinstance(found, Mapping) else None
    entries = found if isinstance(found, list | tuple) else [found] if isinstance(found, Mapping) else []
    yield ""
    if table.text:
        yield from _comment(table.text)
    for number, entry in enumerate(entries or [None]):
        # A table whose keys are all left out, and which must not be there, is itself a comment.
        if table.header:
            yield table.header if entry is not None else f"# {table.header}"
        for key in table.keys:
            if number == 0:
                yield from _comment(f"{key.text.removesuffix('.')}. {_capital(key.summary)}.")
            if entry is not None and key.name in entry:
                yield f"{key.name} = {toml_value(entry[key.name])}"
            elif number == 0:
                yield f"# {key.name} = {key.default or ''}".rstrip()


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent="## ", subsequent_indent="## ")


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
