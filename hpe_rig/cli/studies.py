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
        typer.Argument(help="echo, specimen, chain, motion or harmonic; absent: one report of all."),
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
    over: Annotated[str, typer.Option(help="Keys that may change, such as pulse_rate_hz,gate_length_m.")],
    minimise: Annotated[str, typer.Option(help="jitter or bias (over the amplitude), phase-jitter, time.")] = "jitter",
    bench: BenchPath = None,
    bound: Annotated[list[str] | None, typer.Option(help="key=low:high; absent: what scene and bench imply.")] = None,
    longest_s: Annotated[float | None, typer.Option(help="Most time, s; absent: the scene's own and 1 %.")] = None,
    target: Annotated[str | None, typer.Option(help="Jitter, noise and speckle, to keep, such as 20nm.")] = None,
    draws: Annotated[int, typer.Option(help="Scatterer and noise draws that check the model; 0: none.")] = 200,
    seed: Annotated[int, typer.Option(help="Seed of search and draws.")] = 0,
    output: Annotated[Path | None, typer.Option(help="New scene file, .toml; absent: none is written.")] = None,
) -> None:
    """Find the best scene within limits by the analytic model, and check the model by Monte Carlo. Opens nothing."""
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
    from hpe_rig.cli.study import study_command
    from hpe_rig.store import extra

    replaced = {"points": points, "scatterers": scatterers, "noise": noise, "seed": seed}
    with extra("cluster"):
        study_command(name, output, workers, scheduler, replaced, typer.echo, report)
