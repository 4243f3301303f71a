"""Scene text with some of its numbers changed: comments, order and spacing stay."""

from __future__ import annotations

from collections.abc import Mapping

import tomlkit
from tomlkit.items import Comment, Table, Whitespace

from hpe_rig.scene.keys import Number, container_at
from hpe_rig.scene.validation import KeyPath, Mistake, SettingsError, dotted


def edited_text(text: str, values: Mapping[KeyPath, Number]) -> str:
    """Return the TOML ``text`` with ``values``; a key that is absent follows its section's others.

    Raises ``SettingsError`` naming every value that the text has no place for, such as an entry beyond a list's end.
    """
    document = tomlkit.parse(text)
    mistakes = []
    for path, value in values.items():
        try:
            place, last = container_at(document, path[:-1], tomlkit.table), path[-1]
            if isinstance(place, Table) and last not in place:
                _append(place, str(last), value)
            else:
                place[last] = value
        except (LookupError, TypeError):
            what = "the scene's text has no place for it"
            mistakes.append(Mistake(dotted(path), what, "a list that is long enough, a section that holds the key"))
    if mistakes:
        raise SettingsError("the scene's text", mistakes)
    return tomlkit.dumps(document)


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
