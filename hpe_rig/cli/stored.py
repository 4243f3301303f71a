"""Output of stored runs and recordings: marks, damage, comparisons, moduli, dispersion and maps."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from hpe_rig.cli.console import announce, print_json
from hpe_rig.cli.options import RunsFigureKind
from hpe_rig.cli.tables import wide_console
from hpe_rig.result import probability_text, rich_table
from hpe_rig.scene import Mistake, SettingsError, plural, printable
from hpe_rig.store import (
    Verification,
    extra,
    read_run,
    refuse_unwritable,
    write_file,
    write_map as write_map_file,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from hpe_rig.moduli import DispersionResult, ModuliResult
    from hpe_rig.report import Comparison, ResultDifference
    from hpe_rig.result import MotionMap

METRES_PER_INCH = 0.0254
MIN_WIDTH_M, MAX_WIDTH_M = 30e-3, 1.0
MAX_VALUE = 60
"""Characters of a setting in a table."""


def print_verification(verification: Verification, json: bool = False) -> None:
    """Print the content of a file and its damage."""
    if json:
        print_json(verification.as_dict())
        return
    shots = verification.shots
    content = f"results of {plural(shots, 'shot')}" if verification.kind == "result" else verification.kind
    # Only a run file has records and a status.
    if verification.kind == "run":
        counts = f"{verification.shots_complete} of {shots} shots complete, {plural(verification.records, 'record')}"
        content = f"{counts}, {verification.status}"
    typer.echo(f"{verification.path}: {content}")
    for damage in verification.damage:
        typer.echo(f"DAMAGED: {damage}")
    typer.echo(_verdict(verification))


def _verdict(verification: Verification) -> str:
    if verification.damage and verification.kind == "text":
        return "the file is refused. Try: another copy of it, or the command that wrote it."
    if verification.damage:
        command = {
            "run": "hpe-rig resume, which measures damaged shots again",
            "result": "hpe-rig process",
            "map": "hpe-rig map",
        }[verification.kind]
        return f"damaged data count as missing and enter no result. Try: another copy of the file, or {command}."
    if not verification.checksums:
        return "the file of an earlier release has no checksums: changed values cannot be detected"
    return "sound: all data match their checksums"


def mark_shots(run_file: Path, shots: Sequence[int], why: str | None, good: bool, json: bool) -> None:
    """Mark ``shots`` as bad, or as ``good`` again, then print all marks of the run."""
    stored = read_run(run_file)
    total = stored.shot_complete.size
    mistakes = [
        Mistake("SHOT", f"shot {shot} does not exist", f"1 to {total}") for shot in shots if not 1 <= shot <= total
    ]
    if bool(shots) != (good or why is not None) or (good and why is not None):
        mistakes.append(Mistake("", "a mark is a shot and a verdict", '3 --bad "cable touched", 3 --good, or neither'))
    if why is not None and not why.strip():
        mistakes.append(Mistake("--bad", "the reason is empty", '--bad "cable touched"'))
    if mistakes:
        raise SettingsError("command line", mistakes)
    indices = [shot - 1 for shot in shots]
    if indices:
        path = stored.mark(indices, why)
        announce(
            f"{path}: written; results and reports from before do not have these marks: hpe-rig process {run_file}"
        )
        stored = read_run(run_file)
    if json:
        marks = [{"shot": shot + 1, "mark": text} for shot, text in stored.marks.items()]
        print_json({"shots": total, "marks": marks})
        return
    for shot, text in stored.marks.items():
        typer.echo(f"shot {shot + 1} {text}")
    typer.echo(f"{len(stored.marks)} of {total} shots are marked bad")


def print_comparison(first: Path, second: Path, estimator: str | None, figure: Path | None, json: bool) -> None:
    """Print the differences between two runs, and write their figure."""
    from hpe_rig.report import compare_runs

    comparison = compare_runs(first, second, estimator)
    if figure is not None:
        _save(comparison.figure(), figure, "both results and their differences")
    if json:
        print_json(comparison.as_dict())
        return
    console = wide_console()
    for setting in dict.fromkeys(row.setting for row in comparison.results):
        console.print(f"\n{setting}", style="bold")
        headers = ["f\nHz"]
        headers += [f"{values}\n{run}" for run in ("first", "second") for values in ("nm, u", "deg, u")]
        rows = [_difference_row(row) for row in comparison.results if row.setting == setting]
        console.print(rich_table([*headers, "change\n%", "change\ndeg", "p\nall", "p\nnoise", ""], rows, words=0))
    for text in comparison.alone:
        console.print(text)
    if not comparison.results:
        console.print("no setting and frequency has a result in both")
    else:
        _explain_differences(console, comparison)
    settings = [(item.where, item.what, _value(item.before), _value(item.after)) for item in comparison.settings]
    title = {0: "no setting differs", 1: "1 setting differs"}.get(len(settings), f"{len(settings)} settings differ")
    console.print(f"\n{title}", style="bold")
    if settings:
        console.print(rich_table(("", "setting", *comparison.names), settings, words=4))


def _explain_differences(console: Console, comparison: Comparison) -> None:
    """Print the two runs and the meaning of both probabilities."""
    console.print()
    for run, name, origin, method in zip(
        ("first", "second"), comparison.names, comparison.origins, comparison.estimators, strict=True
    ):
        console.print(f"{run}: {name}, {origin}, estimator {method}")
    console.print(
        "p: probability of a difference of amplitude and phase at least as large by chance, significant below 0.01;\n"
        "all: all sources of uncertainty, independent in the two runs; noise: noise and trigger jitter alone, for\n"
        "runs with the same lateral offset, beams and specimen"
    )


def _difference_row(row: ResultDifference) -> tuple[str, ...]:
    # Amplitude in nm and phase in degrees, each with its u, for either run.
    cells = [f"{row.frequency_hz:g}"]
    for run in (0, 1):
        cells.append(f"{row.amplitude_m[run] * 1e9:.4g}, {row.amplitude_uncertainty_m[run] * 1e9:.2g}")
        cells.append(f"{math.degrees(row.phase_rad[run]):.2f}, {math.degrees(row.phase_uncertainty_rad[run]):.2g}")
    cells += [f"{row.amplitude_change * 100:+.1f}", f"{math.degrees(row.phase_change_rad):+.2f}"]
    return (*cells, probability_text(row.p_all), probability_text(row.p_noise), row.verdict)


def _value(value: Any) -> str:
    text = "absent" if value is None else f"{value:.10g}" if isinstance(value, float) else str(value)
    return printable(text if len(text) <= MAX_VALUE else f"{text[:MAX_VALUE]}...")


def print_moduli(result: ModuliResult, figure: Path | None, json: bool) -> None:
    """Print ``result`` and write its ``figure``; raise ``StoreError`` if it cannot be written."""
    if figure is not None:
        _save(result.figure(), figure, "measured and fitted vibrations")
    if json:
        print_json(result.as_dict())
    else:
        typer.echo(str(result))


def print_dispersion(result: DispersionResult, figure: Path | None, *, json: bool, csv: bool) -> None:
    """Print ``result`` and write its ``figure``; raise ``StoreError`` if it cannot be written."""
    if figure is not None:
        _save(result.figure(), figure, "phase velocity and attenuation")
    if json:
        print_json(result.as_dict())
    else:
        typer.echo(result.to_csv() if csv else str(result), nl=not csv)


def draw_figure(
    run_files: Sequence[Path],
    output: Path,
    kind: RunsFigureKind,
    width: str,
    *,
    frequencies_hz: Sequence[float] | None,
    estimator: str | None,
    profile_step_m: float | None,
) -> None:
    """Write the figure ``kind`` of stored runs, ``width`` wide; raise ``SettingsError`` if they lack its data."""
    from matplotlib import rc_context

    from hpe_rig.result import STYLE
    from hpe_rig.runs import dispersion, fit_moduli, open_run
    from hpe_rig.scene import length_m

    mistakes = list(_figure_mistakes(kind, len(run_files), frequencies_hz, profile_step_m))
    if not (width_m := length_m(width, "--width", MAX_WIDTH_M)) >= MIN_WIDTH_M:
        mistakes.append(Mistake("--width", f"{width!r} is too narrow for a figure", "a width such as 85mm"))
    if mistakes:
        raise SettingsError("command line", mistakes)
    width_in = width_m / METRES_PER_INCH
    size = width_in, width_in * (0.62 if kind == "displacement" else 1.1)
    with rc_context({**STYLE, "font.size": 8, "pdf.fonttype": 42, "figure.figsize": size}):
        if kind == "moduli":
            drawing = fit_moduli(*run_files, estimator=estimator, profile_step_m=profile_step_m).figure(figsize=size)
        elif kind == "dispersion":
            drawing = dispersion(*run_files, estimator=estimator).figure(figsize=size)
        else:
            result = open_run(run_files[0]).with_profile(profile_step_m).estimate(estimator)
            try:
                drawing = result.figure(kind, frequencies_hz=frequencies_hz)
            except ValueError as error:
                mistake = Mistake(f"--kind {kind}", str(error), "another kind or frequency")
                raise SettingsError("command line", [mistake]) from error
        _save(drawing, output, f"{kind}, {width_m * 1e3:g} mm wide")


def _figure_mistakes(
    kind: RunsFigureKind, run_count: int, frequencies_hz: Sequence[float] | None, profile_step_m: float | None
) -> Iterator[Mistake]:
    """Yield the options that a figure ``kind`` lacks or does not use."""
    fits_medium = kind in {"moduli", "dispersion"}
    if run_count > 1 and not fits_medium:
        yield Mistake("RUN.h5", f"--kind {kind} draws one run", "one run file, or --kind moduli or dispersion")
    if kind == "dispersion" and profile_step_m is not None:
        yield Mistake("--gate-profile-step", "--kind dispersion uses the gates of the scene", "leave it out")
    if kind == "profile" and profile_step_m is None:
        yield Mistake("--kind profile", "no gates over depth are named", "--gate-profile-step 0.5mm")
    if frequencies_hz and (fits_medium or kind == "displacement"):
        yield Mistake("--frequency", f"--kind {kind} draws all frequencies", "leave it out")


def refuse_dataset(dataset: Path | None) -> None:
    """Raise ``StoreError`` for a ``dataset`` that cannot be written, before anything is computed."""
    if dataset is not None:
        refuse_unwritable(dataset)
        with extra("frames"):
            importlib.import_module("xarray")


def write_map(motion_map: MotionMap, output: Path | None, figure: Path | None) -> None:
    """Write dataset and figure of a map, if their paths are given; raise ``StoreError`` if one cannot be written.

    The other one is written in any case.
    """
    try:
        if output is not None:
            write_map_file(output, motion_map.to_xarray())
            announce(f"{output}: axes line, depth and frequency; xarray.open_dataset opens it")
    finally:
        if figure is not None:
            _save(motion_map.figure(), figure, "amplitude, phase, uncertainty and velocity")


def _save(figure: Figure, path: Path, content: str) -> None:
    from hpe_rig.result import figure_bytes

    write_file(path, figure_bytes(figure, path))
    announce(f"{path}: {content}")
