"""The commands of ``hpe-rig``; each imports what it needs when it is called, so that ``--help`` stays light."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from hpe_rig.cli.console import (
    EXIT_INSTRUMENT,
    EXIT_MISTAKE,
    BenchPath,
    SceneName,
    announce,
    guarded,
    progress,
    show,
)
from hpe_rig.cli.studies import studies
from hpe_rig.result import Stages

app = typer.Typer(
    help="Measure harmonic motion with pulsed ultrasound excitation, on the bench or on its twin.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
Csv = Annotated[bool, typer.Option("--csv", help="Print CSV, a row a shot and frequency, instead of a table.")]
Compress = Annotated[bool, typer.Option("--compress", help="Compress the records (extra: compression).")]
Estimator = Annotated[str | None, typer.Option(help="Motion estimator, as in [processing]; absent: as the scene says.")]
Live = Annotated[bool, typer.Option("--live", help="Show a live page with a stop button (extra live).")]
Verbose = Annotated[bool, typer.Option("--verbose", help="Log every step to a file beside the run file.")]
Port = Annotated[int, typer.Option(min=0, max=65535, help="Port of the live page on this machine; 0: any free one.")]


def main() -> None:
    """Run the command line."""
    for library in ("OMP", "OPENBLAS", "MKL"):
        # The matrices are small: threads of the algebra library wait for one another longer than they work.
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A title the console's code page lacks must not cost a measurement.
            stream.reconfigure(errors="replace")
    app()


@app.command()
@guarded
def run(
    scene: SceneName,
    bench: BenchPath = None,
    output: Annotated[Path | None, typer.Option(help="Run file; absent: SCENE.h5 here, numbered if taken.")] = None,
    estimator: Estimator = None,
    json: Json = False,
    csv: Csv = False,
    compress: Compress = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the run file if it exists.")] = False,
    live: Live = False,
    verbose: Verbose = False,
) -> None:
    """Plan, acquire, store, estimate: one measurement from the scene to the table."""
    stages = Stages()
    with stages("load"):
        from hpe_rig.acquire import chosen_estimator, prepare, process, record_run
        from hpe_rig.cli.watch import watched
        from hpe_rig.processing import estimate_run  # noqa: F401, needed at the end
        from hpe_rig.store import WriteOptions, free_path

    setup = prepare(scene, bench, stages)
    chosen_estimator(estimator, setup.scene.scene)
    path = output or free_path(setup.scene.name, Path())
    with watched(setup, path, live, verbose, announce) as watching:
        with progress(setup, quiet=json or csv) as observer:
            record_run(setup, path, watching(observer), stages, WriteOptions(compress, overwrite))
        show(process(path, estimator, stages), json, csv)


@app.command()
@guarded
def resume(
    run_file: Path,
    scene: Annotated[str | None, typer.Option(help="Scene to compare with; absent: the run's own.")] = None,
    bench: BenchPath = None,
    output: Annotated[Path | None, typer.Option(help="Run file; absent: beside the first, numbered.")] = None,
    estimator: Estimator = None,
    json: Json = False,
    csv: Csv = False,
    compress: Compress = False,
    live: Live = False,
    verbose: Verbose = False,
) -> None:
    """Go on with a run that stopped: take its complete shots over into a new file, measure the others."""
    stages = Stages()
    with stages("load"):
        from hpe_rig.acquire import prepare_rest, process, resume as resume_run
        from hpe_rig.cli.watch import watched
        from hpe_rig.processing import estimate_run  # noqa: F401, needed at the end
        from hpe_rig.store import free_path

    rest = prepare_rest(run_file, scene, bench, stages)
    announce(f"{rest.complete} of {len(rest.setup.plan.shots)} shots are complete")
    path = output or free_path(run_file.stem, run_file.parent)
    with watched(rest.setup, path, live, verbose, announce) as watching:
        with progress(rest.setup, quiet=json or csv) as observer:
            resume_run(rest, path, watching(observer), stages, compress)
        show(process(path, estimator, stages), json, csv)


@app.command()
@guarded
def process(run_file: Path, estimator: Estimator = None, json: Json = False, csv: Csv = False) -> None:
    """Estimate again from a stored run, also with another estimator."""
    from hpe_rig.acquire import process as process_run

    show(process_run(run_file, estimator, Stages()), json, csv)


@app.command()
@guarded
def report(
    run_file: Path,
    estimator: Estimator = None,
    output: Annotated[Path | None, typer.Option(help="HTML file; absent: RUN.html beside the run file.")] = None,
    shot: Annotated[int | None, typer.Option(help="Shot to draw, from 1; absent: the one that moves most.")] = None,
) -> None:
    """Write one self-contained HTML page: what was measured, figures, tests, uncertainties, provenance."""
    from hpe_rig.report import write_report

    typer.echo(f"{write_report(run_file, estimator, output, shot)}: open it in any browser")


@app.command()
@guarded
def live(
    run_file: Path,
    port: Port = 0,
    attached: Annotated[bool, typer.Option("--attached", hidden=True)] = False,
) -> None:
    """Serve the live page of a run that another process writes, on this machine only; Ctrl-C ends it."""
    from hpe_rig.store import extra

    with extra("live"):
        from hpe_rig.live import serve_run

    serve_run(run_file, port, attached)


@app.command()
@guarded
def align(scene: SceneName, bench: BenchPath = None, port: Port = 0) -> None:
    """Repeat single tracking shots without pushing, for aligning the focus on a live page, until stopped."""
    from hpe_rig.acquire import prepare
    from hpe_rig.store import extra

    with extra("live"):
        from hpe_rig.live import align as align_focus, without_pushing

    setup = without_pushing(prepare(scene, bench, refuse=False))
    shots = align_focus(setup, port, announce)
    typer.echo(f"stopped after {shots} single shots: every output is off, verified")


@app.command()
@guarded
def check(
    scene: SceneName,
    bench: BenchPath = None,
    target: Annotated[
        str | None, typer.Option(help="Wanted uncertainty, such as 20nm: prints what reaches it.")
    ] = None,
) -> None:
    """Print the plan: timeline, checks, what is left out, duration, file size, bias and jitter. Opens nothing."""
    from hpe_rig.acquire import check as check_scene

    checked = check_scene(scene, bench, target)
    typer.echo(checked)
    if checked.refused:
        raise typer.Exit(EXIT_MISTAKE)


@app.command()
@guarded
def emulate(
    scene: SceneName = "bovine-muscle",
    bench: BenchPath = None,
    transport: Annotated[str, typer.Option(help="socket, serial, hislip, vxi11 or prologix")] = "socket",
) -> None:
    """Serve the simulated generators on loopback to any VISA program, print the bench file, end on Ctrl-C."""
    from hpe_rig.acquire import prepare
    from hpe_rig.bench import emulate as serve

    setup = prepare(scene, bench, refuse=False)
    serve(setup.scene.scene, setup.bench, transport, typer.echo)


@app.command()
@guarded
def scenes() -> None:
    """List the shipped scenes."""
    from hpe_rig.scene import parse_scene, shipped_scenes

    for name, text in shipped_scenes().items():
        typer.echo(f"{name:26} {parse_scene(name, text).scene.title}")


@app.command()
@guarded
def new(
    name: Annotated[str, typer.Argument(help="The new scene's name; NAME.toml is written here.")],
    like: Annotated[str, typer.Option(help="The scene to start from.")] = "bovine-muscle",
) -> None:
    """Copy a shipped scene, or the simulated bench file with --like bench, to a file of your own."""
    from hpe_rig.bench import read_bench
    from hpe_rig.scene import scene_text

    text = read_bench().text if like == "bench" else scene_text(like)[1]
    path = Path(name if name.endswith(".toml") else f"{name}.toml")
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        typer.echo(f"{path} exists and is never overwritten. Try: another name.", err=True)
        raise typer.Exit(EXIT_MISTAKE) from None
    except OSError as error:
        typer.echo(f"{path} cannot be written ({error.strerror}). Try: another folder.", err=True)
        raise typer.Exit(EXIT_MISTAKE) from None
    typer.echo(
        f"{path}: edit it, then hpe-rig check {path}" if like != "bench" else f"{path}: edit it, then --bench {path}"
    )


@app.command()
@guarded
def schema(
    of: Annotated[str, typer.Argument(help="scene, bench or simulation")] = "scene",
) -> None:
    """Print the JSON schema of a scene, a bench file or the [simulation] section, for editors."""
    import json

    from hpe_rig.acquire import json_schema

    typer.echo(json.dumps(json_schema(of), indent=2))


@app.command("bench")
@guarded
def bench_command(
    bench: Annotated[Path | None, typer.Argument(help="Bench file or run file; absent: the simulated bench.")] = None,
    compare: Annotated[Path | None, typer.Option(help="Run file: print what differs from its bench.")] = None,
    self_test: Annotated[
        bool, typer.Option("--self-test", help="Have every generator test itself too, with all outputs off.")
    ] = False,
) -> None:
    """Ask every instrument who it is and how it is set, or compare a bench or run with another run; all stays safe."""
    from hpe_rig.cli.bench import bench_state, compare_with, print_report
    from hpe_rig.scene import Mistake, SettingsError

    if bench is not None and bench.suffix == ".h5" and (self_test or compare is None):
        what = "a run file only remembers a bench: no instrument can be asked or tested"
        raise SettingsError(bench.name, [Mistake("", what, "a bench file, or --compare RUN.h5 alone")])
    state = bench_state(bench, self_test)
    if state.report is not None:
        print_report(state.report)
    if compare is not None:
        typer.echo(compare_with(compare, state))
    if state.report is not None and not state.report.complete:
        raise typer.Exit(EXIT_INSTRUMENT)


app.add_typer(studies)
