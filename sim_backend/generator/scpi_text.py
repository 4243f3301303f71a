"""SCPI text: arguments as numbers with suffixes, keywords, switches and strings, and the formats of replies."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

_MULTIPLIERS = {"": 1.0, "N": 1e-9, "U": 1e-6, "M": 1e-3, "K": 1e3, "MA": 1e6, "G": 1e9}
# ASCII digits alone: a superscript two is a digit to Python and none to an instrument.
_NUMBER = re.compile(r"([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))(?:E([+-]?[0-9]+))?\s*([A-Z]*)", re.IGNORECASE | re.ASCII)
MOST_DIGITS = 255
LARGEST_EXPONENT = 32_000
INFINITE = 9.9e37
"""How infinity is printed, and from where on a number is taken for it (SCPI-99, volume 1, 7.2.1.4)."""


class ScpiError(Exception):
    """A command that cannot be carried out: the number and text for the error queue."""

    def __init__(self, number: int, text: str) -> None:
        super().__init__(number, text)
        self.number = number
        self.text = text


def not_simulated(what: str) -> ScpiError:
    """Return the error of a function that the instrument has and the twin does not: nothing is accepted and ignored."""
    return ScpiError(-241, f"Hardware missing; the twin does not simulate {what}")


def split_outside_quotes(text: str, separator: str) -> list[str]:
    """Return the parts of ``text`` between separators that stand outside quoted strings."""
    if '"' not in text and "'" not in text:
        return text.split(separator)
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


def short_form(word: str) -> str:
    """Return the short form of a keyword that is written like ``SINusoid``."""
    return "".join(letter for letter in word if not letter.islower())


def keyword(text: str, choices: Iterable[str]) -> str:
    """Return the short form of the keyword in ``text``; ``choices`` are written like ``SINusoid``.

    Raises ``ScpiError`` -128 for a number and -224 for another word.
    """
    for choice in choices:
        short = short_form(choice)
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
    return whole_number(text, -math.inf, math.inf) != 0


def number(text: str, units: str) -> tuple[float, str]:
    """Return a number and the unit that came with it ("" for none), in the unit without its prefix.

    ``units`` lists the units allowed, such as ``"HZ"`` or ``"V VPP VRMS DBM"``. ``M`` is milli except in ``MHZ`` and
    ``MOHM``. A number beyond the range of floating point is infinite. Raises ``ScpiError`` -148 for a word, -123 and
    -124 for an exponent and a mantissa that are too long, -138 for a suffix where none may stand, -131 for a wrong one.
    """
    match = _NUMBER.fullmatch(text)
    if match is None:
        raise ScpiError(-148, "Character data not allowed")
    mantissa, exponent, suffix = match[1], match[2] or "0", match[3].upper()
    if len(mantissa) > MOST_DIGITS:
        raise ScpiError(-124, "Too many digits")
    if len(exponent) > 6 or abs(int(exponent)) > LARGEST_EXPONENT:
        raise ScpiError(-123, "Exponent too large")
    value = float(f"{mantissa}E{exponent}")
    return _in_unit(value, suffix, units) if suffix else (value, "")


def _in_unit(value: float, suffix: str, units: str) -> tuple[float, str]:
    if not units:
        raise ScpiError(-138, "Suffix not allowed")
    for unit in units.split():
        prefix = suffix.removesuffix(unit)
        if prefix != suffix and prefix in _MULTIPLIERS:
            mega = prefix == "M" and unit in ("HZ", "OHM")
            return value * (1e6 if mega else _MULTIPLIERS[prefix]), unit
    raise ScpiError(-131, "Invalid suffix")


def whole_number(text: str, low: float, high: float) -> int:
    """Return a whole number, rounded; raise ``ScpiError`` -222 for one beyond the limits."""
    value, _ = number(text, "")
    if not (math.isfinite(value) and low <= value <= high):
        raise ScpiError(-222, "Data out of range")
    return round(value)


def quoted(text: str) -> str:
    """Return the content of a quoted string; raise ``ScpiError`` -151 where the quotes are missing."""
    if len(text) < 2 or text[0] not in "\"'" or text[-1] != text[0]:
        raise ScpiError(-151, "Invalid string data")
    return text[1:-1]


def one(arguments: tuple[str, ...]) -> str:
    """Return the only argument; raise ``ScpiError`` -109 where there is none and -108 where there are more."""
    if not arguments:
        raise ScpiError(-109, "Missing parameter")
    none_of(arguments[1:])
    return arguments[0]


def none_of(arguments: tuple[str, ...]) -> None:
    """Raise ``ScpiError`` -108 where there is an argument."""
    if arguments:
        raise ScpiError(-108, "Parameter not allowed")


def real_reply(value: float) -> str:
    """Return a real number as the instrument prints it; infinity is 9.9E+37."""
    return f"{INFINITE if math.isinf(value) else value + 0.0:+.13E}"
