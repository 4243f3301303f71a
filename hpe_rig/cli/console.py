"""Exit codes, error messages, progress and printed results, the same for every command."""

from __future__ import annotations

import functools
import os
import shlex
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ParamSpec

import typer

if TYPE_CHECKING:
    from hpe_rig.measurement import Observer, Setup
    from hpe_rig.result import Result

P = ParamSpec("P")

EXIT_MISTAKE, EXIT_INSTRUMENT, EXIT_UNSAFE, EXIT_PROGRAM, EXIT_INTERRUPTED = 2, 1, 3, 70, 130
EXIT_SIGNAL = 128
"""Plus the number of the signal, as a shell counts."""
EXIT_DAMAGED, EXIT_NO_CHECKSUMS = 4, 5


def guarded(command: Callable[P, None]) -> Callable[P, None]:
    """Return ``command`` with every failure turned into a message and an exit code, never a traceback.

    What nobody foresaw is an error of the program: its traceback goes to a file that the message names.
    Interrupts that come after the first one wait until the message is out.
    """

    @functools.wraps(command)
    def guard(*args: P.args, **kwargs: P.kwargs) -> None:
        from hpe_rig.bench import interruptible, uninterrupted
        from hpe_rig.scene import printable

        with uninterrupted():
            try:
                with interruptible():
                    command(*args, **kwargs)
            except (typer.Exit, SystemExit):
                raise
            except BaseException as raised:
                error = _interrupt_in(raised) or raised
                failure = _failure(error) or (_unforeseen(error), EXIT_PROGRAM)
                # A terminal that was closed takes no message any more.
                with suppress(OSError):
                    typer.echo(f"hpe-rig: {printable(failure[0])}", err=True)
                raise typer.Exit(failure[1]) from None

    return guard


def _interrupt_in(error: BaseException) -> BaseException | None:
    """Return the interrupt that Python wrapped into ``error``, as it does while it makes a class; None for others."""
    from hpe_rig.bench import INTERRUPTS

    # A package whose import was interrupted says that it is broken: while handling, not because of, the interrupt.
    for cause in (error.__cause__, error.__context__):
        if isinstance(error, RuntimeError | ImportError) and isinstance(cause, INTERRUPTS):
            return cause
    return None


def ignore_interrupts() -> None:
    """Let no signal end the process any more but by itself."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)


def announce(text: str) -> None:
    """Print a message to standard error, which keeps standard output for results."""
    typer.echo(text, err=True)


def print_version(asked: bool) -> None:
    """Print the version of the program and end, where it is ``asked`` for."""
    if asked:
        from importlib.metadata import version

        typer.echo(f"hpe-rig {version('hpe-rig')}")
        raise typer.Exit


def file_named(path: Path | None) -> Path | None:
    """Return ``path``; refuse one without a name, such as the empty text of an unset variable."""
    if path is not None and not path.name:
        raise typer.BadParameter("no file is named; give a name such as run.h5, or leave the option out")
    return path


def scenes_like(incomplete: str) -> list[str]:
    """Return the shipped scenes and TOML files in this folder whose names begin with ``incomplete``."""
    from hpe_rig.scene import shipped_scenes

    names = [*shipped_scenes(), *(path.name for path in sorted(Path().glob("*.toml")))]
    return [name for name in names if name.startswith(incomplete)]


def show(result: Result, json: bool, csv: bool, wide: bool = False) -> None:
    """Print a result as CSV, JSON or a table."""
    if csv:
        from hpe_rig.result import result_csv

        typer.echo(result_csv(result), nl=False)
        return
    if json:
        import json as json_format

        typer.echo(json_format.dumps(result.as_dict(), indent=2))
        return
    from hpe_rig.cli.tables import print_result

    print_result(result, wide)


@contextmanager
def progress(setup: Setup, quiet: bool) -> Iterator[Observer]:
    """Yield an observer that shows progress with the time left: a bar on a terminal, lines elsewhere."""
    from hpe_rig.cli.terminal import told
    from hpe_rig.measurement import Progress

    total = sum(shot.capture.record_count for shot in setup.plan.shots)
    with told("records", quiet) as tell:

        def observe(progress: Progress) -> None:
            done = progress.shot.index * progress.shot.capture.record_count + progress.records
            tell(done, total, f"shot {progress.shot.index + 1}: {progress.step.value}")

        yield observe


def _failure(error: BaseException) -> tuple[str, int] | None:
    """Return message and exit code of an expected failure, None for an error of the program."""
    said = getattr(error, "__notes__", ())
    notes, lines = ("".join(before + note for note in said) for before in ("; ", "\n  "))
    # First of all: where an import was interrupted, what is imported below cannot be.
    if type(error) is KeyboardInterrupt:  # a stop from the page is a kind of it, with words of its own
        return f"interrupted{notes}", EXIT_INTERRUPTED
    from drivers.interfaces import InstrumentError
    from hpe_rig.bench import Terminated, UnsafeBenchError
    from hpe_rig.measurement import StopRequested
    from hpe_rig.plan import PlanError
    from hpe_rig.scene import SettingsError
    from hpe_rig.store import StoreError

    match error:
        case UnsafeBenchError():
            return f"{error}{lines}", EXIT_UNSAFE
        case SettingsError() | PlanError() | StoreError():
            return str(error), EXIT_MISTAKE
        case InstrumentError():
            return f"{error}{lines}", EXIT_INSTRUMENT
        case MemoryError():
            return (
                f"this needs more memory than is available{notes}. Try: fewer pulses, samples or scatterers",
                EXIT_MISTAKE,
            )
        case OSError(filename=str() | bytes() as path, strerror=str() as why):
            return f"{os.fsdecode(path)} cannot be used ({why}){notes}. Try: another path.", EXIT_MISTAKE
        case StopRequested():
            return f"stopped from the live page{notes}", EXIT_INTERRUPTED
        case Terminated():
            return f"ended by {error.name}{notes}", EXIT_SIGNAL + error.number
    return None


def _unforeseen(error: BaseException) -> str:
    """Return the message of an error of the program, its traceback written to a file of its own."""
    what = f"{type(error).__name__}: {error}".partition("\n")[0][:200]
    try:
        options: dict[str, Any] = {"prefix": "hpe-rig-", "suffix": ".txt", "encoding": "utf-8", "errors": "replace"}
        with tempfile.NamedTemporaryFile("w", delete=False, **options) as file:
            file.write(f"{shlex.join(sys.argv)}\n{''.join(traceback.format_exception(error))}")
        where = f"{file.name} says where"
    except OSError:
        where = "".join(traceback.format_exception(error))
    said = "".join(f"; {note}" for note in getattr(error, "__notes__", ()))
    return f"this is an error of the program itself ({what}){said}. Try: other input, and report it: {where}"


def refuse_undecodable(arguments: Sequence[str]) -> None:
    """End the program where an argument, such as a file's name, is no text: no file could tell of it."""
    for argument in arguments:
        try:
            argument.encode("utf-8")
        except UnicodeEncodeError:
            announce(f"hpe-rig: {argument!a} is no UTF-8 text. Try: rename the file or folder.")
            raise SystemExit(EXIT_MISTAKE) from None


SceneName = Annotated[
    str,
    typer.Argument(metavar="SCENE", help="Name of a shipped scene, or a TOML file.", autocompletion=scenes_like),
]
BenchPath = Annotated[Path | None, typer.Option("--bench", help="Bench file. Default: the simulated bench.")]
RunFile = Annotated[Path, typer.Argument(metavar="RUN", help="Run file, such as bovine-muscle.h5.")]
