"""Process that serves the live page of a run from its file, so that no browser can hold up the run."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hpe_rig.live.queue_source import QueueSource
from hpe_rig.live.server import LivePage
from hpe_rig.live.source import RunSource
from hpe_rig.measurement import read_queue
from hpe_rig.store import StoreError, read_run, reason

START_S = 20.0
"""How long a page may take to start before the run goes on without it."""
GRACE_S = 15.0
"""Longest time for the last state to be read and to reach every viewer; it ends as soon as it has."""


@dataclass(frozen=True, slots=True)
class PageProcess:
    """The page of a run: where it is, and whether somebody has closed it."""

    address: str
    is_closed: Callable[[], bool]


def serve_run(run_file: Path, port: int = 0, attached: bool = False, opened: bool = False) -> None:
    """Print the address of the live page of ``run_file`` and serve it until Ctrl-C or the page's own button.

    ``run_file`` may be the folder of a queue: its page shows one run after another. ``opened``: in the browser too.
    ``attached``: until standard input ends, which is when the process that started this one does. Only then is a file
    waited for that is not there yet. Raises ``StoreError`` where there is none, or one that is no run file.
    """
    # A run that starts its own page may be about to replace the file.
    if not attached:
        _refuse_never(run_file)
    source = QueueSource(run_file) if run_file.is_dir() else RunSource(run_file)
    page = LivePage(source, port)
    print(page.address, flush=True)
    if opened:
        open_page(page.address)
    if attached:
        threading.Thread(target=_close_with_input, args=(page,), daemon=True).start()
    with contextlib.suppress(KeyboardInterrupt):
        page.serve()


@contextlib.contextmanager
def live_page_of(run_file: Path, port: int = 0) -> Iterator[PageProcess]:
    """Start the live page of ``run_file``, or of a queue's folder, in its own process and yield it; end it afterwards.

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
        yield PageProcess(_address(child), lambda: child.poll() is not None)
    finally:
        if child.stdin is not None:
            child.stdin.close()
        try:
            child.wait(timeout=GRACE_S + 5.0)
        except subprocess.TimeoutExpired:
            child.kill()
        if child.stdout is not None:
            child.stdout.close()


def open_page(address: str) -> bool:
    """Open ``address`` in the user's browser and return whether there is one; a browser must not hold up a run."""
    import webbrowser

    try:
        browser = webbrowser.get()
    except webbrowser.Error:
        return False
    threading.Thread(target=browser.open, args=(address,), daemon=True).start()
    return True


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
    if run_file.is_dir():
        read_queue(run_file)
    else:
        read_run(run_file)


def _close_with_input(page: LivePage) -> None:
    sys.stdin.read()
    page.close(GRACE_S)
