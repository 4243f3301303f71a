"""Commands of ``hpe-rig``; each imports what it needs when called, so that ``--help`` stays fast."""

from __future__ import annotations

import io
import os
import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from hpe_rig.cli.console import (
    EXIT_DAMAGED,
    EXIT_INSTRUMENT,
    EXIT_INTERRUPTED,
    EXIT_MISTAKE,
    EXIT_NO_CHECKSUMS,
    BenchPath,
    RunFile,
    SceneName,
    announce,
    file_named,
    guarded,
    ignore_interrupts,
    print_version,
    progress,
    refuse_undecodable,
    show,
)
from hpe_rig.cli.studies import studies
from hpe_rig.cli.terminal import LogLevel, start_logging
from hpe_rig.result import Stages

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
Csv = Annotated[bool, typer.Option("--csv", help="Print CSV instead of a table, one row per shot and frequency.")]
Wide = Annotated[bool, typer.Option("--wide", help="Print every column, and a table for every shot.")]
Compress = Annotated[bool, typer.Option("--compress", help="Compress the records (needs the extra 'compression').")]
LONGEST_STEP_M = 0.1
ProfileStep = Annotated[
    str | None,
    typer.Option("--gate-profile-step", help="Gates so far apart over the depth of the records, such as 0.5mm, too."),
]
Estimator = Annotated[str | None, typer.Option(help="Motion estimator, as in [processing]. Default: the scene's.")]
Live = Annotated[bool, typer.Option("--live", help="Serve a live page with a stop button (needs the extra 'live').")]
Verbose = Annotated[bool, typer.Option("--verbose", help="Log every step to RUN.log beside the run file.")]
StoredSweep = Annotated[
    list[str] | None,
    typer.Option(
        metavar="KEY=V,V",
        help="Estimate at every value of a number of [processing], [beams] or the gate. No result file is written.",
    ),
]
Together = Annotated[
    bool, typer.Option("--together", help="Several --sweep: their first values, then their second ones.")
]
Yes = Annotated[bool, typer.Option("--yes", help="Between places, go on without asking whether the transducer moved.")]
Open = Annotated[bool, typer.Option("--open", help="Open the live page in the browser.")]
Close = Annotated[
    bool, typer.Option("--close", help="The live page ends with the run. Default: it stays until closed.")
]
Port = Annotated[int, typer.Option(min=0, max=65535, help="Local port of the live page. 0: any free port.")]

RecordingFile = Annotated[
    Path, typer.Argument(metavar="RECORDING", help="NPY, NPZ, MATLAB, HDF5, CSV, raw or AlazarTech file of echoes.")
]
ImportScene = Annotated[
    str, typer.Option(help="Scene: gate, frequencies, beams. How it was recorded, the recording says.")
]
Lines = Annotated[
    str | None, typer.Option(help="Of several lines: 12, 10-20 or all, each a place, or mean, mean:10-20.")
]
Setting = Annotated[
    list[str] | None,
    typer.Option(
        "--set", "-s", metavar="KEY=VALUE", help="Of the recording, such as axes=line,pulse,sample; repeatable."
    ),
]
Sidecar = Annotated[Path | None, typer.Option(help="TOML file about the recording. Default: RECORDING.toml, if any.")]


def main() -> None:
    """Run the command line."""
    for library in ("OMP", "OPENBLAS", "MKL"):
        # The matrices are small: threads of the algebra library wait for one another longer than they work.
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A title the console's code page lacks must not cost a measurement.
            stream.reconfigure(errors="replace")
    refuse_undecodable(sys.argv)
    try:
        app()
    except KeyboardInterrupt:
        # It came before the command began, and so before anything was opened.
        announce("hpe-rig: interrupted")
        sys.exit(EXIT_INTERRUPTED)
    finally:
        # All is said and every output is off: nothing may turn the exit code into another one.
        ignore_interrupts()


