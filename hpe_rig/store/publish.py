"""Creation of a run file: only where it fits, whole or not at all, open to readers from its first moment."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import h5py
from h5py import h5f, h5p

from hpe_rig.store.atomic import atomic_file
from hpe_rig.store.format import StoreError, reason


def refuse_small_disk(path: Path, needed: int) -> None:
    """Raise ``StoreError`` where the disk of ``path`` has less than ``needed`` bytes free."""
    try:
        free = shutil.disk_usage(path.parent).free
    except OSError:
        # Whatever is wrong with the folder is reported when the file is created.
        return
    if free < needed:
        raise StoreError(
            f"{path}: the run needs {needed / 1e6:.6g} MB, the disk has {free / 1e6:.6g} MB free. "
            "Try: another folder with --output, --compress, or fewer repeats."
        )


def publish(image: bytes, path: Path, overwrite: bool) -> None:
    """Create ``path`` with the bytes ``image``, whole or not at all; raise ``StoreError`` where it cannot be."""
    try:
        with atomic_file(path, overwrite) as draft, draft.open("xb") as file:
            file.write(image)
            file.flush()
            os.fsync(file.fileno())
    except FileExistsError:
        raise StoreError(f"{path} already exists. Try: another --output, or --overwrite.") from None
    except OSError as error:
        raise StoreError(f"{path} cannot be created ({reason(error)}). Try: another folder with --output.") from None


def open_for_readers(path: Path) -> h5py.File:
    """Open ``path`` in HDF5's single-writer-multiple-reader mode, so that it stays readable if its writer is killed."""
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_libver_bounds(h5f.LIBVER_V110, h5f.LIBVER_V110)
    return h5py.File(h5f.open(os.fsencode(path), h5f.ACC_RDWR | h5f.ACC_SWMR_WRITE, access))
