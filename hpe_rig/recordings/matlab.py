"""MATLAB's files of version 5 as NPZ, by a program of its own: SciPy's reader may crash or never end on damaged bytes.

Of 1000 files with one or two bytes changed ten ended the interpreter and two went on for ever (SciPy 1.17). So the file
is read in another process, whose end is judged here.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

PATIENCE_S = 60.0
"""How long the reader may take, and a second more for every megabyte."""
NOT_WRITTEN, TOO_LARGE = 3, 4
"""Exit codes of the reader where not the file is at fault."""
KILLED = -9
"""What a process returns that POSIX's SIGKILL ended."""
TEMPORARY_REMEDY = "free space there, or another folder in the environment variable TMPDIR"
PREFIX = "of "
"""Before every name in the NPZ file, whose writer has names of its own."""


def matlab_to_npz(path: Path, npz: Path) -> None:
    """Write the numbers of ``path``, also those in its structures, to ``npz``.

    Raises ``ValueError`` where the file is damaged, and where memory or the disk of ``npz`` are too small for it.
    """
    command = [sys.executable, "-P", __file__, str(path), str(npz)]
    patience_s = PATIENCE_S + path.stat().st_size / 1e6
    try:
        # This file, by this interpreter: nothing of the file's is a part of the command.
        done = subprocess.run(command, capture_output=True, text=True, timeout=patience_s, check=False)  # noqa: S603
    except subprocess.TimeoutExpired:
        raise ValueError(
            f"it is a damaged MATLAB file (no end of it within {patience_s:.0f} s): save it anew"
        ) from None
    why = (done.stderr.strip().splitlines() or ["no reason given"])[-1][:160]
    if done.returncode == NOT_WRITTEN:
        raise ValueError(
            f"its numbers cannot be written to temporary files in {npz.parent.parent} ({why}): {TEMPORARY_REMEDY}"
        )
    if done.returncode == TOO_LARGE:
        raise ValueError(f"its numbers do not fit in memory ({why}): part of them, or more memory")
    if done.returncode == 1:
        raise ValueError(f"it is no whole MATLAB file of version 5 or 7.3 ({why}): save it anew")
    if done.returncode == KILLED:
        raise ValueError("the system ended its reader, as it does where memory runs out: part of it, or more memory")
    if done.returncode:
        raise ValueError("it is a damaged MATLAB file (SciPy's reader crashed on it): save it anew")


def _convert(path: str, npz: str) -> None:
    from scipy.io import loadmat

    found = loadmat(path, struct_as_record=True, squeeze_me=False)
    values = {name: value for name, value in found.items() if not name.startswith("__")}
    # Text and cells hold no samples.
    arrays = {f"{PREFIX}{name}": value for name, value in _fields(values) if value.dtype.kind in "iufc"}
    try:
        np.savez(npz, **arrays)  # type: ignore[arg-type]
    except OSError as error:
        _leave(NOT_WRITTEN, error.strerror or str(error))


def _leave(code: int, why: str) -> NoReturn:
    sys.stderr.write(f"{why}\n")
    sys.exit(code)


def _fields(values: Mapping[str, Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield arrays by name; those in a structure of one element as STRUCTURE.FIELD."""
    for name, value in values.items():
        if isinstance(value, np.ndarray) and value.dtype.names and value.size == 1:
            inside = {f"{name}.{key}": value.reshape(-1)[0][key] for key in value.dtype.names}
            yield from _fields(inside)
        elif isinstance(value, np.ndarray):
            yield name, value


if __name__ == "__main__":
    try:
        _convert(*sys.argv[1:])
    except MemoryError as error:
        _leave(TOO_LARGE, str(error) or "MemoryError")
    except Exception as error:
        # Whatever damaged bytes lead to.
        sys.exit(str(error).partition("\n")[0] or type(error).__name__)
