"""Headers: a message -> commands, each looked up in the instrument's command tree."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

from sim_backend.generator.scpi_text import ScpiError, not_simulated, short_form, split_outside_quotes

Entry = TypeVar("Entry")
Branch = tuple[str, ...]

_FORM_NODE = re.compile(r"\[:?([A-Za-z]+)(<n>)?:?\]|:?([A-Za-z]+)(<n>)?")
_MNEMONIC = re.compile(r"\*?[A-Z][A-Z_]*([0-9]*)", re.IGNORECASE | re.ASCII)
MAX_MNEMONIC = 12
MAX_ARGUMENTS = 100
MAX_CACHED = 2_000
"""Size of the cache of spellings; a program uses some dozens."""


@dataclass(frozen=True, slots=True)
class Command(Generic[Entry]):
    """One command of a message: the table's entry for its header, and its arguments."""

    entry: Entry
    channel: int
    query: bool
    arguments: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Header(Generic[Entry]):
    """A header in one spelling: its entry, and the branch that continues with the next header."""

    entry: Entry
    channel: int
    query: bool
    branch: Branch


class HeaderTable(Generic[Entry]):
    """Forms such as ``[SOURce<n>:]FREQuency[:CW]`` with their entries, in every accepted spelling.

    A node in brackets may be omitted; every node has a long and a short form; ``<n>`` is an optional channel number if
    ``channels`` is above 0.
    """

    def __init__(self, entries: Mapping[str, Entry], not_simulated: Iterable[str], channels: int = 0) -> None:
        """Store every spelling of the headers in ``entries``; ``channels`` is the number of channels, 0 for none.

        ``not_simulated``: beginnings of headers that the instrument knows and the twin does not simulate.
        """
        self._channels = channels
        self._short: dict[str, str] = {}
        self._entries: dict[Branch, tuple[Entry, Branch]] = {}
        self._cache: dict[tuple[Branch, str], _Header[Entry]] = {}
        for form, entry in entries.items():
            for nodes in self._variants(form):
                # The nodes with <n>, which a number may follow, are stored with the entry.
                numbered = tuple(node for node, may_have_number in nodes if may_have_number)
                self._entries[tuple(node for node, _ in nodes)] = entry, numbered
        variants = itertools.chain.from_iterable(map(self._variants, not_simulated))
        self._not_simulated = {tuple(node for node, _ in nodes) for nodes in variants}

    def _variants(self, form: str) -> Iterable[tuple[tuple[str, bool], ...]]:
        """Return all spellings of a header's form: optional nodes present or absent, each node in its short form.

        Each node comes with whether a channel number may follow it.
        """
        if form.startswith("*"):
            self._short[form] = form
            return [((form, False),)]
        # Each node is either required or optional; the product gives every spelling.
        choices: list[tuple[tuple[str, bool] | None, ...]] = []
        for optional, optional_number, required, required_number in _FORM_NODE.findall(form):
            long = optional or required
            short = short_form(long)
            self._short[long.upper()] = self._short[short] = short
            node = (short, bool(optional_number or required_number))
            choices.append((None, node) if optional else (node,))
        return [tuple(filter(None, nodes)) for nodes in itertools.product(*choices)]

    def commands(self, message: str) -> Iterator[Command[Entry]]:
        """Yield the SCPI commands of ``message``; raise ``ScpiError`` at the first invalid one.

        A header after ``;`` continues in the branch of the previous one, unless it starts with ``:`` or ``*``: in
        ``SOUR:FREQ 1;FUNC SIN`` the second is SOUR:FUNC.
        """
        branch: Branch = ()
        for text in split_outside_quotes(message, ";"):
            words = text.split(None, 1)
            if not words:
                continue
            header = self._cache.get((branch, words[0])) or self._look_up(branch, words[0])
            branch = header.branch
            arguments = _arguments(words[1]) if len(words) > 1 else ()
            yield Command(header.entry, header.channel, header.query, arguments)

    def _look_up(self, branch: Branch, header: str) -> _Header[Entry]:
        """Return the entry of ``header``, and cache it for this ``branch``; raise ``ScpiError`` if there is none.

        Without a leading ``:`` or ``*``, the header is relative to ``branch``, the path left by the preceding command.
        """
        nodes = tuple(header.removesuffix("?").removeprefix(":").split(":"))
        if not header.startswith(("*", ":")):
            nodes = branch + nodes
        entry, channel = self._entry(nodes)
        if len(self._cache) >= MAX_CACHED:
            self._cache.clear()
        # A common command does not change the branch.
        result = _Header(entry, channel, header.endswith("?"), branch if header.startswith("*") else nodes[:-1])
        self._cache[branch, header] = result
        return result

    def _entry(self, nodes: Branch) -> tuple[Entry, int]:
        """Return the entry at ``nodes`` in any spelling, and its channel; raise ``ScpiError`` if there is none.

        The channel is 1 for a header without a number.
        """
        # Split each node into mnemonic and digits, and reduce the mnemonic to its short form. An unknown mnemonic
        # becomes "?", which is in no entry.
        short_nodes, numbered = [], []
        for node in nodes:
            digits = _digits(node)
            short_nodes.append(self._short.get(node[: len(node) - len(digits)].upper(), "?"))
            if digits:
                numbered.append((short_nodes[-1], digits))
        # An entry is stored with those of its nodes that a channel number may follow. Digits elsewhere, or at an
        # instrument without channels, make the header undefined.
        stored = self._entries.get(tuple(short_nodes))
        beginnings = (tuple(short_nodes[:length]) for length in range(1, len(nodes) + 1))
        if stored is None and not self._not_simulated.isdisjoint(beginnings):
            raise not_simulated(":".join(nodes))
        if stored is None or not all(self._channels and node in stored[1] for node, _ in numbered):
            raise ScpiError(-113, "Undefined header")
        entry, _ = stored
        # All numbers in a header must name the same channel; without a number it is 1. Three digits are enough for a
        # comparison with the number of channels.
        channels = {int(digits[:3]) for _, digits in numbered} or {1}
        if len(channels) > 1 or not 1 <= min(channels) <= max(1, self._channels):
            raise ScpiError(-114, "Header suffix out of range")
        return entry, channels.pop()


def _digits(node: str) -> str:
    """Return the digits at the end of a mnemonic; raise ``ScpiError`` for an invalid mnemonic."""
    match = _MNEMONIC.fullmatch(node)
    if match is None:
        raise ScpiError(-102, "Syntax error") if node.isascii() else ScpiError(-101, "Invalid character")
    if len(node) - len(match[1]) > MAX_MNEMONIC:
        raise ScpiError(-112, "Program mnemonic too long")
    return match[1]


def _arguments(text: str) -> tuple[str, ...]:
    """Return the arguments in ``text``, which commas separate; raise ``ScpiError`` -223 for too many."""
    if text.count(",") > MAX_ARGUMENTS:
        raise ScpiError(-223, "Too much data")
    return tuple(argument.strip() for argument in split_outside_quotes(text.strip(), ","))
