"""Entry point of the program: Ctrl-C ends it with one line even while Python is still loading it."""

from __future__ import annotations

from hpe_rig.startup import exit_on_interrupt


def main() -> None:
    """Run the command line. Until the command itself handles interrupts, Ctrl-C ends the process at once."""
    exit_on_interrupt()
    # Loading the commands takes a third of a second. Nothing is open during that time.
    from hpe_rig.cli.app import main as run_command_line

    run_command_line()
