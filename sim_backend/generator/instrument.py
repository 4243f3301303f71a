"""Instrument, the 33250A as a program sees it: messages in, replies and errors out, registers with their history."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from sim_backend.generator.commands import SettingCommand, settings_of
from sim_backend.generator.emission import is_endless, respond, shapes_output
from sim_backend.generator.models import AGILENT_33250A, MODELS, Model
from sim_backend.generator.registers import Registers
from sim_backend.generator.scpi_text import Command, HeaderTable, ScpiError
from sim_backend.generator.status import Status
from sim_backend.wiring import Emission, SimulatedClock, Steps, to_ps

Form = TypeVar("Form")

SCPI_VERSION = "1999.0"
"""Per manual; an emulator that was compared with hardware answers 1994.0 (unresolved)."""


class Generator33250A:
    """One simulated 33250A or sibling; what it puts out follows from its history by ``emission``.

    Assumed of local mode, into which the front panel puts an instrument on RS-232: settings are refused with error 550,
    queries are answered.
    """

    def __init__(self, clock: SimulatedClock, latency_s: float, model: Model = AGILENT_33250A) -> None:
        self._clock = clock
        self._latency_ps = to_ps(latency_s)
        self._replies: list[str] = []
        self._table = TABLES[model.name]
        self.registers = Registers(model)
        self._history: list[tuple[int, Registers]] = [(clock.now_ps, self.registers)]
        self._software_ps: list[int] = []
        self._over_serial = False
        # On GPIB the bus itself claims the instrument; RS-232 has no such line.
        self._local = True
        self.status = Status()
        self.changes = 0

    def write(self, message: str, over_serial: bool = False) -> None:
        """Carry out the commands of ``message``; a mistake goes to the error queue and ends the message."""
        self._over_serial = over_serial
        if self._replies:
            self._replies.clear()
            self.status.queue(-410, "Query INTERRUPTED")
        try:
            for command in self._table.commands(message):
                reply = self._carry_out(command)
                if reply is not None:
                    self._replies.append(reply)
        except ScpiError as error:
            self.status.queue(error.number, error.text)

    def read(self) -> str:
        """Return the reply to the last message; raise ``TimeoutError`` where it asked nothing that can be answered."""
        if not self._replies:
            raise TimeoutError("the 33250A has nothing to say: no query, or one that it does not know (see SYST:ERR?)")
        reply = ";".join(self._replies)
        self._replies.clear()
        return reply

    def close(self) -> None:
        """Forget a reply that nobody read; the instrument itself stays as it is."""
        self._replies.clear()

    def serial_poll(self) -> int:
        """Return the status byte as the bus reads it, without a message."""
        return int(self.status.byte(self.message_waiting))

    def hold(self, local: bool) -> None:
        """Go to local or to remote mode; raise ``ScpiError`` 514 where the message did not come over RS-232."""
        if not self._over_serial:
            raise ScpiError(514, "Command allowed only with RS-232")
        self._local = local

    @property
    def message_waiting(self) -> bool:
        """Whether a reply waits to be read."""
        return bool(self._replies)

    @property
    def endless(self) -> bool:
        """Whether the output goes on without further triggers."""
        return is_endless(self.registers)

    @property
    def software_triggers_ps(self) -> tuple[int, ...]:
        """When a command started a burst, since ``forget_past``."""
        return tuple(self._software_ps)

    def emission(self, arriving: Steps, until_ps: int) -> Emission:
        """Return what was and, if nothing changes, will be put out, given the voltage at Trig In."""
        return respond(self._history, self._software_ps, arriving, self._latency_ps, until_ps)

    def forget_past(self) -> None:
        """Begin the history now; for when nothing is going on any more."""
        self._history = [(self._clock.now_ps, self.registers)]
        self._software_ps = []

    def reset(self) -> None:
        """Return to the power-on state; the beeper keeps its setting."""
        self._become(Registers(self.registers.model, beeper=self.registers.beeper))

    def trigger(self) -> None:
        """Start a burst, whatever the trigger source; raise ``ScpiError`` -211 where bursts are off."""
        if not self.registers.burst:
            raise ScpiError(-211, "Trigger ignored")
        self._software_ps.append(self._clock.now_ps)
        self.changes += 1

    def trigger_from_bus(self) -> None:
        """Start a burst; raise ``ScpiError`` -211 unless the bus is the trigger source."""
        if self.registers.trigger_source != "BUS":
            raise ScpiError(-211, "Trigger ignored")
        self.trigger()

    def wait(self) -> None:
        """Let the burst that a command started come to its end."""
        length_s = self.registers.delay_s + self.registers.burst_s
        if self._software_ps and self.registers.trigger_source == "BUS" and math.isfinite(length_s):
            self._clock.advance_to(self._software_ps[-1] + self._latency_ps + to_ps(length_s))

    def _carry_out(self, command: Command[SettingCommand | Action]) -> str | None:
        entry, arguments = command.entry, command.arguments
        if self._over_serial and self._local and not command.query and entry not in REMOTE:
            raise ScpiError(550, "Command not allowed in local")
        if isinstance(entry, Action):
            return entry.carry_out(self, command.query, arguments)
        if command.query:
            return _existing(entry.read)(self.registers, arguments)
        coerced = _existing(entry.write)(self.registers, arguments)
        self._become(coerced.registers)
        for number, text in coerced.errors:
            self.status.queue(number, text)
        return None

    def _become(self, registers: Registers) -> None:
        if shapes_output(self.registers, registers):
            self._history.append((self._clock.now_ps, registers))
            self.changes += 1
        elif not registers.output:
            # Nothing shows while the output is off: the last state before it goes on is all that counts.
            self._history[-1] = (self._history[-1][0], registers)
        self.registers = registers


@dataclass(frozen=True, slots=True)
class Action:
    """What a header does that is no setting: as a command, and as a query."""

    command: Callable[[Generator33250A, tuple[str, ...]], None] | None = None
    query: Callable[[Generator33250A], str] | None = None

    def carry_out(self, instrument: Generator33250A, query: bool, arguments: tuple[str, ...]) -> str | None:
        """Return the reply of the query, or carry the command out; ``ScpiError`` -113 for a form that is missing."""
        if query:
            return _existing(self.query)(instrument)
        _existing(self.command)(instrument, arguments)
        return None


def _existing(form: Form | None) -> Form:
    if form is None:
        raise ScpiError(-113, "Undefined header")
    return form


def _wait_and_answer(instrument: Generator33250A) -> str:
    instrument.wait()
    return "1"


def _beep(instrument: Generator33250A, arguments: tuple[str, ...]) -> None:
    """Make no noise: there is nobody to hear it."""


ACTIONS: Mapping[str, Action] = {
    "*IDN": Action(query=lambda instrument: instrument.registers.model.identity),
    "*RST": Action(lambda instrument, arguments: instrument.reset()),
    "*CLS": Action(lambda instrument, arguments: instrument.status.clear()),
    "*TRG": Action(lambda instrument, arguments: instrument.trigger_from_bus()),
    "*WAI": Action(lambda instrument, arguments: instrument.wait()),
    "*OPC": Action(lambda instrument, arguments: instrument.status.complete(), _wait_and_answer),
    "*TST": Action(query=lambda instrument: "+0"),
    "*ESR": Action(query=lambda instrument: instrument.status.events()),
    "*STB": Action(query=lambda instrument: instrument.status.byte(instrument.message_waiting)),
    "*ESE": Action(
        lambda instrument, arguments: instrument.status.enable("ESE", arguments),
        lambda instrument: instrument.status.enabled("ESE"),
    ),
    "*SRE": Action(
        lambda instrument, arguments: instrument.status.enable("SRE", arguments),
        lambda instrument: instrument.status.enabled("SRE"),
    ),
    "TRIGger[:IMMediate]": Action(lambda instrument, arguments: instrument.trigger()),
    "SYSTem:ERRor[:NEXT]": Action(query=lambda instrument: instrument.status.next_error()),
    "SYSTem:VERSion": Action(query=lambda instrument: SCPI_VERSION),
    "SYSTem:BEEPer[:IMMediate]": Action(_beep),
    "SYSTem:LOCal": Action(lambda instrument, arguments: instrument.hold(True)),
    "SYSTem:REMote": Action(lambda instrument, arguments: instrument.hold(False)),
    "SYSTem:RWLock": Action(lambda instrument, arguments: instrument.hold(False)),
    "STATus:QUEStionable:CONDition": Action(query=lambda instrument: "+0"),
    "STATus:QUEStionable[:EVENt]": Action(query=lambda instrument: "+0"),
}

REMOTE = (ACTIONS["SYSTem:REMote"], ACTIONS["SYSTem:RWLock"])
TABLES: Mapping[str, HeaderTable[SettingCommand | Action]] = {
    model.name: HeaderTable({**settings_of(model), **ACTIONS}, model.numbered) for model in MODELS.values()
}
