"""Entry of the program: Ctrl-C ends it plainly even while Python is still loading it."""

from __future__ import annotations

import gc
import os
import signal
import sys
from types import FrameType

INTERRUPTED = 130


def main() -> None:
    """Run the command line. Until the command itself guards what it opens, Ctrl-C ends the process at once."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, _end_at_once)
    # Loading makes many objects and hardly any garbage: look for that seldom.
    gc.set_threshold(100_000)
    # It takes a third of a second, in which nothing is open yet.
    from hpe_rig.cli.app import main as begin

    begin()


def _end_at_once(number: int, frame: FrameType | None) -> None:
    os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, b"hpe-rig: interrupted\n")
    os._exit(INTERRUPTED)
