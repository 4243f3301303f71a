"""Commands of ``hpe-rig`` that study scenes and estimators instead of measuring."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hpe_rig.cli.console import BenchPath, SceneName, announce, guarded

studies = typer.Typer()


@studies.command()
@guarded
def accuracy(
    part: Annotated[
        str | None,
        typer.Argument(metavar="PART", help="echo, specimen, chain, motion or harmonic; default: one report of all."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(help="Table, .csv or .json (default: printed); of all parts the report (default: accuracy.html)."),
    ] = None,
    figure: Annotated[Path | None, typer.Option(help="Work-precision figure: .svg, .png or .pdf.")] = None,
    largest: Annotated[int, typer.Option(help="Largest number of scatterers.")] = 1_000_000,
    most_echoes: Annotated[int, typer.Option(help="Largest number of echoes.")] = 10_000,
    longest_s: Annotated[float, typer.Option(help="Skip cases expected to take longer than this (s).")] = 5.0,
    draws: Annotated[int, typer.Option(min=2, help="Draws per case of motion; ten times as many end to end.")] = 100,
) -> None:
    """Measure error against run time: of the twin's physics, of the estimators, and end to end."""
    from hpe_rig.validation import Effort, write_accuracy, write_accuracy_report

    effort = Effort(largest, most_echoes, longest_s, draws)
    if part is None:
        write_accuracy_report(output or Path("accuracy.html"), figure, effort, announce)
    else:
        write_accuracy(part, output, figure, effort, typer.echo)


@studies.command()
@guarded
def design(
    scene: SceneName,
    over: Annotated[str, typer.Option(help="Keys to vary, such as pulse_rate_hz,gate_length_m.")],
    minimise: Annotated[
        str, typer.Option(help="jitter or bias (relative to the amplitude), phase-jitter or time.")
    ] = "jitter",
    bench: BenchPath = None,
    bound: Annotated[list[str] | None, typer.Option(help="key=low:high; default: what scene and bench imply.")] = None,
    longest_s: Annotated[
        float | None, typer.Option(help="Longest measurement time (s); default: the scene's own plus 1 %.")
    ] = None,
    target: Annotated[
        str | None, typer.Option(help="Jitter from noise and speckle not to exceed, such as 20nm.")
    ] = None,
    draws: Annotated[int, typer.Option(help="Draws of scatterers and noise that check the model; 0: none.")] = 200,
    seed: Annotated[int, typer.Option(help="Seed of the search and the draws.")] = 0,
    output: Annotated[Path | None, typer.Option(help="New scene file, .toml; default: none is written.")] = None,
) -> None:
    """Find the best scene within limits by the analytic model, checked by Monte Carlo. Opens no instrument."""
    from hpe_rig.design import Request, write_design

    bounds = tuple(bound or ())
    request = Request(scene, over, minimise, bench, bounds, longest_s, target, draws, seed, output)
    write_design(request, typer.echo, announce)


@studies.command()
@guarded
def study(
    name: Annotated[
        str, typer.Argument(metavar="STUDY", help="fig-4 to fig-13, paper (these), reproduction, or a TOML.")
    ],
    output: Annotated[Path, typer.Option(help="Folder of results; cases finished there are not repeated.")] = Path(
        "studies"
    ),
    workers: Annotated[int | None, typer.Option(min=1, help="Number of processes; default: one per core.")] = None,
    scheduler: Annotated[str | None, typer.Option(help="dask: tcp://HOST:8786, or local (extra cluster).")] = None,
    points: Annotated[
        int | None, typer.Option(help="Number of values of every range; 101 for the finest maps.")
    ] = None,
    scatterers: Annotated[int | None, typer.Option(help="Draws of scatterers per case.")] = None,
    noise: Annotated[int | None, typer.Option(help="Draws of noise per draw of scatterers.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of every random number.")] = None,
    report: Annotated[bool, typer.Option("--report", help="Write STUDY.html and every figure as SVG and PNG.")] = False,
) -> None:
    """Run a Monte Carlo parameter study: bias and jitter of amplitude and phase, with standard errors."""
    from hpe_rig.cli.study import study_command
    from hpe_rig.store import extra

    replaced = {"points": points, "scatterers": scatterers, "noise": noise, "seed": seed}
    with extra("cluster"):
        study_command(name, output, workers, scheduler, replaced, typer.echo, report)
