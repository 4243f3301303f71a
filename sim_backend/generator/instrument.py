"""Instrument, the 33250A as a program sees it: messages in, replies and errors out, registers with their history."""

from __future__ import annotations

import math

from sim_backend.generator.arbitrary import WaveformMemory
from sim_backend.generator.command_tree import REMOTE, Action, Entry, table_of
from sim_backend.generator.emission import is_endless, respond, shapes_output
from sim_backend.generator.headers import Command
from sim_backend.generator.kinds import SettingCommand
from sim_backend.generator.models import AGILENT_33250A, Model
from sim_backend.generator.registers import Coerced, Registers, power_on
from sim_backend.generator.scpi_text import ScpiError
from sim_backend.generator.status import Status
from sim_backend.generator.stored_states import StoredStates, learn_string
from sim_backend.wiring import Emission, SimulatedClock, Steps, to_ps

MOST_REPLY = 1 << 16
"""How long a reply may become, in characters; what does not fit is lost, with error 522."""
MOST_STATES = 4096
"""How many states of an output that is on are remembered; the oldest is forgotten, so that a program that never
switches the output off cannot fill the memory."""
MOST_TRIGGERS = 1 << 16
"""How many triggers by command are remembered."""


class Generator33250A:
    """One simulated 33250A or sibling; what it puts out follows from its history by ``emission``.

    Assumed of local mode, into which the front panel puts an instrument on RS-232: settings are refused with error 550,
    queries are answered.
    """

    def __init__(self, clock: SimulatedClock, latency_s: float, model: Model = AGILENT_33250A) -> None:
        self._clock = clock
        self._latency_ps = to_ps(latency_s)
        self._replies: list[str] = []
        self._table = table_of(model.name)
        self.registers: Registers = power_on(model)
        # Of the channels beyond the first no output is wired on any bench: they keep settings and put out nothing.
        self._others = (self.registers,) * (model.channels - 1)
        self.states: StoredStates = StoredStates()
        self.waveforms: WaveformMemory = WaveformMemory()
        self.byte_order: str = "NORM"
        self._history: list[tuple[int, Registers]] = [(clock.now_ps, self.registers)]
        self._software_ps: list[int] = []
        self._over_serial = False
        # On GPIB the bus itself claims the instrument; RS-232 has no such line.
        self._local = True
        self.status: Status = Status()
        self.changes = 0

    def write(self, message: str, over_serial: bool = False) -> None:
        """Carry out the commands of ``message``; a mistake goes to the error queue and ends the message."""
        self._over_serial = over_serial
        if self._replies:
            self._replies.clear()
            self.status.queue(-410, "Query INTERRUPTED")
        try:
            length = 0
            for command in self._table.commands(message):
                reply = self._carry_out(command)
                if reply is not None:
                    self._replies.append(reply)
                    length += len(reply) + 1
                    if length > MOST_REPLY:
                        self._replies.clear()
                        raise ScpiError(522, "Output buffer overflow")
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

    def hold(self, local: bool, anywhere: bool = False) -> None:
        """Go to local or to remote mode; ``ScpiError`` 514 unless it came over RS-232 or may come from ``anywhere``."""
        if not (self._over_serial or anywhere):
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

    def program(self, *channels: Registers) -> None:
        """Take over the state of each channel, from the first on; those that are not given stay."""
        self._become(channels[0])
        self._others = channels[1:] or self._others

    def reset(self) -> None:
        """Return to the power-on state; the beeper keeps its setting."""
        state = power_on(self.registers.model, self.registers.beeper)
        self.program(state, *(state for _ in self._others))

    def save(self, place: int) -> None:
        """Store the state of every channel."""
        self.states.save(place, (self.registers, *self._others))

    def recall(self, place: int) -> None:
        """Return to a stored state; ``ScpiError`` 810 where there is none. Assumed: an output that was on goes on."""
        self.program(*self.states.recall(place))

    def learn_string(self) -> str:
        """Return the commands that restore the present state."""
        return learn_string((self.registers, *self._others), bool(self._others), self._setting)

    def trigger(self) -> None:
        """Start a burst, whatever the trigger source; raise ``ScpiError`` -211 where bursts are off."""
        if not self.registers.burst:
            raise ScpiError(-211, "Trigger ignored")
        self._software_ps.append(self._clock.now_ps)
        del self._software_ps[:-MOST_TRIGGERS]
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

    def _carry_out(self, command: Command[Entry]) -> str | None:
        entry, arguments = command.entry, command.arguments
        if self._over_serial and self._local and not command.query and entry not in REMOTE:
            raise ScpiError(550, "Command not allowed in local")
        if isinstance(entry, Action):
            return entry.carry_out(self, command.query, arguments)
        state = self.registers if command.channel == 1 else self._others[command.channel - 2]
        if command.query:
            return entry.answer(state, arguments)
        self._take(entry.carried_out(state, arguments), command.channel)
        return None

    def _take(self, coerced: Coerced, channel: int) -> None:
        if channel == 1:
            self._become(coerced.registers)
        else:
            others = list(self._others)
            others[channel - 2] = coerced.registers
            self._others = tuple(others)
        for number, text in coerced.errors:
            self.status.queue(number, text)

    def _setting(self, header: str, channel: int) -> str | None:
        entry = self._table.find(header)
        if not isinstance(entry, SettingCommand):
            return None
        return entry.answer((self.registers, *self._others)[channel - 1], ())

    def _become(self, registers: Registers) -> None:
        if shapes_output(self.registers, registers):
            if self._history[-1][0] == self._clock.now_ps and len(self._history) > 1:
                self._history.pop()
            self._history.append((self._clock.now_ps, registers))
            if len(self._history) > MOST_STATES:
                del self._history[: MOST_STATES // 2]
            self.changes += 1
        elif not registers.output:
            # Nothing shows while the output is off: the last state before it goes on is all that counts.
            self._history[-1] = (self._history[-1][0], registers)
        self.registers = registers
