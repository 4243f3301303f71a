"""Self-contained HTML page of parts: words, inline SVG pictures, and tables that download as CSV. No script."""

from __future__ import annotations

import base64
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any
from urllib.parse import quote

import jinja2
from markupsafe import Markup

from hpe_rig.result import Picture, csv_text, mappings, page_style, symbols

TableRow = Mapping[str, Any]

UNITS = {"m": "m", "s": "s", "hz": "Hz", "rad": "rad", "v": "V", "db": "dB", "mib": "MiB"}
"""Units at the end of a column's name, as they are written."""
AXIS = re.compile(r"[A-Z]_\w+")
"""A symbol with its index, such as W_x, which stays as it is."""
MOST_ROWS = 120
"""Rows of a table that the page shows; its CSV has all."""
MOST_INSIDE = 5000
"""Rows of a table whose CSV the page holds; of more it points to the file beside."""


@dataclass(frozen=True, slots=True)
class PageTable:
    """Rows with the same columns; ``key`` names its CSV file, ``beside`` where it lies, as seen from the page.

    ``folded``: shown when asked for. ``shown``: other rows that the page shows, the CSV having ``rows`` in full. Of a
    column whose name begins with ``verdict`` the page counts the verdicts, and shows the rows of one of them by a link.
    """

    key: str
    caption: str
    rows: Sequence[TableRow]
    folded: bool = True
    beside: str | None = None
    shown: Sequence[TableRow] = ()

    @property
    def seen(self) -> Sequence[TableRow]:
        """Rows that the page shows."""
        return self.shown or self.rows

    @property
    def columns(self) -> list[str]:
        """Names of the columns that the page shows."""
        return list(self.seen[0]) if self.seen else []

    @property
    def words(self) -> set[str]:
        """Columns that hold text; a number with its error is none."""
        rows = self.seen[:MOST_ROWS]
        return {name for name in self.columns if any(_is_text(row[name]) for row in rows)}

    @property
    def wordy(self) -> bool:
        """Whether most columns hold text: on a phone its rows then stand as paragraphs."""
        return 2 * len(self.words) > len(self.columns)

    @property
    def verdicts(self) -> dict[str, dict[str, int]]:
        """How many rows have each verdict, by column."""
        columns = (name for name in self.columns if name.startswith("verdict"))
        return {name: dict(Counter(sorted(row[name] for row in self.seen))) for name in columns}

    def anchor(self, column: str, verdict: str) -> str:
        """Return the name of the rows with that verdict: of the place to link to and of their class."""
        return "-".join(re.findall(r"\w+", f"{self.key} {column.removeprefix('verdict')} {verdict}"))


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and not value.startswith(("-", "–", *"0123456789"))


@dataclass(frozen=True, slots=True)
class Part:
    """One section of the page; ``headline`` is what the page says first where this section leads it."""

    key: str
    title: str
    words: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    tables: tuple[PageTable, ...] = ()
    headline: str = ""


def table(
    key: str,
    caption: str,
    rows: Sequence[Any],
    folded: bool = True,
    beside: str | None = None,
    shown: Sequence[TableRow] = (),
) -> PageTable:
    """Return a table of dataclass instances or mappings."""
    return PageTable(key, caption, mappings(rows), folded, beside, shown)


def render(title: str, lead: Sequence[str], parts: Sequence[Part], facts: Mapping[str, str] | None = None) -> str:
    """Return the page as HTML text; ``facts`` say where and with what it was made."""
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    environment.filters.update(cell=cell, heading=heading, symbols=symbols, svg=_svg, width=_width_px, address=_address)
    template = (resources.files("hpe_rig.study") / "study.html").read_text(encoding="utf-8")
    page = environment.from_string(template)
    style = Markup(page_style())  # noqa: S704, a file of this program
    return page.render(style=style, title=title, lead=lead, parts=parts, facts=facts or {}, most_rows=MOST_ROWS)


def heading(name: str) -> str:
    """Return the name of a column as a person reads it, its unit in brackets: ``gate_length_m`` is gate length (m)."""
    words, _, unit = name.rpartition("_")
    named = f"{words} ({UNITS[unit]})" if words and unit in UNITS else name
    return named.replace("_", " ") if "_" in named and not AXIS.fullmatch(named) else named


def cell(value: Any) -> str:
    """Return a value as a person reads it: four digits, a dash where there is none."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, float):
        return str(value)
    return f"{value:.2e}" if 0 < abs(value) < 1e-3 else f"{value:.4g}"


def _svg(picture: Picture) -> Markup:
    # Drawn here, from numbers, with every text escaped by the drawing itself.
    return Markup(picture.svg)  # noqa: S704


def _width_px(picture: Picture) -> int:
    """Return how wide a picture is at most shown: a quarter more than it was drawn for paper."""
    box = re.search(r'viewBox="[-\d.]+ [-\d.]+ ([\d.]+)', picture.svg)
    return round(1.25 * 4 / 3 * float(box[1])) if box else 1200


def _address(one: PageTable) -> str:
    if one.beside is not None and len(one.rows) > MOST_INSIDE:
        return quote(one.beside)
    return "data:text/csv;charset=utf-8;base64," + base64.b64encode(csv_text(one.rows).encode()).decode()
