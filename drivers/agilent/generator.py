"""The Agilent 33250A and its siblings as master trigger, pulse train, toneburst or continuous sine.

A task becomes registers (`programs`) with the model's headers (`models`), which are sent and read back (`scpi`). Each
group of settings is one message; then the error queue is emptied and the group read back. APPLy is never sent, because
it switches the output on at once.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, Self, final

from drivers.agilent.limits import mistakes
from drivers.agilent.models import AGILENT_33250A, MODELS, model_named
from drivers.agilent.programs import READABLE, Group, changed, program
from drivers.agilent.read_back import Readable, Register, whole_number
from drivers.agilent.scpi import DroppedError, NoReplyError, RefusedError, ScpiSession
from drivers.interfaces import Connection, ContinuousSine, GeneratorTask, Identity, InstrumentError, Setting

OUTPUT_OFF: Final = Register("output_on", "OUTP", False)
OUTPUT_ON: Final = Register("output_on", "OUTP", True)
_LOG: Final = logging.getLogger("drivers")
# The self-test takes some seconds (assumed: up to half a minute), a time-out 1.5 s.
SELF_TEST_TIMEOUTS: Final = 20
NO_SERIAL: Final = ("", "0")
"""Serial field of ``*IDN?`` of a model that reports none, as the 33250A."""
LABEL: Final = "MEM:STAT:NAME"
"""Name of a stored state. It is kept without power and through ``*RST``, whether or not a state is stored."""
LABEL_LOCATION: Final = 4
QUESTIONABLE: Final = "STAT:QUES:COND?"
LOOP_UNLOCKED, EXTERNAL_REFERENCE = 1 << 5, 1 << 9
"""Bits of the questionable condition (from memory of the manual)."""
UNLABELLED: Final = ("", f"STATE_{LABEL_LOCATION}")
"""Names of a location without a label: none, or the manual's default."""


