"""Map on the terminal: progress over the lines, the dataset and the figure in files."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from hpe_rig.cli.console import announce
from hpe_rig.store import StoreError, atomic_file, extra

if TYPE_CHECKING:
    from hpe_rig.result import MotionMap


@contextmanager
def counting(what: str) -> Iterator[Callable[[int, int], None] | None]:
    """Yield what is told (done, of) and draws a progress bar on a terminal; None elsewhere."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what)
        yield lambda done, of: bar.update(task, completed=done, total=of)


def write_map(found: MotionMap, output: Path | None, figure: Path | None) -> None:
    """Write dataset and figure of a map where they are wanted; raise ``StoreError`` where they cannot be written."""
    if output is not None:
        with extra("frames"):
            dataset = found.to_xarray()
        try:
            with atomic_file(output) as draft:
                dataset.to_netcdf(draft, engine="h5netcdf")
        except (OSError, ValueError, ModuleNotFoundError) as error:
            raise StoreError(
                f"{output} cannot be written ({error}). Try: another folder, h5netcdf installed."
            ) from error
        announce(f"{output}: axes line, depth and frequency; xarray.open_dataset opens it")
    if figure is not None:
        try:
            found.figure().savefig(figure, dpi=150)
        except (OSError, ValueError) as error:
            raise StoreError(f"{figure} cannot be written ({error}). Try: a name that ends in .png.") from error
        announce(f"{figure}: amplitude, phase, uncertainty and velocity")