@app.callback()
def program(
    version: Annotated[
        bool, typer.Option("--version", callback=print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
    log_level: Annotated[
        LogLevel,
        typer.Option("--log-level", help="Logged to standard error; debug: every message to an instrument."),
    ] = LogLevel.WARNING,
) -> None:
    """Measure harmonic motion in tissue with pulsed ultrasound excitation, on a real or simulated bench."""
    start_logging(log_level)


@app.command()
@guarded
def run(
    scene: SceneName,
    bench: BenchPath = None,
    output: Annotated[
        Path | None,
        typer.Option(callback=file_named, help="Run file. Default: SCENE.h5 in this folder, numbered if it exists."),
    ] = None,
    estimator: Estimator = None,
    json: Json = False,
    csv: Csv = False,
    wide: Wide = False,
    compress: Compress = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the run file if it exists.")] = False,
    yes: Yes = False,
    live: Live = False,
    port: Port = 0,
    opened: Open = False,
    closes: Close = False,
    verbose: Verbose = False,
    report: Annotated[bool, typer.Option("--report", help="Write the report too, as hpe-rig report does.")] = False,
) -> None:
    """Measure a scene, from the plan to the printed result. SCENE may be a run file, whose scene is measured again."""
    stages = Stages()
    with stages("load"):
        from hpe_rig.cli.watch import page_options, watched
        from hpe_rig.measurement import prepare, provenance_now, record_run
        from hpe_rig.processing import estimate_run  # noqa: F401, needed at the end
        from hpe_rig.runs import chosen_estimator, process
        from hpe_rig.store import WriteOptions, free_path, new_run_id, refuse_unwritable, result_path

    setup = prepare(scene, bench, stages)
    chosen = chosen_estimator(estimator, setup.scene.scene)
    path, run_id = output or free_path(setup.scene.name, Path()), new_run_id()
    refuse_unwritable(result_path(path, chosen))
    page = page_options(live, port, opened, closes)
    with watched(setup, path, run_id, page, verbose, announce, yes) as watching:
        with progress(setup, quiet=json or csv) as observer:
            options = WriteOptions(compress, overwrite, run_id=run_id, provenance=provenance_now(setup.bench.bench))
            record_run(setup, path, watching.observed(observer), stages, options, move=watching.move)
        show(process(path, estimator, stages), json, csv, wide)
        if report:
            from hpe_rig.report import write_report

            announce(f"{write_report(path, estimator)}: open it in any browser")
        elif not (json or csv):
            announce(f"figures: hpe-rig report {path}")


@app.command()
@guarded
def resume(
    run_file: RunFile,
    scene: Annotated[
        str | None, typer.Option(help="Scene that must equal the run's. Default: the scene in the run file.")
    ] = None,
    bench: BenchPath = None,
    output: Annotated[
        Path | None,
        typer.Option(callback=file_named, help="New run file. Default: beside the old one, numbered."),
    ] = None,
    estimator: Estimator = None,
    json: Json = False,
    csv: Csv = False,
    wide: Wide = False,
    compress: Compress = False,
    yes: Yes = False,
    live: Live = False,
    port: Port = 0,
    opened: Open = False,
    closes: Close = False,
    verbose: Verbose = False,
) -> None:
    """Continue a stopped run, keeping its complete shots. They are copied to a new file, which gets the others too."""
    stages = Stages()
    with stages("load"):
        from hpe_rig.cli.watch import page_options, watched
        from hpe_rig.measurement import prepare_rest, provenance_now, resume as resume_run
        from hpe_rig.processing import estimate_run  # noqa: F401, needed at the end
        from hpe_rig.runs import chosen_estimator, process
        from hpe_rig.store import WriteOptions, free_path, new_run_id, refuse_unwritable, result_path

    rest = prepare_rest(run_file, scene, bench, stages)
    chosen = chosen_estimator(estimator, rest.setup.scene.scene)
    announce(f"{rest.complete} of {len(rest.setup.plan.shots)} shots are complete")
    path, run_id = output or free_path(run_file.stem, run_file.parent), new_run_id()
    refuse_unwritable(result_path(path, chosen))
    page = page_options(live, port, opened, closes)
    with watched(rest.setup, path, run_id, page, verbose, announce, yes) as watching:
        with progress(rest.setup, quiet=json or csv) as observer:
            options = WriteOptions(compress, run_id=run_id, provenance=provenance_now(rest.setup.bench.bench))
            resume_run(rest, path, watching.observed(observer), stages, options, watching.move)
        show(process(path, estimator, stages), json, csv, wide)


@app.command()
@guarded
def process(
    run_file: RunFile,
    estimator: Estimator = None,
    gate_profile_step: ProfileStep = None,
    sweep: StoredSweep = None,
    together: Together = False,
    json: Json = False,
    csv: Csv = False,
    wide: Wide = False,
) -> None:
    """Estimate again from a stored run. The result is printed and written beside the run file."""
    from hpe_rig.runs import process as process_run

    _refuse_unswept(bool(sweep), together, gate_profile_step)
    if sweep:
        from hpe_rig.runs import open_run, parse_axes

        result = open_run(run_file).sweep(parse_axes(sweep), together=together, estimator=estimator)
    else:
        result = process_run(run_file, estimator, Stages(), _step_m(gate_profile_step))
    show(result, json, csv, wide)


def _refuse_unswept(swept: bool, together: bool, gate_profile_step: str | None) -> None:
    from hpe_rig.scene import Mistake, SettingsError

    mistakes = []
    if together and not swept:
        mistakes.append(Mistake("--together", "no --sweep is given whose values could go together", "--sweep KEY=V,V"))
    if swept and gate_profile_step is not None:
        what = "no depth profile is made at the points of a sweep"
        mistakes.append(Mistake("--gate-profile-step", what, "--sweep gate_depth_m=V,V, or no --sweep"))
    if mistakes:
        raise SettingsError("command line", mistakes)


def _step_m(text: str | None) -> float | None:
    from hpe_rig.scene import length_m

    return None if text is None else length_m(text, "--gate-profile-step", LONGEST_STEP_M)


@app.command("import")
@guarded
def import_command(
    recording: RecordingFile,
    scene: ImportScene,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Run file. Default: RECORDING.h5 in this folder, numbered.")
    ] = None,
    lines: Lines = None,
    setting: Setting = None,
    sidecar: Sidecar = None,
    compress: Compress = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the run file if it exists.")] = False,
) -> None:
    """Make a run file of echoes that another program recorded. Prints what is inferred; hpe-rig process goes on."""
    from hpe_rig.recordings import parse_options
    from hpe_rig.runs import import_recording
    from hpe_rig.store import WriteOptions

    options = parse_options(setting or []) | ({} if lines is None else {"lines": lines})
    made = import_recording(recording, scene, output, sidecar, options, WriteOptions(compress, overwrite))
    for text in made.inferred:
        typer.echo(text)
    typer.echo(f"{made.path}: hpe-rig process {made.path} estimates it, hpe-rig report {made.path} shows it")


@app.command("map")
@guarded
def map_command(
    recording: RecordingFile,
    scene: ImportScene,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="NetCDF file of the map (needs the extra 'frames').")
    ] = None,
    figure: Annotated[Path | None, typer.Option(help="Figure of the map, .png, .svg or .pdf.")] = None,
    lines: Lines = None,
    setting: Setting = None,
    sidecar: Sidecar = None,
) -> None:
    """Map amplitude, phase and velocity over lines and depths of a recording. Bad pixels are marked."""
    from hpe_rig.cli.stored import write_map
    from hpe_rig.cli.terminal import told
    from hpe_rig.recordings import parse_options
    from hpe_rig.runs import map_recording

    options = parse_options(setting or []) | ({} if lines is None else {"lines": lines})
    with told("lines") as tell:
        counted = lambda done, total: tell(done, total, "")  # noqa: E731
        found, inferred = map_recording(recording, scene, sidecar, options, counted)
    for text in (*inferred, str(found)):
        typer.echo(text)
    write_map(found, output, figure)


