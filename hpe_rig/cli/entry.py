"""Entry of the program: Ctrl-C ends it plainly even while Python is still loading it."""

from __future__ import annotations

import gc
import os

from hpe_rig.startup import end_plainly

NEW_OBJECTS = 100_000
"""So many more objects than were freed before Python looks for cycles among them, by default 700. Loading makes that
many, of which none is ever freed, and looking costs a tenth of a start."""


def main() -> None:
    """Run the command line. Until the command itself guards what it opens, Ctrl-C ends the process at once."""
    end_plainly()
    gc.set_threshold(NEW_OBJECTS)
    # Pydantic would look through every installed package for plugins of its own, for each process.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # Loading it takes a third of a second, in which nothing is open yet.
    from hpe_rig.cli.app import main as begin

    begin()
