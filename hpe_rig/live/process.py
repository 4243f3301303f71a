"""Process that serves the live page of a run from its file, so that no browser can delay the run."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from hpe_rig.live.queue_source import QueueSource
from hpe_rig.live.server import LivePage
from hpe_rig.live.source import RunSource
from hpe_rig.measurement import read_queue
from hpe_rig.store import StoreError, read_run, reason

START_S = 20.0
"""Time that a page may take to start before the run continues without it."""
GRACE_S = 15.0
"""Maximum time for the last state to reach every viewer."""


def serve_run(run_file: Path, port: int = 0, attached: bool = False, open_browser: bool = False) -> None:
    """Print the address of the live page of ``run_file`` and serve it until Ctrl-C or the page's own button.

    ``run_file`` may be the folder of a queue, for the runs in succession. ``open_browser``: display the page too.
    ``attached``: serve until standard input ends, with the parent process, and wait for a file that does not exist yet.
    Otherwise raises ``StoreError`` if there is no run file.
    """
    # A parent process that measures may be about to replace the file.
    if not attached:
        _require_run(run_file)
    source = QueueSource(run_file) if run_file.is_dir() else RunSource(run_file)
    page = LivePage(source, port)
    print(page.address, flush=True)
    if open_browser:
        open_page(page.address)
    if attached:
        threading.Thread(target=_close_with_input, args=(page,), daemon=True).start()
    with contextlib.suppress(KeyboardInterrupt):
        page.serve()


@contextlib.contextmanager
def live_page_of(run_file: Path, port: int = 0) -> Iterator[tuple[str, Callable[[], bool]]]:
    """Start the live page of ``run_file``, or of a queue's folder, in a separate process; end it on leaving.

    Yield its address, and a function that returns whether it was closed. Raises ``StoreError`` if it does not start.
    """
    command = [sys.executable, "-P", "-m", "hpe_rig", "live", str(run_file), "--port", str(port), "--attached"]
    # -P excludes the working directory, which may contain a folder with the name of one of these packages.
    packages = str(Path(__file__).parents[2])
    paths = filter(None, (packages, os.environ.get("PYTHONPATH", "")))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    # A separate process group: Ctrl-C ends the run first, and the page displays its final state.
    windows = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)
    options: dict[str, Any] = {"start_new_session": os.name == "posix", "creationflags": windows, "env": environment}
    child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **options)  # noqa: S603
    try:
        yield _address(child), lambda: child.poll() is not None
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
    """Open ``address`` in the user's browser, in a thread; return whether a browser exists."""
    import webbrowser

    try:
        browser = webbrowser.get()
    except webbrowser.Error:
        return False
    threading.Thread(target=browser.open, args=(address,), daemon=True).start()
    return True


def _address(child: subprocess.Popen[str]) -> str:
    """Return the address that the page's process prints; raise ``StoreError`` after ``START_S``."""
    lines: list[str] = []

    def read() -> None:
        lines.append(child.stdout.readline().strip() if child.stdout is not None else "")

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    reader.join(START_S)
    if not lines or not lines[0].startswith("http"):
        raise StoreError(
            "the live page did not start. Try: hpe-rig live RUN.h5 in another terminal, which states the reason."
        )
    return lines[0]


def _require_run(run_file: Path) -> None:
    """Raise ``StoreError`` unless ``run_file`` is a run file or queue: the page would wait for a mistyped path."""
    try:
        run_file.stat()
    except OSError as error:
        remedy = (
            "the path of a run file, after the start of the run; hpe-rig run SCENE --live displays it from the start"
        )
        raise StoreError(f"no run can be followed at {run_file} ({reason(error)}). Try: {remedy}.") from None
    if run_file.is_dir():
        read_queue(run_file)
    else:
        read_run(run_file)


def _close_with_input(page: LivePage) -> None:
    sys.stdin.read()
    page.close(GRACE_S)
