"""Stored states: the memory locations of ``*SAV`` and ``*RCL``, and the learn string of ``*LRN?``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from sim_backend.generator.arbitrary import waveform_name
from sim_backend.generator.levels import load_divider
from sim_backend.generator.registers import Registers
from sim_backend.generator.scpi_text import ScpiError, only_argument, real_reply, whole_number

LOCATIONS = 5
DEFAULT_NAMES = ("AUTO_RECALL", *(f"STATE_{location}" for location in range(1, LOCATIONS)))
State = tuple[Registers, ...]


class StoredStates:
    """States by memory location, 0 to 4; they survive a reset."""

    def __init__(self) -> None:
        """Start with empty memory locations and their default names."""
        self._states: dict[int, State] = {}
        self._names = list(DEFAULT_NAMES)
        self.recalled_at_power_on = False

    def save(self, location: int, state: State) -> None:
        """Store ``state``."""
        self._states[location] = state

    def recall(self, location: int) -> State:
        """Return the stored state; raise ``ScpiError`` 810 if there is none."""
        if location not in self._states:
            raise ScpiError(810, "State has not been stored")
        return self._states[location]

    def delete(self, location: int) -> None:
        """Delete a state and its name."""
        self._states.pop(location, None)
        self._names[location] = DEFAULT_NAMES[location]

    def valid(self, location: int) -> bool:
        """Return whether a state is stored at the location."""
        return location in self._states

    def rename(self, arguments: tuple[str, ...]) -> None:
        """Set the name of a location."""
        location = location_of(arguments[:1])
        self._names[location] = waveform_name(only_argument(arguments[1:]))

    def name(self, location: int) -> str:
        """Return the name of a location."""
        return self._names[location]


def location_of(arguments: tuple[str, ...]) -> int:
    """Return the location in the only argument; raise ``ScpiError`` -222 if it does not exist."""
    return whole_number(only_argument(arguments), 0, LOCATIONS - 1)


# The order avoids conflicts after a reset: burst settings with the burst off and the highest frequency, the pulse at a
# frequency with room for it, then frequency, function, levels; the output last.
BURST_AND_TRIGGER = (
    *("TRIG<n>:SLOP", "SOUR<n>:BURS:MODE", "SOUR<n>:BURS:NCYC", "SOUR<n>:BURS:INT:PER", "SOUR<n>:BURS:PHAS"),
    *("SOUR<n>:BURS:GATE:POL", "TRIG<n>:TIM", "TRIG<n>:DEL", "TRIG<n>:SOUR", "OUTP:TRIG:SLOP", "OUTP:TRIG"),
)
PULSE = (
    *("SOUR<n>:PULS:WIDT", "SOUR<n>:FUNC:PULS:WIDT", "SOUR<n>:PULS:TRAN", "SOUR<n>:FUNC:PULS:TRAN"),
    "SOUR<n>:FUNC:PULS:HOLD",
)
WAVEFORM = (
    *("SOUR<n>:VOLT:OFFS", "SOUR<n>:VOLT:UNIT", "SOUR<n>:VOLT:RANG:AUTO", "SOUR<n>:PHAS"),
    *("OUTP<n>:POL", "OUTP:SYNC", "DISP", "SOUR<n>:BURS:STAT", "OUTP<n>"),
)
INACTIVE = (
    *("AM:DEPT", "AM:SOUR", "AM:INT:FREQ", "AM:INT:FUNC", "FM:DEV", "FM:SOUR", "FM:INT:FREQ", "FM:INT:FUNC"),
    *("FSK:FREQ", "FSK:SOUR", "FSK:INT:RATE", "SWE:SPAC", "SWE:TIME", "FREQ:STAR", "FREQ:STOP", "MARK:FREQ"),
)


def learn_string(channels: Sequence[Registers], numbered: bool, setting_of: Callable[[str, int], str | None]) -> str:
    """Return the commands that restore the present state of all ``channels`` from any other, as one message (*LRN?).

    ``setting_of`` returns the query's reply for a header and a channel, None if the model lacks the header.
    """
    commands = ["*RST"]
    for channel, state in enumerate(channels, 1):
        for header, value in _settings(state):
            setting = setting_of(header.replace("<n>", ""), channel) if value is None else value
            if setting is not None:
                commands.append(f":{header.replace('<n>', str(channel) if numbered else '')} {setting}")
    return ";".join(commands)


def _settings(state: Registers) -> Iterator[tuple[str, str | None]]:
    """Yield the headers of all settings, with a value or None, sorted so that each can be restored after those before.

    With None the present setting is restored; a value is a temporary one that later settings need.
    """
    yield "UNIT:ANGL", None
    yield "OUTP<n>:LOAD", None
    yield "SOUR<n>:FUNC:SQU:DCYC", None
    yield "SOUR<n>:FUNC:RAMP:SYMM", None
    # With the trigger on BUS and the highest frequency, burst settings meet no limit.
    yield "TRIG<n>:SOUR", "BUS"
    yield "SOUR<n>:FREQ", "MAX"
    yield from ((header, None) for header in BURST_AND_TRIGGER)
    # A period with room for the pulse and its edges.
    yield "SOUR<n>:FREQ", f"{1 / (2 * state.width_s + 4 * state.edge_s):.2E}"
    yield from ((header, None) for header in PULSE)
    yield from ((f"SOUR<n>:{header}", None) for header in INACTIVE)
    yield "SOUR<n>:FREQ", None
    yield "SOUR<n>:FUNC", None
    # In volts peak to peak, independent of the displayed unit.
    yield "SOUR<n>:VOLT", f"{real_reply(state.amplitude_v * load_divider(state))} VPP"
    yield from ((header, None) for header in WAVEFORM)