@final
class Agilent33250A:
    """Driver of one generator behind ``connection``.

    ``role`` names it in messages. ``series`` is the expected model or series of ``MODELS``; empty accepts all.
    ``max_vpp`` is the largest swing into the declared load that the connected device tolerates. With
    ``external_reference`` the clock must be locked to the 10 MHz input, which is verified with all settings. A ``with``
    statement first identifies the instrument, and ends with the output verified off and the connection closed.
    """

    def __init__(
        self,
        connection: Connection,
        role: str = "generator",
        series: str = "",
        max_vpp: float = math.inf,
        external_reference: bool = False,
    ) -> None:
        self._role = role
        self._series = series
        self._max_vpp = max_vpp
        self._external_reference = external_reference
        self._session = ScpiSession(connection, role)
        self._model = AGILENT_33250A
        self._identity: Identity | None = None
        self._serial: str | None = None
        self._programmed: tuple[Register, ...] = ()
        self._output = OUTPUT_OFF

    def __enter__(self) -> Self:
        try:
            self.identify()
        except BaseException:
            # Nothing is sent to an unknown instrument, not even to switch it off.
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
        """The role of this instrument on the bench."""
        return self._role

    @property
    def bus(self) -> str:
        """Name of the bus; empty for an instrument in the same process."""
        return self._session.bus

    def identify(self) -> Identity:
        """Return the identity from ``*IDN?``; raise ``InstrumentError`` unless it is the expected model.

        The vendor is not compared: later instruments of the same model carry another company's name.
        """
        reply = self._session.identify()
        fields = [field.strip() for field in reply.split(",")]
        model = model_named(fields[1]) if len(fields) > 3 else None
        if model is None or self._series not in ("", model.name):
            expected = self._series or " or ".join(model.name for model in MODELS)
            raise InstrumentError(
                self.role,
                f"*IDN? was answered with {reply!r}, expected model {expected}",
                "the address in the bench file belongs to another instrument",
                f"give {self.role} the address of a {expected} in the bench file, or its model",
            )
        self._model = model
        self._identity = Identity(fields[0], fields[1], fields[2], ",".join(fields[3:]))
        return self._identity

    def serial_number(self) -> str:
        """Return the serial number of ``*IDN?``, or the name of stored state 4 of a model without one.

        Empty without either. The name has up to 12 letters, digits and underscores.
        """
        self._serial = self._read_serial()
        return self._serial

    def _read_serial(self) -> str:
        serial = self._identified().serial
        if serial not in NO_SERIAL:
            return serial
        try:
            label = self._session.query(f"{LABEL}? {LABEL_LOCATION}").strip().strip('"')
        except DroppedError:
            raise
        except InstrumentError:
            # An instrument that does not know the query sends no reply and queues an error.
            self._session.drain_errors()
            return ""
        return "" if label in UNLABELLED else label

    def store_label(self, label: str) -> None:
        """Name stored state 4 ``label``, verified; the state itself is not changed."""
        self._send_verified("label", f"{LABEL} {LABEL_LOCATION},{label}")
        if (stored := self.serial_number()) != label:
            why = "this model or firmware keeps no names of stored states, or changes them"
            remedy = 'name the state at the front panel, or enter serial = "none" in the bench file'
            raise InstrumentError(self.role, f"label {label} was stored, and reads back as {stored!r}", why, remedy)

    def display(self, text: str) -> None:
        """Show ``text`` on the front panel, up to 12 characters in large letters; empty: the settings as usual."""
        self._send_verified("display", f'DISP:TEXT "{text}"' if text else "DISP:TEXT:CLE")

    def configure(self, task: GeneratorTask, /) -> None:
        """Program ``task`` with the output off: changed settings alone if possible, else all from the reset state.

        A connection that was lost while the output was off is opened again, once. Raises ``InstrumentError`` with all
        ``mistakes`` before a setting is sent, and at the first group of settings that the instrument refuses or
        changes.
        """
        previous, self._programmed = self._programmed, ()
        self._output = OUTPUT_OFF
        self._identified()
        problems = mistakes(task, self._model, self._max_vpp)
        if problems:
            why = f"the {self._model.name} or the connected device cannot do this, and no setting was sent"
            raise InstrumentError(self.role, "; ".join(problems), why, "change the value in the scene or bench file")
        groups = program(task, self._model)
        registers = tuple(register for _, group in groups for register in group)
        differing = changed(previous, registers)
        try:
            if differing is None:
                self._from_reset(groups)
            else:
                self._session.program("changes", self._spelled((OUTPUT_OFF, *differing)))
        except (DroppedError, NoReplyError):
            # Instruments and firewalls end idle connections, such as during a pause between two shots.
            if not self._reconnected():
                raise
            self._from_reset(groups)
            _LOG.warning(
                "%s: the connection was lost while its output was off. It is open again: the same instrument answers, "
                "and all settings are programmed from the reset state",
                self.role,
            )
        self._programmed = registers
        self._verify_reference()

    def sine(self, frequency_hz: float, amplitude_vpp: float, load_ohm: float = 50.0) -> None:
        """Switch on a continuous sine without offset, verified; it lasts until ``make_safe``."""
        self.configure(ContinuousSine(frequency_hz, amplitude_vpp, load_ohm))
        self.enable_output()

    def verify(self) -> Mapping[str, Setting]:
        """Return the ``snapshot``; raise ``InstrumentError`` if a setting differs or an error is queued."""
        self._require_configured("verify")
        return self._settings(self._session.verify("settings", self._spelled(self._programmed), self._readable))

    def enable_output(self) -> None:
        """Switch the output on, verified."""
        self._require_configured("enable_output")
        self._output = OUTPUT_ON
        self._session.program("output", self._spelled((OUTPUT_ON,)))

    def fire(self) -> None:
        """Trigger one burst by command, then switch the output off; the burst's first edge comes before that.

        Raises ``InstrumentError`` if the output was off, the trigger is ignored or the output stays on.
        """
        self._require_configured("fire")
        # After an overload the output relay is open: a trigger would be accepted without any output.
        self._session.verify("output before the trigger", self._spelled((OUTPUT_ON,)))
        (off,) = self._spelled((OUTPUT_OFF,))
        self._output = OUTPUT_OFF
        self._session.write("*TRG")
        self._session.write(off.command)
        self._session.verify("trigger by command", (off,))

    def recheck(self) -> None:
        """Raise ``InstrumentError`` if output or settings differ from the verified ones.

        Outputs are on meanwhile, so time-outs are short, and a missing reply is queried once more. A lost connection is
        opened again, once.
        """
        self._require_configured("recheck")
        expected = self._spelled((self._output, *self._programmed))
        try:
            with self._session.short_timeout():
                try:
                    self._session.verify("settings after the shot", expected)
                except RefusedError:
                    raise
                except InstrumentError as error:
                    if isinstance(error, DroppedError):
                        self._session.reopen()
                    self._session.verify("settings after the shot", expected)
                self._verify_reference()
        except RefusedError as error:
            # The next shot starts from the reset state, whatever was changed.
            self._programmed = ()
            why = "another program, or a person at the front panel, changed it after it was verified"
            remedy = "end other programs that talk to the instrument, measure again"
            raise InstrumentError(self.role, error.what, why, remedy) from error

    def snapshot(self) -> Mapping[str, Setting]:
        """Return every setting of ``READABLE``, read back, and the ``*IDN?`` fields."""
        self._identified()
        replies = self._session.query_all([f"{header}?" for header in self._readable])
        return self._settings(dict(zip(self._readable, replies, strict=True)))

    def snapshot_and_errors(self) -> tuple[Mapping[str, Setting], tuple[str, ...]]:
        """Return the ``snapshot`` and the errors queued since ``switch_off``; the queue is empty afterwards."""
        self._identified()
        replies, errors = self._session.read_back(self._readable)
        return self._settings(replies), tuple(map(str, errors))

    def self_test(self) -> bool:
        """Return whether the instrument's self-test passes; the output is verified off before and after it.

        The programmed settings are forgotten, as the test may have changed them.
        """
        self.make_safe()
        self._programmed = ()
        reply = self._session.query("*TST?", SELF_TEST_TIMEOUTS)
        # A failed test queues errors, which make_safe clears.
        self.make_safe()
        return self._decoded(Readable("self-test result", "*TST", whole_number), reply) == 0

    def switch_off(self) -> None:
        """Send the command that switches the output off, without waiting for a reply."""
        (off,) = self._spelled((OUTPUT_OFF,))
        self._output = OUTPUT_OFF
        # The switch comes first in the message, so that no error prevents it. Earlier errors are cleared after it.
        with self._session.short_timeout():
            self._session.write(off.command, "*CLS")

    def prove_off(self) -> str:
        """Return how the output is proven to be off; raise ``InstrumentError`` if it is not."""
        with self._session.short_timeout():
            self._session.verify("output off", self._spelled((OUTPUT_OFF,)))
        return "read back as off"

    def make_safe(self) -> str:
        """Switch the output off in any state of the instrument, and return how that is proven.

        A lost connection is opened again, once. Raises ``InstrumentError`` if the output is not proven off.
        """
        try:
            return self._switched_off()
        except RefusedError:
            # The Local key may have been pressed on RS-232; settings are refused until SYST:REM. On other interfaces
            # this command is an error, which the next attempt clears.
            self._session.write("SYST:REM")
            return f"{self._switched_off()}, after the instrument was taken back from local mode"
        except DroppedError:
            if not self._session.reopen():
                raise
            return f"{self._switched_off()}, over the connection opened again"
        except InstrumentError:
            # In local mode the instrument may also be silent. A busy one, or one on a slow line, answers late.
            self._session.write("SYST:REM")
            self.switch_off()
            self._session.verify("output off", self._spelled((OUTPUT_OFF,)))
            return "read back as off, answered late"

    def close(self) -> None:
        """Close the connection; the instrument keeps its state."""
        self._session.close()

    def _send_verified(self, group: str, command: str) -> None:
        """Send ``command``; raise ``RefusedError`` if the instrument queues an error."""
        self._session.write(command)
        self._session.verify(group, ())

    def _verify_reference(self) -> None:
        """Raise ``InstrumentError`` if the clock must be locked to the 10 MHz input and is not."""
        if not self._external_reference:
            return
        reply = self._session.query(QUESTIONABLE)
        condition = int(self._decoded(Readable("questionable condition", QUESTIONABLE[:-1], whole_number), reply))
        if condition & LOOP_UNLOCKED or not condition & EXTERNAL_REFERENCE:
            raise InstrumentError(
                self.role,
                f"its clock is not locked to the 10 MHz input ({QUESTIONABLE} was answered with {condition})",
                "no reference is connected, it is too weak, or the internal one is selected",
                "connect the reference, or change common_reference in the bench file; it is "
                '"source" for the instrument that gives the reference',
            )

    def _switched_off(self) -> str:
        self.switch_off()
        return self.prove_off()

    def _reconnected(self) -> bool:
        """Open the lost connection again and return whether the instrument answers; raise if it is another one."""
        identity, serial = self._identity, self._serial
        try:
            if not self._session.reopen():
                return False
            # A label is compared if it was read before: not every model has one.
            same = self.identify() == identity and (serial is None or self.serial_number() == serial)
        except (DroppedError, NoReplyError):
            return False
        if not same:
            what = f"after a lost connection {self._identity} answers, before {identity}"
            remedy = "connect the instruments as the bench file says, then hpe-rig resume"
            raise InstrumentError(self.role, what, "instruments or their addresses were exchanged", remedy)
        return True

    def _identified(self) -> Identity:
        return self._identity or self.identify()

    @property
    def _readable(self) -> list[str]:
        return [self._model.header(item.header) for item in READABLE]

    def _settings(self, replies: Mapping[str, str]) -> Mapping[str, Setting]:
        identity = self._identified()
        settings = {item.key: self._decoded(item, replies[self._model.header(item.header)]) for item in READABLE}
        return {"model": identity.model, "vendor": identity.vendor, "firmware": identity.firmware, **settings}

    def _from_reset(self, groups: Sequence[Group]) -> None:
        (off,) = self._spelled((OUTPUT_OFF,))
        self._session.write(off.command, "*CLS", "*RST")
        self._session.verify("reset", (off,))
        for name, registers in groups:
            self._session.program(name, self._spelled(registers))

    def _spelled(self, registers: Sequence[Register]) -> tuple[Register, ...]:
        """Return ``registers`` with the model's headers, and tolerances of at least its resolution."""
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
                "the connection corrupts replies, or another program shares it",
                "check the cable and the connection's settings, end other programs",
            ) from None

    def _require_configured(self, action: str) -> None:
        if not self._programmed:
            why = "nothing is programmed, or the last configure failed"
            raise InstrumentError(self.role, f"{action} came before configure", why, "call configure first")
