"""Commands that study scenes and estimators by simulation: ``accuracy``, ``design``, ``study``."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer

from hpe_rig.cli.console import announce, guarded
from hpe_rig.cli.options import BenchPath, Json, SceneName, SchedulerOptions, output_option

studies = typer.Typer()


@dataclass(frozen=True, slots=True)
class AccuracyOptions:
    """Sizes and draws of the accuracy studies (None: the default of ``hpe_rig.validation.Effort``), or a scene."""

    largest: Annotated[
        int | None,
        typer.Option(min=100, metavar="N", help="Largest number of scatterers. Default: 100000, with --full 1000000."),
    ] = None
    most_echoes: Annotated[
        int | None,
        typer.Option(min=10, metavar="N", help="Largest number of echoes. Default: 1000, with --full 10000."),
    ] = None
    longest_s: Annotated[
        float | None,
        typer.Option(
            min=0.001, metavar="SECONDS", help="Skip cases expected to take longer, in s. Default: 0.5, with --full 5."
        ),
    ] = None
    draws: Annotated[
        int | None,
        typer.Option(
            min=2,
            metavar="N",
            help="Draws per case in motion; ten times as many end to end. Default: 10, with --full 100.",
        ),
    ] = None
    scene: Annotated[
        str | None,
        typer.Option(
            metavar="SCENE", help="Measure the effect of estimator, fit, gate and field settings on this scene."
        ),
    ] = None
    bench: BenchPath = None
    seeds: Annotated[
        int | None, typer.Option(min=2, metavar="N", help="Draws of scatterers and noise with --scene.")
    ] = None
    quick: Annotated[bool, typer.Option("--quick", help="With --scene: fewer seeds, within a minute.")] = False


@studies.command()
@guarded
def accuracy(
    options: AccuracyOptions,
    part: Annotated[
        str | None,
        typer.Argument(
            metavar="PART", help="One of echo, specimen, chain, motion, harmonic. Default: one report of all."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        output_option("Table, .csv or .json. Default: printed. Without PART: the report, default accuracy.html."),
    ] = None,
    figure: Annotated[
        # Not checked by itself: all mistakes of the command are reported at once.
        Path | None,
        typer.Option(metavar="FILE", help="Work-precision figure, .svg, .png or .pdf."),
    ] = None,
    full: Annotated[
        bool, typer.Option("--full", help="All sizes and draws, which take minutes instead of one minute.")
    ] = False,
) -> None:
    """Measure error against run time. Of the simulated physics, of the estimators, end to end, or on a scene."""
    from dataclasses import replace

    from hpe_rig.cli.terminal import progress_reporter
    from hpe_rig.validation import FULL, Effort, write_accuracy, write_accuracy_report, write_own_scene

    if options.scene is not None:
        _refuse_part(part)
        scene, bench, seeds, quick = options.scene, options.bench, options.seeds, options.quick
        write_own_scene(scene, bench, seeds, quick, output, figure, typer.echo, announce)
        return
    # Options that are not given keep the default of the effort.
    sizes = {name: getattr(options, name) for name in ("largest", "most_echoes", "longest_s", "draws")}
    stated = {name: value for name, value in sizes.items() if value is not None}
    efforts = replace(FULL if full else Effort(), **stated)
    if part is None:
        with progress_reporter("accuracy") as report:
            write_accuracy_report(output or Path("accuracy.html"), figure, efforts, announce, report)
    else:
        write_accuracy(part, output, figure, efforts, typer.echo)


def _refuse_part(part: str | None) -> None:
    from hpe_rig.scene import Mistake, SettingsError

    if part is not None:
        raise SettingsError("command line", [Mistake("PART", f"{part} is not studied on a scene", "--scene alone")])


@dataclass(frozen=True, slots=True)
class GoalOptions:
    """Variables, goal and limits of a design."""

    over: Annotated[str, typer.Option(metavar="KEY,KEY", help="Keys to vary, such as pulse_rate_hz,gate_length_m.")]
    minimise: Annotated[
        str,
        typer.Option(
            metavar="GOAL",
            help="One of jitter, bias (both relative to the amplitude), phase-jitter, time, modulus-uncertainty.",
        ),
    ] = "jitter"
    bound: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=LOW:HIGH", help="Limits of a key; repeatable. Default: the limits that scene and bench imply."
        ),
    ] = None
    longest_s: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Longest measurement, in s. Default: 1 % more than the scene's duration."),
    ] = None
    target: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Largest jitter of noise and speckle combined, such as 20nm.")
    ] = None


@studies.command()
@guarded
def design(
    scene: SceneName,
    goal: GoalOptions,
    bench: BenchPath = None,
    draws: Annotated[
        int, typer.Option(metavar="N", help="Monte Carlo draws of scatterers and noise that check the model. 0: none.")
    ] = 200,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of the search and the draws.")] = 0,
    output: Annotated[Path | None, output_option("New scene file, .toml. Default: none.")] = None,
    report: Annotated[
        bool,
        typer.Option("--report", help="Write a page, SCENE-design.html: before and after, the goal over each key."),
    ] = False,
    json: Json = False,
) -> None:
    """Optimise a scene within limits. By the analytic model, checked by Monte Carlo; no instrument is opened."""
    from hpe_rig.cli.terminal import progress_reporter
    from hpe_rig.design import Request, write_design

    request = Request(
        scene=scene,
        over=goal.over,
        minimise=goal.minimise,
        bench=bench,
        bounds=tuple(goal.bound or ()),
        longest_s=goal.longest_s,
        target=goal.target,
        draws=draws,
        seed=seed,
        output=output,
        report=report,
        json=json,
    )
    with progress_reporter("design") as report_progress:
        write_design(request, typer.echo, announce, report_progress)


@dataclass(frozen=True, slots=True)
class SizeOptions:
    """Settings that replace those of the study."""

    points: Annotated[
        int | None, typer.Option(metavar="N", help="Number of values in every range; 101 gives the finest maps.")
    ] = None
    scatterers: Annotated[
        int | None,
        typer.Option(
            "--draws", "--scatterers", metavar="N", help="Draws of scatterers per case. Default: the study's."
        ),
    ] = None
    noise: Annotated[int | None, typer.Option(metavar="N", help="Draws of noise per draw of scatterers.")] = None
    seed: Annotated[int | None, typer.Option(metavar="N", help="Seed of the random numbers.")] = None


@studies.command()
@guarded
def study(
    name: Annotated[
        str,
        typer.Argument(
            metavar="STUDY", help="One of fig-4 to fig-13, paper (all of them), reproduction, or a TOML file."
        ),
    ],
    scheduling: SchedulerOptions,
    size: SizeOptions,
    output: Annotated[
        Path, output_option("Folder of the results. Cases finished there are not repeated.", "FOLDER")
    ] = Path("studies"),
    report: Annotated[
        bool, typer.Option("--report", help="Write STUDY.html, and every figure as SVG and PNG.")
    ] = False,
    json: Json = False,
) -> None:
    """Run a Monte Carlo parameter study. Bias and jitter of amplitude and phase, each with its standard error."""
    from hpe_rig.cli.study import run_and_print
    from hpe_rig.store import extra

    with extra("cluster"):
        run_and_print(name, output, scheduling, asdict(size), report=report, json=json)