@app.command()
@guarded
def verify(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Run file or result file.")], json: Json = False
) -> None:
    """Compare every byte of a file with its checksums. Exit code 0: sound, 4: damaged, 5: it has no checksums."""
    from hpe_rig.cli.stored import print_verification
    from hpe_rig.store import verify as verify_file

    found = verify_file(file)
    print_verification(found, json)
    if found.damage:
        raise typer.Exit(EXIT_DAMAGED)
    if not found.checksums:
        raise typer.Exit(EXIT_NO_CHECKSUMS)


@app.command()
@guarded
def report(
    run_file: RunFile,
    estimator: Estimator = None,
    output: Annotated[
        Path | None,
        typer.Option(callback=file_named, help="HTML file. Default: RUN.html beside the run file."),
    ] = None,
    shot: Annotated[
        int | None, typer.Option(help="Shot to draw, counted from 1. Default: the one with the largest motion.")
    ] = None,
    gate_profile_step: ProfileStep = None,
    sweep: StoredSweep = None,
    together: Together = False,
) -> None:
    """Write the report of a run. One HTML file with results, figures, residual tests, predictions and provenance."""
    from hpe_rig.report import StoredAxes, write_report

    _refuse_unswept(bool(sweep), together, gate_profile_step)
    axes = None
    if sweep:
        from hpe_rig.runs import parse_axes

        axes = StoredAxes(parse_axes(sweep), together)
    written = write_report(run_file, estimator, output, shot, _step_m(gate_profile_step), axes)
    typer.echo(f"{written}: open it in any browser")


