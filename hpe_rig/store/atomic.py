"""Atomic writing of files: written as a draft in the same folder, synchronised, then renamed.

A draft is created exclusively, with a random name, and written through its open descriptor. So no link that another
user has placed in a shared folder is followed. After a power loss a file is either the earlier or the new one, whole.
"""

from __future__ import annotations

import errno
import os
import secrets
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final

from hpe_rig.store.format import StoreError, reason

REPLACE_TIMEOUT_S = 2.0
"""Time to wait for a file that another program has open: a reader usually closes it at once."""
SHARING_VIOLATIONS = (5, 32)
"""Windows: access denied, and used by another process. POSIX replaces an open file, its readers keep the old one."""
NO_FOLDER_SYNC: Final = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS, errno.EACCES, errno.EPERM)
"""Errors of file systems that cannot synchronise a folder, and of folders that may be written but not read."""


@contextmanager
def atomic_file(path: Path, overwrite: bool = True) -> Iterator[BinaryIO]:
    """Yield a draft open for writing, which becomes ``path`` when the block ends and is deleted when it fails.

    Its ``name`` is the draft's path, for libraries that open files themselves. Draft and folder are synchronised. A
    link at ``path`` is replaced, not followed. Raises ``FileExistsError`` if ``path`` exists at the end and
    ``overwrite`` is False, and ``PermissionError`` if another program keeps the file open (Windows). Errors of the
    operating system name ``path``.
    """
    try:
        file = _new_draft(path)
        draft = Path(file.name)
        try:
            with file:
                yield file
                synchronise(file)
            if overwrite:
                _replace(draft, path)
            else:
                _rename_to_new(draft, path)
            sync_folder(path.parent)
        finally:
            # After a rename the draft no longer exists.
            with suppress(OSError):
                draft.unlink()
    except OSError as error:
        if error.errno is None or error.filename == str(path):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def synchronise(file: BinaryIO) -> None:
    """Wait until the content of ``file`` is on the disk."""
    file.flush()
    os.fsync(file.fileno())


def write_file(path: Path, content: str | bytes, overwrite: bool = True) -> None:
    """Write ``content``, text as UTF-8, to ``path`` completely or not at all.

    Raises ``StoreError`` if that is impossible, or if ``path`` exists and ``overwrite`` is False.
    """
    try:
        with atomic_file(path, overwrite) as file:
            file.write(content.encode() if isinstance(content, str) else content)
    except FileExistsError:
        raise StoreError(f"{path} already exists and is not overwritten. Try: another name.") from None
    except (OSError, ValueError) as error:
        # An impossible file name raises ValueError.
        raise _not_written(path, error) from None


def replace_text(path: Path, text: str) -> None:
    """Replace the text of the file ``path`` completely or not at all; a link to it and its access rights stay.

    Raises ``StoreError`` if that is impossible.
    """
    try:
        target = path.resolve()
        with atomic_file(target) as file:
            # Through the descriptor, where the system can: the name could lead to another file by now.
            draft = file.fileno() if os.chmod in os.supports_fd else file.name
            os.chmod(draft, stat.S_IMODE(target.stat().st_mode))  # noqa: PTH101
            file.write(text.encode())
    except OSError as error:
        raise _not_written(path, error) from None


def make_folder(folder: Path, exist_ok: bool = True) -> None:
    """Make ``folder`` and its parents where absent, and synchronise them; raise ``StoreError`` if impossible."""
    try:
        absent = [parent for parent in (folder, *folder.parents) if not parent.exists()]
        folder.mkdir(parents=True, exist_ok=exist_ok)
        for new_folder in absent:
            sync_folder(new_folder.parent)
    except OSError as error:
        raise _not_written(folder, error) from None


def sync_folder(folder: Path) -> None:
    """Wait until the names in ``folder`` are on the disk, where the system can; raise ``OSError`` if the disk fails."""
    if sys.platform == "win32":
        return
    try:
        number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(number)
        finally:
            os.close(number)
    except OSError as error:
        if error.errno not in NO_FOLDER_SYNC:
            raise


def open_ordinary(path: str, flags: int) -> int:
    """Open an ordinary file, for ``open(..., opener=open_ordinary)``.

    Raises ``OSError`` for a link, a further name of a file, and a pipe, which another user may have placed there. It
    does not wait for the other end of a pipe.
    """
    try:
        number = os.open(path, flags | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0), 0o666)
    except OSError as error:
        if error.errno not in (errno.ELOOP, errno.ENXIO):
            raise
    else:
        status = os.fstat(number)
        if stat.S_ISREG(status.st_mode) and status.st_nlink == 1:
            return number
        os.close(number)
    raise OSError(errno.EINVAL, "it is a link or no ordinary file", path)


def _not_written(path: Path, error: BaseException) -> StoreError:
    why = reason(error) if isinstance(error, OSError) else error
    return StoreError(f"{path} cannot be written ({why}). Try: free space there, or another folder or name.")


def refuse_unwritable(path: Path) -> None:
    """Raise ``StoreError`` if ``path`` cannot be written; called before the work starts."""
    if why := unwritable(path):
        if not path.parent.exists():
            raise StoreError(
                f"{path} cannot be written: the folder {path.parent} does not exist. Try: make it, or another folder."
            )
        raise StoreError(f"{path} cannot be written ({why}). Try: another folder or name.")


def unwritable(path: Path) -> str:
    """Return why ``path`` cannot be written, or "" if it can: a draft in its folder is created and deleted."""
    try:
        if not path.name or path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        with _new_draft(path) as file:
            draft = Path(file.name)
        draft.unlink()
    except OSError as error:
        return reason(error)
    return ""


def _new_draft(path: Path) -> BinaryIO:
    """Return a new, empty file beside ``path``, open for reading and writing."""
    draft = path.with_name(f".{path.name}.{secrets.token_hex(8)}.draft")
    return open(draft, "x+b", opener=lambda name, flags: os.open(name, flags | getattr(os, "O_NOFOLLOW", 0), 0o666))


def _replace(draft: Path, path: Path) -> None:
    """Replace ``path`` by ``draft``; raise ``PermissionError`` if another program has it open for too long."""
    deadline_s = time.monotonic() + REPLACE_TIMEOUT_S
    while True:
        try:
            draft.replace(path)
            return
        except PermissionError as error:
            if getattr(error, "winerror", None) not in SHARING_VIOLATIONS:
                raise
            if time.monotonic() >= deadline_s:
                why = "another program has it open, close that program or page and try again"
                raise PermissionError(error.errno, why, str(path)) from error
        time.sleep(0.05)


def _rename_to_new(draft: Path, path: Path) -> None:
    """Rename ``draft`` to ``path``; raise ``FileExistsError`` if ``path`` exists.

    On POSIX a rename would replace an existing file, so a hard link is created instead.
    """
    if os.name != "posix":
        draft.rename(path)
        return
    try:
        path.hardlink_to(draft)
    except FileExistsError:
        raise
    except OSError:
        # On a file system without hard links, the check and the rename are two steps.
        if path.exists():
            raise FileExistsError(path) from None
        draft.rename(path)
