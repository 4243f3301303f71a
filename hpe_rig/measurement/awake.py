"""The computer stays awake during a run, where its system offers that; a failure is logged and changes nothing.

A crash of the program ends the request: Windows ties it to the thread, macOS to the process, and on Linux the child
that holds it ends with the pipe to it.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Final

_LOG: Final = logging.getLogger("hpe_rig")
RELEASE_S: Final = 1.0
"""Time that a child process gets to end."""
ES_CONTINUOUS, ES_SYSTEM_REQUIRED = 0x80000000, 0x00000001
"""Arguments of SetThreadExecutionState (winbase.h): until changed, and the system must not sleep."""
INHIBIT: Final = (
    *("systemd-inhibit", "--what=idle:sleep", "--who=hpe-rig", "--why=a measurement runs", "--mode=block"),
    # It ends as soon as the other end of its standard input is closed, by this program or by its end.
    "cat",
)
"""Linux: the computer does not sleep until the command in it ends."""


@contextmanager
def kept_awake(needed: bool) -> Iterator[None]:
    """Keep the computer awake during the block if ``needed``: on a real bench, as a simulated one can be repeated."""
    with ExitStack() as stack:
        if needed:
            try:
                _request(stack)
            except Exception as error:
                _LOG.info("the computer may go to sleep during the run: %s", error)
        yield


def _request(stack: ExitStack) -> None:
    """Ask the system not to sleep until ``stack`` is closed; raise if it cannot be asked."""
    if sys.platform == "win32":
        import ctypes

        set_state = ctypes.windll.kernel32.SetThreadExecutionState
        stack.callback(set_state, ES_CONTINUOUS)
        if not set_state(ES_CONTINUOUS | ES_SYSTEM_REQUIRED):
            raise OSError("SetThreadExecutionState failed")
    elif sys.platform == "darwin":
        stack.callback(_release, _child(("caffeinate", "-i", "-w", str(os.getpid()))))
    else:
        stack.callback(_release, _child(INHIBIT))


def _child(command: tuple[str, ...]) -> subprocess.Popen[bytes]:
    """Return the process of ``command``, which Ctrl-C in the terminal does not reach."""
    # The commands are the constants above.
    return subprocess.Popen(  # noqa: S603
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _release(child: subprocess.Popen[bytes]) -> None:
    """End ``child``, which holds the request; nothing here may hide how a run ended."""
    with suppress(OSError):
        if child.stdin is not None:
            child.stdin.close()
    if sys.platform == "darwin":
        child.terminate()
    try:
        if child.wait(RELEASE_S) > 0:
            _LOG.info("the computer may have gone to sleep during the run: %s failed", child.args)
    except subprocess.TimeoutExpired:
        child.kill()
        with suppress(subprocess.TimeoutExpired):
            child.wait(RELEASE_S)
