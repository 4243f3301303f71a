"""Validation of settings: every mistake at once, each with its path, value and bound, and a misspelt key's correction.

The settings are Pydantic models. Pydantic reports each mistake as an entry with a type such as "less_than_equal"; this
module turns entries into sentences.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from hpe_rig.scene.mistakes import MAX_SHOWN_CHARACTERS, KeyPath, Mistake, SettingsError, dotted, shortened
from hpe_rig.scene.removed_keys import removal_remedy
from hpe_rig.scene.units import unit_of_path

Model = TypeVar("Model", bound=BaseModel)
Words = tuple[str, str]
"""A mistake in words, and its remedy."""
Entry = Mapping[str, Any]
"""A mistake as Pydantic reports it: type, location, input, context, message."""
Hint = Callable[[str, float], str]
"""Function that returns the probable intended value of a key, such as "100e-6", or an empty text."""
STORED = "stored"
"""Validation context of settings from a run file: rules on which settings go together may be younger than the run."""


class Section(BaseModel):
    """A frozen table of settings that refuses keys it does not know."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True, use_attribute_docstrings=True
    )


def mistakes_of(
    model: type[BaseModel],
    tables: Mapping[str, Any],
    prefix: KeyPath = (),
    context: str | None = None,
    hint: Hint = lambda key, value: "",
) -> list[Mistake]:
    """Return all mistakes of ``tables`` as settings of ``model``; empty if there are none.

    ``prefix`` is the path of the tables in their file, ``context`` is passed to the rules of the model (`STORED`), and
    ``hint`` suggests values for those that are out of bounds.
    """
    try:
        model.model_validate(tables, context=context)
    except ValidationError as error:
        # One wrong value can give several entries; consequences of another mistake are dropped.
        entries = [dict(entry) for entry in error.errors(include_url=False)]
        return [_mistake(entry, model, tables, prefix, hint) for entry in entries if not _is_consequence(entry)]
    return []


def validated(model: type[Model], tables: Mapping[str, Any], source: str) -> Model:
    """Return ``tables`` as settings of ``model``; raise ``SettingsError`` about ``source`` with every mistake."""
    if mistakes := mistakes_of(model, tables):
        raise SettingsError(source, mistakes)
    return model.model_validate(tables)


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield every model in a type annotation, through options, lists and tuples."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in getattr(annotation, "__args__", ()):
        yield from models_in(inner)


def _is_consequence(entry: Entry) -> bool:
    """Return whether a list counts as too short only because Pydantic left its wrong entries out."""
    return bool(entry["type"] == "too_short" and len(entry["input"]) >= entry["ctx"]["min_length"])


def _mistake(entry: Entry, model: type[BaseModel], tables: Mapping[str, Any], prefix: KeyPath, hint: Hint) -> Mistake:
    path = _path_in_file(entry["loc"], tables)
    # A single value is accepted as a list of one; then the file has no index 0.
    if path and path[-1] == 0 and not isinstance(_value_at(tables, path[:-1]), list | tuple):
        path = path[:-1]
    kind = entry["type"]
    # Each type of mistake has a function for its words.
    if kind == "extra_forbidden":
        key = str(path[-1])
        if remedy := removal_remedy(dotted(prefix + path)):
            words: Words = "this key of an earlier version was removed", remedy
        else:
            words = _unknown_key(key, _keys_at(model, path[:-1]), list(_paths_to(key, model, prefix)))
    elif kind in _BOUNDS:
        words = _out_of_bounds(entry, path, hint)
    elif kind in _WORDS:
        words = _WORDS[kind](entry)
    else:
        words = _wrong_kind(entry) or _own_message(entry)
    return Mistake(dotted(prefix + path), *words)


def _unknown_key(key: str, keys: Sequence[str], same_name: Sequence[str]) -> Words:
    """Return the words about an unknown ``key`` in a table of ``keys``; ``same_name``: paths of keys elsewhere."""
    close = same_name or difflib.get_close_matches(key, keys, n=1)
    remedy = f"did you mean {close[0]}?" if close else f"remove it; the keys here are {', '.join(keys)}"
    return "unknown key", remedy


_BOUNDS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}


def _out_of_bounds(entry: Entry, path: KeyPath, hint: Hint) -> Words:
    key, word = _BOUNDS[entry["type"]]
    value, unit = entry["input"], unit_of_path(path)
    bound = f"{word} {entry['ctx'][key]:g} {unit}".rstrip()
    remedy = f"a value {'of ' if 'at' in word else ''}{bound}"
    if isinstance(value, int | float) and (meant := hint(dotted(path), value)):
        remedy += f"; perhaps {meant}?"
    return f"{_shown(value)} is out of bounds, it must be {bound}", remedy


