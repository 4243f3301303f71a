"""Lock of a bench's instruments between the programs of one computer: a file named after each resource.

The system releases the lock when its process ends, for any reason. A second file names the process, for a program that
is refused or that takes over after a crash.
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

MAX_HOLDER_CHARACTERS: Final = 300
"""Length of the text about another program that a message shows."""


class BenchInUseError(InstrumentError):
    """Another program uses an instrument of the bench; ``holder`` names it and the start time."""

    def __init__(self, resource: str, holder: str) -> None:
        why = "two programs on one bench would measure each other's settings"
        remedy = "wait until it has ended or end it; in an emergency hpe-rig bench BENCH --off switches off anyway"
        super().__init__("bench", f"{resource} is in use by {holder}", why, remedy)
        self.resource = resource
        self.holder = holder


def resources(bench: BenchFile) -> list[str]:
    """Return the names of the instruments that a real bench locks; none for a simulated one."""
    if bench.simulated:
        return []
    generators = (
        " behind ".join(filter(None, (item.address, item.interface))) for item in bench.generators.by_role.values()
    )
    board = f"Alazar system {bench.digitizer.system_id} board {bench.digitizer.board_id}"
    # Every program locks in the same order, so that two cannot block each other.
    return sorted({*generators, board})


_held_for_several_runs: set[str] = set()
"""Resources that this process has locked for several runs in sequence."""


@contextmanager
def hold(names: Iterable[str], announce: Callable[[str], None] | None = None) -> Iterator[None]:
    """Lock every resource in ``names`` for all benches that are opened in the block; raises as ``locked``."""
    new_names = [name for name in names if name not in _held_for_several_runs]
    with locked(new_names, announce):
        _held_for_several_runs.update(new_names)
        try:
            yield
        finally:
            _held_for_several_runs.difference_update(new_names)


@contextmanager
def locked(names: Iterable[str], announce: Callable[[str], None] | None = None) -> Iterator[None]:
    """Lock every resource in ``names``; raise ``BenchInUseError`` at once if another process has locked one.

    The lock of a process that died is taken over, and ``announce`` is called about it (default: standard error).
    """
    with ExitStack() as stack:
        names = [name for name in names if name not in _held_for_several_runs]
        crashed = {holder for name in names if (holder := stack.enter_context(_lock(name)))}
        for holder in sorted(crashed):
            (announce or _to_standard_error)(f"the bench was left locked by {holder}, which has ended: taken over")
        yield


def holder_of(name: str) -> str | None:
    """Return a description of the program that has locked ``name``; None if it is free."""
    from filelock import Timeout

    lock, holder = _files(name)
    try:
        with lock:
            return None
    except Timeout:
        return _holder_text(holder) or "another program"


@contextmanager
def _lock(name: str) -> Iterator[str]:
    """Lock one resource and yield the description of the crashed program that had locked it; empty if none."""
    from filelock import Timeout

    lock, holder = _files(name)
    try:
        lock.acquire()
    except Timeout:
        raise BenchInUseError(name, _holder_text(holder) or "another program") from None
    except OSError as error:
        why = f"{lock.lock_file} cannot be opened ({error.strerror})"
        raise InstrumentError("bench", f"{name} cannot be locked", why, "remove that file as its owner") from None
    try:
        # A program that ends normally deletes the second file, so its text names a crashed one.
        crashed = _holder_text(holder)
        with suppress(OSError):
            holder.write_text(_this_program(), encoding="utf-8")
        yield crashed
    finally:
        with suppress(OSError):
            holder.unlink(missing_ok=True)
        lock.release()


def _files(name: str) -> tuple[FileLock, Path]:
    """Return the lock of a resource, and the path of the file that names its holder."""
    from filelock import FileLock

    path = _folder() / re.sub(r"[^A-Z0-9.]+", "-", name.upper())
    return FileLock(f"{path}.lock", timeout=0, mode=0o666), path.with_name(f"{path.name}.holder")


def _folder() -> Path:
    """Return the folder of this computer's locks, which all users may write to."""
    folder = Path(tempfile.gettempdir()) / "hpe_rig-locks"
    with suppress(OSError):
        folder.mkdir(exist_ok=True)
        folder.chmod(0o1777)
    return folder


def _holder_text(holder: Path) -> str:
    with suppress(OSError, UnicodeDecodeError):
        return " ".join(holder.read_text(encoding="utf-8")[:MAX_HOLDER_CHARACTERS].split())
    return ""


def _this_program() -> str:
    program = " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])[:100] if sys.argv else "Python"
    return f"process {os.getpid()} ({program}), since {datetime.now().astimezone().isoformat(' ', 'seconds')}"


def _to_standard_error(text: str) -> None:
    print(f"hpe-rig: {text}", file=sys.stderr)
