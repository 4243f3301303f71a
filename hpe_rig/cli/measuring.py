"""Commands that measure: ``run``, ``resume``, ``queue``, ``live``, ``align``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from hpe_rig.cli.console import announce, guarded, progress, show
from hpe_rig.cli.options import (
    BenchPath,
    Compress,
    Json,
    Open,
    Overwrite,
    Port,
    ResultOptions,
    RunFile,
    SceneName,
    SceneOptions,
    WatchOptions,
    output_option,
)
from hpe_rig.result import Stages

measuring = typer.Typer()


@measuring.command()
@guarded
def run(
    scene: SceneName,
    result: ResultOptions,
    watch: WatchOptions,
    scene_options: SceneOptions,
    output: Annotated[
        Path | None, output_option("Run file. Default: SCENE.h5 in this folder, numbered if it exists.")
    ] = None,
    compress: Compress = False,
    overwrite: Overwrite = False,
    report: Annotated[bool, typer.Option("--report", help="Write the report too, as hpe-rig report does.")] = False,
) -> None:
    """Measure a scene, from the plan to the printed result. SCENE may be a run file: its scene is measured again."""
    stages = Stages()
    with stages("load"):
        from hpe_rig.cli.watch import after_complete_run, supervise
        from hpe_rig.measurement import prepare, provenance_now, record_run
        from hpe_rig.processing import estimate_run  # noqa: F401, used after the measurement
        from hpe_rig.runs import chosen_estimator, process
        from hpe_rig.store import (
            WriteOptions,
            free_path,
            new_run_id,
            refuse_unwritable,
            result_path,
            results_of_other_runs,
        )

    setup = prepare(scene, scene_options.bench, stages, changes=scene_options.changes)
    estimator = chosen_estimator(result.estimator, setup.scene.scene)
    path, run_id = output or free_path(setup.scene.name, Path()), new_run_id()
    # An unwritable folder is an error before the measurement, not after it.
    refuse_unwritable(result_path(path, estimator))
    options = WriteOptions(compress, overwrite, run_id=run_id, provenance=provenance_now(setup.bench.bench))
    quiet = result.json or result.csv
    with supervise(setup, path, run_id, watch, announce) as (watched, move):
        with progress(setup, quiet) as observer:
            record_run(setup, path, watched(observer), stages, options, move=move)
        with after_complete_run(path):
            show(process(path, result.estimator, stages), result)
            for other in results_of_other_runs(path) if overwrite else ():
                announce(f"{other}: of the run that was replaced, remove it or hpe-rig process {path} --estimator ...")
            if report:
                from hpe_rig.report import write_report

                announce(f"{write_report(path, result.estimator)}: open it in any browser")
            elif not quiet:
                option = f" --estimator {result.estimator}" if result.estimator else ""
                announce(f"figures: hpe-rig report {path}{option}")


@measuring.command()
@guarded
def resume(
    run_file: RunFile,
    result: ResultOptions,
    watch: WatchOptions,
    scene: Annotated[
        str | None,
        typer.Option(metavar="SCENE", help="Scene that must equal the run's. Default: the scene in the run file."),
    ] = None,
    bench: BenchPath = None,
    output: Annotated[Path | None, output_option("New run file. Default: beside the old one, numbered.")] = None,
    compress: Compress = False,
) -> None:
    """Continue a stopped run. Its complete shots are copied to a new file, and the other shots are measured."""
    stages = Stages()
    with stages("load"):
        from hpe_rig.cli.watch import after_complete_run, supervise
        from hpe_rig.measurement import prepare_resumption, provenance_now, resume as resume_run
        from hpe_rig.processing import estimate_run  # noqa: F401, used after the measurement
        from hpe_rig.runs import chosen_estimator, process
        from hpe_rig.store import WriteOptions, free_path, new_run_id, refuse_unwritable, result_path

    resumption = prepare_resumption(run_file, scene, bench, stages)
    setup = resumption.setup
    estimator = chosen_estimator(result.estimator, setup.scene.scene)
    announce(f"{resumption.complete} of {len(setup.plan.shots)} shots are complete")
    path, run_id = output or free_path(run_file.stem, run_file.parent), new_run_id()
    refuse_unwritable(result_path(path, estimator))
    options = WriteOptions(compress, run_id=run_id, provenance=provenance_now(setup.bench.bench))
    with supervise(setup, path, run_id, watch, announce) as (watched, move):
        with progress(setup, quiet=result.json or result.csv) as observer:
            resume_run(resumption, path, watched(observer), stages, options, move=move)
        with after_complete_run(path):
            show(process(path, result.estimator, stages), result)


@measuring.command()
@guarded
def queue(
    watch: WatchOptions,
    scenes: Annotated[
        list[str] | None,
        typer.Argument(metavar="SCENE ...", help="Scenes or run files in order, or one TOML list: [[run]]."),
    ] = None,
    bench: BenchPath = None,
    output: Annotated[
        Path | None, output_option("New folder for the run files. Default: queue, numbered.", "FOLDER")
    ] = None,
    resume: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Continue the queue in FOLDER that was stopped or failed.")
    ] = None,
    stop_on_failure: Annotated[
        bool, typer.Option("--stop-on-failure", help="A failed run ends the queue. Default: the others follow.")
    ] = False,
    json: Json = False,
) -> None:
    """Measure several scenes one after another. All are checked first; p pauses between two shots, Ctrl-C stops."""
    from hpe_rig.cli.queue import continue_queue, measure_queue, start_queue

    if resume is None:
        folder, runs, stop = start_queue(scenes or (), bench, output)
    else:
        folder, runs, stop = continue_queue(resume, is_alone=not (scenes or bench or output))
    raise typer.Exit(measure_queue(folder, runs, stop or stop_on_failure, watch, json))


@measuring.command()
@guarded
def live(
    run_file: Annotated[
        Path, typer.Argument(metavar="RUN.h5", help="Run file, such as bovine-muscle.h5, or the folder of a queue.")
    ],
    port: Port = 0,
    open: Open = False,
    attached: Annotated[bool, typer.Option("--attached", hidden=True)] = False,
) -> None:
    """Serve the live page of a run or queue, running or ended. On this machine only; ends with Ctrl-C or Close page."""
    from hpe_rig.store import extra

    with extra("live"):
        from hpe_rig.live import serve_run

    # ``attached`` is for the page of ``run --live``, which ends with its parent process.
    serve_run(run_file, port, attached, open)


@measuring.command()
@guarded
def align(
    scene: SceneName,
    bench: BenchPath = None,
    band: Annotated[
        str, typer.Option(metavar="LOW:HIGH", help="Wanted level of the echo, in percent of full scale.")
    ] = "10:80",
    port: Port = 0,
    open: Open = False,
) -> None:
    """Align the focus on a live page, without excitation. Single tracking shots are repeated until stopped."""
    from hpe_rig.measurement import prepare
    from hpe_rig.store import extra

    with extra("live"):
        from hpe_rig.live import align as align_focus

    # Conflicts of the tonebursts do not concern the alignment, which omits them.
    setup = prepare(scene, bench, refuse=False)
    shots = align_focus(setup, port, partial(_announce_page, open), band)
    typer.echo(f"stopped after {shots} single shots; all outputs verified off")


def _announce_page(open: bool, address: str) -> None:
    from hpe_rig.live import open_page

    announce(f"live page: {address}")
    if open and not open_page(address):
        announce("no browser can be opened here: open the address yourself")
