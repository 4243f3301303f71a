"""Changing values in the TOML text of a scene or bench; comments, order and spacing stay."""

from __future__ import annotations

from collections.abc import Mapping

import tomlkit
from tomlkit.items import Comment, Table, Whitespace

from hpe_rig.scene.keys import Number, container_at
from hpe_rig.scene.mistakes import KeyPath, Mistake, SettingsError, dotted


def edited_text(text: str, values: Mapping[KeyPath, Number | str]) -> str:
    """Return the TOML ``text`` with ``values``; an absent key is added at the end of its section.

    Raises ``SettingsError`` with every path that does not exist, such as an entry beyond a list's end.
    """
    document = tomlkit.parse(text)
    mistakes = []
    for path, value in values.items():
        try:
            container, last = container_at(document, path[:-1], tomlkit.table), path[-1]
            if isinstance(container, Table) and last not in container:
                _append(container, str(last), value)
            else:
                container[last] = value
        except (LookupError, TypeError):
            what = "the scene's text has no such entry"
            mistakes.append(Mistake(dotted(path), what, "a list that is long enough, a section that holds the key"))
    if mistakes:
        raise SettingsError("the scene's text", mistakes)
    return tomlkit.dumps(document)


def _append(section: Table, key: str, value: Number | str) -> None:
    """Add a key after the others, and before trailing comments, which usually describe the next section."""
    body = section.value.body
    trailing: list[Comment | Whitespace] = []
    while body and isinstance(item := body[-1][1], Comment | Whitespace):
        trailing.append(item)
        body.pop()
    section.add(key, value)
    for item in reversed(trailing):
        section.add(item)
