"""Commands that study scenes and estimators by simulation: ``accuracy``, ``design``, ``study``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hpe_rig.cli.console import BenchPath, SceneName, announce, file_named, guarded

studies = typer.Typer()


@studies.command()
@guarded
def accuracy(
    part: Annotated[
        str | None,
        typer.Argument(
            metavar="PART", help="One of echo, specimen, chain, motion, harmonic. Default: one report of all."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(help="Table, .csv or .json. Default: printed. Without PART: the report, default accuracy.html."),
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(callback=file_named, help="Work-precision figure, .svg, .png or .pdf."),
    ] = None,
    largest: Annotated[
        int | None, typer.Option(help="Largest number of scatterers. Default: 100000, with --full 1000000.")
    ] = None,
    most_echoes: Annotated[
        int | None, typer.Option(help="Largest number of echoes. Default: 1000, with --full 10000.")
    ] = None,
    longest_s: Annotated[
        float | None, typer.Option(help="Skip cases expected to take longer, in s. Default: 0.5, with --full 5.")
    ] = None,
    draws: Annotated[
        int | None,
        typer.Option(
            min=2, help="Draws per case in motion; ten times as many end to end. Default: 10, with --full 100."
        ),
    ] = None,
    full: Annotated[bool, typer.Option("--full", help="Every size and all draws: minutes instead of one.")] = False,
    scene: Annotated[
        str | None,
        typer.Option(metavar="SCENE", help="Measure on this scene what it leaves open: estimator, fit, gate, field."),
    ] = None,
    bench: BenchPath = None,
    seeds: Annotated[int | None, typer.Option(min=2, help="Draws of scatterers and noise with --scene.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="With --scene: within a minute, by fewer seeds.")] = False,
) -> None:
    """Measure error against run time. Of the simulated physics, of the estimators, end to end, or on a scene."""
    from dataclasses import replace

    from hpe_rig.cli.terminal import told
    from hpe_rig.validation import FULL, Effort, write_accuracy, write_accuracy_report, write_own_scene

    if scene is not None:
        _refuse_part(part)
        write_own_scene(scene, bench, seeds, quick, output, figure, typer.echo, announce)
        return
    asked = {"largest": largest, "most_echoes": most_echoes, "longest_s": longest_s, "draws": draws}
    stated = {name: value for name, value in asked.items() if value is not None}
    effort = replace(FULL if full else Effort(), **stated)  # type: ignore[arg-type]
    if part is None:
        with told("accuracy") as step:
            write_accuracy_report(output or Path("accuracy.html"), figure, effort, announce, step)
    else:
        write_accuracy(part, output, figure, effort, typer.echo)


def _refuse_part(part: str | None) -> None:
    from hpe_rig.scene import Mistake, SettingsError

    if part is not None:
        raise SettingsError("command line", [Mistake("PART", f"{part} is not studied on a scene", "--scene alone")])


@studies.command()
@guarded
def design(
    scene: SceneName,
    over: Annotated[str, typer.Option(help="Keys to vary, such as pulse_rate_hz,gate_length_m.")],
    minimise: Annotated[
        str,
        typer.Option(
            help="One of jitter, bias (both relative to the amplitude), phase-jitter, time, modulus-uncertainty."
        ),
    ] = "jitter",
    bench: BenchPath = None,
    bound: Annotated[
        list[str] | None, typer.Option(help="KEY=low:high, repeatable. Default: the limits that scene and bench imply.")
    ] = None,
    longest_s: Annotated[
        float | None, typer.Option(help="Longest measurement, in s. Default: the scene's own duration and 1 %.")
    ] = None,
    target: Annotated[
        str | None, typer.Option(help="Jitter, of noise and speckle together, to stay below, such as 20nm.")
    ] = None,
    draws: Annotated[
        int, typer.Option(help="Monte Carlo draws of scatterers and noise that check the model. 0: none.")
    ] = 200,
    seed: Annotated[int, typer.Option(help="Seed of the search and the draws.")] = 0,
    output: Annotated[
        Path | None,
        typer.Option(callback=file_named, help="New scene file, .toml. Default: none."),
    ] = None,
    report: Annotated[
        bool,
        typer.Option("--report", help="Write a page, SCENE-design.html: before and after, the goal over each key."),
    ] = False,
) -> None:
    """Optimise a scene within limits. By the analytic model, checked by Monte Carlo; no instrument is opened."""
    from hpe_rig.design import Request, write_design

    bounds = tuple(bound or ())
    request = Request(scene, over, minimise, bench, bounds, longest_s, target, draws, seed, output, report)
    write_design(request, typer.echo, announce)


@studies.command()
@guarded
def study(
    name: Annotated[
        str,
        typer.Argument(
            metavar="STUDY", help="One of fig-4 to fig-13, paper (all of them), reproduction, or a TOML file."
        ),
    ],
    output: Annotated[Path, typer.Option(help="Folder of the results. Cases finished there are not repeated.")] = Path(
        "studies"
    ),
    workers: Annotated[
        int | None, typer.Option(min=1, help="Number of processes. Default: the number of cores.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Dask scheduler: tls://HOST:8786, or tcp:// in a trusted network, or local.")
    ] = None,
    tls_ca: Annotated[Path | None, typer.Option(help="Authority of the scheduler's certificate, a PEM file.")] = None,
    tls_cert: Annotated[Path | None, typer.Option(help="Own certificate for the scheduler, a PEM file.")] = None,
    tls_key: Annotated[Path | None, typer.Option(help="Key of that certificate, a PEM file.")] = None,
    points: Annotated[
        int | None, typer.Option(help="Number of values in every range; 101 gives the finest maps.")
    ] = None,
    scatterers: Annotated[int | None, typer.Option(help="Draws of scatterers per case.")] = None,
    noise: Annotated[int | None, typer.Option(help="Draws of noise per draw of scatterers.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the random numbers.")] = None,
    report: Annotated[
        bool, typer.Option("--report", help="Write STUDY.html, and every figure as SVG and PNG.")
    ] = False,
) -> None:
    """Run a Monte Carlo parameter study. Bias and jitter of amplitude and phase, each with its standard error."""
    from hpe_rig.cli.study import study_command
    from hpe_rig.store import extra
    from hpe_rig.study import TlsFiles

    replaced = {"points": points, "scatterers": scatterers, "noise": noise, "seed": seed}
    with extra("cluster"):
        tls = TlsFiles(tls_ca, tls_cert, tls_key)
        study_command(name, output, workers, scheduler, replaced, typer.echo, report, tls)
