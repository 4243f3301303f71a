"""Atomic writing of files: written as a draft in the same folder, then renamed."""

from __future__ import annotations

import errno
import os
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hpe_rig.scene import Mistake, SettingsError
from hpe_rig.store.format import StoreError, reason

REPLACE_TIMEOUT_S = 2.0
"""Time to wait for a file that another program has open: a reader usually closes it at once."""
SHARING_VIOLATIONS = (5, 32)
"""Windows: access denied, and used by another process. POSIX replaces an open file, its readers keep the old one."""


@contextmanager
def atomic_file(path: Path, overwrite: bool = True) -> Iterator[Path]:
    """Yield the path of a draft, which is renamed to ``path`` when the block ends and deleted when it fails.

    Raises ``FileExistsError`` if ``path`` exists at the end and ``overwrite`` is False, and ``PermissionError`` if
    another program keeps the file open (Windows).
    """
    draft = _draft(path)
    try:
        yield draft
        if overwrite:
            _replace(draft, path)
        else:
            _rename_to_new(draft, path)
    finally:
        # After a rename the draft no longer exists.
        with suppress(OSError):
            draft.unlink()


def write_text_file(path: Path, text: str) -> None:
    """Write ``text`` completely or not at all, and make its folder; raise ``SettingsError`` if that is impossible."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as draft:
            draft.write_text(text, encoding="utf-8", newline="")
    except OSError as error:
        mistake = Mistake(str(path), f"cannot be written ({error.strerror})", "another folder, by --output")
        raise SettingsError("command line", [mistake]) from None


def replace_text(path: Path, text: str) -> None:
    """Replace the text of the file ``path`` completely or not at all; a link to it and its access rights stay."""
    target = path.resolve()
    with atomic_file(target) as draft:
        draft.write_text(text, encoding="utf-8", newline="")
        shutil.copymode(target, draft)


def refuse_unwritable(path: Path) -> None:
    """Raise ``StoreError`` if ``path`` cannot be written; called before the work starts."""
    if why := unwritable(path):
        if not path.parent.exists():
            raise StoreError(
                f"{path} cannot be written: the folder {path.parent} does not exist. Try: make it, or another --output."
            )
        raise StoreError(f"{path} cannot be written ({why}). Try: another folder or name.")


def unwritable(path: Path) -> str:
    """Return why ``path`` cannot be written, or "" if it can: a draft in its folder is created and deleted."""
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
    # Unique for each thread: another thread may still be waiting for a disk that does not respond.
    return path.with_name(f".{path.name}.{os.getpid()}-{threading.get_native_id()}.draft")


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
