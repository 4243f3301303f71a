"""One simulated 33250A: messages in, replies and errors out, registers with their history."""

from __future__ import annotations

import math

from sim_backend.generator.command_tree import ALLOWED_IN_LOCAL, Action, Entry, table_of
from sim_backend.generator.emission import changes_output, is_endless, respond, with_clock_error
from sim_backend.generator.headers import Command
from sim_backend.generator.models import AGILENT_33250A, Model
from sim_backend.generator.registers import Coerced, Registers, power_on
from sim_backend.generator.scpi_text import ScpiError
from sim_backend.generator.state_names import StateNames
from sim_backend.generator.status import Status
from sim_backend.wiring import Emission, SimulatedClock, Steps, to_ps

MAX_REPLY = 1 << 16
"""Characters of the output buffer; a longer reply is lost, with error 522."""
MAX_STATES = 4096
"""Length of the history while the output is on; older states are dropped, so that memory stays bounded."""
MAX_TRIGGERS = 1 << 16
"""Length of the history of triggers by command."""


class Generator33250A:
    """One simulated 33250A or sibling; ``emission`` computes its output from its history.

    Assumed: in local mode, which the front panel selects on RS-232, settings are refused with error 550 and queries are
    answered.
    """

    def __init__(
        self, clock: SimulatedClock, latency_s: float, model: Model = AGILENT_33250A, clock_error: float = 0.0
    ) -> None:
        """Switch the generator on; ``latency_s``: from a trigger to the burst.

        ``clock_error`` is the relative error of its time base's rate, positive if it is fast.
        """
        self._clock = clock
        self._clock_error = clock_error
        self._latency_ps = to_ps(latency_s)
        self._replies: list[str] = []
        self._table = table_of(model.name)
        self.registers: Registers = power_on(model)
        # Channels beyond the first are wired on no bench: they have settings but no output.
        self._other_channels = (self.registers,) * (model.channels - 1)
        self.states: StateNames = StateNames()
        self._history: list[tuple[int, Registers]] = [(clock.now_ps, self.registers)]
        self._software_ps: list[int] = []
        self._over_serial = False
        # GPIB has a remote line; on RS-232 the instrument starts in local mode.
        self._local = True
        self.status: Status = Status()
        self.changes = 0

    def write(self, message: str, over_serial: bool = False) -> None:
        """Execute the commands of ``message``; the first error goes to the error queue and ends the message."""
        self._over_serial = over_serial
        # A new message before the reply was read interrupts the query.
        if self._replies:
            self._replies.clear()
            self.status.queue(-410, "Query INTERRUPTED")
        try:
            length = 0
            for command in self._table.commands(message):
                reply = self._execute(command)
                if reply is not None:
                    self._replies.append(reply)
                    length += len(reply) + 1
                    if length > MAX_REPLY:
                        self._replies.clear()
                        raise ScpiError(522, "Output buffer overflow")
        except ScpiError as error:
            self.status.queue(error.number, error.text)

    def read(self) -> str:
        """Return the reply to the last message; raise ``TimeoutError`` if there is none."""
        if not self._replies:
            raise TimeoutError("the 33250A has no reply: no query, or an unknown one (see SYST:ERR?)")
        reply = ";".join(self._replies)
        self._replies.clear()
        return reply

    def close(self) -> None:
        """Drop an unread reply; the instrument keeps its state."""
        self._replies.clear()

    def serial_poll(self) -> int:
        """Return the status byte, as by a serial poll on the bus."""
        return int(self.status.byte(self.message_waiting))

    def set_local(self, local: bool, over_any_bus: bool = False) -> None:
        """Enter or leave local mode; raise ``ScpiError`` 514 unless over RS-232 or allowed ``over_any_bus``."""
        if not (self._over_serial or over_any_bus):
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

    def emission(self, arriving: Steps, until_ps: int) -> Emission:
        """Return past output and, without further commands, future output; ``arriving`` is the voltage at Trig In."""
        history = [(time_ps, with_clock_error(registers, self._clock_error)) for time_ps, registers in self._history]
        return respond(history, self._software_ps, arriving, self._latency_ps, until_ps)

    def forget_past(self) -> None:
        """Start the history now; valid when no burst is running."""
        self._history = [(self._clock.now_ps, self.registers)]
        self._software_ps = []

    def reset(self) -> None:
        """Return to the power-on state; the beeper keeps its setting."""
        state = power_on(self.registers.model, self.registers.beeper)
        self._set_registers(state)
        self._other_channels = (state,) * len(self._other_channels)

    def trigger(self) -> None:
        """Start a burst by command, whatever the trigger source; raise ``ScpiError`` -211 if bursts are off."""
        if not self.registers.burst:
            raise ScpiError(-211, "Trigger ignored")
        self._software_ps.append(self._clock.now_ps)
        del self._software_ps[:-MAX_TRIGGERS]
        self.changes += 1

    def trigger_from_bus(self) -> None:
        """Start a burst; raise ``ScpiError`` -211 unless the bus is the trigger source."""
        if self.registers.trigger_source != "BUS":
            raise ScpiError(-211, "Trigger ignored")
        self.trigger()

    def wait(self) -> None:
        """Advance the clock until the burst that a command has triggered ends."""
        emitted = with_clock_error(self.registers, self._clock_error)
        length_s = emitted.delay_s + emitted.burst_s
        if self._software_ps and self.registers.trigger_source == "BUS" and math.isfinite(length_s):
            self._clock.advance_to(self._software_ps[-1] + self._latency_ps + to_ps(length_s))

    def _execute(self, command: Command[Entry]) -> str | None:
        """Execute a command, or return the reply to a query; raise ``ScpiError`` 550 in local mode."""
        entry, arguments = command.entry, command.arguments
        if self._over_serial and self._local and not command.query and entry not in ALLOWED_IN_LOCAL:
            raise ScpiError(550, "Command not allowed in local")
        if isinstance(entry, Action):
            return entry.execute(self, command.query, arguments)
        state = self.registers if command.channel == 1 else self._other_channels[command.channel - 2]
        if command.query:
            return entry.answer(state, arguments)
        self._apply(entry.execute(state, arguments), command.channel)
        return None

    def _apply(self, coerced: Coerced, channel: int) -> None:
        """Replace the registers of a channel by ``coerced``, and queue the errors of values that were changed."""
        if channel == 1:
            self._set_registers(coerced.registers)
        else:
            channels = list(self._other_channels)
            channels[channel - 2] = coerced.registers
            self._other_channels = tuple(channels)
        for number, text in coerced.errors:
            self.status.queue(number, text)

    def _set_registers(self, registers: Registers) -> None:
        """Replace the registers of channel 1, and add them to the history if they change the output."""
        if changes_output(self.registers, registers):
            # Several settings at one time count as one state.
            if self._history[-1][0] == self._clock.now_ps and len(self._history) > 1:
                self._history.pop()
            self._history.append((self._clock.now_ps, registers))
            if len(self._history) > MAX_STATES:
                del self._history[: MAX_STATES // 2]
            self.changes += 1
        elif not registers.output:
            # With the output off, only the last state before switching on has an effect.
            self._history[-1] = (self._history[-1][0], registers)
        self.registers = registers
