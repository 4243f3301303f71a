"""Stored states: the places of ``*SAV`` and ``*RCL`` with their names, and the learn string of ``*LRN?``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from sim_backend.generator.arbitrary import waveform_name
from sim_backend.generator.levels import load_share
from sim_backend.generator.registers import Registers
from sim_backend.generator.scpi_text import ScpiError, one, real_reply, whole_number

PLACES = 5
DEFAULT_NAMES = ("AUTO_RECALL", *(f"STATE_{place}" for place in range(1, PLACES)))
State = tuple[Registers, ...]


class StoredStates:
    """States by place, 0 to 4; they survive a reset."""

    def __init__(self) -> None:
        self._states: dict[int, State] = {}
        self._names = list(DEFAULT_NAMES)
        self.recalled_at_power_on = False

    def save(self, place: int, state: State) -> None:
        """Keep ``state``."""
        self._states[place] = state

    def recall(self, place: int) -> State:
        """Return the state of a place; raise ``ScpiError`` 810 where none was stored."""
        if place not in self._states:
            raise ScpiError(810, "State has not been stored")
        return self._states[place]

    def delete(self, place: int) -> None:
        """Forget the state of a place, and its name."""
        self._states.pop(place, None)
        self._names[place] = DEFAULT_NAMES[place]

    def valid(self, place: int) -> bool:
        """Return whether a state is stored at a place."""
        return place in self._states

    def rename(self, arguments: tuple[str, ...]) -> None:
        """Give a place another name."""
        place = place_of(arguments[:1])
        self._names[place] = waveform_name(one(arguments[1:]))

    def name(self, place: int) -> str:
        """Return the name of a place."""
        return self._names[place]


def place_of(arguments: tuple[str, ...]) -> int:
    """Return the place that the only argument names; raise ``ScpiError`` -222 for one that does not exist."""
    return whole_number(one(arguments), 0, PLACES - 1)


# In an order that meets no conflict after a reset: what belongs to a burst while it is off and the frequency as high as
# it can be, the pulse at a rate at which it fits, then frequency, function, levels; the output last.
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


def learn_string(channels: Sequence[Registers], numbered: bool, ask: Callable[[str, int], str | None]) -> str:
    """Return the commands that restore the state of all ``channels`` from anywhere, as one message.

    ``ask`` returns the setting of a header and a channel as the query does, None where the model lacks the header.
    """
    commands = ["*RST"]
    for channel, state in enumerate(channels, 1):
        for header, value in _settings(state):
            held = ask(header.replace("<n>", ""), channel) if value is None else value
            if held is not None:
                commands.append(f":{header.replace('<n>', str(channel) if numbered else '')} {held}")
    return ";".join(commands)


def _settings(state: Registers) -> Iterator[tuple[str, str | None]]:
    """Yield headers, with a value where it is not the present one."""
    yield "UNIT:ANGL", None
    yield "OUTP<n>:LOAD", None
    yield "SOUR<n>:FUNC:SQU:DCYC", None
    yield "SOUR<n>:FUNC:RAMP:SYMM", None
    yield "TRIG<n>:SOUR", "BUS"
    yield "SOUR<n>:FREQ", "MAX"
    yield from ((header, None) for header in BURST_AND_TRIGGER)
    yield "SOUR<n>:FREQ", f"{1 / (2 * state.width_s + 4 * state.edge_s):.2E}"
    yield from ((header, None) for header in PULSE)
    yield from ((f"SOUR<n>:{header}", None) for header in INACTIVE)
    yield "SOUR<n>:FREQ", None
    yield "SOUR<n>:FUNC", None
    # Whatever unit it is shown in: peak to peak it is what room the offset leaves.
    yield "SOUR<n>:VOLT", f"{real_reply(state.amplitude_v * load_share(state))} VPP"
    yield from ((header, None) for header in WAVEFORM)