@app.command()
@guarded
def compare(
    first: Annotated[Path, typer.Argument(metavar="A.h5", help="Run file.")],
    second: Annotated[Path, typer.Argument(metavar="B.h5", help="Run file to compare with it.")],
    estimator: Estimator = None,
    figure: Annotated[Path | None, typer.Option(help="Both results and their differences, .svg, .png or .pdf.")] = None,
    json: Json = False,
) -> None:
    """Compare two runs. Settings that differ, results side by side, and how significant each difference is."""
    from hpe_rig.cli.stored import print_comparison

    print_comparison(first, second, estimator, figure, json)


@app.command()
@guarded
def moduli(
    run_files: Annotated[
        list[Path], typer.Argument(metavar="RUN.h5 ...", help="Run files, each of one place or more.")
    ],
    law: Annotated[
        list[str] | None,
        typer.Option(metavar="LAW", help="Medium to try: voigt, zener, power_law, maxwell; repeatable. Default: all."),
    ] = None,
    estimator: Estimator = None,
    width_uncertainty: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Relative uncertainty of the widths of the force.")
    ] = 0.05,
    per_place: Annotated[
        bool, typer.Option("--per-place", help="The force was not the same at all places: every amplitude is free.")
    ] = False,
    gate_profile_step: ProfileStep = None,
    figure: Annotated[
        Path | None,
        typer.Option(callback=file_named, help="Measured and fitted vibrations, .svg, .png or .pdf."),
    ] = None,
    json: Json = False,
) -> None:
    """Fit the shear modulus and viscosity of the medium to the vibrations at all places of one or more runs."""
    from hpe_rig.cli.stored import print_moduli
    from hpe_rig.runs import fit_moduli

    print_moduli(
        fit_moduli(
            *run_files,
            laws=law or (),
            estimator=estimator,
            width_uncertainty=width_uncertainty,
            common_amplitude=not per_place,
            profile_step_m=_step_m(gate_profile_step),
        ),
        figure,
        json,
    )


@app.command()
@guarded
def live(
    run_file: Annotated[
        Path, typer.Argument(metavar="RUN", help="Run file, such as bovine-muscle.h5, or the folder of a queue.")
    ],
    port: Port = 0,
    opened: Open = False,
    attached: Annotated[bool, typer.Option("--attached", hidden=True)] = False,
) -> None:
    """Serve the live page of a run or queue, ongoing or ended. On this machine only; ends with Ctrl-C or Close page."""
    from hpe_rig.store import extra

    with extra("live"):
        from hpe_rig.live import serve_run

    serve_run(run_file, port, attached, opened)


@app.command()
@guarded
def align(
    scene: SceneName,
    bench: BenchPath = None,
    band: Annotated[
        str, typer.Option(metavar="LOW:HIGH", help="Where the echo is to be, in percent of full scale.")
    ] = "10:80",
    port: Port = 0,
    opened: Open = False,
) -> None:
    """Align the focus on a live page, without excitation. Single tracking shots are repeated until stopped."""
    from hpe_rig.measurement import prepare
    from hpe_rig.store import extra

    with extra("live"):
        from hpe_rig.live import align as align_focus, band_percent, without_pushing

    wanted = band_percent(band)
    setup = without_pushing(prepare(scene, bench, refuse=False))
    shots = align_focus(setup, port, partial(_say_page, opened), wanted)
    typer.echo(f"stopped after {shots} single shots; all outputs verified off")