def _missing(entry: Entry) -> Words:
    if isinstance(entry["loc"][-1], int):
        return "this entry of the list is absent", "give every entry; none is optional"
    return "this key is required and absent", "add it; hpe-rig new NAME --full writes every key with its meaning"


def _not_a_choice(entry: Entry) -> Words:
    choices = str(entry["ctx"]["expected"])
    close = difflib.get_close_matches(str(entry["input"]), re.findall(r"'([^']+)'", choices), n=1)
    suggestion = f"; did you mean {close[0]!r}?" if close else ""
    return f"{_shown(entry['input'])} is not one of the choices", f"one of {choices}{suggestion}"


def _wrong_length(entry: Entry) -> Words:
    limits = entry["ctx"]
    allowed = f"at least {limits['min_length']}" if "min_length" in limits else f"at most {limits['max_length']}"
    return f"{len(entry['input'])} entries instead of {allowed}", f"a list of {allowed}"


_WORDS: Mapping[str, Callable[[Entry], Words]] = {
    "missing": _missing,
    "finite_number": lambda entry: (f"{_shown(entry['input'])} is not finite", "a finite number"),
    "literal_error": _not_a_choice,
    "too_short": _wrong_length,
    "too_long": _wrong_length,
}
_KINDS = {
    "float": "a number",
    "int": "a whole number",
    "bool": "true or false",
    "string": "a text in quotes",
    "tuple": "a list",
    "list": "a list",
    "model": "a table",
    "dict": "a table",
    "date": "a date such as 2026-03-05, without quotes",
}
"""Beginning of Pydantic's type of a mistake, and the kind of value that it expects."""


def _wrong_kind(entry: Entry) -> Words | None:
    """Return the words about a value of the wrong kind, such as a text for a number; None for another mistake."""
    value = entry["input"]
    if entry["type"] == "float_type" and isinstance(value, int) and not isinstance(value, bool):
        return f"{_shown(value)} is out of all bounds", "a value as it occurs on a bench"
    kind = next((kind for beginning, kind in _KINDS.items() if entry["type"].startswith(beginning)), None)
    if kind is None:
        return None
    return f"{_shown(value)} is not {kind}", f"{kind} without quotes" if "number" in kind else kind


def _own_message(entry: Entry) -> Words:
    """Return the words of a rule of ours, "mistake: remedy", or Pydantic's own."""
    what, _, remedy = str(entry.get("ctx", {}).get("error", entry["msg"])).partition(": ")
    return what, remedy or "a value as hpe-rig schema describes it"


def _shown(value: Any) -> str:
    """Return a value as a message shows it."""
    if isinstance(value, int) and value.bit_length() > 3 * MAX_SHOWN_CHARACTERS:
        return f"a whole number of about {round(value.bit_length() * math.log10(2))} digits"
    try:
        return shortened(repr(value))
    except ValueError:
        # The list or table contains a whole number with more digits than Python prints.
        return f"a {'list' if isinstance(value, list) else 'table'} with a number of thousands of digits"


def _path_in_file(path: KeyPath, tables: Any) -> KeyPath:
    """Return ``path`` without Pydantic's own parts, such as names of alternatives, that are not in the file."""
    *segments, last = path or (None,)
    written: list[str | int] = []
    for segment in segments:
        if isinstance(segment, int):
            tables = tables[segment] if isinstance(tables, list | tuple) else None
        elif isinstance(tables, Mapping) and segment in tables:
            tables = tables[segment]
        else:
            continue
        written.append(segment)
    return (*written, *([] if last in (None, "[key]") else [last]))


def _value_at(tables: Any, path: KeyPath) -> Any:
    for segment in path:
        tables = tables[segment] if isinstance(tables, Mapping) and segment in tables else None
    return tables


def _paths_to(key: str, model: type[BaseModel], path: KeyPath) -> Iterator[str]:
    """Yield the path of every ``key`` of ``model``, which is the table at ``path``, and of the tables inside it."""
    for name, field in model.model_fields.items():
        if name == key:
            yield dotted((*path, name))
        for inner in models_in(field.annotation):
            yield from _paths_to(key, inner, (*path, name))


def _keys_at(model: type[BaseModel], path: KeyPath) -> list[str]:
    """Return the keys of the section at ``path``, following sub-models through options, lists and tuples."""
    for segment in path:
        if isinstance(segment, str) and segment in model.model_fields:
            model = next(models_in(model.model_fields[segment].annotation), model)
    return list(model.model_fields)
