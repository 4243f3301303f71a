"""Description of settings files: every key with its kind, unit, default and bounds, from the JSON schema.

``described`` is the source of the reference in the documentation, ``annotated`` of the file with every key that
``hpe-rig new --full`` writes. The schema is also the one that validates settings, so that the three always agree.
The descriptions of keys are the docstrings below them (Pydantic's ``use_attribute_docstrings``).
"""

from __future__ import annotations

import json
import math
import re
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any

from hpe_rig.scene.units import unit_of

JsonSchema = Mapping[str, Any]
COMMENT_WIDTH = 110


@dataclass(frozen=True, slots=True)
class DescribedKey:
    """One key of a settings file, in words and as TOML.

    ``kind`` is such as ``number`` or ``list of 3 numbers``; ``unit`` and ``bounds`` are empty if there are none;
    ``default`` is TOML, or None if the key is absent by default.
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
    """One table of a settings file with its keys; ``repeated`` if it is a list of tables, ``[[path]]``."""

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


def described(schema: JsonSchema, path: tuple[str, ...] = (), text: str = "") -> list[DescribedTable]:
    """Return the tables of the settings that the JSON ``schema`` describes, each followed by the tables inside it.

    ``path`` and ``text`` are those of the outermost table.
    """
    root = DescribedTable(path, False, True, text, ())
    return list(_tables(schema, schema, root))


def _tables(root: JsonSchema, schema: JsonSchema, table: DescribedTable) -> Iterator[DescribedTable]:
    """Yield ``table`` with the keys of its ``schema``, then the tables inside; ``root`` has the schemas by name."""
    required = set(schema.get("required", ()))
    keys, inner_tables = [], []
    for name, entry in schema["properties"].items():
        inner_schema, repeated = _schema_inside(root, entry)
        # Tables follow all keys of the table around them, as TOML requires.
        if inner_schema is None:
            keys.append(_key(name, entry, name in required))
        else:
            text = _one_line(_text_of_table(root, entry, inner_schema))
            inner = DescribedTable((*table.path, name), repeated, name in required, text, ())
            inner_tables.append((inner_schema, inner))
    yield DescribedTable(table.path, table.repeated, table.required, table.text, tuple(keys))
    for inner_schema, inner in inner_tables:
        yield from _tables(root, inner_schema, inner)


def _text_of_table(root: JsonSchema, entry: JsonSchema, table: JsonSchema) -> str:
    """Return the description of a table: its class's, or its key's if several tables have the same class."""
    class_text, key_text = str(table.get("description", "")), str(entry.get("description", ""))
    several = json.dumps(root).count(f'"#/$defs/{table["title"]}"') > 1
    return (key_text or class_text) if several else (class_text or key_text)


def _schema_inside(root: JsonSchema, entry: JsonSchema) -> tuple[JsonSchema | None, bool]:
    """Return the schema of the table at ``entry``, None if it is a value, and whether it is a list of tables."""
    for choice in entry.get("anyOf", [entry]):
        repeated = choice.get("type") == "array" and isinstance(choice.get("items"), Mapping)
        item = choice["items"] if repeated else choice
        if "$ref" in item:
            return root["$defs"][item["$ref"].rpartition("/")[2]], repeated
    return None, False


def _key(name: str, entry: JsonSchema, required: bool) -> DescribedKey:
    # An optional key has the additional choice null, which TOML cannot write.
    choices = [choice for choice in entry.get("anyOf", [entry]) if choice.get("type") != "null"]
    kind, bounds = " or ".join(map(_kind, choices)), _bounds(choices[0])
    default = None if entry.get("default") is None else toml_value(entry["default"])
    return DescribedKey(name, kind, unit_of(name), required, default, bounds, _one_line(entry.get("description", "")))


_KINDS = {"number": "number", "integer": "whole number", "boolean": "true or false", "string": "text"}


def _kind(choice: JsonSchema) -> str:
    if "enum" in choice or "const" in choice:
        return "one of " + ", ".join(map(toml_value, choice.get("enum", [choice.get("const")])))
    if choice.get("type") == "array":
        prefix_items, items = choice.get("prefixItems"), choice.get("items", {})
        item_kind = _KINDS.get((prefix_items[0] if prefix_items else items).get("type", ""), "value")
        return f"list of {f'{len(prefix_items)} ' if prefix_items else ''}{item_kind}s"
    if choice.get("format") == "date":
        return "date"
    return _KINDS.get(choice.get("type", ""), "table")


def _bounds(choice: JsonSchema) -> str:
    if choice.get("type") == "array":
        prefix_items = choice.get("prefixItems")
        item_bounds = _bounds(prefix_items[0] if prefix_items else choice.get("items", {}))
        return f"each {item_bounds}" if item_bounds else ""
    if "minimum" in choice and "maximum" in choice:
        return f"{_plain_number(choice['minimum'])} to {_plain_number(choice['maximum'])}"
    limits = {"minimum": "at least", "exclusiveMinimum": "above", "maximum": "at most", "exclusiveMaximum": "below"}
    return " and ".join(f"{word} {_plain_number(choice[key])}" for key, word in limits.items() if key in choice)


def _plain_number(bound: float) -> str:
    """Return a bound as people write it: 1e9, not 1e+09."""
    return re.sub(r"e\+?(-?)0*", r"e\1", f"{bound:g}")


def _one_line(text: str) -> str:
    """Return a docstring on one line, its code marks as in Markdown."""
    return " ".join(text.split()).replace("``", "`")


def annotated(tables: list[DescribedTable], values: Mapping[str, Any]) -> str:
    """Return a TOML file that sets ``values`` and lists every other key of ``tables`` in a comment.

    An absent key is a comment with its default, if it has one: removing the ``#`` changes nothing.
    """
    return "\n".join(line for table in tables for line in _annotated_table(table, values)).strip() + "\n"


def _annotated_table(table: DescribedTable, values: Mapping[str, Any]) -> Iterator[str]:
    yield ""
    if table.text:
        yield from _comment(table.text)
    entries = _entries_at(values, table.path)
    if not entries:
        # An absent table is a comment from its header to its last key.
        yield from ([f"# {table.header}"] if table.header else [])
        for key in table.keys:
            yield from (*_key_comment(key), _commented_out(key))
    for number, entry in enumerate(entries):
        yield from ([table.header] if table.header else [])
        for key in table.keys:
            # Keys are explained in the first of several tables, and absent ones are listed in it.
            if number == 0:
                yield from _key_comment(key)
            if key.name in entry:
                yield f"{key.name} = {toml_value(entry[key.name])}"
            elif number == 0:
                yield _commented_out(key)


def _entries_at(values: Any, path: tuple[str, ...]) -> list[Mapping[str, Any]]:
    """Return the tables at ``path``: none, one, or those of a list."""
    for name in path:
        values = values.get(name) if isinstance(values, Mapping) else None
    return list(values) if isinstance(values, list | tuple) else [values] if isinstance(values, Mapping) else []


def _key_comment(key: DescribedKey) -> list[str]:
    summary = key.summary[:1].upper() + key.summary[1:]
    return _comment(f"{key.text.removesuffix('.')}. {summary}.")


def _commented_out(key: DescribedKey) -> str:
    return f"# {key.name} = {key.default or ''}".rstrip()


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, COMMENT_WIDTH, initial_indent="## ", subsequent_indent="## ")


def toml_value(value: Any) -> str:
    """Return ``value`` as TOML; numbers with powers of ten in steps of three, as people write them."""
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{key} = {toml_value(inner)}' for key, inner in value.items())} }}"
    return str(value) if isinstance(value, int | date) else _toml_float(value)


def _toml_float(value: float) -> str:
    if not 1e-15 < abs(value) < 1e15 or 1e-2 <= abs(value) < 1e5:
        return repr(value)
    power = 3 * math.floor(math.log10(abs(value)) / 3)
    text = f"{value / 10.0**power:.12g}e{power}"
    # The shorter form is used only if it gives the same number back.
    return text if float(text) == value else repr(value)
