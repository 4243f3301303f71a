"""Standard streams that are missing, full, closed or not read: the command ends, and says what is missing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import pytest

from hpe_rig.store import read_run

pytestmark = pytest.mark.skipif(os.name == "nt", reason="needs /dev/full and pipes with a small buffer")

PROGRAM = [sys.executable, "-m", "hpe_rig"]
LIST = "scenes"
"""A command that prints some kB and opens nothing."""
MANY_LINES = """
import sys
from hpe_rig.cli import app
app.app = lambda **_: (open("started", "w").close(), print("a line of a long table\\n" * 20_000, end=""))
app.main()
"""


@contextmanager
def unread(command: list[str], stream: str, cwd: Path) -> Iterator[tuple[subprocess.Popen[bytes], IO[bytes]]]:
    """Yield a program whose ``stream`` is a pipe without space; the end that reads comes with it."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    for size in (4096, 1):
        try:
            while True:
                os.write(writer, bytes(size))
        except BlockingIOError:
            pass
    os.set_blocking(writer, True)
    streams = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, stream: writer}
    process = subprocess.Popen(command, cwd=cwd, **streams)  # type: ignore[call-overload]
    os.close(writer)
    with open(reader, "rb") as file:  # noqa: PTH123
        try:
            yield process, file
        finally:
            process.kill()
            process.wait()


def test_results_that_cannot_be_printed_are_reported_with_exit_code_1_and_the_run_file_is_complete(
    tmp_path: Path,
) -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [*PROGRAM, "run", "table-1", "--output", "run.h5"],
            stdout=full,
            stderr=subprocess.PIPE,
            cwd=tmp_path,
            text=True,
            check=False,
        )
    assert done.returncode == 1, done.stderr
    assert "results are missing: standard output cannot be written (No space left on device). Try:" in done.stderr
    assert read_run(tmp_path / "run.h5").status == "complete"


def with_full_output(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    with Path("/dev/full").open("wb") as full:
        command = [*PROGRAM, *arguments]
        return subprocess.run(command, stdout=full, stderr=subprocess.PIPE, cwd=cwd, text=True, check=False, timeout=60)


@pytest.mark.slow
def test_the_switched_off_outputs_are_reported_without_standard_output(tmp_path: Path) -> None:
    off = with_full_output("bench", "--off", cwd=tmp_path)
    assert off.returncode == 1
    assert "burst_train at in process, output: off (read back as off)" in off.stderr
    assert "hpe-rig process" not in off.stderr


@pytest.mark.slow
def test_a_lost_bench_file_is_reported_without_standard_output(tmp_path: Path) -> None:
    emulation = with_full_output("emulate", cwd=tmp_path)
    assert emulation.returncode == 1
    assert "standard output cannot be written" in emulation.stderr


@pytest.mark.parametrize(
    "closed",
    [
        *(pytest.param(each, marks=pytest.mark.slow) for each in ("<&-", ">&-", "2>&-", "2>/dev/full")),
        "<&- >&- 2>&-",
    ],
)
def test_streams_that_are_missing_or_full_end_no_command(tmp_path: Path, closed: str) -> None:
    command = f"exec '{sys.executable}' -m hpe_rig {LIST} {closed}"
    done = subprocess.run(["sh", "-c", command], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert ("bovine-muscle" in done.stdout) == (">&-" not in closed.replace("2>&-", ""))


def test_a_reader_that_has_read_enough_is_no_mistake(tmp_path: Path) -> None:
    command = f"'{sys.executable}' -m hpe_rig {LIST} | head -1"
    done = subprocess.run(["sh", "-c", command], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert done.stdout.count("\n") == 1


def wait_at_output(process: subprocess.Popen[bytes], folder: Path) -> None:
    """Wait until the program prints its lines; it must not end before they are read."""
    deadline_s = time.monotonic() + 60
    while not (folder / "started").exists():
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(1.0)


def test_results_wait_for_a_slow_reader_and_arrive_completely(tmp_path: Path) -> None:
    with unread([sys.executable, "-c", MANY_LINES], "stdout", tmp_path) as (process, file):
        wait_at_output(process, tmp_path)
        assert file.read().count(b"a line of a long table\n") == 20_000
        assert process.wait(20) == 0


def test_a_signal_ends_the_wait_for_the_reader_of_results(tmp_path: Path) -> None:
    with unread([sys.executable, "-c", MANY_LINES], "stdout", tmp_path) as (process, _):
        wait_at_output(process, tmp_path)
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 130


def test_messages_without_a_reader_do_not_keep_the_program(tmp_path: Path) -> None:
    with unread([*PROGRAM, "--log-level", "debug", "check", "no-such-scene"], "stderr", tmp_path) as (process, _):
        assert process.wait(30) == 2


def test_a_movement_that_nobody_can_confirm_ends_the_run_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    from hpe_rig.cli.watch import _wait_for_line
    from hpe_rig.store import StoreError

    with Path(os.devnull).open(encoding="utf-8") as empty:
        monkeypatch.setattr(sys, "stdin", empty)
        with pytest.raises(StoreError, match=r"standard input has ended.*--yes"):
            _wait_for_line()


def test_a_thread_that_holds_the_lock_of_h5py_does_not_keep_the_program_alive() -> None:
    # Ctrl-C while a disk is slow leaves such a thread.
    program = """if True:
        import contextlib, sys, threading, h5py._objects
        from hpe_rig.store.task import make_or_undo
        def wait_for_disk(cancelled):
            with h5py._objects.phil:
                cancelled.set()
                threading.Event().wait()
        with contextlib.suppress(OSError):
            make_or_undo(wait_for_disk, print)
        sys.argv = ["hpe-rig", "--version"]
        from hpe_rig.cli.app import main
        main()
    """
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert "hpe-rig" in process.communicate(timeout=30)[0]
        finally:
            process.kill()
    assert process.returncode == 0
