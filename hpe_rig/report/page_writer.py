"""Writer of every HTML page: one template family, one table layout, one palette, no script and no network.

    page.html      head, style, banner with the source of the numbers, header and main block
    macros.html    tables and figures
    sections.html  page of titled sections: studies, designs, accuracy
    report.html    page of one run

A page is one file: figures are inline SVG, and tables download as CSV from links that hold the data. Templates escape
texts.
"""

from __future__ import annotations

import base64
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any
from urllib.parse import quote

import jinja2
from markupsafe import Markup

from hpe_rig.result import Picture, csv_text, mappings, page_style, symbols

Row = Mapping[str, Any]

UNITS = {"m": "m", "s": "s", "hz": "Hz", "rad": "rad", "v": "V", "db": "dB", "mib": "MiB"}
"""Unit suffixes of column names, as print writes them."""
SYMBOL_WITH_INDEX = re.compile(r"(?<![A-Za-z0-9])[A-Za-z]_\w+")
"""A symbol such as W_x or F_0, which stays as it is."""
MAX_ROWS = 120
"""Rows of a table that a page of sections displays; its CSV holds all rows."""
MAX_EMBEDDED_ROWS = 5000
"""Rows of a table up to which the page embeds the CSV; a larger table links to its file."""
ACCEPTED_VERDICTS = ("agrees", "not run", "passed")
"""Verdicts that the page does not highlight."""


@dataclass(frozen=True, slots=True)
class PageTable:
    """One table: rows with the same columns.

    The page highlights verdicts in columns named ``verdict``. For columns named ``verdict, ...`` it also counts the
    verdicts, and a link on each count filters the rows.
    """

    key: str
    """Id in the page, and name of the CSV file."""
    caption: str
    rows: Sequence[Row]
    folded: bool = True
    """Whether the reader has to unfold the table."""
    csv_path: str | None = None
    """Address of the CSV file relative to the page, for a table too large to embed."""
    display_rows: Sequence[Row] = ()
    """Rows that the page displays; empty: ``rows``, which the CSV always holds."""
    downloadable: bool = True

    @property
    def displayed(self) -> Sequence[Row]:
        """Rows that the page displays."""
        return self.display_rows or self.rows

    @property
    def columns(self) -> list[str]:
        """Names of the displayed columns."""
        return list(self.displayed[0]) if self.displayed else []

    @property
    def text_columns(self) -> set[str]:
        """Displayed columns that hold text; a number with its error is no text."""
        rows = self.displayed[:MAX_ROWS]
        return {name for name in self.columns if any(_is_text(row[name]) for row in rows)}

    @property
    def mostly_text(self) -> bool:
        """Whether most columns hold text: on a phone each row is then a paragraph."""
        return 2 * len(self.text_columns) > len(self.columns)

    @property
    def verdict_counts(self) -> dict[str, dict[str, int]]:
        """Number of rows of each verdict, by column."""
        columns = [name for name in self.columns if name.startswith("verdict,")]
        return {name: dict(Counter(sorted(row[name] for row in self.displayed))) for name in columns}

    def anchor(self, column: str, verdict: str) -> str:
        """Return the id of the filter for one verdict, which is also the class of its rows."""
        return "-".join(re.findall(r"\w+", f"{self.key} {column.removeprefix('verdict')} {verdict}"))


@dataclass(frozen=True, slots=True)
class PageSection:
    """One section of a page; ``headline`` is the first sentence of a page that this section leads."""

    key: str
    title: str
    paragraphs: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    tables: tuple[PageTable, ...] = ()
    headline: str = ""


def page_table(key: str, caption: str, rows: Sequence[Any], **options: Any) -> PageTable:
    """Return a table of dataclass instances or mappings; ``options`` are fields of ``PageTable``."""
    return PageTable(key, caption, mappings(rows), **options)


def render_sections(
    title: str, introduction: Sequence[str], sections: Sequence[PageSection], facts: Mapping[str, str] | None = None
) -> str:
    """Return a page of sections as HTML; ``facts`` state the versions and command that made it."""
    return render_template(
        "sections.html", title=title, introduction=introduction, sections=sections, facts=facts or {}
    )


def render_template(name: str, **values: Any) -> str:
    """Return the page of the template ``name`` as HTML."""
    style = Markup(page_style())  # noqa: S704, a file of this program
    return _environment().get_template(name).render({"style": style, "max_rows": MAX_ROWS, **values})


def heading(name: str) -> str:
    """Return a column name for display, with its unit in brackets: ``gate_length_m`` is gate length (m).

    Scene keys, which contain a point, and symbols such as W_x stay as they are.
    """
    if "." in name:
        return name
    stem, _, unit = name.rpartition("_")
    # The last word of a name is its unit, if it is one.
    label = f"{stem} ({UNITS[unit]})" if stem and unit in UNITS else name
    return label if SYMBOL_WITH_INDEX.search(label) else label.replace("_", " ")


def cell_text(value: Any) -> str:
    """Return a cell's value for display: numbers to four digits, a dash for None and NaN."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, float):
        return str(value)
    return f"{value:.2e}" if 0 < abs(value) < 1e-3 else f"{value:.4g}"


@cache
def _environment() -> jinja2.Environment:
    """Return the template environment; it compiles a template once a process, a tenth of the time of a page."""
    folder = resources.files("hpe_rig.report")
    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        loader=jinja2.FunctionLoader(lambda name: (folder / name).read_text(encoding="utf-8")),
    )
    # An SVG needs no escaping: Matplotlib drew it from numbers and escaped every text.
    environment.filters.update(
        cell=cell_text,
        heading=heading,
        symbols=symbols,
        svg=lambda picture: Markup(picture.svg),  # noqa: S704
        width=_width_px,
        address=_csv_address,
    )
    environment.globals["ACCEPTED"] = ACCEPTED_VERDICTS
    return environment


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and not value.startswith(("-", "+", "–", *"0123456789"))


def _width_px(picture: Picture) -> int:
    """Return the maximum display width: 1.25 times the printed width, at 4/3 pixels a point."""
    box = re.search(r'viewBox="[-\d.]+ [-\d.]+ ([\d.]+)', picture.svg)
    return round(1.25 * 4 / 3 * float(box[1])) if box else 1200


def _csv_address(table: PageTable) -> str:
    # A very large table would make the page slow: it links to its file.
    if table.csv_path is not None and len(table.rows) > MAX_EMBEDDED_ROWS:
        return quote(table.csv_path)
    return "data:text/csv;charset=utf-8;base64," + base64.b64encode(csv_text(table.rows).encode()).decode()
