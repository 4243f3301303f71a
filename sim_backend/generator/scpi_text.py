"""SCPI text: numbers with suffixes, keywords, switches and strings in arguments; formats of replies."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

_MULTIPLIERS = {"": 1.0, "N": 1e-9, "U": 1e-6, "M": 1e-3, "K": 1e3, "MA": 1e6, "G": 1e9}
# ASCII digits alone: Python would also accept a superscript two.
_NUMBER = re.compile(r"([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))(?:E([+-]?[0-9]+))?\s*([A-Z]*)", re.IGNORECASE | re.ASCII)
MAX_DIGITS = 255
MAX_EXPONENT = 32_000
INFINITE = 9.9e37
"""Infinity in replies; larger numbers in arguments are infinite too (SCPI-99, volume 1, 7.2.1.4)."""


class ScpiError(Exception):
    """Failure of a command, with number and text for the error queue."""

    def __init__(self, number: int, text: str) -> None:
        """Store the error's number and text, as the instrument queues them."""
        super().__init__(number, text)
        self.number = number
        self.text = text


def not_simulated(function: str) -> ScpiError:
    """Return the error of a function that the instrument has and the twin does not simulate."""
    return ScpiError(-241, f"Hardware missing; the twin does not simulate {function}")


def split_outside_quotes(text: str, separator: str) -> list[str]:
    """Split ``text`` at separators outside quoted strings."""
    if '"' not in text and "'" not in text:
        return text.split(separator)
    texts, start, quote = [], 0, ""
    for index, character in enumerate(text):
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        elif character == separator:
            texts.append(text[start:index])
            start = index + 1
    return [*texts, text[start:]]


def short_form(word: str) -> str:
    """Return the short form of a keyword, its capitals (``SINusoid``)."""
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
    """Return the value of ON, OFF or a number (0 is off); raise ``ScpiError`` -224 for another text."""
    if text.upper() in ("ON", "OFF"):
        return text.upper() == "ON"
    if not _NUMBER.fullmatch(text):
        raise ScpiError(-224, "Illegal parameter value")
    return whole_number(text, -math.inf, math.inf) != 0


def number_with_unit(text: str, units: str) -> tuple[float, str]:
    """Return the number in ``text``, with its prefix multiplied in, and its unit ("" for none).

    ``units`` lists the valid units, such as ``"HZ"`` or ``"V VPP VRMS DBM"``. ``M`` is milli except in ``MHZ`` and
    ``MOHM``. A number beyond floating point is infinite. Raises ``ScpiError`` -148 for a word, -123 for a large
    exponent, -124 for a long mantissa, -138 for a suffix without valid units, -131 for another suffix.
    """
    match = _NUMBER.fullmatch(text)
    if match is None:
        raise ScpiError(-148, "Character data not allowed")
    mantissa, exponent, suffix = match[1], match[2] or "0", match[3].upper()
    if len(mantissa) > MAX_DIGITS:
        raise ScpiError(-124, "Too many digits")
    if len(exponent) > 6 or abs(int(exponent)) > MAX_EXPONENT:
        raise ScpiError(-123, "Exponent too large")
    value = float(f"{mantissa}E{exponent}")
    return _in_unit(value, suffix, units) if suffix else (value, "")


def _in_unit(value: float, suffix: str, units: str) -> tuple[float, str]:
    """Return the value times the prefix of ``suffix``, and its unit; raise ``ScpiError`` for an invalid suffix."""
    if not units:
        raise ScpiError(-138, "Suffix not allowed")
    for unit in units.split():
        prefix = suffix.removesuffix(unit)
        if prefix != suffix and prefix in _MULTIPLIERS:
            # In MHZ and MOHM the prefix M is mega, otherwise milli.
            mega = prefix == "M" and unit in ("HZ", "OHM")
            return value * (1e6 if mega else _MULTIPLIERS[prefix]), unit
    raise ScpiError(-131, "Invalid suffix")


def whole_number(text: str, low: float, high: float) -> int:
    """Return the number in ``text``, rounded to a whole one; raise ``ScpiError`` -222 outside the limits."""
    value, _ = number_with_unit(text, "")
    if not (math.isfinite(value) and low <= value <= high):
        raise ScpiError(-222, "Data out of range")
    return round(value)


def unquoted(text: str) -> str:
    """Return ``text`` without the quotes around it; raise ``ScpiError`` -151 if it has none."""
    if len(text) < 2 or text[0] not in "\"'" or text[-1] != text[0]:
        raise ScpiError(-151, "Invalid string data")
    return text[1:-1]


def only_argument(arguments: tuple[str, ...]) -> str:
    """Return the only argument; raise ``ScpiError`` -109 if there is none, -108 if there are more."""
    if not arguments:
        raise ScpiError(-109, "Missing parameter")
    refuse_arguments(arguments[1:])
    return arguments[0]


def refuse_arguments(arguments: tuple[str, ...]) -> None:
    """Raise ``ScpiError`` -108 if there are any ``arguments``."""
    if arguments:
        raise ScpiError(-108, "Parameter not allowed")


def real_reply(value: float) -> str:
    """Return a real number in the instrument's format; infinity is 9.9E+37."""
    return f"{INFINITE if math.isinf(value) else value + 0.0:+.13E}"