def _say_page(opened: bool, address: str) -> None:
    from hpe_rig.live import open_page

    announce(f"live page: {address}")
    if opened and not open_page(address):
        announce("there is no browser to open here: open the address yourself")


@app.command()
@guarded
def check(
    scene: SceneName,
    bench: BenchPath = None,
    target: Annotated[
        str | None,
        typer.Option(
            help="Wanted uncertainty, such as 20nm. Print the pulse count, pulse rate or SNR that reaches it."
        ),
    ] = None,
    verbose: Annotated[bool, typer.Option("--verbose", help="List the checks that passed as well.")] = False,
) -> None:
    """Say whether a scene can be measured, with timeline, conflicts and expected errors. No instrument is opened."""
    from hpe_rig.cli.terminal import terminal_columns, wrapped
    from hpe_rig.runs import check as check_scene

    checked = check_scene(scene, bench, target)
    columns = terminal_columns()
    typer.echo(wrapped(checked.in_words(columns, verbose), columns))
    if checked.refused:
        raise typer.Exit(EXIT_MISTAKE)


@app.command()
@guarded
def emulate(
    scene: SceneName = "bovine-muscle",
    bench: BenchPath = None,
    transport: Annotated[str, typer.Option(help="One of socket, serial, hislip, vxi11, prologix.")] = "socket",
) -> None:
    """Serve the simulated generators to any VISA program. On loopback; prints the bench file; stop with Ctrl-C."""
    from hpe_rig.bench import emulate as serve
    from hpe_rig.measurement import prepare

    setup = prepare(scene, bench, refuse=False)
    serve(setup.scene.scene, setup.bench, transport, typer.echo)


@app.command()
@guarded
def queue(
    scenes: Annotated[
        list[str] | None,
        typer.Argument(metavar="SCENE ...", help="Scenes or run files in order, or one TOML list: [[run]]."),
    ] = None,
    bench: BenchPath = None,
    output: Annotated[Path | None, typer.Option(help="New folder for the run files. Default: queue, numbered.")] = None,
    resume: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Go on with the queue in FOLDER that was stopped or failed.")
    ] = None,
    stop_on_failure: Annotated[
        bool, typer.Option("--stop-on-failure", help="A run that fails ends the queue. Default: the others go on.")
    ] = False,
    yes: Yes = False,
    live: Live = False,
    port: Port = 0,
    opened: Open = False,
    closes: Close = False,
    verbose: Verbose = False,
) -> None:
    """Measure several scenes one after another. All are checked first; p pauses between two shots, Ctrl-C stops."""
    from hpe_rig.cli.queue import queue_command
    from hpe_rig.cli.watch import page_options

    page = page_options(live, port, opened, closes)
    raise typer.Exit(queue_command(scenes or (), bench, output, resume, stop_on_failure, page, verbose, yes))


@app.command("list")
@guarded
def list_command(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder with run files. Default: this one.")
    ] = Path(),
    find: Annotated[
        list[str] | None,
        typer.Option(metavar="TEXT", help="Only runs with TEXT in file name, title, state or notes; repeatable."),
    ] = None,
    since: Annotated[str | None, typer.Option(metavar="DATE", help="Only runs from this date on.")] = None,
    until: Annotated[str | None, typer.Option(metavar="DATE", help="Only runs up to this date.")] = None,
    below: Annotated[bool, typer.Option("--below", help="Also in the folders below.")] = False,
    json: Json = False,
    csv: Annotated[bool, typer.Option("--csv", help="Print CSV, one row per run, a column per note.")] = False,
) -> None:
    """List the runs in a folder with date, title, result and notes."""
    from hpe_rig.cli.listing import print_runs

    print_runs(folder, below, find or (), since, until, json, csv)


@app.command()
@guarded
def scenes() -> None:
    """List the shipped scenes."""
    from hpe_rig.scene import parse_scene, shipped_scenes

    for name, text in shipped_scenes().items():
        typer.echo(f"{name:26} {parse_scene(name, text).scene.title}")


