"""Names of the memory locations 0 to 4, which survive a reset; the states themselves are not simulated."""

from __future__ import annotations

import re

from sim_backend.generator.scpi_text import ScpiError, only_argument, unquoted, whole_number

LOCATIONS = 5
MAX_NAME = 12
_NAME = re.compile(r"[A-Z][A-Z0-9_]*", re.ASCII)


class StateNames:
    """Names of the memory locations of one instrument."""

    def __init__(self) -> None:
        self._names = ["AUTO_RECALL", *(f"STATE_{location}" for location in range(1, LOCATIONS))]

    def rename(self, arguments: tuple[str, ...]) -> None:
        """Set the name of a location; ``arguments`` are both, as sent.

        Raises ``ScpiError`` -222 for another location, -148 for an invalid name, -112 for a long one.
        """
        location, name = _location(arguments[:1]), only_argument(arguments[1:])
        name = (unquoted(name) if name[:1] in ('"', "'") else name).upper()
        if not _NAME.fullmatch(name):
            raise ScpiError(-148, "Character data not allowed")
        if len(name) > MAX_NAME:
            raise ScpiError(-112, "Program mnemonic too long")
        self._names[location] = name

    def name(self, arguments: tuple[str, ...]) -> str:
        """Return the name of the location in the only argument, in quotes; raise ``ScpiError`` -222 for another one."""
        return f'"{self._names[_location(arguments)]}"'


def _location(arguments: tuple[str, ...]) -> int:
    return whole_number(only_argument(arguments), 0, LOCATIONS - 1)
