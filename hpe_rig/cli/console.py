"""Exit codes, error messages, progress and printed results of all commands."""

from __future__ import annotations

import functools
import inspect
import io
import itertools
import os
import shlex
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hpe_rig.bench import END_SIGNALS
from hpe_rig.cli.options import ResultOptions, expand_option_groups, is_figure_name, output_option
from hpe_rig.cli.streams import EXIT_SIGNAL, wait_for_messages

if TYPE_CHECKING:
    from hpe_rig.measurement import Observer, Setup
    from hpe_rig.result import Result

EXIT_MISTAKE, EXIT_INSTRUMENT, EXIT_UNSAFE, EXIT_PROGRAM, EXIT_INTERRUPTED = 2, 1, 3, 70, 130
EXIT_DAMAGED, EXIT_NO_CHECKSUMS = 4, 5
OUTPUTS = ("output", "print_to", "figure")
"""Parameters of commands that name files to write."""


def guarded(command: Callable[..., None]) -> Callable[..., None]:
    """Return ``command`` such that every failure ends with a message and an exit code, never with a traceback.

    An unexpected exception is an error of the program: the message names a file with its traceback. Interrupts after
    the first one wait until the message is printed. A file that the command reads is refused as its output. Option
    groups are expanded, see ``options``.
    """
    command = expand_option_groups(command)

    @functools.wraps(command)
    def guard(*args: Any, **kwargs: Any) -> None:
        from hpe_rig.bench import interruptible, uninterrupted
        from hpe_rig.scene import printable

        with uninterrupted():
            try:
                _refuse_inputs_as_outputs(kwargs)
                with interruptible():
                    command(*args, **kwargs)
            except (typer.Exit, SystemExit):
                raise
            except BaseException as raised:
                error = _wrapped_interrupt(raised) or raised
                message, exit_code = _failure(error) or (_program_error(error), EXIT_PROGRAM)
                # A terminal that was closed accepts no message.
                with suppress(OSError):
                    typer.echo(f"hpe-rig: {printable(message)}", err=True)
                # A further signal may end the program as soon as this block is left.
                wait_for_messages()
                raise typer.Exit(exit_code) from None

    return guard


def _refuse_inputs_as_outputs(values: Mapping[str, Any]) -> None:
    """Raise ``StoreError`` if one of ``OUTPUTS`` is a file that the other ``values`` of a command name."""
    outputs = [path for name in OUTPUTS if isinstance(path := values.get(name), Path)]
    inputs = [value for name, value in values.items() if name not in OUTPUTS]
    for item in itertools.chain.from_iterable(value if isinstance(value, list) else [value] for value in inputs):
        for output in outputs if isinstance(item, str | Path) else ():
            # A text that is no name of a file, such as that of a shipped scene, cannot be an output.
            with suppress(OSError, ValueError):
                if output.is_file() and output.samefile(item):
                    from hpe_rig.store import StoreError

                    raise StoreError(f"{output} is read by this command: it stays unchanged. Try: another name.")


def _refuse_binary(path: Path) -> None:
    """Raise ``StoreError`` if ``path`` exists and is no text: it may be a run."""
    from hpe_rig.store import StoreError

    # The attempt to write reports a file that cannot be read.
    with suppress(OSError), path.open("rb") as file:
        if b"\0" in file.read(1024):
            raise StoreError(f"{path} exists and is no text: it stays unchanged. Try: another name.")


def printing(command: Callable[..., None]) -> Callable[..., None]:
    """Return ``command`` with the option -o: a file that receives what the command otherwise prints."""
    signature, option = inspect.signature(command), output_option("File instead of standard output.")
    parameter = inspect.Parameter("print_to", inspect.Parameter.KEYWORD_ONLY, default=None)
    annotation = Annotated[Path | None, option]

    @functools.wraps(command)
    def printer(print_to: Path | None, **values: Any) -> None:
        if print_to is None:
            command(**values)
            return
        from hpe_rig.store import StoreError, refuse_unwritable, write_file

        if "figure" in values and is_figure_name(print_to):
            raise StoreError(f"-o {print_to}: the printed text is no figure. Try: --figure {print_to}.")
        refuse_unwritable(print_to)
        _refuse_binary(print_to)
        text = io.StringIO()
        try:
            with redirect_stdout(text):
                command(**values)
        except typer.Exit:
            # The exit code of a refused scene or a damaged file does not change what is written about it.
            write_file(print_to, text.getvalue())
            raise
        write_file(print_to, text.getvalue())
        announce(f"{print_to}: written")

    printer.__annotations__ = command.__annotations__ | {"print_to": annotation}
    signed: Any = printer
    signed.__signature__ = signature.replace(parameters=[*signature.parameters.values(), parameter])
    return printer


