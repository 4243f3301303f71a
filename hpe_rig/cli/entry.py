"""Entry of the program: Ctrl-C ends it plainly even while Python is still loading it."""

from __future__ import annotations

from hpe_rig.startup import end_plainly


def main() -> None:
    """Run the command line. Until the command itself guards what it opens, Ctrl-C ends the process at once."""
    end_plainly()
    # Loading it takes a third of a second, in which nothing is open yet.
    from hpe_rig.cli.loading import load_what_is_used

    load_what_is_used()
    from hpe_rig.cli.app import main as begin

    begin()
