"""APPLy: sets a whole waveform with one command and **switches the output on at once**, as on the instrument."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from sim_backend.generator.commands import AMPLITUDE, FREQUENCY, OFFSET
from sim_backend.generator.kinds import SettingCommand, Write
from sim_backend.generator.registers import Coerced, Registers
from sim_backend.generator.scpi_text import ScpiError, short_form
from sim_backend.generator.timing import set_function

SHAPES: Mapping[str, Mapping[str, float]] = {"SQU": {"duty_percent": 50.0}, "RAMP": {"symmetry_percent": 100.0}}
"""Settings of the command in addition to its arguments."""
IGNORED_ARGUMENTS = {"DC": 2, "NOIS": 1}
"""How many of frequency, amplitude and offset, in this order, are ignored."""


def _apply(function: str) -> Write:
    """Return the function that executes APPLy for a waveform: it sets frequency, amplitude, offset, and output on."""

    def write(state: Registers, arguments: tuple[str, ...]) -> Coerced:
        """Return the registers after APPLy with ``arguments`` (frequency, amplitude, offset), and errors to queue."""
        if len(arguments) > 3:
            raise ScpiError(-108, "Parameter not allowed")
        frequency, amplitude, offset = (*arguments, "", "", "")[:3]
        # Internal trigger, no burst. A given frequency is set below; until then 1 kHz is within every limit.
        shape = SHAPES.get(function, {})
        start = replace(state, trigger_source="IMM", burst=False, range_auto="1", **shape)  # type: ignore[arg-type]
        start = replace(start, frequency_hz=1e3 if frequency else state.frequency_hz)
        coerced = set_function(start, function)
        # The present offset must not limit a new amplitude that comes with a new offset.
        values = [(OFFSET, "0")] if amplitude and offset else []
        all_values = [(FREQUENCY, frequency), (AMPLITUDE, amplitude), (OFFSET, offset)]
        values += all_values[IGNORED_ARGUMENTS.get(function, 0) :]
        for setting, text in values:
            if text:
                coerced = coerced.then(partial(setting.execute, arguments=(text,)))
        return coerced.changed(output=True)

    return write


def _present_waveform(state: Registers, arguments: tuple[str, ...]) -> str:
    """Return the reply to APPLy?: function, frequency, amplitude and offset in quotes."""
    values = ",".join(setting.answer(state, ()) for setting in (FREQUENCY, AMPLITUDE, OFFSET))
    return f'"{state.function} {values}"'


def apply_forms(functions: str) -> Mapping[str, SettingCommand]:
    """Return the commands APPLy for ``functions``, by the form of their header.

    As the manual says; the effect on the trigger source is that of the sibling models.
    """
    accepts = "frequency, amplitude, offset: numbers with units, MIN, MAX, DEF; omitted ones stay"
    forms = {
        f"[SOURce<n>:]APPLy:{function}": SettingCommand(_apply(short_form(function)), None, accepts)
        for function in functions.split()
    }
    return {**forms, "[SOURce<n>:]APPLy": SettingCommand(None, _present_waveform)}
