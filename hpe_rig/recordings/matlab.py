"""Conversion of MATLAB files of version 5 to NPZ in a separate process.

SciPy's reader may crash or not terminate on damaged files: of 1000 files with one or two changed bytes, ten ended the
interpreter and two did not terminate (SciPy 1.17). So this module runs itself as a program and judges its exit code.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

TIMEOUT_S = 60.0
"""Longest time of the reader, plus one second per megabyte."""
MEMORY_RATIO = 3
"""Memory of the reader relative to its numbers: bytes, array and stacked array."""
EXIT_NOT_WRITTEN, EXIT_OUT_OF_MEMORY = 3, 4
"""Exit codes of the reader for errors that are not in the file."""
EXIT_KILLED = -9
"""Exit code of a process that SIGKILL ended."""
TEMPORARY_REMEDY = "free space there, or another folder in the environment variable TMPDIR"
PREFIX = "of "
"""Prefix of every name in the NPZ file: `numpy.savez` reserves some names."""


def matlab_to_npz(path: Path, npz: Path, max_bytes: int) -> None:
    """Write the arrays of ``path``, including those in structures, to ``npz``.

    Raises ``ValueError`` if the file is damaged, if its numbers expand to more than ``max_bytes``, or if they are too
    large for the memory or the disk of ``npz``.
    """
    command = [sys.executable, "-P", __file__, str(path), str(npz), str(MEMORY_RATIO * max_bytes)]
    timeout_s = TIMEOUT_S + path.stat().st_size / 1e6
    try:
        # The command runs this module by this interpreter. The content of the file is no part of it.
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, check=False)  # noqa: S603
    except subprocess.TimeoutExpired:
        raise ValueError(f"it is a damaged MATLAB file (not read within {timeout_s:.0f} s): save it anew") from None
    why = (done.stderr.strip().splitlines() or ["no reason given"])[-1][:160]
    if done.returncode == EXIT_NOT_WRITTEN:
        raise ValueError(
            f"its numbers cannot be written to temporary files in {npz.parent.parent} ({why}): {TEMPORARY_REMEDY}"
        )
    if done.returncode == EXIT_OUT_OF_MEMORY:
        raise ValueError(
            f"its numbers take more memory than is available, or than the {max_bytes / 1e6:.0f} MB that this file may "
            f"expand to ({why}): part of them, or a file without compression"
        )
    if done.returncode == 1:
        raise ValueError(f"it is no whole MATLAB file of version 5 or 7.3 ({why}): save it anew")
    if done.returncode == EXIT_KILLED:
        raise ValueError("the system killed its reader, probably for lack of memory: part of it, or more memory")
    if done.returncode:
        raise ValueError("it is a damaged MATLAB file (SciPy's reader crashed on it): save it anew")


def _convert(path: str, npz: str, max_bytes: str) -> None:
    from scipy.io import loadmat

    _limit_memory(int(max_bytes))
    variables = loadmat(path, struct_as_record=True, squeeze_me=False)
    values = {name: value for name, value in variables.items() if not name.startswith("__")}
    # Text and cells hold no samples.
    arrays = {f"{PREFIX}{name}": value for name, value in _fields(values) if value.dtype.kind in "iufc"}
    try:
        np.savez(npz, **arrays)  # type: ignore[arg-type]
    except OSError as error:
        _exit(EXIT_NOT_WRITTEN, error.strerror or str(error))


def _limit_memory(max_bytes: int) -> None:
    """Limit the memory of this process to ``max_bytes`` more than it has, where the system can (Linux)."""
    if sys.platform == "linux":
        import resource

        in_use = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (in_use + max_bytes, resource.getrlimit(resource.RLIMIT_AS)[1]))


def _exit(code: int, why: str) -> NoReturn:
    sys.stderr.write(f"{why}\n")
    sys.exit(code)


def _fields(values: Mapping[str, Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield arrays with their names, those of structures as STRUCTURE.FIELD; elements become the first axis."""
    for name, value in values.items():
        if not isinstance(value, np.ndarray):
            continue
        if value.dtype.names:
            if {"command", "argument"} <= set(value.dtype.names):
                yield from _commands(name, value.reshape(-1))
            for key in value.dtype.names:
                elements = [element[key] for element in value.reshape(-1)]
                # Times of the elements of an array of structures are those of pulses.
                is_time = value.size > 1 and key.lower() in ("t", "time")
                yield from _stacked(f"{name}.{key}.pulse_time" if is_time else f"{name}.{key}", elements)
        elif value.dtype == np.object_:
            yield from _stacked(name, list(value.reshape(-1)))
        else:
            yield name, value


def _commands(name: str, structures: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the numbers in ``argument`` of an array of structures by the text in their ``command``."""
    arguments: dict[str, list[float]] = {}
    for command, argument in zip(structures["command"], structures["argument"], strict=True):
        if _is_numeric(argument) and argument.size == 1:
            arguments.setdefault("".join(map(str, np.ravel(command))), []).append(float(argument.real.item()))
    for text, numbers in arguments.items():
        yield f"{name}.{text}", np.array(numbers)


def _stacked(name: str, elements: list[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the elements of a cell or of a field as one array, if they are arrays of numbers of one shape."""
    if len(elements) == 1:
        yield from _fields({name: elements[0]})
        return
    shapes = {element.shape if _is_numeric(element) else None for element in elements}
    if len(shapes) == 1 and None not in shapes:
        yield name, np.stack(elements)


def _is_numeric(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.kind in "iufc"


if __name__ == "__main__":
    try:
        _convert(*sys.argv[1:])
    except MemoryError as error:
        _exit(EXIT_OUT_OF_MEMORY, str(error) or "MemoryError")
    except Exception as error:
        # Damaged bytes may raise any exception.
        sys.exit(str(error).partition("\n")[0] or type(error).__name__)
