"""Names, versions and limits that writers and readers of run files share, and their one error."""

from __future__ import annotations

import platform
import re
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Final
from uuid import uuid4

from hpe_rig.store.foreign_hdf5 import InvalidContentError

GIT_TIMEOUT_S: Final = 5.0
FORMAT: Final = "hpe_rig run"
FORMAT_VERSION: Final = 3
OLDEST_VERSION: Final = 2
"""Version 2 has checksums by BLAKE2b, or none, and was written in place during the run."""
LIBVER: Final = ("v110", "v110")
"""Readable with HDF5 1.10 and later."""
RESULT_FORMAT: Final = "hpe_rig result"
RESULT_VERSION: Final = 2
"""Version of result files. Version 1, not stated in the file, counted shots from 0 and called the tracked amplitude
``amplitude_m`` and the corrected one ``corrected_amplitude_m``."""
MAP_FORMAT: Final = "hpe_rig map"

STAGES: Final = (
    "load",
    "plan",
    "take over",
    "open bench",
    "read conditions",
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
"""Stages of an acquisition, in the order of the run times in the run file; all outputs are off after "collect"."""
STAGE_BYTES: Final = 16
STATUSES: Final = ("running", "complete", "aborted", "failed", "killed")
STATUS_BYTES: Final = 8
"""Enough for each status; the size is fixed, because the attribute is filled in when the run ends."""
RUN_ID_BYTES: Final = 32
"""Length of a run's identifier, random hexadecimal digits; empty for a run that needs none."""
SNAPSHOT_BYTES: Final = 8192
"""Enough for the settings of one shot as JSON; the size is fixed before the run."""
CHUNK_BYTES: Final = 1_000_000
"""Minimum size of a chunk of echoes, unless a shot is smaller."""
TIME_BYTES: Final = 32
"""Enough for a time in seconds with its offset from UTC, ISO 8601."""
UNTRUSTED_BYTES: Final = 1024
"""Enough for the reason why a shot is untrusted, and for changed settings; longer texts are cut."""
CONDITION_BYTES: Final = 32
"""Maximum length of the name of a condition."""
BITSHUFFLE: Final = 32008
"""Registered number of the HDF5 filter bitshuffle with LZ4."""


class StoreError(Exception):
    """A file that cannot be written or read; the message states the file, the cause and a remedy."""


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Raise ``StoreError`` naming the extra ``name`` if a package is missing inside the block."""
    try:
        yield
    except ModuleNotFoundError as error:
        remedy = f'pip install "hpe-rig[{name}]"'
        raise StoreError(f"this needs {error.name}, which is not installed. Try: {remedy}.") from None


def new_run_id() -> str:
    """Return a unique identifier."""
    return uuid4().hex


@cache
def versions() -> Mapping[str, str]:
    """Return the versions of Python and of the packages that produced the numbers, and the commit if known."""
    packages = {name: metadata.version(name) for name in ("numpy", "scipy", "h5py")}
    try:
        version = metadata.version("hpe-rig")
    except metadata.PackageNotFoundError:
        version = "not installed"
    return {"hpe_rig": version, "commit": _commit(), "python": platform.python_version(), **packages}


@cache
def _commit() -> str:
    """Return the commit of a working copy, with "-dirty" if its files differ from it; "unknown" outside of one."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return "unknown"
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=GIT_TIMEOUT_S, check=True)  # noqa: S603
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return done.stdout.strip()


def free_path(stem: str, folder: Path) -> Path:
    """Return ``folder/stem.h5``, or the first numbered name after it that does not exist."""
    path, number = folder / f"{stem}.h5", 2
    while path.exists():
        path, number = folder / f"{stem}-{number}.h5", number + 1
    return path


def result_path(run_path: Path, estimator: str) -> Path:
    """Return the path of an estimator's result file, in the folder of the run file."""
    return run_path.with_name(f"{run_path.stem}.{estimator}.h5")


def reason(error: BaseException) -> str:
    """Return the cause of ``error`` in the operating system's words or plain words, not in the HDF5 library's."""
    text = str(error)
    if isinstance(error, InvalidContentError):
        return text
    if system_message := re.search(r"error message = '([^']*)'", text):
        return system_message.group(1)
    if isinstance(error, OSError) and error.strerror and "nable to" not in error.strerror:
        return error.strerror
    if isinstance(error, MemoryError):
        return "it needs more memory than is available"
    return next(
        (words for hdf5_words, words in _CAUSES.items() if hdf5_words in text), "the HDF5 library cannot read it"
    )


_CAUSES: Final = {
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
