"""Opening of a run: its file in HDF5 or, while it goes on or after its program was killed, its log."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from hpe_rig.store.assembly import view_of
from hpe_rig.store.foreign_hdf5 import InvalidContentError
from hpe_rig.store.format import StoreError, reason
from hpe_rig.store.log import is_log
from hpe_rig.store.validation import CheckedFile, checked_run, declared_size, open_hdf5


@contextlib.contextmanager
def open_checked(path: Path) -> Iterator[CheckedFile]:
    """Yield the content of the run ``path``, also while another program writes it; raise ``StoreError`` if invalid."""
    try:
        with _open_unchecked(path) as unchecked:
            yield checked_run(unchecked)
    except InvalidContentError as error:
        raise StoreError(
            f"{path} is not a readable run file: {error}. It is damaged, was changed, or comes from elsewhere. "
            "Try: a file written by hpe-rig run."
        ) from None
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError, MemoryError) as error:
        raise StoreError(
            f"{path} is not a readable run file ({reason(error)}). It is cut short, damaged or comes from elsewhere. "
            "Try: a copy of it, or measure again."
        ) from error


@contextlib.contextmanager
def _open_unchecked(path: Path) -> Iterator[CheckedFile]:
    """Yield the log or HDF5 file ``path`` before it is known to be a run.

    Each dataset is checked when it is read (`CheckedFile`); format and shape of the run are checked by ``checked_run``.
    """
    if is_log(path):
        with path.open("rb", buffering=0) as stream:
            yield view_of(path, stream)
        return
    declared, size = declared_size(path), path.stat().st_size
    with open_hdf5(path) as file:
        yield CheckedFile(file, size, missing_bytes=declared - size)
