"""Notes of a scene: what an operator wants to find again with the numbers, by names of their own."""

from __future__ import annotations

from datetime import date, datetime, time
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema

MOST_NOTES, MOST_NAME, MOST_NOTE = 100, 60, 2000

Note = str | int | float | bool
"""One note: a text, a number, or true or false; a date or time of TOML becomes its ISO 8601 text."""


def _note(value: Any) -> Any:
    if isinstance(value, datetime | date | time):
        return value.isoformat()
    if not isinstance(value, str | int | float):
        raise ValueError("a note is a text, a number, a date, or true or false: one key a note, no table or list")
    if isinstance(value, str) and (len(value) > MOST_NOTE or not value.replace("\n", "").isprintable()):
        raise ValueError(f"a note is a text of at most {MOST_NOTE} printable characters: shorten it")
    if isinstance(value, int) and value.bit_length() > 63:
        raise ValueError("a whole number of more than 63 bits: put it in quotes")
    return value


def _named(notes: dict[str, Any]) -> dict[str, Any]:
    if wrong := [name for name in notes if not 0 < len(name) <= MOST_NAME or not name.isprintable()]:
        raise ValueError(f"the name {wrong[0][:MOST_NAME]!r} is none for a note: 1 to {MOST_NAME} printable characters")
    return notes


_Value = Annotated[Any, BeforeValidator(_note), WithJsonSchema({"type": ["string", "number", "boolean"]})]
Notes = Annotated[dict[str, _Value], Field(max_length=MOST_NOTES), AfterValidator(_named)]
"""Notes by name, in the order in which they stand in the scene."""
