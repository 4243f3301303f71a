"""Ctrl-C while the program loads: it ends plainly. Nothing is open yet that would have to be switched off.

At the top stands only what Python has loaded by then: Ctrl-C during an import is Python's, and ends in a traceback.
"""

import os
import sys

INTERRUPTED = 130


def is_program() -> bool:
    """Return whether Python was started for ``hpe-rig`` or ``python -m hpe_rig``, not to use the package."""
    # As typed: a worker process is handed its parent's sys.argv.
    started = sys.orig_argv[1:3]
    script = started[0].replace("\\", "/").rpartition("/")[2] if started else ""
    return script.startswith("hpe-rig") or started == ["-m", "hpe_rig"]


def end_plainly() -> None:
    """From now on let Ctrl-C end the process at once, until a command itself guards what it opens."""
    try:
        # Loads enum and more, some milliseconds in which Ctrl-C is still Python's.
        import signal

        if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            signal.signal(signal.SIGINT, _end_at_once)
    except KeyboardInterrupt:
        _end_at_once()


def _end_at_once(number: int = 0, frame: object = None) -> None:
    os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, b"hpe-rig: interrupted\n")
    os._exit(INTERRUPTED)
