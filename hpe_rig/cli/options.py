"""Arguments and options that several commands share.

A command that takes one of the dataclasses below has one option for each of its fields: ``expand_option_groups``
replaces the parameter in the signature, which typer reads, and combines the values again at a call.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

import typer

from hpe_rig.result import FigureKind


def check_file_name(path: Path | None) -> Path | None:
    """Return ``path``; refuse a path without a name, such as the empty text of an unset variable."""
    if path is not None and not path.name:
        raise typer.BadParameter("no file is named; give a name such as run.h5, or leave the option out")
    return path


def is_figure_name(path: Path) -> bool:
    """Return whether Matplotlib has a format for the ending of ``path``."""
    from matplotlib.backend_bases import FigureCanvasBase

    return path.suffix.lower().removeprefix(".") in FigureCanvasBase.get_supported_filetypes()


def check_figure_name(path: Path | None) -> Path | None:
    """Return ``path``; refuse a figure that cannot be written, before the command computes anything."""
    if path is None or check_file_name(path) is None:
        return None
    from hpe_rig.store import StoreError, refuse_unwritable

    if not is_figure_name(path):
        why = f"Matplotlib has no format {path.suffix!r}"
        raise typer.BadParameter(f"{path} cannot be written ({why}). Try: a name that ends in .svg, .png or .pdf.")
    try:
        refuse_unwritable(path)
    except StoreError as error:
        raise typer.BadParameter(str(error)) from None
    return path


def figure_option(text: str, *names: str) -> Any:
    """Return an option for the file of a figure, with the help ``text``; ``names``: as -o, default the parameter's."""
    help_text = f"{text}, .svg, .png or .pdf."
    return typer.Option(*names, metavar="FILE", callback=check_figure_name, help=help_text)


def output_option(text: str, metavar: str = "FILE") -> Any:
    """Return the option -o, --output, which every command that writes a file has, with the help ``text``."""
    return typer.Option("--output", "-o", metavar=metavar, callback=check_file_name, help=text)


def complete_scene(incomplete: str) -> list[str]:
    """Return the shipped scenes and the TOML files of this folder with names that begin with ``incomplete``."""
    from hpe_rig.scene import shipped_scenes

    names = [*shipped_scenes(), *(path.name for path in sorted(Path().glob("*.toml")))]
    return [name for name in names if name.startswith(incomplete)]


