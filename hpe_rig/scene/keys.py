"""Numbers of a scene by their path: list them, find one by a short name, set values in the scene's tables."""

from __future__ import annotations

import copy
import difflib
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Union, get_args, get_origin

from hpe_rig.scene.mistakes import KeyPath, Mistake, SettingsError, dotted
from hpe_rig.scene.validation import Section

Number = int | float


@dataclass(frozen=True, slots=True)
class Key:
    """One number of a scene: its path, its value (None: absent and without default), whether it must be whole."""

    path: KeyPath
    value: Number | None
    is_integer: bool

    def __str__(self) -> str:
        return dotted(self.path)


def keys_of(section: Section, tables: Mapping[str, Any]) -> list[Key]:
    """Return every number that ``section``, a scene made from ``tables``, has or could have; list entries singly."""
    return [*_keys_of_section(section, tables, ()), *_keys_of_value(tables.get("simulation", {}), ("simulation",))]


def _keys_of_section(section: Section, tables: Any, prefix: KeyPath) -> Iterator[Key]:
    for name, field in type(section).model_fields.items():
        value, path = getattr(section, name), (*prefix, name)
        # Sections by their model; lists of tables and [simulation], which has no model here, by the file's content.
        if isinstance(value, Section):
            yield from _keys_of_section(value, tables.get(name, {}), path)
        elif isinstance(tables.get(name), list):
            yield from _keys_of_value(tables[name], path)
        elif name != "simulation":
            number_types = set(_number_types(field.annotation))
            # A list with one value can be varied like a single number.
            single = value[0] if isinstance(value, tuple) and len(value) == 1 else value
            if number_types and not isinstance(single, tuple):
                yield Key(path, single, number_types == {int})


def _keys_of_value(value: Any, path: KeyPath) -> Iterator[Key]:
    if isinstance(value, Mapping | list):
        for name, inner in value.items() if isinstance(value, Mapping) else enumerate(value):
            yield from _keys_of_value(inner, (*path, name))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield Key(path, value, False)


def _number_types(annotation: Any) -> Iterator[type]:
    """Yield int or float for each number that the annotation allows, as a value or as the entries of a list."""
    if annotation in (int, float):
        yield annotation
    elif get_origin(annotation) is tuple and Ellipsis in get_args(annotation):
        yield from _number_types(get_args(annotation)[0])
    elif get_origin(annotation) in (Annotated, Union, types.UnionType):
        # Annotated has the type first, then its bounds; a union has types only.
        for inner in get_args(annotation)[: 1 if get_origin(annotation) is Annotated else None]:
            yield from _number_types(inner)


def resolve(name: str, keys: Sequence[Key]) -> Key | Mistake:
    """Return the key that ``name`` means, the end of its path or all of it; a mistake if none or several match."""
    paths = {str(key): key for key in keys}
    # The whole path first: a short name may also be the end of a longer path.
    matches = [name] if name in paths else [path for path in paths if path.endswith(f".{name}")]
    if len(matches) == 1:
        return paths[matches[0]]
    if matches:
        return Mistake(name, f"{len(matches)} numbers of the scene have that name", f"one of {', '.join(matches)}")
    entries = [path for path in paths if f".{path.rpartition('[')[0]}".endswith(f".{name}")]
    if entries:
        return Mistake(name, "this is a list, and one number at a time is varied", f"one of {', '.join(entries)}")
    by_last_part = {path: path for path in paths} | {path.rpartition(".")[2]: path for path in paths}
    close = difflib.get_close_matches(name, by_last_part, n=1, cutoff=0.5)
    every_key = dict.fromkeys(path.partition("[")[0] for path in paths)
    remedy = by_last_part[close[0]] if close else f"one of {', '.join(every_key)}"
    return Mistake(name, "no number of the scene has that name", remedy)


def with_values(tables: Mapping[str, Any], values: Mapping[KeyPath, Any]) -> dict[str, Any]:
    """Return a copy of the scene's tables with ``values`` by path; absent sections are added.

    Raises ``SettingsError`` with every path that does not exist, such as an index beyond the end of a list.
    """
    changed: dict[str, Any] = copy.deepcopy(dict(tables))
    mistakes = []
    for path, value in values.items():
        try:
            *sections, last = path
            container = container_at(changed, tuple(sections))
            if isinstance(last, int) != isinstance(container, list):
                raise TypeError
            # Copied, so that later changes of the tables do not reach the caller's lists.
            container[last] = copy.deepcopy(value)
        except (LookupError, TypeError, ValueError):
            remedy = "a key of the scene, with [0] for the first entry of a list in the file"
            mistakes.append(Mistake(dotted(path), "the scene has no such entry", remedy))
    if mistakes:
        raise SettingsError("the scene", mistakes)
    return changed


def container_at(tables: Any, path: KeyPath, make_section: Callable[[], Any] = dict) -> Any:
    """Return the section or list at ``path``, adding absent sections made by ``make_section``.

    Raises ``LookupError`` or ``TypeError`` if the path does not exist, such as beyond the end of a list.
    """
    for segment in path:
        if isinstance(segment, str) and segment not in tables:
            tables[segment] = make_section()
        tables = tables[segment]
    return tables


def plain_tables(section: Section) -> dict[str, Any]:
    """Return the settings that were given for ``section``, a scene or a bench, as the tables of a TOML file."""
    tables: dict[str, Any] = _plain(section.model_dump(exclude_unset=True, exclude_none=True))
    return tables


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    return [_plain(inner) for inner in value] if isinstance(value, list | tuple) else value
