"""The Agilent 33250A and the three generator roles it plays: master trigger, pulse train, toneburst.

Each group of settings is one message, after which the error queue is drained and the group read back. The order
avoids passing through a state that the instrument would resolve by itself. APPLy is never sent: it switches the
output on at once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Final, Literal, Never, final

from drivers.interfaces import Identity, InstrumentError, PulseTrain, Setting, Toneburst, TriggerPulse, Wire
from drivers.limits_33250a import (
    EDGE_S,
    pulse_train_mistakes,
    refuse,
    toneburst_mistakes,
    trigger_pulse_mistakes,
)
from drivers.read_back import Readable, Register, number, short_form, switch, whole_number
from drivers.scpi import ScpiSession

MODEL: Final = "33250A"
OUTPUT_OFF: Final = Register("output_on", "OUTP", False)
OUTPUT_ON: Final = Register("output_on", "OUTP", True)
RESET_WIDTH_S: Final = 100e-6
RESET_PERIOD_S: Final = 1e-3
# Levels are made of amplitude and offset, so that zero comes back as a small difference.
LEVEL_TOLERANCE_V: Final = 1e-9

READABLE: Final = (
    Readable("output_on", "OUTP", switch),
    Readable("load_ohm", "OUTP:LOAD", number),
    Readable("polarity", "OUTP:POL", short_form),
    Readable("trigger_output_on", "OUTP:TRIG", switch),
    Readable("function", "FUNC", short_form),
    Readable("frequency_hz", "FREQ", number),
    Readable("period_s", "PULS:PER", number),
    Readable("width_s", "PULS:WIDT", number),
    Readable("edge_s", "PULS:TRAN", number),
    Readable("amplitude_unit", "VOLT:UNIT", short_form),
    Readable("amplitude_vpp", "VOLT", number),
    Readable("offset_v", "VOLT:OFFS", number),
    Readable("low_v", "VOLT:LOW", number),
    Readable("high_v", "VOLT:HIGH", number),
    Readable("burst_on", "BURS:STAT", switch),
    Readable("burst_mode", "BURS:MODE", short_form),
    Readable("cycles", "BURS:NCYC", whole_number),
    Readable("burst_phase_deg", "BURS:PHAS", number),
    Readable("trigger_source", "TRIG:SOUR", short_form),
    Readable("trigger_slope", "TRIG:SLOP", short_form),
    Readable("delay_s", "TRIG:DEL", number),
)

Group = tuple[str, tuple[Register, ...]]


@final
class Agilent33250A:
    """The commands that all roles share; the state is the instrument's, here is only what was asked of it."""

    def __init__(self, wire: Wire, role: str) -> None:
        self.role = role
        self._session = ScpiSession(wire, role)
        self._programmed: tuple[Register, ...] = ()

    def identify(self) -> Identity:
        """Return who answers ``*IDN?``; raise ``InstrumentError`` if it is no 33250A.

        The vendor is not compared: later instruments of the same model carry another company's name.
        """
        reply = self._session.query("*IDN?")
        fields = [field.strip() for field in reply.split(",")]
        if len(fields) < 4 or fields[1].upper() != MODEL:
            raise InstrumentError(
                self.role,
                f"*IDN? was answered with {reply!r}, expected model {MODEL}",
                "the address in the bench file belongs to another instrument",
                f"give {self.role} the address of a {MODEL} in the bench file",
            )
        return Identity(fields[0], fields[1], fields[2], ",".join(fields[3:]))

    def configure(self, groups: Sequence[Group]) -> None:
        """Reset, then program group by group with the output off; ``InstrumentError`` at the first that fails."""
        self._programmed = ()
        self.identify()
        self._session.write("OUTP 0", "*CLS", "*RST")
        self._session.verify("reset", (OUTPUT_OFF,))
        for name, registers in groups:
            self._session.program(name, registers)
        self._programmed = tuple(register for _, registers in groups for register in registers)

    def verify(self) -> None:
        """Read every programmed setting back; raise ``InstrumentError`` where it differs or an error is queued."""
        self._require_configured("verify")
        self._session.verify("settings", self._programmed)

    def enable_output(self) -> None:
        """Switch the output on, verified."""
        self._require_configured("enable_output")
        self._session.program("output", (OUTPUT_ON,))

    def fire(self) -> None:
        """Trigger one burst by command; raise ``InstrumentError`` if the output is off or the trigger is ignored."""
        self._require_configured("fire")
        # The relay opens by itself on an overload; the trigger would then be accepted and nothing emitted.
        self._session.verify("output before the trigger", (OUTPUT_ON,))
        self._session.write("*TRG")
        self._session.verify("trigger by command", ())

    def snapshot(self) -> Mapping[str, Setting]:
        """Return every setting of ``READABLE`` as the instrument states it, and its ``*IDN?`` fields."""
        identity = self.identify()
        settings = {item.key: item.decode(self._session.query(f"{item.header}?")) for item in READABLE}
        return {"model": identity.model, "vendor": identity.vendor, "firmware": identity.firmware, **settings}

    def make_safe(self) -> None:
        """Switch the output off in whatever state the instrument is, and prove it by read-back."""
        # Errors from before must not hide behind, nor be blamed on, this one command.
        self._session.write("*CLS", OUTPUT_OFF.command)
        self._session.verify("output off", (OUTPUT_OFF,))

    def close(self) -> None:
        """Close the connection; the instrument keeps its state."""
        self._session.close()

    def _require_configured(self, action: str) -> None:
        if not self._programmed:
            why = "nothing is programmed, or the last configure failed"
            raise InstrumentError(self.role, f"{action} came before configure", why, "call configure first")


