"""Tables of rows: the layout for the terminal, CSV, and the packages of the extra 'frames'."""

from __future__ import annotations

import csv
import importlib
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, is_dataclass
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from rich.table import Table

TEXT_WIDTH = 1000
"""Width of a table as text, in characters: no cell is ever cut."""


def mappings(rows: Iterable[Any]) -> list[Mapping[str, Any]]:
    """Return rows, dataclass instances or mappings, as mappings by column."""
    return [asdict(row) if is_dataclass(row) and not isinstance(row, type) else row for row in rows]


def package_of_extra(name: str, caller: str, extra: str = "frames") -> Any:
    """Return the package ``name`` of the ``extra``, which ``caller`` needs."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        message = f'{caller} needs {name}, which is not installed. Try: pip install "hpe-rig[{extra}]".'
        raise ModuleNotFoundError(message, name=error.name) from None


def csv_text(rows: Iterable[Any]) -> str:
    """Return rows, dataclass instances or mappings, as CSV with a header.

    Numbers keep every digit; None and missing values are empty; without rows there is no header.
    """
    cells = mappings(rows)
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(dict.fromkeys(name for row in cells for name in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(cells)
    return text.getvalue()


def rich_table(headers: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> Table:
    """Return a table without rules; the first ``words`` columns are left-aligned, all others right-aligned."""
    from rich.table import Table

    table, rows = Table(box=None, header_style="bold", pad_edge=False), list(rows)
    for index, header in enumerate(headers):
        # On a narrow terminal cells fold, because a cut address is useless; the name in the first column does not.
        min_width = max((len(row[0]) for row in rows), default=0) if index == 0 else None
        justify: Literal["left", "right"] = "left" if index < words else "right"
        table.add_column(header, justify=justify, overflow="fold", min_width=min_width)
    for row in rows:
        table.add_row(*row)
    return table


def text_table(headers: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> str:
    """Return `rich_table` as plain text of any width."""
    from rich.console import Console

    text = io.StringIO()
    console = Console(file=text, width=TEXT_WIDTH, markup=False, emoji=False, highlight=False)
    console.print(rich_table(headers, rows, words))
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines())
