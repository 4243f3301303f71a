"""Moduli on the terminal: as text or JSON, and as a figure in a file."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from hpe_rig.cli.console import announce
from hpe_rig.store import StoreError

if TYPE_CHECKING:
    from hpe_rig.moduli import ModuliResult

FORMATS = (".svg", ".png", ".pdf")


def print_moduli(result: ModuliResult, figure: Path | None, json: bool) -> None:
    """Print ``result`` and write its ``figure``; raise ``StoreError`` where it cannot be written."""
    if figure is not None:
        try:
            result.figure().savefig(figure)
        except (OSError, ValueError) as error:
            raise StoreError(f"{figure} cannot be written ({error}). Try: a name that ends in {FORMATS}.") from error
        announce(f"{figure}: measured and fitted vibrations")
    typer.echo(json_format.dumps(result.as_dict(), indent=2) if json else str(result))
