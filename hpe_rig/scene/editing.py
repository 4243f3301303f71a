"""A scene's own text with some of its numbers changed: comments, order and spacing stay."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from hpe_rig.scene.keys import Number, with_values
from hpe_rig.scene.validation import Mistake, Path, SettingsError, dotted

_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]#]+?)\s*\]\]?\s*(#.*)?$")


def edited_text(text: str, values: Mapping[Path, Number]) -> str:
    """Return the TOML ``text`` with ``values``; a key that is absent follows its section's others.

    Raises ``SettingsError`` naming every value that stands where it cannot be found, such as in an inline table.
    """
    written = text
    for path, value in values.items():
        written = _with_value(written, path, value)
    if _tables(written) != with_values(tomllib.loads(text), values):
        lost = [path for path, value in values.items() if _at(_tables(written), path) != value]
        what = "the scene's text does not hold it in a line of its own"
        remedy = "[section] headers with one key = value a line"
        raise SettingsError("the scene's text", [Mistake(dotted(path), what, remedy) for path in lost or values])
    return written


def _tables(text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return {}


def _at(value: Any, path: Path) -> Any:
    for part in path:
        try:
            value = value[part]
        except (KeyError, IndexError, TypeError):
            return None
    return value


def _with_value(text: str, path: Path, value: Number) -> str:
    section, key, entry = _split(path)
    lines = text.splitlines()
    begin, end = _section(lines, section)
    if begin is None:
        return "\n".join([*lines, "", f"[{dotted(section)}]", f"{key} = {_number(value)}"]) + "\n"
    for index in range(begin, end):
        match = re.match(rf'^\s*"?{re.escape(key)}"?\s*=\s*', lines[index])
        if match:
            old, rest = _value_and_rest(lines[index][match.end() :])
            new = _number(value) if entry is None else _with_entry(old, entry, value)
            lines[index] = lines[index][: match.end()] + new + rest
            return "\n".join(lines) + "\n"
    while end > begin and (not lines[end - 1].strip() or lines[end - 1].lstrip().startswith("#")):
        end -= 1
    return "\n".join([*lines[:end], f"{key} = {_number(value)}", *lines[end:]]) + "\n"


def _split(path: Path) -> tuple[Path, str, int | None]:
    """Return the section, the key in it, and which entry of its list or None."""
    *section, last = path
    if isinstance(last, int):
        return tuple(section[:-1]), str(section[-1]), last
    return tuple(section), last, None


def _section(lines: list[str], section: Path) -> tuple[int | None, int]:
    """Return the first line after the header of ``section`` and the line after its last; None where it is absent."""
    seen: dict[str, int] = {}
    heads: list[tuple[int, Path]] = [(-1, ())]
    for index, line in enumerate(lines):
        match = _HEADER.match(line)
        if match:
            parts: Path = tuple(part.strip().strip('"') for part in match[2].split("."))
            if match[1] == "[[":
                name = ".".join(map(str, parts))
                parts, seen[name] = (*parts, seen.get(name, 0)), seen.get(name, 0) + 1
            heads.append((index, parts))
    for (index, parts), (following, _) in pairwise([*heads, (len(lines), ())]):
        if parts == section:
            return index + 1, following
    return None, len(lines)


def _value_and_rest(text: str) -> tuple[str, str]:
    """Return the value at the start of ``text`` and what follows it: spaces and a comment."""
    ends = [match.start() for match in re.finditer("#", text)]
    for end in (*ends, len(text)):
        value = text[:end].rstrip()
        try:
            tomllib.loads(f"value = {value}")
        except tomllib.TOMLDecodeError:
            continue
        return value, text[len(value) :]
    return text, ""


def _with_entry(old: str, entry: int, value: Number) -> str:
    """Return the list ``old`` with one entry changed; as it was where it is no list of plain numbers."""
    parts = re.findall(r"[^\[\],\s]+", old)
    if entry >= len(parts):
        return old
    return "[" + ", ".join([*parts[:entry], _number(value), *parts[entry + 1 :]]) + "]"


def _number(value: Number) -> str:
    return repr(value) if isinstance(value, int) else repr(float(value))
