"""Lock of a bench's instruments between the programs of one computer: a file for each resource, shared by all users.

The system releases the lock when its process ends, for any reason. The file names the process, for a program that is
refused or that takes over after a crash. Any user can place something else under that name, so only an ordinary file
is opened, never a link or a pipe.
"""

from __future__ import annotations

import errno
import os
import re
import stat
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Final

from drivers.interfaces import InstrumentError
from hpe_rig.bench.bench_file import BenchFile
from hpe_rig.bench.resource_name import resolved_names, resource_names, shared_addresses
from hpe_rig.scene import SettingsError, printable

FOLDER_VARIABLE: Final = "HPE_RIG_LOCKS"
"""Environment variable that names another folder, for programs in containers that share instruments."""
SYSTEM_FOLDERS: Final = (Path("/run/lock"), Path("/tmp"))  # noqa: S108 - every user can reach it
"""Folders of locks on POSIX: the first one, if root has opened it to all users, otherwise the second one."""
SHARED_MODE: Final = 0o1777
"""Permissions of a folder where all users may create files, and remove only their own."""
MAX_HOLDER_BYTES: Final = 1000
MAX_HOLDER_CHARACTERS: Final = 300
"""Length of the text about another program that a message shows."""
MAX_NAME_CHARACTERS: Final = 200
"""Length of a resource's name in that of its file; file systems permit 255 bytes."""
SAFE_FLAGS: Final[int] = (
    getattr(os, "O_NOFOLLOW", 0)
    | getattr(os, "O_NONBLOCK", 0)
    | getattr(os, "O_NOCTTY", 0)
    | getattr(os, "O_BINARY", 0)
)
"""Open no link, do not wait for the other end of a pipe."""


class BenchInUseError(InstrumentError):
    """Another program uses an instrument of the bench; ``holder`` names it and the start time."""

    def __init__(self, resource: str, holder: str) -> None:
        why = "two programs on one bench would measure each other's settings"
        remedy = "wait until it has ended or end it; in an emergency hpe-rig bench BENCH --off switches off anyway"
        super().__init__("bench", f"{resource} is in use by {holder}", why, remedy)
        self.resource = resource
        self.holder = holder


def resources(bench: BenchFile, resolve: bool = True) -> list[str]:
    """Return the names of the instruments that a real bench locks; none for a simulated one.

    Without ``resolve`` host names stay as they are written, and no network is waited for.
    """
    if bench.simulated:
        return []
    return _lock_names(bench, resolved_names(bench) if resolve else resource_names(bench))


@contextmanager
def exclusive(bench: BenchFile) -> Iterator[None]:
    """Lock every instrument of a real bench; raises as ``locked``.

    Raises ``SettingsError`` if two roles have one instrument.
    """
    if bench.simulated:
        yield
        return
    names = resolved_names(bench)
    if mistakes := list(shared_addresses(bench, names)):
        raise SettingsError("the bench file", mistakes)
    with locked(_lock_names(bench, names)):
        yield


def _lock_names(bench: BenchFile, names: Mapping[str, str]) -> list[str]:
    board = f"Alazar system {bench.digitizer.system_id} board {bench.digitizer.board_id}"
    # An instrument that another bench file reaches by a different interface has the same serial number there.
    serials = (f"serial number {serial}" for serial in bench.serials.values())
    # Also the names without resolution: another program may get no answer to it.
    # Every program locks in the same order, so that two cannot block each other.
    return sorted({*names.values(), *resource_names(bench).values(), *serials, board})


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
    # Whatever is wrong with the file, it must not prevent switching outputs off.
    with suppress(OSError):
        path = _path(name)
        if not path.exists():
            return None
        file = _open(path)
        try:
            return None if _acquired(file) else _holder_text(file) or "another program"
        finally:
            os.close(file)
    return None


@contextmanager
def _lock(name: str) -> Iterator[str]:
    """Lock one resource and yield the description of the crashed program that had locked it; empty if none."""
    path = _path(name)
    with ExitStack() as stack:
        try:
            file = _open(path)
            stack.callback(os.close, file)
            acquired = _acquired(file)
        except OSError as error:
            why = f"{path} cannot be used: {error.strerror or error}"
            remedy = "remove that file as its owner or as the administrator"
            raise InstrumentError("bench", f"{name} cannot be locked", why, remedy) from None
        if not acquired:
            raise BenchInUseError(name, _holder_text(file) or "another program")
        # A program that ends normally clears the text, so that a text names a crashed one.
        crashed = _holder_text(file)
        _write_holder(file, _this_program())
        try:
            yield crashed
        finally:
            _write_holder(file, "")


