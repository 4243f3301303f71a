"""The Agilent 33250A, its siblings, and the three generator roles: master trigger, pulse train, toneburst.

Each group of settings is one message, after which the error queue is drained and the group read back. The order
avoids passing through a state that the instrument would resolve by itself. APPLy is never sent: it switches the
output on at once. Registers carry the 33250A's headers; a sibling's spelling is put in when they are sent.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final, Never, final

from drivers.agilent import programs
from drivers.agilent.limits import (
    pulse_train_mistakes,
    refuse,
    toneburst_mistakes,
    trigger_pulse_mistakes,
    wiring_mistakes,
)
from drivers.agilent.models import AGILENT_33250A, MODELS, GeneratorModel, model_named
from drivers.agilent.programs import READABLE, Group
from drivers.agilent.read_back import Readable, Register, whole_number
from drivers.agilent.scpi import RefusedError, ScpiSession
from drivers.interfaces import Identity, InstrumentError, PulseTrain, Setting, Toneburst, TriggerPulse, Wire

OUTPUT_OFF: Final = Register("output_on", "OUTP", False)
OUTPUT_ON: Final = Register("output_on", "OUTP", True)
# The test takes some seconds (assumed: up to half a minute), a read gives up after two.
SELF_TEST_PATIENCE: Final = 15

Limits = Callable[[GeneratorModel], list[str]]
Program = Callable[[GeneratorModel], Sequence[Group]]


@final
class Agilent33250A:
    """The commands that all roles share; the state is the instrument's, here is only what was asked of it.

    ``series`` is the name in ``generator_models`` that must answer; empty accepts every one of them.
    """

    def __init__(self, wire: Wire, role: str, series: str = "") -> None:
        self.role = role
        self._series = series
        self._session = ScpiSession(wire, role)
        self._model = AGILENT_33250A
        self._identity: Identity | None = None
        self._programmed: tuple[Register, ...] = ()

    def identify(self) -> Identity:
        """Return who answers ``*IDN?``; raise ``InstrumentError`` if it is no 33250A or sibling, or the wrong one.

        The vendor is not compared: later instruments of the same model carry another company's name.
        """
        reply = self._session.query("*IDN?")
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

    def configure(self, program: Program, limits: Limits) -> None:
        """Program with the output off: what changed since the last time, else everything from the reset state.

        Raises ``InstrumentError`` for what ``limits`` lists, before a setting is sent, and at the first group that
        fails.
        """
        before, self._programmed = self._programmed, ()
        self._identified()
        refuse(self.role, self._model, limits(self._model))
        groups = program(self._model)
        registers = tuple(register for _, group in groups for register in group)
        changed = programs.changed(before, registers)
        if changed is None:
            self._from_reset(groups)
        else:
            self._session.program("changes", self._spelled((OUTPUT_OFF, *changed)))
        self._programmed = registers

    def verify(self) -> Mapping[str, Setting]:
        """Return the ``snapshot``; raise ``InstrumentError`` where it is not as programmed or an error is queued."""
        self._require_configured("verify")
        return self._settings(self._session.verify("settings", self._spelled(self._programmed), self._readable))

    def enable_output(self) -> None:
        """Switch the output on, verified."""
        self._require_configured("enable_output")
        self._session.program("output", self._spelled((OUTPUT_ON,)))

    def fire(self) -> None:
        """Trigger one burst by command; raise ``InstrumentError`` if the output is off or the trigger is ignored."""
        self._require_configured("fire")
        # The relay opens by itself on an overload; the trigger would then be accepted and nothing emitted.
        self._session.verify("output before the trigger", self._spelled((OUTPUT_ON,)))
        self._session.write("*TRG")
        self._session.verify("trigger by command", ())

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

    def make_safe(self) -> None:
        """Switch the output off in whatever state the instrument is, and prove it by read-back."""
        try:
            self._switch_off()
        except RefusedError:
            # Somebody may have pressed Local at an instrument on RS-232: it takes no setting until it is told to.
            # Elsewhere the command is an error, and cleared with the others.
            self._session.write("SYST:REM")
            self._switch_off()
        except InstrumentError:
            # In local mode it may also be silent. Who tries again finds it in remote; a dead one costs no more time.
            self._session.write("SYST:REM")
            raise

    def close(self) -> None:
        """Close the connection; the instrument keeps its state."""
        self._session.close()

    def _switch_off(self) -> None:
        (off,) = self._spelled((OUTPUT_OFF,))
        # The switch goes first, so that nothing before it can keep it from being carried out. Errors from before must
        # neither hide behind nor be blamed on it; what it did itself, the read-back tells.
        self._session.write(off.command, "*CLS")
        self._session.verify("output off", (off,))

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
        return tuple(replace(register, header=self._model.header(register.header)) for register in registers)

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


class GeneratorRole(ABC):
    """What every role of the instrument can do; the roles differ in what they program.

    ``max_vpp`` is the largest swing into the declared load that what hangs on the output may see.
    """

    def __init__(self, wire: Wire, role: str, series: str = "", max_vpp: float = math.inf) -> None:
        self._generator = Agilent33250A(wire, role, series)
        self._max_vpp = max_vpp

    @abstractmethod
    def configure(self, program: Never, /) -> None:
        """Program what the role does; what that is, each role states by its own type."""

    @property
    def role(self) -> str:
        """The part this instrument plays on the bench."""
        return self._generator.role

    def identify(self) -> Identity:
        """See ``Agilent33250A.identify``."""
        return self._generator.identify()

    def verify(self) -> Mapping[str, Setting]:
        """See ``Agilent33250A.verify``."""
        return self._generator.verify()

    def enable_output(self) -> None:
        """See ``Agilent33250A.enable_output``."""
        self._generator.enable_output()

    def self_test(self) -> bool:
        """See ``Agilent33250A.self_test``."""
        return self._generator.self_test()

    def snapshot(self) -> Mapping[str, Setting]:
        """See ``Agilent33250A.snapshot``."""
        return self._generator.snapshot()

    def make_safe(self) -> None:
        """See ``Agilent33250A.make_safe``."""
        self._generator.make_safe()

    def close(self) -> None:
        """See ``Agilent33250A.close``."""
        self._generator.close()


@final
class MasterTrigger33250A(GeneratorRole):
    """One pulse a command."""

    def configure(self, pulse: TriggerPulse) -> None:
        """Program one pulse on ``*TRG``; raise ``InstrumentError`` for what the instrument cannot do or changed."""

        def limits(model: GeneratorModel) -> list[str]:
            return [*trigger_pulse_mistakes(pulse, model), *wiring_mistakes("high_v", pulse.high_v, self._max_vpp)]

        self._generator.configure(partial(programs.trigger_pulse, pulse), limits)

    def fire(self) -> None:
        """Emit the pulse; see ``Agilent33250A.fire``."""
        self._generator.fire()


@final
class PulseGenerator33250A(GeneratorRole):
    """A finite train of TTL pulses after an external trigger."""

    def configure(self, train: PulseTrain) -> None:
        """Program the train; raise ``InstrumentError`` for what the instrument cannot do or changed."""

        def limits(model: GeneratorModel) -> list[str]:
            return [*pulse_train_mistakes(train, model), *wiring_mistakes("high_v", train.high_v, self._max_vpp)]

        self._generator.configure(partial(programs.pulse_train, train), limits)


@final
class ToneburstGenerator33250A(GeneratorRole):
    """A finite sine burst after an external trigger."""

    def configure(self, burst: Toneburst) -> None:
        """Program the burst; raise ``InstrumentError`` for what the instrument cannot do or changed."""

        def limits(model: GeneratorModel) -> list[str]:
            return [
                *toneburst_mistakes(burst, model),
                *wiring_mistakes("amplitude_vpp", burst.amplitude_vpp, self._max_vpp),
            ]

        self._generator.configure(partial(programs.toneburst, burst), limits)
