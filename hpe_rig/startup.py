"""Ctrl-C while the program loads: the process ends with one line instead of a traceback.

Nothing is open yet that would have to be switched off. This module imports only ``os`` and ``sys``, which Python has
loaded already: an interrupt during an import is handled by Python, and prints a traceback.
"""

import os
import sys

EXIT_INTERRUPTED = 130


def is_program() -> bool:
    """Return whether Python was started for ``hpe-rig`` or ``python -m hpe_rig``, not to use the package."""
    # `sys.orig_argv` holds the words of the shell; a worker process inherits its parent's `sys.argv`.
    words = sys.orig_argv[1:3]
    script = words[0].replace("\\", "/").rpartition("/")[2] if words else ""
    return script.startswith("hpe-rig") or words == ["-m", "hpe_rig"]


def exit_on_interrupt() -> None:
    """Let Ctrl-C end the process at once, until a command installs its own handler."""
    try:
        # This import loads enum and more, which takes some milliseconds.
        import signal

        if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            signal.signal(signal.SIGINT, _exit)
    except KeyboardInterrupt:
        _exit()


def _exit(number: int = 0, frame: object = None) -> None:
    os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, b"hpe-rig: interrupted\n")
    os._exit(EXIT_INTERRUPTED)
