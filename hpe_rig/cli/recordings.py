"""Commands on recordings of other programs: ``import``, ``map``, ``export``."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from hpe_rig.cli.console import announce, guarded, print_json
from hpe_rig.cli.options import Compress, Json, Overwrite, RecordingOptions, RunFile, figure_option, output_option

recordings = typer.Typer()

RecordingFiles = Annotated[
    list[Path],
    typer.Argument(
        metavar="RECORDING...",
        help="File of echoes: NPY, NPZ, MATLAB, HDF5, text, oscilloscope, WAV, raw or AlazarTech; or a file per pulse.",
    ),
]
RecordedScene = Annotated[
    str,
    typer.Option(metavar="SCENE", help="Scene: gate, frequencies, beams. The recording replaces its rates and counts."),
]


@recordings.command("import")
@guarded
def import_command(
    recording: RecordingFiles,
    scene: RecordedScene,
    settings: RecordingOptions,
    output: Annotated[Path | None, output_option("Run file. Default: RECORDING.h5 in this folder, numbered.")] = None,
    compress: Compress = False,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Make a run file of echoes that another program recorded. Prints the inferred values."""
    from hpe_rig.runs import import_recording
    from hpe_rig.store import WriteOptions, refuse_output

    if output is not None:
        refuse_output(output, overwrite)
    options = WriteOptions(compress, overwrite)
    path, inferred = import_recording(_source(recording), scene, output, settings.sidecar, _parsed(settings), options)
    if json:
        print_json({"run_file": str(path), "inferred": inferred})
        return
    for text in inferred:
        typer.echo(text)
    typer.echo(f"{path}: hpe-rig process {path} estimates it, hpe-rig report {path} shows it")


@recordings.command("map")
@guarded
def map_command(
    recording: RecordingFiles,
    scene: RecordedScene,
    settings: RecordingOptions,
    output: Annotated[Path | None, output_option("NetCDF file of the map (needs the extra 'frames').")] = None,
    figure: Annotated[Path | None, figure_option("Figure of the map")] = None,
    moduli: Annotated[
        bool, typer.Option("--moduli", help="Also fit the moduli of the medium to the lines at the focus.")
    ] = False,
    json: Json = False,
) -> None:
    """Map amplitude, phase and velocity over lines and depths of a recording. Bad pixels are marked."""
    from hpe_rig.cli.stored import refuse_dataset, write_map
    from hpe_rig.cli.terminal import progress_reporter
    from hpe_rig.runs import fit_map_moduli, map_recording

    refuse_dataset(output)
    with progress_reporter("lines") as report:
        motion_map, inferred = map_recording(
            _source(recording), scene, settings.sidecar, _parsed(settings), lambda done, total: report(done, total, "")
        )
    show = announce if json else typer.echo
    for text in (*inferred, str(motion_map)):
        show(text)
    write_map(motion_map, output, figure)
    fitted = fit_map_moduli(motion_map, scene) if moduli else None
    if json:
        fit = None if fitted is None else fitted.as_dict()
        print_json({**motion_map.summary(), "inferred": inferred, "moduli": fit})
    elif fitted is not None:
        typer.echo(str(fitted))


@recordings.command("export")
@guarded
def export_command(
    run_file: RunFile,
    output: Annotated[Path, output_option("New file: .hdf5 (zea), .uff (USTB) or .mat.")],
    file_format: Annotated[
        Literal["zea", "uff", "mat"] | None, typer.Option("--format", help="Format. Default: by the ending.")
    ] = None,
    shot: Annotated[
        list[int] | None,
        typer.Option(metavar="SHOT", help="Shot to export, counted from 1; repeatable. Default: all good ones."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the output if it exists.")] = False,
    json: Json = False,
) -> None:
    """Write the echoes of a run for zea, USTB or MATLAB, with rates and times; a simulated run with its truth."""
    from hpe_rig.runs import export_run

    shots = None if shot is None else [number - 1 for number in shot]
    texts = export_run(run_file, output, file_format, shots, overwrite=overwrite)
    if json:
        print_json({"file": str(output), "messages": texts})
    for text in () if json else texts:
        typer.echo(text)


def _source(paths: list[Path]) -> Path | tuple[Path, ...]:
    """Return the file, or the files by the numbers in their names: shot_2 before shot_10.

    A pattern that the shell left as it is, as on Windows, is expanded.
    """
    files = [path for name in paths for path in (name.parent.glob(name.name) if "*" in name.name else [name])]
    if not files:
        # The error names the pattern.
        return paths[0]
    files.sort(key=_natural_order)
    return files[0] if len(files) == 1 else tuple(files)


def _natural_order(path: Path) -> list[tuple[bool, int, str]]:
    texts = re.split(r"(\d+)", str(path))
    return [(text.isdigit(), int(text) if text.isdigit() else 0, text) for text in texts]


def _parsed(options: RecordingOptions) -> dict[str, Any]:
    """Return the settings of --set and --lines."""
    from hpe_rig.scene import parse_settings

    return parse_settings(options.setting or []) | ({} if options.lines is None else {"lines": options.lines})
