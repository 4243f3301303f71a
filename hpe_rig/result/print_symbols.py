"""Units and symbols of plain texts as a page shows them: us as µs, +- as ±, f_r with its subscript."""

from __future__ import annotations

import re

from markupsafe import Markup, escape

UNITS = (
    (re.compile(r"(?:(?<=\d )|(?<=\())us\b"), "µs"),
    (re.compile(r"(?:(?<=\d )|(?<=\())um\b"), "µm"),
    (re.compile(r"(?<=\d) deg\b"), "°"),
    (re.compile(r"\+-"), "±"),
    (re.compile(r"\b2 pi\b"), "2π"),
    (re.compile(r"(?<=/cm)2\b"), "²"),
    (re.compile(r"(?<=/m)3\b"), "³"),
)
GREEK = {"sigma": "σ", "chi": "χ"}
# Not within a path, but in a quotient such as 1/T_b.
SUBSCRIPT = re.compile(r"(?:(?<![\w./\\-])|(?<=[\s(]\d/))([A-Za-z]|sigma|chi)_([A-Za-z0-9]{1,4})(?![\w(/\\-]|\.\w)")


def symbols(text: object) -> Markup:
    """Return ``text`` as HTML with the units and symbols of print."""
    return Markup(SUBSCRIPT.sub(lambda m: f"{_letter(m)}<sub>{m[2]}</sub>", str(escape(_units(str(text))))))  # noqa: S704


def svg_symbols(svg: str) -> str:
    """Return ``svg`` with the units and symbols of print in its texts; a subscript is a smaller piece, set lower."""
    return re.sub(r"(?<=>)[^<>]+(?=</text>)", lambda found: _lowered(_units(found[0])), svg)


def _units(text: str) -> str:
    for pattern, shown in UNITS:
        text = pattern.sub(shown, text)
    return text


def _lowered(text: str) -> str:
    # What follows a shifted piece stays as low, unless something lifts it: a space of no width.
    lift = '<tspan dy="-2">&#8203;</tspan>'
    return SUBSCRIPT.sub(lambda m: f'{_letter(m)}<tspan dy="2" font-size="75%">{m[2]}</tspan>{lift}', text)


def _letter(found: re.Match[str]) -> str:
    return GREEK.get(found[1], found[1])