def _wrapped_interrupt(error: BaseException) -> BaseException | None:
    """Return the interrupt during which ``error`` was raised, if any."""
    from hpe_rig.bench import INTERRUPTS

    # Python wraps an interrupt that occurs during the creation of a class. A package with an interrupted import raises
    # ImportError: the interrupt is its context, not its cause.
    for cause in (error.__cause__, error.__context__):
        if isinstance(error, RuntimeError | ImportError) and isinstance(cause, INTERRUPTS):
            return cause
    return None


def ignore_interrupts() -> None:
    """Ignore all signals that would end the process."""
    for number in END_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def announce(text: str) -> None:
    """Print a message to standard error; standard output is for results."""
    typer.echo(text, err=True)


def print_version(requested: bool) -> None:
    """Print the version of the program and exit, if ``requested``."""
    if requested:
        from importlib.metadata import version

        typer.echo(f"hpe-rig {version('hpe-rig')}")
        raise typer.Exit


def print_json(value: Any) -> None:
    """Print ``value`` as JSON."""
    from hpe_rig.result import json_text

    typer.echo(json_text(value, indent=2))


def show(result: Result, options: ResultOptions) -> None:
    """Print a result as CSV, JSON or a table."""
    if options.csv:
        from hpe_rig.result import result_csv

        typer.echo(result_csv(result), nl=False)
    elif options.json:
        print_json(result.as_dict())
    else:
        from hpe_rig.cli.tables import print_result

        print_result(result, options.wide)


@contextmanager
def progress(setup: Setup, quiet: bool) -> Iterator[Observer]:
    """Yield an observer that reports progress with the time left: a bar on a terminal, else lines."""
    from hpe_rig.cli.terminal import progress_reporter
    from hpe_rig.measurement import Progress

    total = sum(shot.capture.record_count for shot in setup.plan.shots)
    with progress_reporter("records", quiet) as report:

        def observe(progress: Progress) -> None:
            done = progress.shot.index * progress.shot.capture.record_count + progress.records
            report(done, total, f"shot {progress.shot.index + 1}: {progress.step.value}")

        yield observe


def _failure(error: BaseException) -> tuple[str, int] | None:
    """Return message and exit code of an expected failure, None for an error of the program."""
    note_texts = getattr(error, "__notes__", ())
    notes, note_lines = ("".join(separator + note for note in note_texts) for separator in ("; ", "\n  "))
    # This comes first: after an interrupted import the imports below may fail. A stop from the live page is a subclass
    # with another message.
    if type(error) is KeyboardInterrupt:
        return f"interrupted{notes}", EXIT_INTERRUPTED
    from drivers.interfaces import InstrumentError
    from hpe_rig.bench import Terminated, UnsafeBenchError
    from hpe_rig.measurement import StopRequested
    from hpe_rig.plan import PlanError
    from hpe_rig.scene import SettingsError
    from hpe_rig.store import StoreError

    match error:
        case UnsafeBenchError():
            return f"{error}{note_lines}", EXIT_UNSAFE
        case SettingsError() | PlanError() | StoreError():
            return str(error), EXIT_MISTAKE
        case InstrumentError():
            return f"{error}{note_lines}", EXIT_INSTRUMENT
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


def _program_error(error: BaseException) -> str:
    """Return the message of an error of the program; its traceback is written to a temporary file."""
    summary = f"{type(error).__name__}: {error}".partition("\n")[0][:200]
    try:
        options: dict[str, Any] = {"prefix": "hpe-rig-", "suffix": ".txt", "encoding": "utf-8", "errors": "replace"}
        with tempfile.NamedTemporaryFile("w", delete=False, **options) as file:
            file.write(f"{shlex.join(sys.argv)}\n{''.join(traceback.format_exception(error))}")
        details = f"{file.name} holds the details"
    except OSError:
        details = "".join(traceback.format_exception(error))
    notes = "".join(f"; {note}" for note in getattr(error, "__notes__", ()))
    return (
        f"this is an error of the program itself ({summary}){notes}. Try: other input, and report it: {details}, and "
        "hpe-rig bug-report FILE ... collects what a report needs"
    )


def refuse_undecodable(arguments: Sequence[str]) -> None:
    """Exit if an argument, such as a file name, is not valid text: a file could not store it."""
    for argument in arguments:
        try:
            argument.encode("utf-8")
        except UnicodeEncodeError:
            announce(f"hpe-rig: {argument!a} is no UTF-8 text. Try: rename the file or folder.")
            raise SystemExit(EXIT_MISTAKE) from None