SceneName = Annotated[
    str, typer.Argument(metavar="SCENE", help="Name of a shipped scene, or a TOML file.", autocompletion=complete_scene)
]
BenchPath = Annotated[
    Path | None, typer.Option("--bench", metavar="BENCH.toml", help="Bench file. Default: the simulated bench.")
]
RunFile = Annotated[Path, typer.Argument(metavar="RUN.h5", help="Run file, such as bovine-muscle.h5.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
Compress = Annotated[bool, typer.Option("--compress", help="Compress the records (needs the extra 'compression').")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace the run file if it exists.")]
ProfileStep = Annotated[
    str | None,
    typer.Option("--gate-profile-step", metavar="LENGTH", help="Add gates over depth with this step, such as 0.5mm."),
]
Estimator = Annotated[
    str | None, typer.Option(metavar="NAME", help="Motion estimator, as in [processing]. Default: the scene's.")
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Value instead of the scene's, by its full key; repeatable."),
]
Open = Annotated[bool, typer.Option("--open", help="Open the live page in the browser.")]
Port = Annotated[
    int, typer.Option(min=0, max=65535, metavar="PORT", help="Local port of the live page. 0: any free port.")
]


RunsFigureKind = Literal[FigureKind, "moduli", "dispersion"]
"""Content of a figure of stored runs; the last two are fits to several runs."""


def refuse_two_formats(json: bool, csv: bool) -> None:
    """Raise ``SettingsError`` if both formats are requested: only one can be printed."""
    from hpe_rig.scene import Mistake, SettingsError

    if json and csv:
        raise SettingsError("command line", [Mistake("--json, --csv", "both formats are requested", "one of them")])


@dataclass(frozen=True, slots=True)
class ResultOptions:
    """Estimator and format of the printed result."""

    estimator: Estimator = None
    json: Json = False
    csv: Annotated[
        bool, typer.Option("--csv", help="Print CSV instead of a table, one row per shot and frequency.")
    ] = False
    wide: Annotated[bool, typer.Option("--wide", help="Print every column, and a table for every shot.")] = False

    def __post_init__(self) -> None:
        """Refuse two formats at once, before anything is measured."""
        refuse_two_formats(self.json, self.csv)


@dataclass(frozen=True, slots=True)
class SceneOptions:
    """Bench and changes of the scene to be measured."""

    bench: BenchPath = None
    settings: Settings = None
    control: Annotated[
        bool, typer.Option("--control", help="Repeat each shot with tonebursts off, and subtract that motion.")
    ] = False

    @property
    def changes(self) -> dict[str, Any]:
        """Values that replace those of the scene, by their key."""
        from hpe_rig.scene import parse_settings

        return parse_settings(self.settings or ()) | ({"acquisition.control": True} if self.control else {})


@dataclass(frozen=True, slots=True)
class WatchOptions:
    """Log, confirmations and live page of a run."""

    yes: Annotated[
        bool, typer.Option("--yes", help="Announce each movement of the transducer, and continue without confirmation.")
    ] = False
    live: Annotated[
        bool, typer.Option("--live", help="Serve a live page with a stop button (needs the extra 'live').")
    ] = False
    port: Port = 0
    open: Open = False
    close: Annotated[
        bool, typer.Option("--close", help="Close the live page with the run. Default: it stays until closed.")
    ] = False
    verbose: Annotated[bool, typer.Option("--verbose", help="Log every step to RUN.log beside the run file.")] = False

    @property
    def has_page(self) -> bool:
        """Whether a live page is served: each of its options implies it."""
        return self.live or self.port > 0 or self.open or self.close


@dataclass(frozen=True, slots=True)
class SweepOptions:
    """Processing of a stored run with other settings, at several values, or at gates over depth."""

    settings: Settings = None
    gate_profile_step: ProfileStep = None
    sweep: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=V,V",
            help="Estimate at each value of a number of [processing], [beams] or the gate. Writes no result file.",
        ),
    ] = None
    together: Annotated[
        bool, typer.Option("--together", help="Several --sweep: combine their first values, their second ones, ...")
    ] = False

    @property
    def changes(self) -> dict[str, Any]:
        """Values that replace those of the scene, by their key."""
        from hpe_rig.scene import parse_settings

        return parse_settings(self.settings or ())


@dataclass(frozen=True, slots=True)
class RecordingOptions:
    """Settings of a recording of another program."""

    lines: Annotated[
        str | None,
        typer.Option(metavar="LINES", help="Of several lines: 12, 10-20 or all, one result each, or mean, mean:10-20."),
    ] = None
    setting: Annotated[
        list[str] | None,
        typer.Option(
            "--set", "-s", metavar="KEY=VALUE", help="Of the recording, such as axes=line,pulse,sample; repeatable."
        ),
    ] = None
    sidecar: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="TOML file about the recording. Default: RECORDING.toml, if any."),
    ] = None


@dataclass(frozen=True, slots=True)
class SchedulerOptions:
    """Processes on this machine, or a Dask scheduler."""

    workers: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Number of processes. Default: the number of cores.")
    ] = None
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Dask scheduler: tls://HOST:8786, or tcp:// in a trusted network, or local."
        ),
    ] = None
    tls_ca: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Authority of the scheduler's certificate, a PEM file.")
    ] = None
    tls_cert: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Client certificate for the scheduler, a PEM file.")
    ] = None
    tls_key: Annotated[Path | None, typer.Option(metavar="FILE", help="Key of that certificate, a PEM file.")] = None


def expand_option_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Return ``command`` with every parameter that is a dataclass replaced by one parameter for each field."""
    hints = get_type_hints(command, include_extras=True)
    parameters, groups = list[inspect.Parameter](), dict[str, Any]()
    for parameter in inspect.signature(command).parameters.values():
        kind = hints.get(parameter.name)
        if is_dataclass(kind):
            groups[parameter.name] = kind
            parameters += _field_parameters(kind)
        else:
            # Keyword-only, since fields with and without defaults alternate.
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=kind))

    @functools.wraps(command)
    def expanded(**values: Any) -> None:
        for name, kind in groups.items():
            values[name] = kind(**{field.name: values.pop(field.name) for field in fields(kind)})
        command(**values)

    # Typer reads names, defaults and help texts from the signature, and types from the annotations.
    signature: Any = expanded
    signature.__signature__ = inspect.Signature(parameters)
    expanded.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return expanded


def _field_parameters(kind: Any) -> list[inspect.Parameter]:
    hints = get_type_hints(kind, include_extras=True)
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if field.default is MISSING else field.default,
            annotation=hints[field.name],
        )
        for field in fields(kind)
    ]
