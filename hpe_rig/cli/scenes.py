"""Commands on scenes and other settings: ``check``, ``scenes``, ``new``, ``schema``, ``extensions``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hpe_rig.cli.console import EXIT_MISTAKE, guarded, print_json, printing
from hpe_rig.cli.options import BenchPath, Json, SceneName, Settings, output_option

scene_commands = typer.Typer()


@scene_commands.command()
@guarded
@printing
def check(
    scene: SceneName,
    bench: BenchPath = None,
    target: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH",
            help="Wanted uncertainty, such as 20nm. Print the pulse count, pulse rate or SNR that reaches it.",
        ),
    ] = None,
    verbose: Annotated[bool, typer.Option("--verbose", help="List the checks that passed as well.")] = False,
    settings: Settings = None,
    json: Json = False,
) -> None:
    """Say whether a scene can be measured, with timeline, conflicts and expected errors. No instrument is opened."""
    from hpe_rig.cli.terminal import terminal_columns, wrapped
    from hpe_rig.runs import check as check_scene
    from hpe_rig.scene import parse_settings

    checked = check_scene(scene, bench, target, parse_settings(settings or ()))
    columns = terminal_columns()
    if json:
        print_json(checked.as_dict())
    else:
        typer.echo(wrapped(checked.in_words(columns, verbose), columns))
    if checked.refused:
        raise typer.Exit(EXIT_MISTAKE)


@scene_commands.command()
@guarded
@printing
def scenes(json: Json = False) -> None:
    """List the shipped scenes."""
    from hpe_rig.scene import parse_scene, shipped_scenes

    titles = {name: parse_scene(name, text).scene.title for name, text in shipped_scenes().items()}
    if json:
        print_json([{"name": name, "title": title} for name, title in titles.items()])
        return
    for name, title in titles.items():
        typer.echo(f"{name:26} {title}")


@scene_commands.command()
@guarded
def new(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Name of the copy. NAME.toml is written to this folder.")
    ] = None,
    like: Annotated[
        str, typer.Option(metavar="SOURCE", help="Scene or run file to copy, or 'bench' for a bench file.")
    ] = "bovine-muscle",
    full: Annotated[
        bool, typer.Option("--full", help="Add every other key in a comment: meaning, unit, bounds, default.")
    ] = False,
    output: Annotated[Path | None, output_option("File of the copy, instead of NAME.")] = None,
) -> None:
    """Copy a shipped scene, the scene of a run file or a bench file, to edit."""
    from hpe_rig.bench import read_bench
    from hpe_rig.measurement import source_text
    from hpe_rig.scene import Mistake, SettingsError, edited_text
    from hpe_rig.store import write_file

    if (name is None) is (output is None):
        what = "no file is named" if name is None else "two files are named, here and by -o"
        raise SettingsError("command line", [Mistake("NAME", what, "new NAME, or new -o FILE.toml")])
    path = output or Path(f"{(name or '').removesuffix('.toml')}.toml")
    is_bench = like == "bench"
    text = edited_text(read_bench().text, {("title",): f"Bench {path.stem}"}) if is_bench else source_text(like)[1]
    if full:
        from hpe_rig.runs import full_text

        text = full_text("bench" if is_bench else "scene", text)
    write_file(path, text, overwrite=False)
    next_step = f"pass --bench {path}" if is_bench else f"run hpe-rig check {path}"
    typer.echo(f"{path}: edit it, then {next_step}")


@scene_commands.command()
@guarded
@printing
def schema(
    of: Annotated[
        str,
        typer.Argument(
            metavar="FILE",
            help="One of scene, bench, simulation, queue, result, list, verify, moduli, dispersion, compare.",
        ),
    ] = "scene",
) -> None:
    """Print the JSON schema of a settings file, for use in editors, or of the output of --json."""
    from hpe_rig.report import comparison_schema
    from hpe_rig.runs import json_schema

    # The schema of a comparison belongs to the report, which runs does not import.
    print_json(json_schema(of, {"compare": comparison_schema}))


@scene_commands.command()
@guarded
@printing
def extensions(json: Json = False) -> None:
    """List the estimators, media and importers of other packages. Each is loaded and checked."""
    from hpe_rig.cli.listing import extension_lines

    lines, all_load = extension_lines()
    if json:
        print_json({"extensions": lines, "all_load": all_load})
    else:
        typer.echo("\n".join(lines or ["no extension is installed; docs/how-to/extend.md explains how to write one"]))
    if not all_load:
        raise typer.Exit(EXIT_MISTAKE)
