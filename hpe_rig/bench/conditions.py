"""Conditions of a bench, such as the temperature of the water: one number each, from a command or a plug-in.

A condition that cannot be read is NaN with a reason; no failure of a command or plug-in raises an exception.
"""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import IO, Final

from drivers.visa import within
from hpe_rig.bench.bench_file import Condition
from hpe_rig.extensions import CONDITIONS, installed, load
from hpe_rig.scene import printable

MAX_OUTPUT_BYTES: Final = 1000
MAX_WHY: Final = 400
"""Characters of the reason why a condition is not read."""
MAX_QUOTED: Final = 120
"""Characters of it that are quoted from a command or plug-in."""
KILL_S: Final = 1.0
"""Time that the system gets to end a command."""


@dataclass(frozen=True, slots=True)
class Reading:
    """A condition with its ``value``, NaN if it was not read, and then the reason."""

    condition: Condition
    value: float
    why: str = ""

    @property
    def accepted(self) -> bool:
        """Whether a shot may begin."""
        return self.condition.accepts(self.value)

    def __str__(self) -> str:
        limits = f", limits {self.condition.limits_text}" if self.condition.has_limits else ""
        reason = f" ({self.why})" if self.why else ""
        return f"{self.condition.name} {self.condition.value_text(self.value)}{reason}{limits}"


def read_conditions(conditions: Sequence[Condition]) -> tuple[Reading, ...]:
    """Return the readings of ``conditions``, one after another, each within its time-out."""
    return tuple(map(_read, conditions))


def _read(condition: Condition) -> Reading:
    try:
        value = (
            _of_command(condition) if condition.plugin is None else _of_plugin(condition.plugin, condition.timeout_s)
        )
        if not math.isfinite(value):
            raise ValueError(f"{value} is no finite number; check the sensor")
        return Reading(condition, value)
    except Exception as error:
        return Reading(condition, math.nan, printable(str(error).strip() or type(error).__name__)[:MAX_WHY])


def _of_command(condition: Condition) -> float:
    """Return the number that the command prints; raise if it prints none, fails or takes too long."""
    name = _quoted(condition.command[0])
    # Files instead of pipes: a process that the command leaves behind cannot hold up the reading.
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        process = _started(condition.command, output, errors)
        try:
            exit_code = process.wait(condition.timeout_s)
        except subprocess.TimeoutExpired:
            what = f"no answer of {name} within {condition.timeout_s:g} s"
            raise TimeoutError(f"{what}; check the sensor, or state a longer timeout_s") from None
        finally:
            # Also after Ctrl-C.
            if process.poll() is None:
                _end(process)
        text = _text(output)
        if exit_code:
            # Programs state the cause in their last line.
            cause = _quoted("".join(_text(errors).splitlines()[-1:])) or "no message"
            raise ValueError(f"{name} ended with exit code {exit_code}: {cause}; try the command in a terminal")
    try:
        return float(text)
    except ValueError:
        what = f"{name} printed '{_quoted(text)}', not one number"
        raise ValueError(f"{what}; let it print only a number with a decimal point, such as 20.5") from None


def _started(command: Sequence[str], output: IO[bytes], errors: IO[bytes]) -> subprocess.Popen[bytes]:
    """Return the started command, in a process group that can be ended as a whole."""
    group = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)
    try:
        # The command is the user's own, from the bench file that is named on the command line.
        return subprocess.Popen(  # noqa: S603
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=errors,
            start_new_session=sys.platform != "win32",
            creationflags=group,
        )
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        what = f"{_quoted(command[0])} cannot be started ({why})"
        raise ValueError(f"{what}; check the key command in the bench file, or write the full path") from None


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a command that still runs, with the processes that it has started."""
    # The system may have ended a process in between.
    with suppress(OSError, subprocess.TimeoutExpired):
        if sys.platform == "win32":
            arguments = ["taskkill", "/F", "/T", "/PID", str(process.pid)]
            subprocess.run(arguments, capture_output=True, timeout=KILL_S, check=False)  # noqa: S603
        else:
            os.killpg(process.pid, signal.SIGKILL)
    with suppress(OSError, subprocess.TimeoutExpired):
        process.kill()
        process.wait(KILL_S)


def _text(file: IO[bytes]) -> str:
    """Return the text in a temporary file, without space around it; bytes that are no text are escaped."""
    file.seek(0)
    return file.read(MAX_OUTPUT_BYTES).decode("utf-8", "backslashreplace").strip()


def _quoted(text: str) -> str:
    """Return the beginning of ``text`` on one line, with control characters escaped."""
    line = printable(text).replace("\n", "\\n")
    return line if len(line) <= MAX_QUOTED else f"{line[:MAX_QUOTED]}..."


_BUSY: Final[set[str]] = set()
"""Plug-ins that have not returned; these are not called again."""


def _of_plugin(name: str, timeout_s: float) -> float:
    """Return the number of the plug-in ``name``; raise if it is not installed, fails or takes too long."""
    if name not in installed(CONDITIONS):
        raise ValueError(f"no installed package has the entry point {name} in the group {CONDITIONS}; install it")
    if name in _BUSY:
        raise TimeoutError(f"the plug-in {name} has not returned since an earlier reading; check the sensor")
    _BUSY.add(name)
    try:
        outcome = within(timeout_s, lambda: _outcome_of_plugin(name))
    except TimeoutError:
        what = f"no answer of the plug-in {name} within {timeout_s:g} s"
        raise TimeoutError(f"{what}; check the sensor, or state a longer timeout_s") from None
    if isinstance(outcome, BaseException):
        what = f"the plug-in {name} failed ({type(outcome).__name__}: {_quoted(str(outcome))})"
        raise ValueError(f"{what}; check the sensor and the plug-in")
    return outcome


def _outcome_of_plugin(name: str) -> float | Exception | SystemExit:
    # An exception is returned, because a plug-in's own TimeoutError is another failure than no answer in time.
    try:
        return float(load(CONDITIONS, name)())
    except (Exception, SystemExit) as error:
        return error
    finally:
        _BUSY.discard(name)
