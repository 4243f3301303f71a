"""The commands of ``hpe-rig``; each imports what it needs when it is called, so that ``--help`` stays light."""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Annotated

import typer

from hpe_rig.console import EXIT_INSTRUMENT, EXIT_MISTAKE, announce, extra, guarded, progress, scenes_like, show
from hpe_rig.stages import Stages

app = typer.Typer(
    help="Measure harmonic motion with pulsed ultrasound excitation, on the bench or on its twin.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

SceneName = Annotated[
    str,
    typer.Argument(metavar="SCENE", help="A shipped scene's name or a TOML file.", autocompletion=scenes_like),
]
BenchPath = Annotated[Path | None, typer.Option("--bench", help="Bench file; absent: the simulated bench.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
Csv = Annotated[bool, typer.Option("--csv", help="Print CSV, a row a shot and frequency, instead of a table.")]
Compress = Annotated[bool, typer.Option("--compress", help="Compress the records (extra: compression).")]
Estimator = Annotated[str | None, typer.Option(help="Motion estimator, as in [processing]; absent: as the scene says.")]
Live = Annotated[bool, typer.Option("--live", help="Show a live page with a stop button (extra live).")]
Verbose = Annotated[bool, typer.Option("--verbose", help="Log every step to a file beside the run file.")]
Port = Annotated[int, typer.Option(help="Port of the live page on this machine; 0: any free one.")]


def main() -> None:
    """Run the command line."""
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
        import hpe_rig.estimation  # noqa: F401, needed at the end
        from hpe_rig.run import chosen_estimator, measure, prepare, process
        from hpe_rig.run_watch import watched
        from hpe_rig.store import WriteOptions, free_path

    setup = prepare(scene, bench, stages)
    chosen_estimator(estimator, setup.scene.scene)
    path = output or free_path(setup.scene.name, Path())
    with watched(setup, path, live, verbose, announce) as watching:
        with progress(setup, quiet=json or csv) as observer:
            measure(setup, path, watching(observer), stages, WriteOptions(compress, overwrite))
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
        import hpe_rig.estimation  # noqa: F401, needed at the end
        from hpe_rig.resume import prepare_rest
        from hpe_rig.resume import resume as resume_run
        from hpe_rig.run import process
        from hpe_rig.run_watch import watched
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
    from hpe_rig.run import process as process_run

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
    with extra("live"):
        from hpe_rig.live import serve_run

    serve_run(run_file, port, attached)


@app.command()
@guarded
def align(scene: SceneName, bench: BenchPath = None, port: Port = 0) -> None:
    """Repeat single tracking shots without pushing, for aligning the focus on a live page, until stopped."""
    from hpe_rig.run import prepare

    with extra("live"):
        from hpe_rig.live_align import align as align_focus
        from hpe_rig.live_align import without_pushing

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
    from hpe_rig.detection import calibration_text, detection_text
    from hpe_rig.prediction import averaging_text, length_m, prediction_text
    from hpe_rig.run import prepare
    from hpe_rig.timeline import plan_text

    setup = prepare(scene, bench, Stages(), refuse=False)
    target_m = None if target is None else length_m(target, "--target")
    typer.echo(plan_text(setup.scene.scene.title, setup.plan, setup.findings))
    scene_text, simulated = setup.scene.scene, setup.bench.bench.simulated
    foreseen = [*detection_text(scene_text, simulated, setup.plan.shots[0])]
    foreseen += [*calibration_text(scene_text, setup.bench.bench), *averaging_text(scene_text, simulated)]
    typer.echo("\n" + "\n".join([*foreseen, *prediction_text(scene_text, target_m)]))
    if any(finding.level == "refused" for finding in setup.findings):
        raise typer.Exit(EXIT_MISTAKE)


@app.command()
@guarded
def emulate(
    scene: SceneName = "bovine-muscle",
    bench: BenchPath = None,
    transport: Annotated[str, typer.Option(help="socket, serial, hislip, vxi11 or prologix")] = "socket",
) -> None:
    """Serve the simulated generators on loopback to any VISA program, print the bench file, end on Ctrl-C."""
    from hpe_rig.emulate import emulate as serve
    from hpe_rig.run import prepare

    setup = prepare(scene, bench, refuse=False)
    serve(setup.scene.scene, setup.bench, transport, typer.echo)


@app.command()
@guarded
def scenes() -> None:
    """List the shipped scenes."""
    from hpe_rig.scene import parse_scene, shipped_scenes

    for name, text in shipped_scenes().items():
        typer.echo(f"{name:20} {parse_scene(name, text).scene.title}")


@app.command()
@guarded
def new(
    name: Annotated[str, typer.Argument(help="The new scene's name; NAME.toml is written here.")],
    like: Annotated[str, typer.Option(help="The scene to start from.")] = "bovine-muscle",
) -> None:
    """Copy a shipped scene, or the simulated bench file with --like bench, to a file of your own."""
    from hpe_rig.bench_file import read_bench
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

    from hpe_rig.run import json_schema

    typer.echo(json.dumps(json_schema(of), indent=2))


@app.command()
@guarded
def accuracy(
    of: Annotated[
        str | None,
        typer.Argument(metavar="[PART]", help="echo, specimen, chain, motion or harmonic; absent: one report of all."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(help="Table, .csv or .json, absent: printed; of all: the report, absent: accuracy.html."),
    ] = None,
    figure: Annotated[Path | None, typer.Option(help="Work-precision figure, .svg, .png or .pdf.")] = None,
    largest: Annotated[int, typer.Option(help="Most scatterers.")] = 1_000_000,
    most_echoes: Annotated[int, typer.Option(help="Most echoes.")] = 10_000,
    longest_s: Annotated[float, typer.Option(help="Leave out what is expected to take longer, s.")] = 5.0,
    draws: Annotated[int, typer.Option(min=2, help="Draws a case, motion; ten times as many end to end.")] = 100,
) -> None:
    """Measure error against run time of the twin's physics, of the estimators and end to end, every way they can."""
    if of is None:
        from hpe_rig.study.accuracy_report import Effort, write_accuracy_report

        effort = Effort(largest, most_echoes, longest_s, draws)
        write_accuracy_report(output or Path("accuracy.html"), figure, effort, announce)
        return
    if of in ("motion", "harmonic"):
        from hpe_rig.study.estimator_accuracy import write_estimator_accuracy

        write_estimator_accuracy(of, output, figure, draws, typer.echo)
        return
    if of in ("specimen", "chain"):
        from importlib import import_module

        from hpe_rig.study.work_precision import write_points

        points = list(import_module(f"hpe_rig.study.accuracy_{of}").points())
        write_points(points, output, figure, typer.echo)
        return
    if of != "echo":
        typer.echo(f"{of}: no such part. Try: echo, motion, harmonic, specimen or chain.", err=True)
        raise typer.Exit(EXIT_MISTAKE)
    from hpe_rig.study.accuracy_echo import write_accuracy

    write_accuracy(output, figure, largest, most_echoes, longest_s, typer.echo)


@app.command()
@guarded
def design(
    scene: SceneName,
    over: Annotated[str, typer.Option(help="Keys that may change, such as pulse_rate_hz,gate_length_m.")],
    minimise: Annotated[str, typer.Option(help="jitter, phase-jitter, bias (of the amplitude) or time.")] = "jitter",
    bench: BenchPath = None,
    bound: Annotated[list[str] | None, typer.Option(help="key=low:high; absent: what scene and bench imply.")] = None,
    longest_s: Annotated[float | None, typer.Option(help="Most time, s; absent: the scene's own and 1 %.")] = None,
    target: Annotated[str | None, typer.Option(help="Jitter, noise and speckle, to keep, such as 20nm.")] = None,
    draws: Annotated[int, typer.Option(help="Scatterer and noise draws that check the model; 0: none.")] = 200,
    seed: Annotated[int, typer.Option(help="Seed of search and draws.")] = 0,
    output: Annotated[Path | None, typer.Option(help="New scene file, .toml; absent: none is written.")] = None,
) -> None:
    """Find the best scene within limits by the analytic model, and check the model by Monte Carlo. Opens nothing."""
    from hpe_rig.study.design_text import Request, write_design

    bounds = tuple(bound or ())
    request = Request(scene, over, minimise, bench, bounds, longest_s, target, draws, seed, output)
    write_design(request, typer.echo, announce)


@app.command()
@guarded
def study(
    name: Annotated[str, typer.Argument(metavar="STUDY", help="fig-4 to fig-13, paper (all), or a TOML file.")],
    output: Annotated[Path, typer.Option(help="Folder of results; finished cases in it are not repeated.")] = Path(
        "studies"
    ),
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; absent: as many as cores.")] = None,
    scheduler: Annotated[str | None, typer.Option(help="dask: tcp://HOST:8786, or local (extra cluster).")] = None,
    points: Annotated[int | None, typer.Option(help="Values of every range: 101 for the finest maps.")] = None,
    scatterers: Annotated[int | None, typer.Option(help="Draws of scatterers a case.")] = None,
    noise: Annotated[int | None, typer.Option(help="Noise draws for each draw of scatterers.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of every random number.")] = None,
    report: Annotated[bool, typer.Option("--report", help="Write STUDY.html and every figure as SVG and PNG.")] = False,
) -> None:
    """Run a Monte Carlo parameter study: bias and jitter of amplitude and phase, each with its uncertainty."""
    from hpe_rig.study.study_command import study_command

    replaced = {"points": points, "scatterers": scatterers, "noise": noise, "seed": seed}
    with extra("cluster"):
        study_command(name, output, workers, scheduler, replaced, typer.echo, report)


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
    from hpe_rig.bench_report import bench_state, compare_with, print_report

    state = bench_state(bench, self_test)
    if state.report is not None:
        print_report(state.report)
    if compare is not None:
        typer.echo(compare_with(compare, state))
    if state.report is not None and not state.report.complete:
        raise typer.Exit(EXIT_INSTRUMENT)
