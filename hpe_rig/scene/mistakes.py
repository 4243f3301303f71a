"""Mistakes of settings, each with its key, its cause and a remedy, and the error that reports all of them.

Also the paths of settings, as messages write them: ("excitation", "burst_length_s", 2) is excitation.burst_length_s[2].
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

KeyPath = tuple[str | int, ...]
MAX_SHOWN_CHARACTERS = 80
"""Length of a value, key or line in a message; longer ones are cut."""
_CONTROL_CHARACTERS = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")
"""Unicode's control characters except line ends and tabs."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """One mistake in a settings file: the path of the key, the mistake in words, and a remedy."""

    path: str
    what: str
    remedy: str

    def __str__(self) -> str:
        where = f"{self.path}: " if self.path else ""
        if self.remedy.startswith("did you mean"):
            return printable(f"{where}{self.what}; {self.remedy}")
        return printable(f"{where}{self.what}. Try: {self.remedy}{'' if self.remedy.endswith('?') else '.'}")


class SettingsError(Exception):
    """A settings file that cannot be used; ``mistakes`` holds all of its mistakes."""

    def __init__(self, source: str, mistakes: Sequence[Mistake]) -> None:
        plural = "mistake" if len(mistakes) == 1 else "mistakes"
        lines = "\n".join(f"  {mistake}" for mistake in mistakes)
        super().__init__(f"{printable(source)}: {len(mistakes)} {plural}\n{lines}")
        self.source = source
        self.mistakes = tuple(mistakes)

    def __reduce__(self) -> tuple[type[SettingsError], tuple[str, tuple[Mistake, ...]]]:
        """Return the arguments that rebuild a worker's error in the main process."""
        return SettingsError, (self.source, self.mistakes)


def printable(text: str) -> str:
    """Return ``text`` with every non-printable character but line ends escaped, so that a terminal executes none."""
    return "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text)


def control_character(text: str) -> str:
    """Return the first control character of ``text`` that is neither line end nor tab; "" if there is none."""
    match = _CONTROL_CHARACTERS.search(text)
    return match[0] if match else ""


def shortened(text: str) -> str:
    """Return ``text`` cut to the length that a message shows."""
    return text if len(text) <= MAX_SHOWN_CHARACTERS else f"{text[:MAX_SHOWN_CHARACTERS]}..."


def dotted(path: KeyPath) -> str:
    """Return a path as text, such as ``excitation.burst_length_s[2]``."""
    text = ""
    for segment in path:
        if isinstance(segment, int):
            text += f"[{segment}]"
        else:
            key = shortened(segment if segment.isprintable() else repr(segment))
            text += f".{key}" if text else key
    return text


def path_of(key: str) -> KeyPath:
    """Return the path of a key such as ``simulation.motion[0].amplitude_m``, the inverse of `dotted`."""
    return tuple(int(segment) if segment.isdigit() else segment for segment in re.findall(r"[^.\[\]]+", key))