def _path(name: str) -> Path:
    return lock_folder() / f"hpe_rig-{re.sub(r'[^A-Z0-9.]+', '-', name.upper())[:MAX_NAME_CHARACTERS]}.lock"


def lock_folder() -> Path:
    """Return the folder of this computer's locks, which does not depend on the user or the temporary folder."""
    if stated := os.environ.get(FOLDER_VARIABLE):
        return Path(stated)
    if sys.platform == "win32":
        folder = Path(os.environ.get("PROGRAMDATA", r"C:\ProgramData")) / "hpe_rig-locks"
        # Other users may create files there by the permissions that it inherits.
        with suppress(OSError):
            folder.mkdir(exist_ok=True)
        return folder
    first, second = SYSTEM_FOLDERS
    return first if _is_shared(first) else second


def _is_shared(folder: Path) -> bool:
    """Return whether every user may create files in ``folder``, a folder of root."""
    with suppress(OSError):
        status = folder.lstat()
        # Permissions instead of an attempt: root and every other user must find one folder.
        return stat.S_ISDIR(status.st_mode) and status.st_uid == 0 and status.st_mode & SHARED_MODE == SHARED_MODE
    return False


def _open(path: Path) -> int:
    """Return the descriptor of the ordinary file ``path``, made if there is none; raise ``OSError`` otherwise."""
    try:
        _refuse_unusual(path.lstat())
    except FileNotFoundError:
        with suppress(FileExistsError):
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | SAFE_FLAGS, 0o666)
            if sys.platform != "win32":
                # The umask may have removed the permissions of other users.
                os.fchmod(file, 0o666)
            return file
    # Without O_CREAT, which Linux refuses for files of other users in a shared folder.
    try:
        file = os.open(path, os.O_RDWR | SAFE_FLAGS)
    except PermissionError:
        # A file that only its owner may change can be locked by everybody who may read it.
        file = os.open(path, os.O_RDONLY | SAFE_FLAGS)
    try:
        _refuse_unusual(os.fstat(file))
    except OSError:
        os.close(file)
        raise
    return file


def _refuse_unusual(status: os.stat_result) -> None:
    """Raise ``OSError`` for anything but an ordinary file with a single name."""
    if stat.S_ISREG(status.st_mode) and status.st_nlink == 1:
        return
    kind = "a link" if stat.S_ISLNK(status.st_mode) or stat.S_ISREG(status.st_mode) else "no ordinary file"
    raise OSError(errno.EINVAL, f"it is {kind}, which user {status.st_uid} has placed there")


if sys.platform == "win32":
    import msvcrt

    def _acquired(file: int) -> bool:
        """Lock the open ``file`` until it is closed; return False if another program has it locked."""
        # The locked byte lies beyond the text, which other programs read.
        os.lseek(file, 1 << 30, os.SEEK_SET)
        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

else:
    import fcntl

    def _acquired(file: int) -> bool:
        """Lock the open ``file`` until it is closed; return False if another program has it locked."""
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True


def _holder_text(file: int) -> str:
    with suppress(OSError):
        os.lseek(file, 0, os.SEEK_SET)
        text = os.read(file, MAX_HOLDER_BYTES).decode("utf-8", "replace")
        return printable(" ".join(text.split())[:MAX_HOLDER_CHARACTERS])
    return ""


def _write_holder(file: int, text: str) -> None:
    # The lock holds without the text, for example on a full disk.
    with suppress(OSError):
        os.ftruncate(file, 0)
        os.lseek(file, 0, os.SEEK_SET)
        os.write(file, text.encode("utf-8", "replace"))


def _this_program() -> str:
    program = " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])[:100] if sys.argv else "Python"
    return f"process {os.getpid()} ({program}), since {datetime.now().astimezone().isoformat(' ', 'seconds')}"


def _to_standard_error(text: str) -> None:
    print(f"hpe-rig: {text}", file=sys.stderr)
