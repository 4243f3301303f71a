"""Conditions of a bench, such as the temperature of the water: one number each, from a command or a plug-in.

A condition that cannot be read is NaN with a reason; no failure of a command or plug-in raises an exception.
"""

from __future__ import annotations

import math
import subprocess
import tempfile
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import IO, Final

from hpe_rig.bench.bench_file import Condition
from hpe_rig.extensions import CONDITIONS, installed, load
from hpe_rig.scene import printable

MAX_OUTPUT_BYTES: Final = 1000
MAX_WHY: Final = 200
"""Characters of the reason why a condition is not read."""
KILL_S: Final = 1.0
"""Time that the system gets to end a command."""

Outcome = float | Exception


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
            raise ValueError(f"{value} is no finite number")
        return Reading(condition, value)
    except Exception as error:
        return Reading(condition, math.nan, printable(str(error).strip() or type(error).__name__)[:MAX_WHY])


def _of_command(condition: Condition) -> float:
    """Return the number that the command prints; raise if it prints none, fails or takes too long."""
    # Files instead of pipes: a process that the command leaves behind cannot hold up the reading.
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        # The command is the user's own, from the bench file that is named on the command line.
        process = subprocess.Popen(condition.command, stdin=subprocess.DEVNULL, stdout=output, stderr=errors)  # noqa: S603
        try:
            exit_code = process.wait(condition.timeout_s)
        except subprocess.TimeoutExpired:
            raise TimeoutError(f"no answer of {condition.command[0]} within {condition.timeout_s:g} s") from None
        finally:
            if process.poll() is None:
                process.kill()
                process.wait(KILL_S)
        text = _text(output)
        if exit_code:
            # Programs state the cause in their last line.
            cause = "".join(_text(errors).splitlines()[-1:])
            raise ValueError(f"{condition.command[0]} ended with exit code {exit_code}: {cause}")
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{condition.command[0]} printed {text!r}, not one number") from None


def _text(file: IO[bytes]) -> str:
    """Return the text in a temporary file, without space around it."""
    file.seek(0)
    return file.read(MAX_OUTPUT_BYTES).decode("utf-8", "replace").strip()


_BUSY: Final[dict[str, threading.Thread]] = {}
"""Latest thread of each plug-in; one that has not returned is not called again."""


def _of_plugin(name: str, timeout_s: float) -> float:
    """Return the number of the plug-in ``name``; raise if it is not installed, fails or takes too long."""
    if name not in installed(CONDITIONS):
        raise ValueError(f"no installed package has the entry point {name} in the group {CONDITIONS}")
    if name in _BUSY and _BUSY[name].is_alive():
        raise TimeoutError(f"the plug-in {name} has not returned since an earlier reading")
    outcome = SimpleQueue[Outcome]()
    # A plug-in cannot be ended from outside. Its thread does not keep the program alive.
    _BUSY[name] = threading.Thread(target=_call, args=(lambda: load(CONDITIONS, name)(), outcome), daemon=True)
    _BUSY[name].start()
    try:
        result = outcome.get(timeout=timeout_s)
    except Empty:
        raise TimeoutError(f"no answer of the plug-in {name} within {timeout_s:g} s") from None
    if isinstance(result, Exception):
        raise result
    return result


def _call(read: Callable[[], float], outcome: SimpleQueue[Outcome]) -> None:
    try:
        outcome.put(float(read()))
    except Exception as error:
        outcome.put(error)
