"""SCPI text: a message into commands, headers looked up in a table, numbers with suffixes, reply formats."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

Entry = TypeVar("Entry")

_MULTIPLIERS = {"": 1.0, "N": 1e-9, "U": 1e-6, "M": 1e-3, "K": 1e3, "MA": 1e6, "G": 1e9}
_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:E[+-]?\d+)?)\s*([A-Z]*)", re.IGNORECASE)
_NODE = re.compile(r"\[:?([A-Za-z]+):?\]|:?([A-Za-z]+)")


class ScpiError(Exception):
    """A command that cannot be carried out: the number and text for the error queue."""

    def __init__(self, number: int, text: str) -> None:
        super().__init__(number, text)
        self.number = number
        self.text = text


@dataclass(frozen=True, slots=True)
class Command(Generic[Entry]):
    """One command of a message: what the table says about its header, and what was sent with it."""

    entry: Entry
    query: bool
    arguments: tuple[str, ...]


def split_outside_quotes(text: str, separator: str) -> list[str]:
    """Return the parts of ``text`` between separators that stand outside quoted strings."""
    parts, start, quote = [], 0, ""
    for index, character in enumerate(text):
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        elif character == separator:
            parts.append(text[start:index])
            start = index + 1
    return [*parts, text[start:]]


class HeaderTable(Generic[Entry]):
    """Headers such as ``[SOURce:]FREQuency[:CW]`` with their entries, in every accepted spelling.

    With ``numbered`` a node may carry the number of the only channel, as in ``SOUR1:FREQ``.
    """

    def __init__(self, entries: Mapping[str, Entry], numbered: bool = False) -> None:
        self._numbered = numbered
        self._short: dict[str, str] = {}
        self._entries: dict[tuple[str, ...], Entry] = {}
        for pattern, entry in entries.items():
            for nodes in self._variants(pattern):
                self._entries[nodes] = entry

    def _variants(self, pattern: str) -> Iterable[tuple[str, ...]]:
        if pattern.startswith("*"):
            self._short[pattern] = pattern
            return [(pattern,)]
        choices: list[tuple[str, ...]] = []
        for optional, required in _NODE.findall(pattern):
            long = optional or required
            short = "".join(letter for letter in long if not letter.islower())
            self._short[long.upper()] = self._short[short] = short
            choices.append(("", short) if optional else (short,))
        return [tuple(filter(None, nodes)) for nodes in itertools.product(*choices)]

    def find(self, nodes: Iterable[str]) -> Entry:
        """Return the entry of a header; raise ``ScpiError`` -113 where there is none, -114 for another channel."""
        if self._numbered:
            nodes = [self._of_channel_one(node) for node in nodes]
        found = self._entries.get(tuple(self._short.get(node.upper(), "?") for node in nodes))
        if found is None:
            raise ScpiError(-113, "Undefined header")
        return found

    def _of_channel_one(self, node: str) -> str:
        plain = node.rstrip("0123456789")
        if node[len(plain) :] not in ("", "1"):
            raise ScpiError(-114, "Header suffix out of range")
        return plain

    def commands(self, message: str) -> Iterable[Command[Entry]]:
        """Yield the commands of ``message``; raise ``ScpiError`` at the first that is none.

        A header after ``;`` continues at the node where the one before stood, unless it starts with ``:`` or ``*``.
        """
        branch: tuple[str, ...] = ()
        for part in split_outside_quotes(message.strip(), ";"):
            if not part.strip():
                continue
            header, tail = (*part.split(None, 1), "")[:2]
            query = header.endswith("?")
            nodes = tuple(header.rstrip("?").removeprefix(":").split(":"))
            if not header.startswith("*"):
                nodes = nodes if header.startswith(":") else branch + nodes
                branch = nodes[:-1]
            entry = self.find(nodes)
            arguments = tuple(argument.strip() for argument in split_outside_quotes(tail, ",")) if tail else ()
            yield Command(entry, query, arguments)


def keyword(text: str, choices: Iterable[str]) -> str:
    """Return the short form of the keyword in ``text``; ``choices`` are written like ``SINusoid``.

    Raises ``ScpiError`` -128 for a number and -224 for another word.
    """
    for choice in choices:
        short = "".join(letter for letter in choice if not letter.islower())
        if text.upper() in (short, choice.upper()):
            return short
    if _NUMBER.fullmatch(text):
        raise ScpiError(-128, "Numeric data not allowed")
    raise ScpiError(-224, "Illegal parameter value")


def boolean(text: str) -> bool:
    """Return a switch; raise ``ScpiError`` -224 for what is neither ON, OFF nor a number."""
    if text.upper() in ("ON", "OFF"):
        return text.upper() == "ON"
    if not _NUMBER.fullmatch(text):
        raise ScpiError(-224, "Illegal parameter value")
    return round(number(text, "")[0]) != 0


def number(text: str, units: str) -> tuple[float, str]:
    """Return a number and the unit that came with it ("" for none), in the unit without its prefix.

    ``units`` lists the units allowed, such as ``"HZ"`` or ``"V VPP VRMS DBM"``. ``M`` is milli except in ``MHZ`` and
    ``MOHM``. Raises ``ScpiError`` -148 for a word, -138 for a suffix where none may stand and -131 for a wrong one.
    """
    match = _NUMBER.fullmatch(text)
    if match is None:
        raise ScpiError(-148, "Character data not allowed")
    value, suffix = float(match[1]), match[2].upper()
    if not suffix:
        return value, ""
    if not units:
        raise ScpiError(-138, "Suffix not allowed")
    for unit in units.split():
        prefix = suffix.removesuffix(unit)
        if prefix != suffix and prefix in _MULTIPLIERS:
            mega = prefix == "M" and unit in ("HZ", "OHM")
            return value * (1e6 if mega else _MULTIPLIERS[prefix]), unit
    raise ScpiError(-131, "Invalid suffix")


def quoted(text: str) -> str:
    """Return the content of a quoted string; raise ``ScpiError`` -151 where the quotes are missing."""
    if len(text) < 2 or text[0] not in "\"'" or text[-1] != text[0]:
        raise ScpiError(-151, "Invalid string data")
    return text[1:-1]


def real_reply(value: float) -> str:
    """Return a real number as the instrument prints it; infinity is 9.9E+37."""
    return f"{9.9e37 if math.isinf(value) else value + 0.0:+.13E}"
