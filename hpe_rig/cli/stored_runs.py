"""Commands on stored runs: process, report, compare, moduli, dispersion, figure, mark, verify, list."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hpe_rig.cli.console import EXIT_DAMAGED, EXIT_NO_CHECKSUMS, announce, guarded, printing, show
from hpe_rig.cli.options import (
    Estimator,
    Json,
    ProfileStep,
    ResultOptions,
    RunFile,
    RunsFigureKind,
    SweepOptions,
    figure_option,
    output_option,
)
from hpe_rig.result import Stages

MAX_STEP_M = 0.1

RunsAtOffsets = Annotated[
    list[Path], typer.Argument(metavar="RUN.h5 ...", help="Run files, each with one lateral offset or more.")
]
WidthUncertainty = Annotated[
    float, typer.Option(min=0.0, max=1.0, metavar="U", help="Relative uncertainty of the widths of the force.")
]
PerPlace = Annotated[
    bool, typer.Option("--per-place", help="The force differed between lateral offsets: fit every amplitude.")
]

stored_runs = typer.Typer()


@stored_runs.command()
@guarded
@printing
def process(
    run_file: RunFile,
    result: ResultOptions,
    points: SweepOptions,
    drift: Annotated[str | None, typer.Option(hidden=True)] = None,
) -> None:
    """Estimate again from a stored run. The result is printed and written beside the run file."""
    from hpe_rig.runs import estimate_points, open_run, points_over, process as process_run
    from hpe_rig.scene import parse_axes

    _refuse_conflicts(points)
    changes = points.changes
    if drift is not None:
        announce(f"--drift {drift} is --set processing.drift={drift} since version 1.0")
        changes["processing.drift"] = drift
    if points.sweep:
        run_points = points_over(open_run(run_file).with_(changes), parse_axes(points.sweep), points.together)
        estimates = estimate_points(run_points, result.estimator)
    else:
        step_m = _step_m(points.gate_profile_step)
        estimates = process_run(run_file, result.estimator, Stages(), step_m, changes)
    show(estimates, result)


@stored_runs.command()
@guarded
def report(
    run_file: RunFile,
    points: SweepOptions,
    estimator: Estimator = None,
    output: Annotated[Path | None, output_option("HTML file. Default: RUN.html beside the run file.")] = None,
    shot: Annotated[
        int | None,
        typer.Option(metavar="SHOT", help="Shot to draw, counted from 1. Default: the one with the largest motion."),
    ] = None,
) -> None:
    """Write the report of a run. One HTML file with results, figures, residual tests, predictions and provenance."""
    from hpe_rig.report import write_report
    from hpe_rig.scene import parse_axes

    _refuse_conflicts(points)
    page = write_report(
        run_file,
        estimator,
        output,
        shot,
        profile_step_m=_step_m(points.gate_profile_step),
        axes=parse_axes(points.sweep or ()),
        together=points.together,
        settings=points.changes,
    )
    typer.echo(f"{page}: open it in any browser")


def _refuse_conflicts(points: SweepOptions) -> None:
    from hpe_rig.scene import Mistake, SettingsError

    mistakes = []
    if points.together and not points.sweep:
        mistakes.append(Mistake("--together", "no --sweep is given", "--sweep KEY=V,V"))
    if points.sweep and points.gate_profile_step is not None:
        what = "a sweep has no depth profile"
        mistakes.append(Mistake("--gate-profile-step", what, "--sweep gate_depth_m=V,V, or no --sweep"))
    if mistakes:
        raise SettingsError("command line", mistakes)


def _step_m(text: str | None) -> float | None:
    from hpe_rig.scene import length_m

    return None if text is None else length_m(text, "--gate-profile-step", MAX_STEP_M)


@stored_runs.command()
@guarded
@printing
def compare(
    first: Annotated[Path, typer.Argument(metavar="A.h5", help="Run file.")],
    second: Annotated[Path, typer.Argument(metavar="B.h5", help="Run file to compare with it.")],
    estimator: Estimator = None,
    figure: Annotated[Path | None, figure_option("Both results and their differences")] = None,
    json: Json = False,
) -> None:
    """Compare two runs. Settings that differ, results side by side, and how significant each difference is."""
    from hpe_rig.cli.stored import print_comparison

    print_comparison(first, second, estimator, figure, json)


@stored_runs.command()
@guarded
@printing
def moduli(
    run_files: RunsAtOffsets,
    law: Annotated[
        list[str] | None,
        typer.Option(metavar="LAW", help="Medium to try: voigt, zener, power_law, maxwell; repeatable. Default: all."),
    ] = None,
    estimator: Estimator = None,
    width_uncertainty: WidthUncertainty = 0.05,
    per_place: PerPlace = False,
    gate_profile_step: ProfileStep = None,
    figure: Annotated[Path | None, figure_option("Measured and fitted vibrations")] = None,
    json: Json = False,
) -> None:
    """Fit the shear modulus and viscosity of the medium to the vibrations of one or more runs."""
    from hpe_rig.cli.stored import print_moduli
    from hpe_rig.runs import fit_moduli

    result = fit_moduli(
        *run_files,
        laws=law or (),
        estimator=estimator,
        width_uncertainty=width_uncertainty,
        common_amplitude=not per_place,
        profile_step_m=_step_m(gate_profile_step),
    )
    print_moduli(result, figure, json)


@stored_runs.command()
@guarded
@printing
def dispersion(
    run_files: RunsAtOffsets,
    estimator: Estimator = None,
    width_uncertainty: WidthUncertainty = 0.05,
    per_place: PerPlace = False,
    figure: Annotated[Path | None, figure_option("Phase velocity and attenuation")] = None,
    json: Json = False,
    csv: Annotated[bool, typer.Option("--csv", help="Print CSV, one row per method and frequency.")] = False,
) -> None:
    """Phase velocity and attenuation of shear waves at every harmonic, beside those of plane-wave methods."""
    from hpe_rig.cli.options import refuse_two_formats
    from hpe_rig.cli.stored import print_dispersion
    from hpe_rig.runs import dispersion as dispersion_of

    refuse_two_formats(json, csv)
    result = dispersion_of(
        *run_files, estimator=estimator, width_uncertainty=width_uncertainty, common_amplitude=not per_place
    )
    print_dispersion(result, figure, json=json, csv=csv)


@stored_runs.command()
@guarded
def figure(
    run_files: Annotated[
        list[Path],
        typer.Argument(metavar="RUN.h5 ...", help="Run file; several for moduli and dispersion only."),
    ],
    output: Annotated[Path, figure_option("File of the figure", "--output", "-o")],
    kind: Annotated[
        RunsFigureKind,
        typer.Option(
            help="Amplitude and phase over frequency (spectrum), relative force (drive), lateral offset (distance) or "
            "depth (profile); largest displacement over time; vibrations and the fitted medium (moduli); phase "
            "velocity and attenuation (dispersion)."
        ),
    ] = "spectrum",
    width: Annotated[
        str, typer.Option(metavar="LENGTH", help="Width of the figure, such as 85mm for a column of a journal.")
    ] = "120mm",
    frequency: Annotated[
        list[float] | None, typer.Option(metavar="HZ", help="Frequency to draw; repeatable. Default: all.")
    ] = None,
    estimator: Estimator = None,
    gate_profile_step: ProfileStep = None,
) -> None:
    """Draw a figure for a paper: one curve for each setting or frequency, means over repeats, bars of 2 u."""
    from hpe_rig.cli.stored import draw_figure

    draw_figure(
        run_files,
        output,
        kind,
        width,
        frequencies_hz=frequency or None,
        estimator=estimator,
        profile_step_m=_step_m(gate_profile_step),
    )


@stored_runs.command()
@guarded
@printing
def mark(
    run_file: RunFile,
    shots: Annotated[list[int] | None, typer.Argument(metavar="SHOT ...", help="Shots, counted from 1.")] = None,
    bad: Annotated[str | None, typer.Option(metavar="WHY", help="Leave the shots out of every later result.")] = None,
    good: Annotated[bool, typer.Option("--good", help="Take the marks of the shots back.")] = False,
    json: Json = False,
) -> None:
    """Mark shots of a run as bad, or list the marks. The run file stays unchanged: marks are in RUN.marks.json."""
    from hpe_rig.cli.stored import mark_shots

    mark_shots(run_file, shots or (), bad, good, json)


@stored_runs.command()
@guarded
@printing
def verify(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="Run, result, map, queue.json, RUN.marks.json, study.json or summary.csv."),
    ],
    json: Json = False,
) -> None:
    """Compare every byte of a file with its checksums. Exit code 0: sound, 4: damaged, 5: it has no checksums."""
    from hpe_rig.cli.stored import print_verification
    from hpe_rig.store import verify as verify_file

    verification = verify_file(file)
    print_verification(verification, json)
    if verification.damage:
        raise typer.Exit(EXIT_DAMAGED)
    if not verification.checksums:
        raise typer.Exit(EXIT_NO_CHECKSUMS)


@stored_runs.command("list")
@guarded
@printing
def list_command(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder with run files. Default: this one.")
    ] = Path(),
    find: Annotated[
        list[str] | None,
        typer.Option(metavar="WORDS", help="Only runs with WORDS in file name, title, state or notes; repeatable."),
    ] = None,
    since: Annotated[str | None, typer.Option(metavar="DATE", help="Only runs from this date on.")] = None,
    until: Annotated[str | None, typer.Option(metavar="DATE", help="Only runs up to this date.")] = None,
    below: Annotated[bool, typer.Option("--below", help="Include subfolders.")] = False,
    json: Json = False,
    csv: Annotated[bool, typer.Option("--csv", help="Print CSV, one row per run, a column per note.")] = False,
) -> None:
    """List the runs in a folder with date, title, result and notes."""
    from hpe_rig.cli.listing import print_runs
    from hpe_rig.cli.options import refuse_two_formats

    refuse_two_formats(json, csv)
    print_runs(folder, below, find or (), (since, until), json=json, csv=csv)
