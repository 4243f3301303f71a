"""Process that serves the live page of a run from its file, so that no browser can hold up the run."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hpe_rig.live.server import LivePage
from hpe_rig.live.source import RunSource
from hpe_rig.store import StoreError, read_run, reason

START_S = 20.0
"""How long a page may take to start before the run goes on without it."""
GRACE_S = 15.0
"""Longest time for the last state to be read and to reach every viewer; it ends as soon as it has."""


def serve_run(run_file: Path, port: int = 0, attached: bool = False) -> None:
    """Print the address of the live page of ``run_file`` and serve it until Ctrl-C.

    ``attached``: until standard input ends, which is when the process that started this one does. Only then is
    a file waited for that is not there yet. Raises ``StoreError`` where there is none, or one that is no run file.
    """
    # A run that starts its own page may be about to replace the file.
    if not attached:
        _refuse_never(run_file)
    page = LivePage(RunSource(run_file), port)
    print(page.address, flush=True)
    if attached:
        threading.Thread(target=_close_with_input, args=(page,), daemon=True).start()
    with contextlib.suppress(KeyboardInterrupt):
        page.serve()


@contextlib.contextmanager
def live_page_of(run_file: Path, port: int = 0) -> Iterator[str]:
    """Start the live page of ``run_file`` in a process of its own and yield its address; end it afterwards.

    Raises ``StoreError`` where it does not start.
    """
    command = [sys.executable, "-P", "-m", "hpe_rig", "live", str(run_file), "--port", str(port), "--attached"]
    # Not from the working directory (-P), where a folder may have the name of a package of ours.
    packages = str(Path(__file__).parents[2])
    paths = filter(None, (packages, os.environ.get("PYTHONPATH", "")))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    # A group of its own: Ctrl-C ends the run first, and the page shows how it ended.
    windows = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)
    apart: dict[str, Any] = {
        "start_new_session": os.name == "posix",
        "creationflags": windows,
        "env": environment,
    }
    child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **apart)  # noqa: S603
    try:
        yield _address(child)
    finally:
        if child.stdin is not None:
            child.stdin.close()
        try:
            child.wait(timeout=GRACE_S + 5.0)
        except subprocess.TimeoutExpired:
            child.kill()
        if child.stdout is not None:
            child.stdout.close()


def _address(child: subprocess.Popen[str]) -> str:
    found: list[str] = []

    def read() -> None:
        found.append(child.stdout.readline().strip() if child.stdout is not None else "")

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    reader.join(START_S)
    if not found or not found[0].startswith("http"):
        raise StoreError("the live page did not start. Try: hpe-rig live RUN.h5 by hand, which says why.")
    return found[0]


def _refuse_never(run_file: Path) -> None:
    """Raise ``StoreError`` where ``run_file`` is no run file, or is not there: a slip would be waited for."""
    try:
        run_file.stat()
    except OSError as error:
        remedy = "the path of a run file, once the run has begun; hpe-rig run SCENE --live shows it from the start"
        raise StoreError(f"no run can be followed at {run_file} ({reason(error)}). Try: {remedy}.") from None
    read_run(run_file)


def _close_with_input(page: LivePage) -> None:
    sys.stdin.read()
    page.close(GRACE_S)
