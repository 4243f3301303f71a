"""The Agilent 33250A and its siblings as master trigger, pulse train, toneburst or continuous sine.

A task goes straight down: its registers (`programs`), spelled as the model wants them (`models`), sent and read back
(`scpi`). Each group of settings is one message, after which the error queue is drained and the group read back. APPLy
is never sent: it switches the output on at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, Self, final

from drivers.agilent.limits import mistakes
from drivers.agilent.models import AGILENT_33250A, MODELS, model_named
from drivers.agilent.programs import READABLE, Group, changed, program
from drivers.agilent.read_back import Readable, Register, whole_number
from drivers.agilent.scpi import DroppedError, RefusedError, ScpiSession
from drivers.interfaces import Connection, ContinuousSine, GeneratorTask, Identity, InstrumentError, Setting

OUTPUT_OFF: Final = Register("output_on", "OUTP", False)
OUTPUT_ON: Final = Register("output_on", "OUTP", True)
# The test takes some seconds (assumed: up to half a minute), a read gives up after one and a half.
SELF_TEST_PATIENCE: Final = 20


@final
class Agilent33250A:
    """One generator behind ``connection``; the state is the instrument's, here is only what was asked of it.

    ``role`` names it in messages. ``series`` is the model or series that must answer, one of ``MODELS``; empty accepts
    every one of them. ``max_vpp`` is the largest swing into the declared load that what hangs on the output bears.
    In a ``with`` statement it is identified first, and its output off, verified, and the connection closed at the end.
    """

    def __init__(
        self, connection: Connection, role: str = "generator", series: str = "", max_vpp: float = math.inf
    ) -> None:
        self._role = role
        self._series = series
        self._max_vpp = max_vpp
        self._session = ScpiSession(connection, role)
        self._model = AGILENT_33250A
        self._identity: Identity | None = None
        self._programmed: tuple[Register, ...] = ()
        self._output = OUTPUT_OFF

    def __enter__(self) -> Self:
        try:
            self.identify()
        except BaseException:
            # Nothing is sent to a stranger, not even to switch it off.
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.make_safe()
        finally:
            self.close()

    @property
    def role(self) -> str:
        """The part this instrument plays on the bench."""
        return self._role

    @property
    def bus(self) -> str:
        """Name of the line that leads to the instrument; empty where it is in the same process."""
        return self._session.bus

    def identify(self) -> Identity:
        """Return who answers ``*IDN?``; raise ``InstrumentError`` if it is no 33250A or sibling, or the wrong one.

        The vendor is not compared: later instruments of the same model carry another company's name.
        """
        reply = self._session.ask_who()
        fields = [field.strip() for field in reply.split(",")]
        model = model_named(fields[1]) if len(fields) > 3 else None
        if model is None or self._series not in ("", model.name):
            expected = self._series or " or ".join(known.name for known in MODELS)
            raise InstrumentError(
                self.role,
                f"*IDN? was answered with {reply!r}, expected model {expected}",
                "the address in the bench file belongs to another instrument",
                f"give {self.role} the address of a {expected} in the bench file, or its model",
            )
        self._model = model
        self._identity = Identity(fields[0], fields[1], fields[2], ",".join(fields[3:]))
        return self._identity

    def configure(self, task: GeneratorTask, /) -> None:
        """Program ``task`` with the output off: what changed since the last time, else everything from the reset state.

        Raises ``InstrumentError`` with all ``mistakes`` before a setting is sent, and at the first group of settings
        that the instrument refuses or changes.
        """
        before, self._programmed = self._programmed, ()
        self._output = OUTPUT_OFF
        self._identified()
        found = mistakes(task, self._model, self._max_vpp)
        if found:
            why = f"the {self._model.name} or what it is wired to cannot take this, and no setting was sent"
            raise InstrumentError(self.role, "; ".join(found), why, "change the value in the scene or bench file")
        groups = program(task, self._model)
        registers = tuple(register for _, group in groups for register in group)
        differing = changed(before, registers)
        if differing is None:
            self._from_reset(groups)
        else:
            self._session.program("changes", self._spelled((OUTPUT_OFF, *differing)))
        self._programmed = registers

    def sine(self, frequency_hz: float, amplitude_vpp: float, load_ohm: float = 50.0) -> None:
        """Put out a continuous sine about zero volts, verified; it goes on until ``make_safe``."""
        self.configure(ContinuousSine(frequency_hz, amplitude_vpp, load_ohm))
        self.enable_output()

    def verify(self) -> Mapping[str, Setting]:
        """Return the ``snapshot``; raise ``InstrumentError`` where it is not as programmed or an error is queued."""
        self._require_configured("verify")
        return self._settings(self._session.verify("settings", self._spelled(self._programmed), self._readable))

    def enable_output(self) -> None:
        """Switch the output on, verified."""
        self._require_configured("enable_output")
        self._output = OUTPUT_ON
        self._session.program("output", self._spelled((OUTPUT_ON,)))

    def fire(self) -> None:
        """Trigger one burst by command, and let no other follow: its edge is out before the output goes off again.

        Raises ``InstrumentError`` if the output was off, the trigger is ignored or the output stays on.
        """
        self._require_configured("fire")
        # The relay opens by itself on an overload; the trigger would then be accepted and nothing emitted.
        self._session.verify("output before the trigger", self._spelled((OUTPUT_ON,)))
        (off,) = self._spelled((OUTPUT_OFF,))
        self._output = OUTPUT_OFF
        self._session.write("*TRG")
        self._session.write(off.command)
        self._session.verify("trigger by command", (off,))

    def recheck(self) -> None:
        """Raise ``InstrumentError`` where output or settings are no longer as they were programmed and verified.

        Outputs are on meanwhile, so nobody waits long for an answer, and one that got lost is asked for once more.
        A dropped connection is opened again, once.
        """
        self._require_configured("recheck")
        expected = self._spelled((self._output, *self._programmed))
        try:
            with self._session.haste():
                try:
                    self._session.verify("settings after the shot", expected)
                except RefusedError:
                    raise
                except InstrumentError as error:
                    if isinstance(error, DroppedError):
                        self._session.reopen()
                    self._session.verify("settings after the shot", expected)
        except RefusedError as error:
            # Whatever somebody else sent, the next shot starts from the reset state.
            self._programmed = ()
            why = "another program, or somebody at the front panel, changed it after it was verified"
            remedy = "end other programs that talk to the instrument, measure again"
            raise InstrumentError(self.role, error.what, why, remedy) from error

    def snapshot(self) -> Mapping[str, Setting]:
        """Return every setting of ``READABLE`` as the instrument states it, and its ``*IDN?`` fields."""
        self._identified()
        replies = self._session.query_all([f"{header}?" for header in self._readable])
        return self._settings(dict(zip(self._readable, replies, strict=True)))

    def self_test(self) -> bool:
        """Return whether the instrument's self-test passes; the output is off before it, and verified off after it.

        What was programmed does not count as such any more: the test may have changed it.
        """
        self.make_safe()
        self._programmed = ()
        reply = self._session.query("*TST?", SELF_TEST_PATIENCE)
        # A failed test queues what failed; making safe clears it.
        self.make_safe()
        return self._decoded(Readable("self-test result", "*TST", whole_number), reply) == 0

    def switch_off(self) -> None:
        """Send what switches the output off, and wait for no answer."""
        (off,) = self._spelled((OUTPUT_OFF,))
        self._output = OUTPUT_OFF
        # The switch goes first, so that nothing before it can keep it from being carried out. Errors from before must
        # neither hide behind nor be blamed on it; what it did itself, the read-back tells.
        with self._session.haste():
            self._session.write(off.command, "*CLS")

    def prove_off(self) -> str:
        """Return how the output is known to be off; raise ``InstrumentError`` where it is not."""
        with self._session.haste():
            self._session.verify("output off", self._spelled((OUTPUT_OFF,)))
        return "read back as off"

    def make_safe(self) -> str:
        """Switch the output off in whatever state the instrument is, and return how that is proven.

        A dropped connection is opened again, once. Raises ``InstrumentError`` where the output is not proven off.
        """
        try:
            return self._switched_off()
        except RefusedError:
            # Somebody may have pressed Local at an instrument on RS-232: it takes no setting until it is told to.
            # Elsewhere the command is an error, and cleared with the others.
            self._session.write("SYST:REM")
            return f"{self._switched_off()}, after the instrument was taken back from local mode"
        except DroppedError:
            if not self._session.reopen():
                raise
            return f"{self._switched_off()}, over the connection opened again"
        except InstrumentError:
            # In local mode it may also be silent. Who tries again finds it in remote; a dead one costs no more time.
            self._session.write("SYST:REM")
            raise

    def close(self) -> None:
        """Close the connection; the instrument keeps its state."""
        self._session.close()

    def _switched_off(self) -> str:
        self.switch_off()
        return self.prove_off()

    def _identified(self) -> Identity:
        return self._identity or self.identify()

    @property
    def _readable(self) -> list[str]:
        return [self._model.header(item.header) for item in READABLE]

    def _settings(self, replies: Mapping[str, str]) -> Mapping[str, Setting]:
        who = self._identified()
        settings = {item.key: self._decoded(item, replies[self._model.header(item.header)]) for item in READABLE}
        return {"model": who.model, "vendor": who.vendor, "firmware": who.firmware, **settings}

    def _from_reset(self, groups: Sequence[Group]) -> None:
        (off,) = self._spelled((OUTPUT_OFF,))
        self._session.write(off.command, "*CLS", "*RST")
        self._session.verify("reset", (off,))
        for name, registers in groups:
            self._session.program(name, self._spelled(registers))

    def _spelled(self, registers: Sequence[Register]) -> tuple[Register, ...]:
        """Return ``registers`` with the model's own headers, to be compared as finely as it holds their values."""
        return tuple(
            replace(
                register,
                header=self._model.header(register.header),
                tolerance=max(register.tolerance, self._resolution(register)),
            )
            for register in registers
        )

    def _resolution(self, register: Register) -> float:
        value = register.value
        return self._model.resolution(register.header, value) if isinstance(value, float) else 0.0

    def _decoded(self, item: Readable, reply: str) -> Setting:
        try:
            return item.decode(reply)
        except ValueError:
            raise InstrumentError(
                self.role,
                f"{item.header}? was answered with {reply!r}, which is no {item.key}",
                "the connection garbles replies, or another program shares it",
                "check the cable and the line's settings, end other programs",
            ) from None

    def _require_configured(self, action: str) -> None:
        if not self._programmed:
            why = "nothing is programmed, or the last configure failed"
            raise InstrumentError(self.role, f"{action} came before configure", why, "call configure first")
