"""A scene's own text with some of its numbers changed: comments, order and spacing stay."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import tomlkit
from tomlkit.items import Comment, Table, Whitespace

from hpe_rig.scene.keys import Number
from hpe_rig.scene.validation import Mistake, Path, SettingsError, dotted


def edited_text(text: str, values: Mapping[Path, Number]) -> str:
    """Return the TOML ``text`` with ``values``; a key that is absent follows its section's others.

    Raises ``SettingsError`` naming every value that the text has no place for, such as an entry beyond a list's end.
    """
    document, mistakes = tomlkit.parse(text), []
    for path, value in values.items():
        try:
            _set(document, path, value)
        except (LookupError, TypeError):
            what = "the scene's text has no place for it"
            mistakes.append(Mistake(dotted(path), what, "a list that is long enough, a section that holds the key"))
    if mistakes:
        raise SettingsError("the scene's text", mistakes)
    return tomlkit.dumps(document)


def _set(place: Any, path: Path, value: Number) -> None:
    *sections, last = path
    for part in sections:
        if isinstance(part, str) and part not in place:
            place[part] = tomlkit.table()
        place = place[part]
    if isinstance(place, Table) and last not in place:
        _append(place, str(last), value)
    else:
        place[last] = value


def _append(section: Table, key: str, value: Number) -> None:
    """Add a key after the others: what stands below them, such as a comment on the next section, stays below."""
    body = section.value.body
    below: list[Comment | Whitespace] = []
    while body and isinstance(item := body[-1][1], Comment | Whitespace):
        below.append(item)
        body.pop()
    section.add(key, value)
    for comment in reversed(below):
        section.add(comment)
