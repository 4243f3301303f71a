"""Typographic units and symbols of plain texts: us as µs, +- as ±, f_r with a subscript."""

from __future__ import annotations

import re

from markupsafe import Markup, escape

UNITS = (
    (re.compile(r"(?:(?<=\d )|(?<=\())us\b"), "µs"),
    (re.compile(r"(?:(?<=\d )|(?<=\())um\b"), "µm"),
    (re.compile(r"(?<=\d) deg\b"), "°"),
    # Without a line break between a value and its uncertainty.
    (re.compile(r" \+- "), "\u00a0±\u00a0"),
    (re.compile(r"\+-"), "±"),
    (re.compile(r"\b2 pi\b"), "2π"),
    (re.compile(r"(?<=/cm)2\b"), "²"),
    (re.compile(r"(?<=/m)3\b"), "³"),
)
# Names of Greek letters in plain texts.
GREEK = {"sigma": "σ", "chi": "χ"}
# A symbol with an index; not within a path, but in a quotient such as 1/T_b.
SUBSCRIPT = re.compile(r"(?:(?<![\w./\\-])|(?<=[\s(]\d/))([A-Za-z]|sigma|chi)_([A-Za-z0-9]{1,4})(?![\w(/\\-]|\.\w)")


def symbols(text: object) -> Markup:
    """Return ``text`` as HTML with typographic units and symbols."""
    return Markup(SUBSCRIPT.sub(lambda m: f"{_letter(m)}<sub>{m[2]}</sub>", str(escape(_units(str(text))))))  # noqa: S704


def svg_symbols(svg: str) -> str:
    """Return ``svg`` with typographic units and symbols in its texts."""
    return re.sub(r"(?<=>)[^<>]+(?=</text>)", lambda text: _with_subscripts(_units(text[0])), svg)


def _units(text: str) -> str:
    for pattern, replacement in UNITS:
        text = pattern.sub(replacement, text)
    return text


def _with_subscripts(text: str) -> str:
    # dy shifts all following text of the element: a zero-width space shifts it back.
    lift = '<tspan dy="-2">&#8203;</tspan>'
    return SUBSCRIPT.sub(lambda m: f'{_letter(m)}<tspan dy="2" font-size="75%">{m[2]}</tspan>{lift}', text)


def _letter(match: re.Match[str]) -> str:
    return GREEK.get(match[1], match[1])
