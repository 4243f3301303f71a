"""Names, versions and limits that writers and readers of run files share, and their one error."""

from __future__ import annotations

import platform
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Final
from uuid import uuid4

FORMAT: Final = "hpe_rig run"
FORMAT_VERSION: Final = 2
RESULT_FORMAT: Final = "hpe_rig result"

STAGES: Final = (
    "load",
    "plan",
    "take over",
    "open bench",
    "configure",
    "verify",
    "arm",
    "enable outputs",
    "wait",
    "fire",
    "collect",
    "store",
    "truth",
)
"""Stages of an acquisition, in the order of the run times in the run file; "collect" ends with every output off."""
STAGE_BYTES: Final = 16
MOST_STAGES: Final = 64
STATUSES: Final = ("running", "complete", "aborted", "failed")
STATUS_BYTES: Final = 8
"""Enough for running, complete, aborted and failed: the attribute changes during a run, so its size is fixed."""
RUN_ID_BYTES: Final = 32
"""Length of what tells a run from others of its name: random hexadecimal digits, empty where nobody may have to."""
SNAPSHOT_BYTES: Final = 8192
"""Enough for the settings of one shot as JSON; fixed, since nothing may be created while others read."""
CHUNK_BYTES: Final = 1_000_000
"""Size that a chunk of echoes has at least, if a shot has as much; a crash costs less than one and the last block."""
ROW_CHUNK: Final = 2048
"""Most pulses in one chunk of a quantity with one value per pulse, which is written as a whole with each of echoes."""
TIME_BYTES: Final = 32
"""Enough for a time in seconds with its offset from UTC, ISO 8601."""
UNTRUSTED_BYTES: Final = 1024
"""Enough to say why a shot is not to be trusted; more is cut."""
BITSHUFFLE: Final = 32008
"""Registered number of the HDF5 filter bitshuffle with LZ4."""


class StoreError(Exception):
    """A file that cannot be written or read; the message says which, why, and what to try."""


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Turn a package that is missing inside the block into a ``StoreError`` that names the extra ``name``."""
    try:
        yield
    except ModuleNotFoundError as error:
        remedy = f'pip install "hpe-rig[{name}]"'
        raise StoreError(f"this needs {error.name}, which is not installed. Try: {remedy}.") from None


def new_run_id() -> str:
    """Return what tells a run from every other."""
    return uuid4().hex


@cache
def versions() -> Mapping[str, str]:
    """Return the versions of Python and of the packages that produced the numbers, and the commit if known."""
    packages = {name: metadata.version(name) for name in ("numpy", "scipy", "h5py")}
    try:
        own = metadata.version("hpe-rig")
    except metadata.PackageNotFoundError:
        own = "not installed"
    commit = own.partition("+g")[2].partition(".")[0] or "unknown"
    return {"hpe_rig": own, "commit": commit, "python": platform.python_version(), **packages}


def free_path(stem: str, folder: Path) -> Path:
    """Return ``folder/stem.h5``, or the first numbered name after it that does not exist."""
    path, number = folder / f"{stem}.h5", 2
    while path.exists():
        path, number = folder / f"{stem}-{number}.h5", number + 1
    return path


def result_path(run_path: Path, estimator: str) -> Path:
    """Return the path of the result file beside a run file."""
    return run_path.with_name(f"{run_path.stem}.{estimator}.h5")


def reason(error: BaseException) -> str:
    """Return the cause of ``error`` in the operating system's words or plain ones, never in the HDF5 library's."""
    text = str(error)
    if found := re.search(r"error message = '([^']*)'", text):
        return found.group(1)
    if isinstance(error, OSError) and error.strerror and "nable to" not in error.strerror:
        return error.strerror
    if isinstance(error, MemoryError):
        return "it needs more memory than is available"
    return next((words for sign, words in _PLAIN.items() if sign in text), "the HDF5 library cannot read it")


_PLAIN: Final = {
    "allocate memory": "it needs more memory than is available",
    "start new thread": "it needs more memory than is available",
    "truncated file": "it is cut short",
    "signature not found": "it is not an HDF5 file",
    "unable to lock": "another program has it open",
    "already open": "another program has it open",
    "doesn't exist": "something in it is missing",
    "checksum": "its bytes do not match their checksums",
    "filter": "its records cannot be decompressed",
}
