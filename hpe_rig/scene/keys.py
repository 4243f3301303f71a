"""Numbers of a scene by their path: what there is, found by a short name, set to a value, likely meant otherwise."""

from __future__ import annotations

import copy
import difflib
import re
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Final, Union, get_args, get_origin

from hpe_rig.scene.notation import engineering
from hpe_rig.scene.scene import Scene, Section, plain_tables, shipped_scenes
from hpe_rig.scene.validation import KeyPath, Mistake, SettingsError, dotted, parse_toml, unit_of

Number = int | float
FAR: Final = 100.0
"""Times the most, or under the least, of the shipped scenes from which on a value may lack its unit's prefix."""
NEAR: Final = 10.0
"""The same for what it may have meant."""


@dataclass(frozen=True, slots=True)
class Key:
    """One number of a scene: its path, its value (None: absent and without a default), whether it must be whole."""

    path: KeyPath
    value: Number | None
    whole: bool

    def __str__(self) -> str:
        return dotted(self.path)


def number_keys(tables: Mapping[str, Any]) -> list[Key]:
    """Return every number that the scene in ``tables`` has or could have; entries of lists one by one."""
    return keys_of(Scene.model_validate(tables), tables)


def keys_of(scene: Scene, tables: Mapping[str, Any]) -> list[Key]:
    """Return every number of ``scene``, which was made of ``tables``."""
    return [*_of_section(scene, tables, ()), *_of_tables(tables.get("simulation", {}), ("simulation",))]


def resolve(name: str, keys: Sequence[Key]) -> Key | Mistake:
    """Return the key that ``name`` means, the end of its path or all of it; a mistake where none or several fit."""
    exact = [key for key in keys if str(key) == name]
    found = exact or [key for key in keys if str(key).endswith(f".{name}")]
    if len(found) == 1:
        return found[0]
    if found:
        remedy = f"one of {', '.join(map(str, found))}"
        return Mistake(name, f"{len(found)} numbers of the scene have that name", remedy)
    entries = [str(key) for key in keys if f".{str(key).rpartition('[')[0]}".endswith(f".{name}")]
    if entries:
        return Mistake(name, "this is a list, and one number at a time is varied", f"one of {', '.join(entries)}")
    paths = {str(key): str(key) for key in keys} | {str(key).rpartition(".")[2]: str(key) for key in keys}
    close = difflib.get_close_matches(name, paths, n=1, cutoff=0.5)
    known = dict.fromkeys(str(key).partition("[")[0] for key in keys)
    remedy = paths[close[0]] if close else f"one of {', '.join(known)}"
    return Mistake(name, "no number of the scene has that name", remedy)


def with_values(tables: Mapping[str, Any], values: Mapping[KeyPath, Any]) -> dict[str, Any]:
    """Return a copy of the scene's tables with ``values``; sections that are absent are made.

    Raises ``SettingsError`` naming every value that the tables have no place for, such as one beyond a list's end.
    """
    changed: dict[str, Any] = copy.deepcopy(dict(tables))
    mistakes = []
    for path, value in values.items():
        try:
            *sections, last = path
            container = container_at(changed, tuple(sections))
            if isinstance(last, int) != isinstance(container, list):
                raise TypeError
            container[last] = copy.deepcopy(value)
        except (LookupError, TypeError, ValueError):
            remedy = "a key of the scene, [0] for the first of a list that is written out"
            mistakes.append(Mistake(dotted(path), "the scene has no such entry", remedy))
    if mistakes:
        raise SettingsError("the scene", mistakes)
    return changed


def container_at(tables: Any, path: KeyPath, section: Callable[[], Any] = dict) -> Any:
    """Return the section or list at ``path``; ``section`` makes sections that are absent.

    Raises ``LookupError`` or ``TypeError`` where there is no such place, such as beyond the end of a list.
    """
    for part in path:
        if isinstance(part, str) and part not in tables:
            tables[part] = section()
        tables = tables[part]
    return tables


def _of_section(section: Section, given: Any, prefix: KeyPath) -> Iterator[Key]:
    for name, field in type(section).model_fields.items():
        value, path = getattr(section, name), (*prefix, name)
        if isinstance(value, Section):
            yield from _of_section(value, given.get(name, {}), path)
        elif isinstance(given.get(name), list):
            yield from _of_tables(given[name], path)
        elif name != "simulation":
            kinds = set(_number_types(field.annotation))
            alone = value[0] if isinstance(value, tuple) and len(value) == 1 else value
            if kinds and not isinstance(alone, tuple):
                yield Key(path, alone, kinds == {int})


def _of_tables(value: Any, path: KeyPath) -> Iterator[Key]:
    if isinstance(value, Mapping | list):
        for name, inner in value.items() if isinstance(value, Mapping) else enumerate(value):
            yield from _of_tables(inner, (*path, name))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield Key(path, value, False)


def _number_types(annotation: Any) -> Iterator[type]:
    """Yield int or float for each number that the annotation allows, alone or as the only entry of a list."""
    if annotation in (int, float):
        yield annotation
    elif get_origin(annotation) is tuple and Ellipsis in get_args(annotation):
        yield from _number_types(get_args(annotation)[0])
    elif get_origin(annotation) in (Annotated, Union, types.UnionType):
        for inner in get_args(annotation)[: 1 if get_origin(annotation) is Annotated else None]:
            yield from _number_types(inner)


def forgotten_units(scene: Scene) -> list[Mistake]:
    """Return every number of ``scene`` that is far from the shipped scenes' and near to them with a unit's prefix.

    None is a mistake by itself: they are the likely cause where a scene cannot be measured.
    """
    found, keys = [], keys_of(scene, plain_tables(scene))
    several = {_name(key) for key in keys if str(key).endswith("[1]")}
    for key in keys:
        if key.value is not None and (meant := perhaps_meant(str(key), key.value)):
            low, high = (engineering(value, unit_of(_name(key))) for value in _shipped_values()[_name(key)])
            usual = low if low == high else f"{low} to {high}"
            stands = engineering(key.value, unit_of(_name(key)))
            # One value alone is written without brackets.
            path = str(key) if _name(key) in several else _name(key)
            found.append(Mistake(path, f"{stands}, where the shipped scenes have {usual}", f"perhaps {meant}?"))
    return found


def perhaps_meant(key: str, value: Number) -> str:
    """Return what ``value`` of ``key`` is where a prefix of its unit was forgotten, such as 100e-6; empty if nothing.

    That is 1e3, 1e6 or 1e9 times more or less, within `NEAR` of what the shipped scenes have.
    """
    low, high = _shipped_values().get(_name(key), (0.0, 0.0))
    if value <= 0 or low / FAR <= value <= high * FAR or not high:
        return ""
    for power in (-3, -6, -9) if value > high else (3, 6, 9):
        if low / NEAR <= value * 10.0**power <= high * NEAR:
            return f"{value:g}e{power}" if "e" not in f"{value:g}" else f"{value * 10.0**power:g}"
    return ""


def _name(key: Key | str) -> str:
    """Return a key without the places in lists."""
    return re.sub(r"\[\d+\]", "", str(key))


@cache
def _shipped_values() -> dict[str, tuple[float, float]]:
    """Return least and most of every number with a unit that shipped scenes have above zero, by its key."""
    values: dict[str, list[float]] = {}
    for source, text in shipped_scenes().items():
        for key in number_keys(parse_toml(text, source)):
            if key.value is not None and key.value > 0 and unit_of(_name(key)):
                values.setdefault(_name(key), []).append(float(key.value))
    return {name: (min(found), max(found)) for name, found in values.items()}