class GeneratorRole(ABC):
    """What every role of the instrument can do; the roles differ in what they program."""

    def __init__(self, wire: Wire, role: str) -> None:
        self._generator = Agilent33250A(wire, role)

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

    def verify(self) -> None:
        """See ``Agilent33250A.verify``."""
        self._generator.verify()

    def enable_output(self) -> None:
        """See ``Agilent33250A.enable_output``."""
        self._generator.enable_output()

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
        refuse(self.role, trigger_pulse_mistakes(pulse))
        # The burst of one pulse lasts one period, so the period only has to hold the pulse.
        period_s = max(RESET_PERIOD_S, 2 * pulse.width_s)
        groups = [
            _load(pulse.load_ohm),
            _pulses(1.0 / period_s, pulse.width_s),
            _levels(pulse.high_v),
            _trigger("BUS"),
            _burst(1, 0.0),
        ]
        self._generator.configure(groups)

    def fire(self) -> None:
        """Emit the pulse; see ``Agilent33250A.fire``."""
        self._generator.fire()


@final
class PulseGenerator33250A(GeneratorRole):
    """A finite train of TTL pulses after an external trigger."""

    def configure(self, train: PulseTrain) -> None:
        """Program the train; raise ``InstrumentError`` for what the instrument cannot do or changed."""
        refuse(self.role, pulse_train_mistakes(train))
        groups = [
            _load(train.load_ohm),
            _pulses(train.rate_hz, train.width_s),
            _levels(train.high_v),
            _trigger("EXT"),
            _burst(train.count, train.delay_s),
        ]
        self._generator.configure(groups)


@final
class ToneburstGenerator33250A(GeneratorRole):
    """A finite sine burst after an external trigger."""

    def configure(self, burst: Toneburst) -> None:
        """Program the burst; raise ``InstrumentError`` for what the instrument cannot do or changed."""
        refuse(self.role, toneburst_mistakes(burst))
        groups = [
            _load(burst.load_ohm),
            _sine(burst.carrier_hz, burst.amplitude_vpp),
            _trigger("EXT"),
            _burst(burst.cycles, burst.delay_s),
        ]
        self._generator.configure(groups)


def _load(load_ohm: float) -> Group:
    """Declare the load first, since it rescales all levels, and the unit, since ``VOLT?`` states none."""
    return "load", (Register("load_ohm", "OUTP:LOAD", float(load_ohm)), Register("amplitude_unit", "VOLT:UNIT", "VPP"))


def _pulses(rate_hz: float, width_s: float) -> Group:
    """Order rate and width so that the width after a reset, 100 us, never meets a period too short for it."""
    rate = Register("rate_hz", "FREQ", float(rate_hz))
    width = Register("width_s", "PULS:WIDT", float(width_s))
    order = (width, rate) if width_s <= RESET_WIDTH_S else (rate, width)
    return "pulse", (Register("function", "FUNC", "PULS"), Register("edge_s", "PULS:TRAN", EDGE_S), *order)


def _sine(carrier_hz: float, amplitude_vpp: float) -> Group:
    return "sine", (
        Register("function", "FUNC", "SIN"),
        Register("carrier_hz", "FREQ", float(carrier_hz)),
        Register("amplitude_vpp", "VOLT", float(amplitude_vpp)),
        Register("offset_v", "VOLT:OFFS", 0.0, LEVEL_TOLERANCE_V),
    )


def _levels(high_v: float) -> Group:
    low = Register("low_v", "VOLT:LOW", 0.0, LEVEL_TOLERANCE_V)
    return "levels", (low, Register("high_v", "VOLT:HIGH", float(high_v), LEVEL_TOLERANCE_V))


def _trigger(source: Literal["BUS", "EXT"]) -> Group:
    """Free the trigger connector, which is input and output at once, before it becomes the input."""
    return "trigger", (
        Register("trigger_output_on", "OUTP:TRIG", False),
        Register("trigger_source", "TRIG:SOUR", source),
        Register("trigger_slope", "TRIG:SLOP", "POS"),
    )


def _burst(count: int, delay_s: float) -> Group:
    return "burst", (
        Register("burst_mode", "BURS:MODE", "TRIG"),
        Register("cycles", "BURS:NCYC", count),
        Register("burst_phase_deg", "BURS:PHAS", 0.0),
        Register("delay_s", "TRIG:DEL", float(delay_s)),
        Register("burst_on", "BURS:STAT", True),
    )
