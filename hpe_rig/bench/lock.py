"""Lock of a bench's instruments between the programs of one machine: a file named after each resource.

The system lets go of the lock when its process ends, however that was; who it was stands in a second file beside it,
for the one who is refused or who takes over after a crash.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

from drivers.interfaces import InstrumentError
from hpe_rig.bench.bench_file import BenchFile

if TYPE_CHECKING:
    from filelock import FileLock

MOST_WORDS: Final = 300


class BenchInUseError(InstrumentError):
    """Another program holds an instrument of the bench; ``holder`` says who, and since when."""

    def __init__(self, resource: str, holder: str) -> None:
        why = "two programs on one bench would measure each other's settings"
        remedy = (
            "wait until it has ended or end it; in an emergency hpe-rig bench BENCH --off switches off all the same"
        )
        super().__init__("bench", f"{resource} is in use by {holder}", why, remedy)
        self.resource = resource
        self.holder = holder


def resources(bench: BenchFile) -> list[str]:
    """Return the names of what a real bench takes for itself; none on a simulated one, which is nobody else's."""
    if bench.simulated:
        return []
    places = (
        " behind ".join(filter(None, (item.address, item.interface))) for item in bench.generators.by_role.values()
    )
    board = f"Alazar system {bench.digitizer.system_id} board {bench.digitizer.board_id}"
    # In one order for everybody, and each once.
    return sorted({*places, board})


_held_here: set[str] = set()
"""Resources that this program holds for several runs, one after another."""


@contextmanager
def hold(names: Iterable[str], announce: Callable[[str], None] | None = None) -> Iterator[None]:
    """Hold every resource in ``names`` for all that is opened in the block; raises as ``locked``."""
    wanted = [name for name in names if name not in _held_here]
    with locked(wanted, announce):
        _held_here.update(wanted)
        try:
            yield
        finally:
            _held_here.difference_update(wanted)


@contextmanager
def locked(names: Iterable[str], announce: Callable[[str], None] | None = None) -> Iterator[None]:
    """Hold the lock of every resource in ``names``; raise ``BenchInUseError`` at once where another process does.

    What a process that died has left behind is taken over, and ``announce`` told (standard error where it is None).
    """
    with ExitStack() as stack:
        names = [name for name in names if name not in _held_here]
        left = {holder for name in names if (holder := stack.enter_context(_held(name)))}
        for holder in sorted(left):
            (announce or _to_standard_error)(f"the bench was left locked by {holder}, which has ended: taken over")
        yield


def holder_of(name: str) -> str | None:
    """Return in words who holds the resource ``name``; None where nobody does any more."""
    from filelock import Timeout

    lock, holder = _files(name)
    try:
        with lock:
            return None
    except Timeout:
        return _words(holder) or "another program"


@contextmanager
def _held(name: str) -> Iterator[str]:
    """Hold the lock of one resource and yield who left it locked, empty where it was free."""
    from filelock import Timeout

    lock, holder = _files(name)
    try:
        lock.acquire()
    except Timeout:
        raise BenchInUseError(name, _words(holder) or "another program") from None
    except OSError as error:
        why = f"{lock.lock_file} cannot be opened ({error.strerror})"
        raise InstrumentError("bench", f"{name} cannot be locked", why, "remove that file as its owner") from None
    try:
        left = _words(holder)
        with suppress(OSError):
            holder.write_text(_this_program(), encoding="utf-8")
        yield left
    finally:
        with suppress(OSError):
            holder.unlink(missing_ok=True)
        lock.release()


def _files(name: str) -> tuple[FileLock, Path]:
    """Return the lock of a resource, and the file that says who holds it."""
    from filelock import FileLock

    path = _folder() / re.sub(r"[^A-Z0-9.]+", "-", name.upper())
    return FileLock(f"{path}.lock", timeout=0, mode=0o666), path.with_name(f"{path.name}.holder")


def _folder() -> Path:
    """Return where the locks of this machine are, which everybody may write to."""
    folder = Path(tempfile.gettempdir()) / "hpe_rig-locks"
    with suppress(OSError):
        folder.mkdir(exist_ok=True)
        folder.chmod(0o1777)
    return folder


def _words(holder: Path) -> str:
    with suppress(OSError, UnicodeDecodeError):
        return " ".join(holder.read_text(encoding="utf-8")[:MOST_WORDS].split())
    return ""


def _this_program() -> str:
    program = " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])[:100] if sys.argv else "Python"
    return f"process {os.getpid()} ({program}), since {datetime.now().astimezone().isoformat(' ', 'seconds')}"


def _to_standard_error(text: str) -> None:
    print(f"hpe-rig: {text}", file=sys.stderr)
