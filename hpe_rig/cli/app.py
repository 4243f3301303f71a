"""The program ``hpe-rig``: all commands, and the options before a command.

Each command imports its implementation when it is called, so that ``--help`` stays fast.
"""

from __future__ import annotations

import os
import sys
import threading
from typing import Annotated

import typer

from hpe_rig.bench import DISK_THREAD
from hpe_rig.cli.benches import benches
from hpe_rig.cli.bug_report import reporting
from hpe_rig.cli.console import (
    EXIT_INTERRUPTED,
    EXIT_MISTAKE,
    announce,
    ignore_interrupts,
    print_version,
    refuse_undecodable,
)
from hpe_rig.cli.measuring import measuring
from hpe_rig.cli.recordings import recordings
from hpe_rig.cli.scenes import scene_commands
from hpe_rig.cli.stored_runs import stored_runs
from hpe_rig.cli.streams import finish_streams, queue_streams
from hpe_rig.cli.studies import studies
from hpe_rig.cli.terminal import LogLevel, start_logging

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None)
for group in (measuring, stored_runs, recordings, scene_commands, benches, studies, reporting):
    app.add_typer(group)
commands = app


def main() -> None:
    """Run the command line."""
    for library in ("OMP", "OPENBLAS", "MKL"):
        # The matrices are small: threads of the algebra library would only wait for each other.
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    streams = queue_streams()
    exit_code = finish_streams(streams, _run())
    # All messages are printed and every output is off: a signal must not change the exit code.
    ignore_interrupts()
    # A thread of ``store/task.py`` that still waits for its disk may hold the lock of h5py, for which Python's shutdown
    # would wait forever.
    if any(thread.name == DISK_THREAD for thread in threading.enumerate()):
        os._exit(exit_code)
    sys.exit(exit_code)


def _run() -> int:
    """Run the command and return its exit code."""
    try:
        refuse_undecodable(sys.argv)
        exit_code = app(standalone_mode=False)
        return exit_code if isinstance(exit_code, int) else 0
    except typer.TyperException as error:
        announce(_refusal(error))
        return EXIT_MISTAKE
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0
    except KeyboardInterrupt:
        # The interrupt came before the command began, so nothing is open.
        announce("hpe-rig: interrupted")
        return EXIT_INTERRUPTED


def _refusal(error: typer.TyperException) -> str:
    """Return the message of refused arguments in one sentence with its remedy; without arguments it is the help."""
    # A wrong choice has the prefix of the library that checks it.
    message, context = error.format_message().replace(": Value error, ", ": "), getattr(error, "ctx", None)
    if context is None or "\n" in message:
        return str(message)
    program, option = context.find_root(), getattr(error, "option_name", None)
    remedy = "" if "Try: " in message else f" Try: {context.command_path} --help"
    if any(option in parameter.opts for parameter in program.command.params):
        remedy = f" Try: {program.info_name} {option} ... {context.info_name}"
    return f"{context.command_path}: {message.rstrip('.')}.{remedy}"


@app.callback()
def program(
    version: Annotated[
        bool, typer.Option("--version", callback=print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
    log_level: Annotated[
        LogLevel, typer.Option("--log-level", help="Logged to standard error; debug: every message to an instrument.")
    ] = "warning",
) -> None:
    """Measure harmonic motion in tissue with pulsed ultrasound excitation, on a real or simulated bench."""
    start_logging(log_level)
