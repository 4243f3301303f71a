"""Files that appear whole or not at all: written as a draft beside their place and renamed."""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hpe_rig.store.format import StoreError, reason

PATIENCE_S = 2.0
"""How long a file that another program has open is waited for: a reader is usually done at once."""
SHARING_VIOLATIONS = (5, 32)
"""Windows: access denied, and used by another process. POSIX replaces an open file, its readers keep the old one."""


@contextmanager
def atomic_file(path: Path, overwrite: bool = True) -> Iterator[Path]:
    """Yield a draft beside ``path``, which becomes ``path`` when the block ends and is deleted where it fails.

    Raises ``FileExistsError`` at the end where ``path`` is taken and must not be overwritten, ``PermissionError`` where
    it is to be replaced and another program keeps it open (Windows).
    """
    draft = _draft(path)
    try:
        yield draft
        if overwrite:
            _replace(draft, path)
        else:
            _rename_to_new(draft, path)
    finally:
        # Gone already where all went well.
        with suppress(OSError):
            draft.unlink()


def refuse_unwritable(path: Path) -> None:
    """Raise ``StoreError`` where ``path`` cannot be written, before the work whose result it is to hold."""
    if why := unwritable(path):
        if not path.parent.exists():
            raise StoreError(
                f"{path} cannot be written: the folder {path.parent} does not exist. Try: make it, or another --output."
            )
        raise StoreError(f"{path} cannot be written ({why}). Try: another folder or name.")


def unwritable(path: Path) -> str:
    """Return why ``path`` cannot be written, empty where it can; leaves nothing behind.

    Its folder must exist and take files, and its name leave room for a draft's.
    """
    try:
        if not path.name or path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        draft = _draft(path)
        draft.open("xb").close()
        draft.unlink()
    except OSError as error:
        return reason(error)
    return ""


def _draft(path: Path) -> Path:
    # Of this thread alone: another may still be waiting for a disk that does not answer.
    return path.with_name(f".{path.name}.{os.getpid()}-{threading.get_native_id()}.draft")


def _replace(draft: Path, path: Path) -> None:
    """Rename over ``path``; wait for one who has it open, then raise ``PermissionError`` that says so."""
    deadline_s = time.monotonic() + PATIENCE_S
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
    """Rename, raising ``FileExistsError`` where ``path`` is taken: a link on POSIX, where a rename would replace it."""
    if os.name != "posix":
        draft.rename(path)
        return
    try:
        path.hardlink_to(draft)
    except FileExistsError:
        raise
    except OSError:
        # A file system without links: the check and the rename are then two steps.
        if path.exists():
            raise FileExistsError(path) from None
        draft.rename(path)