@app.command()
@guarded
def extensions() -> None:
    """List the estimators, media and importers that other packages bring. Each is loaded and looked at."""
    from hpe_rig.cli.listing import extension_lines

    lines, sound = extension_lines()
    for line in lines:
        typer.echo(line)
    if not sound:
        raise typer.Exit(EXIT_MISTAKE)


@app.command()
@guarded
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the copy. NAME.toml is written to this folder.")],
    like: Annotated[
        str, typer.Option(help="Scene or run file to copy, or 'bench' for a bench file.")
    ] = "bovine-muscle",
    full: Annotated[
        bool, typer.Option("--full", help="With every key there is in a comment: meaning, unit, bounds, default.")
    ] = False,
) -> None:
    """Copy a shipped scene, the scene of a run file or a bench file, to edit."""
    from hpe_rig.bench import read_bench, titled
    from hpe_rig.measurement import source_text

    path = Path(name if name.endswith(".toml") else f"{name}.toml")
    text = titled(read_bench().text, f"Bench {path.stem}") if like == "bench" else source_text(like)[1]
    if full:
        from hpe_rig.runs import full_text

        text = full_text("bench" if like == "bench" else "scene", text)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except (OSError, ValueError) as error:
        # A name that no file can have is an error of values.
        taken = isinstance(error, FileExistsError)
        why = getattr(error, "strerror", None) or error
        why = "already exists and is not overwritten" if taken else f"cannot be written ({why})"
        announce(f"hpe-rig: {path} {why}. Try: another {'name' if taken else 'folder'}.")
        raise typer.Exit(EXIT_MISTAKE) from None
    then = f"pass --bench {path}" if like == "bench" else f"run hpe-rig check {path}"
    typer.echo(f"{path}: edit it, then {then}")


@app.command()
@guarded
def schema(
    of: Annotated[
        str,
        typer.Argument(
            metavar="FILE", help="One of scene, bench, simulation, queue, result, list, verify, moduli, compare."
        ),
    ] = "scene",
) -> None:
    """Print the JSON schema of a settings file, for use in editors, or of what --json prints."""
    import json

    from hpe_rig.report import comparison_schema
    from hpe_rig.runs import json_schema

    typer.echo(json.dumps(json_schema(of, {"compare": comparison_schema}), indent=2))


@app.command("bench")
@guarded
def bench_command(
    bench: Annotated[
        Path | None, typer.Argument(metavar="BENCH", help="Bench file or run file. Default: the simulated bench.")
    ] = None,
    compare: Annotated[Path | None, typer.Option(help="Run file. Print how its bench differs from this one.")] = None,
    self_test: Annotated[
        bool, typer.Option("--self-test", help="Also run each generator's self-test, outputs off.")
    ] = False,
    off: Annotated[
        bool, typer.Option("--off", help="Only switch every output off, whoever uses the bench, and prove it.")
    ] = False,
    wide: Annotated[bool, typer.Option("--wide", help="Print every column.")] = False,
) -> None:
    """Identify every instrument, read its settings, leave outputs off. Or compare with the bench of a run."""
    from hpe_rig.cli.bench import all_off, bench_state, compare_with, print_report
    from hpe_rig.scene import Mistake, SettingsError

    if off:
        if compare is not None or self_test or (bench is not None and bench.suffix == ".h5"):
            what = "it switches the instruments of a bench file off, and does nothing besides"
            raise SettingsError("--off", [Mistake("", what, "hpe-rig bench BENCH.toml --off")])
        raise typer.Exit(all_off(bench))
    if bench is not None and bench.suffix == ".h5" and (self_test or compare is None):
        what = "a run file records a bench but gives no access to its instruments"
        raise SettingsError(bench.name, [Mistake("", what, "a bench file, or --compare RUN.h5 alone")])
    state = bench_state(bench, self_test)
    if state.report is not None:
        print_report(state.report, wide)
    if compare is not None:
        typer.echo(compare_with(compare, state))
    if state.report is not None and not state.report.complete:
        raise typer.Exit(EXIT_INSTRUMENT)


app.add_typer(studies)
commands = app
"""The whole command line, for programs that run or document it."""
