"""Output of stored runs and recordings: marks, damage, comparisons, moduli, dispersion and maps."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from hpe_rig.cli.console import announce, print_json
from hpe_rig.cli.options import RunsFigureKind
from hpe_rig.cli.tables import wide_console
from hpe_rig.cli.terminal import terminal_columns, wrapped
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
    if verification.torn_bytes:
        typer.echo(f"the last {plural(verification.torn_bytes, 'byte')} are of a write that was interrupted: left out")
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
    console.print(f"\n{wrapped(comparison.sentence(), terminal_columns())}", style="bold")
    if comparison.results:
        _print_differences(console, comparison)
    for text in comparison.alone:
        console.print(wrapped(text, terminal_columns()))
    title = {0: "no setting differs", 1: "1 setting differs:"}
    console.print(f"\n{title.get(len(comparison.settings), f'{len(comparison.settings)} settings differ:')}")
    for item in comparison.settings:
        console.print(f"  {item.where}, {item.what}: {_value(item.before)} -> {_value(item.after)}")


def _print_differences(console: Console, comparison: Comparison) -> None:
    """Print the table of differences, the two runs and the meaning of both probabilities.

    A single setting has a row for each frequency. Several settings have a row each, at the frequency with the largest
    difference.
    """
    varied, rows = comparison.varied_settings(), comparison.results
    if varied:
        groups = (list(group) for _, group in groupby(rows, lambda row: row.settings))
        rows = tuple(max(group, key=lambda row: row.change_over_u) for group in groups)
        console.print(f"most changed at each of {len(rows)} settings; --json lists every frequency")
    # A name in two lines keeps its column narrow.
    headers = [name.rpartition(".")[2].replace("_", "\n", 1) for name in varied]
    headers += ["f\nHz", "first\nnm", "second\nnm", "change\n%", "\n/u", "change\ndeg", "\n/u", "p\nnoise", ""]
    cells = [(*(row.setting_text(name) for name in varied), *_difference_row(row)) for row in rows]
    console.print(rich_table(headers, cells, words=0))
    for run, name, origin, method in zip(
        ("first", "second"), comparison.names, comparison.origins, comparison.estimators, strict=True
    ):
        console.print(f"{run}: {name}, {origin}, estimator {method}")
    console.print(
        "/u: change over its standard uncertainty from all sources, independent in both\n"
        "runs. Results differ if chance explains such a change with a probability below\n"
        "0.01. p noise: that probability for noise and trigger jitter alone. If alike:\n"
        "they differ if lateral offset, beams and specimen are the same."
    )


def _difference_row(row: ResultDifference) -> tuple[str, ...]:
    amplitudes = (f"{amplitude_m * 1e9:.4g}" for amplitude_m in row.amplitude_m)
    amplitude = f"{row.amplitude_change * 100:+z.1f}", _over_u(row.amplitude_change_over_u)
    phase = f"{math.degrees(row.phase_change_rad):+z.2f}", _over_u(row.phase_change_over_u)
    verdict = row.verdict.removeprefix("differs ")
    return f"{row.frequency_hz:g}", *amplitudes, *amplitude, *phase, probability_text(row.p_noise), verdict


def _over_u(ratio: float) -> str:
    return f"{ratio:+z.1f}" if math.isfinite(ratio) else "u = 0"


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
