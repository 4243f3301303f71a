"""Tables of rows: one layout for the terminal, one CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, is_dataclass
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from rich.table import Table

WIDEST = 1000
"""Columns of a table that is returned as text: whoever prints it may scroll, but no cell is ever cut."""


def mappings(rows: Iterable[Any]) -> list[Mapping[str, Any]]:
    """Return rows, dataclass instances or mappings, as mappings by column."""
    return [asdict(row) if is_dataclass(row) and not isinstance(row, type) else row for row in rows]


def csv_text(rows: Iterable[Any]) -> str:
    """Return rows, dataclass instances or mappings, as CSV with a header.

    Numbers keep every digit, None and what a row lacks are empty; no rows give no header.
    """
    cells = mappings(rows)
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(dict.fromkeys(name for row in cells for name in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(cells)
    return text.getvalue()


def rich_table(headers: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> Table:
    """Return a table without rules: the first ``words`` columns aligned to the left, those of numbers to the right."""
    from rich.table import Table

    table, rows = Table(box=None, header_style="bold", pad_edge=False), list(rows)
    for index, header in enumerate(headers):
        # Folded where the terminal is narrow, since an address that is cut is none; what a row is of never is.
        least = max((len(row[0]) for row in rows), default=0) if index == 0 else None
        justify: Literal["left", "right"] = "left" if index < words else "right"
        table.add_column(header, justify=justify, overflow="fold", min_width=least)
    for row in rows:
        table.add_row(*row)
    return table


def text_table(headers: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> str:
    """Return `rich_table` as plain text, however wide."""
    from rich.console import Console

    text = io.StringIO()
    console = Console(file=text, width=WIDEST, markup=False, emoji=False, highlight=False)
    console.print(rich_table(headers, rows, words))
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines())
