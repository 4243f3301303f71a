"""What is printed and drawn of stored runs and recordings: damage, comparisons, moduli and maps."""

from __future__ import annotations

import json as json_format
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from hpe_rig.cli.console import announce
from hpe_rig.cli.tables import wide_console
from hpe_rig.result import rich_table
from hpe_rig.scene import printable
from hpe_rig.store import StoreError, Verification, atomic_file, extra

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hpe_rig.moduli import ModuliResult
    from hpe_rig.report import ResultDifference
    from hpe_rig.result import MotionMap

LONGEST_VALUE = 60


def print_verification(found: Verification, json: bool = False) -> None:
    """Print what was found in a file."""
    if json:
        typer.echo(json_format.dumps(found.as_dict(), indent=2))
        return
    what = f"{found.shots_complete} of {found.shots} shots complete, {found.records} records, {found.status}"
    typer.echo(f"{found.path}: {what if found.kind == 'run' else f'results of {found.shots} shots'}")
    for damage in found.damage:
        typer.echo(f"DAMAGED: {damage}")
    typer.echo(_verdict(found))


def _verdict(found: Verification) -> str:
    if found.damage:
        remedy = "hpe-rig process" if found.kind == "result" else "hpe-rig resume, which measures damaged shots again"
        return f"what is damaged counts as missing and enters no result. Try: another copy of the file, or {remedy}."
    if not found.checksums:
        return "it holds no checksums, being of an earlier release: whether its values were changed cannot be told"
    return "sound: everything in it is as its checksums say"


def print_comparison(first: Path, second: Path, named: str | None, figure: Path | None, json: bool) -> None:
    """Print what differs between two runs, and write its figure."""
    from hpe_rig.report import compare_runs

    found = compare_runs(first, second, named)
    if figure is not None:
        _save(found.figure(), figure, "both results and their differences")
    if json:
        typer.echo(json_format.dumps(found.as_dict(), indent=2))
        return
    console = wide_console()
    many = {0: "no setting differs", 1: "1 setting differs"}.get(len(found.settings))
    console.print(many or f"{len(found.settings)} settings differ", style="bold")
    settings = [(each.where, each.what, _value(each.before), _value(each.after)) for each in found.settings]
    if settings:
        console.print(rich_table(("", "setting", *found.names), settings, words=4))
    for setting in dict.fromkeys(row.setting for row in found.results):
        console.print(f"\n{setting}", style="bold")
        headers = ["f\nHz"]
        headers += [f"{what}\n{name}" for name in ("first", "second") for what in ("nm, u", "deg, u")]
        rows = [_compared(row) for row in found.results if row.setting == setting]
        console.print(rich_table([*headers, "change\n%", "change\ndeg", "p\nall", "p\nnoise", ""], rows, words=0))
    for text in found.alone:
        console.print(text)
    if not found.results:
        console.print("no setting and frequency has a result in both")
        return
    console.print()
    runs = zip(("first", "second"), found.names, found.origins, found.estimators, strict=True)
    for which, name, origin, estimator in runs:
        console.print(f"{which}: {name}, {origin}, estimator {estimator}")
    console.print(
        "p: probability of as large a difference of amplitude and phase by chance, below 0.01 they differ; all: every\n"
        "source of uncertainty independent in the two; noise: noise and trigger jitter alone, for runs alike:\n"
        "of the same place, beams and specimen"
    )


def _compared(row: ResultDifference) -> tuple[str, ...]:
    cells = [f"{row.frequency_hz:g}"]
    for side in (0, 1):
        cells.append(f"{row.amplitude_m[side] * 1e9:.4g}, {row.amplitude_uncertainty_m[side] * 1e9:.2g}")
        cells.append(f"{math.degrees(row.phase_rad[side]):.2f}, {math.degrees(row.phase_uncertainty_rad[side]):.2g}")
    cells += [f"{row.amplitude_change * 100:+.1f}", f"{math.degrees(row.phase_change_rad):+.2f}"]
    return (*cells, f"{row.p_all:.2g}", f"{row.p_noise:.2g}", row.verdict)


def _value(value: Any) -> str:
    text = "absent" if value is None else f"{value:.10g}" if isinstance(value, float) else str(value)
    return printable(text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}...")


def print_moduli(result: ModuliResult, figure: Path | None, json: bool) -> None:
    """Print ``result`` and write its ``figure``; raise ``StoreError`` where it cannot be written."""
    if figure is not None:
        _save(result.figure(), figure, "measured and fitted vibrations")
    typer.echo(json_format.dumps(result.as_dict(), indent=2) if json else str(result))


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
        _save(found.figure(), figure, "amplitude, phase, uncertainty and velocity")


def _save(drawn: Figure, path: Path, what: str) -> None:
    from hpe_rig.result import write_figure

    try:
        write_figure(drawn, path)
    except (OSError, ValueError) as error:
        raise StoreError(
            f"{path} cannot be written ({error}). Try: a name that ends in .svg, .png or .pdf, in a folder that exists."
        ) from error
    announce(f"{path}: {what}")
