"""Programmed registers, and their comparison with the instrument's replies."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from drivers.interfaces import Setting

# Numbers are sent with 13 digits; ten must come back, the resolution of the shortest 33250A reply.
RELATIVE_TOLERANCE: Final = 1e-10
# The difference of one resolution step is computed with a rounding error.
ROUNDING: Final = 1e-9
SCPI_INFINITY: Final = 9.9e37
SHORT_FORM_LETTERS: Final = 4


@dataclass(frozen=True, slots=True)
class Register:
    """One programmed setting: its key in messages, SCPI header, value, and an absolute tolerance.

    ``tolerance`` is the instrument's resolution, or, for levels near zero, the rounding of a difference.
    """

    key: str
    header: str
    value: Setting
    tolerance: float = 0.0

    @property
    def command(self) -> str:
        """The command that programs the value."""
        return f"{self.header} {argument(self.value)}"

    def matches(self, reply: str) -> bool:
        """Return whether ``reply`` is the programmed value within its tolerance."""
        if isinstance(self.value, str):
            return short_form(self.value) == short_form(reply)
        try:
            value = number(reply)
        except ValueError:
            return False
        return math.isclose(
            value, float(self.value), rel_tol=RELATIVE_TOLERANCE, abs_tol=self.tolerance * (1 + ROUNDING)
        )


@dataclass(frozen=True, slots=True)
class Readable:
    """One setting that can be queried: its key in messages, SCPI header and decoder of the reply."""

    key: str
    header: str
    decode: Callable[[str], Setting]


def argument(value: Setting) -> str:
    """Return ``value`` as a SCPI argument: 13 digits for a real number, INF for infinity, 0 or 1 for a boolean."""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, float):
        return f"{value:.12E}" if math.isfinite(value) else "INF"
    return str(value)


def number(reply: str) -> float:
    """Return the number in ``reply``, infinity for SCPI's 9.9E+37; raise ``ValueError`` if there is none."""
    value = float(reply)
    return math.copysign(math.inf, value) if abs(value) >= SCPI_INFINITY else value


def whole_number(reply: str) -> Setting:
    """Return the number in ``reply`` as an int; infinity stays a float."""
    value = number(reply)
    return int(value) if value.is_integer() else value


def switch(reply: str) -> bool:
    """Return an on/off reply as a boolean."""
    return bool(int(reply))


def short_form(keyword: str) -> str:
    """Return SCPI's short form: four letters, or three if the fourth is a vowel (``EXTernal`` -> ``EXT``)."""
    letters = keyword.strip().upper()
    if len(letters) <= SHORT_FORM_LETTERS:
        return letters
    return letters[:3] if letters[3] in "AEIOU" else letters[:SHORT_FORM_LETTERS]
