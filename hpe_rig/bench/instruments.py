"""Open instruments of a bench, and how each of them is made safe whatever happens to the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drivers.interfaces import Clock, Digitizer, Instrument, MasterTrigger, PulseGenerator, Setting, ToneburstGenerator
from hpe_rig.bench.interrupts import uninterrupted

if TYPE_CHECKING:
    from sim_backend.world import World

SAFE_ATTEMPTS = 2
"""How often an instrument is asked to be safe before it counts as unreachable: one lost reply is no lost bench."""
SAFE_ORDER = ("toneburst", "burst_train", "master", "tracking_pulser", "tracking_train", "digitizer")
"""Order of making safe: what pushes first."""


class UnsafeBenchError(Exception):
    """Some output could not be proven off."""

    def __init__(self, failures: Sequence[tuple[str, BaseException]]) -> None:
        lines = "\n".join(f"  {role}: {error}" for role, error in failures)
        super().__init__(
            f"THE BENCH MAY STILL BE DRIVING: not proven off: {', '.join(role for role, _ in failures)}\n{lines}\n"
            "Switch these outputs off by hand, now; programmed trains are finite and end by themselves."
        )
        self.roles = tuple(role for role, _ in failures)


@dataclass(frozen=True, slots=True)
class Bench:
    """The open instruments of a bench; ``burst_train`` and ``toneburst`` are None where nothing pushes."""

    simulated: bool
    clock: Clock
    world: World | None
    master: MasterTrigger
    tracking_train: PulseGenerator
    tracking_pulser: ToneburstGenerator
    digitizer: Digitizer
    burst_train: PulseGenerator | None = None
    toneburst: ToneburstGenerator | None = None

    @property
    def instruments(self) -> tuple[Instrument, ...]:
        """Every open instrument, in the order of making safe."""
        return tuple(getattr(self, role) for role in SAFE_ORDER if getattr(self, role) is not None)

    @property
    def generators(self) -> tuple[MasterTrigger | PulseGenerator | ToneburstGenerator, ...]:
        """The open generators, in the order of the trigger's way."""
        chain = (self.master, self.burst_train, self.toneburst, self.tracking_train, self.tracking_pulser)
        return tuple(generator for generator in chain if generator is not None)

    def make_safe(self) -> None:
        """Switch every output off and abort the capture, each guarded on its own; raise ``UnsafeBenchError``."""
        make_safe(self.instruments)

    def verify(self) -> dict[str, Mapping[str, Setting]]:
        """Return every instrument's settings as read back, by role; raise where one is not as programmed."""
        return {instrument.role: instrument.verify() for instrument in self.instruments}


def identify_each(instruments: Sequence[Instrument], known: list[Instrument]) -> None:
    """Add to ``known`` every instrument that is who it should be; raise the first failure, the others as its notes.

    All are asked whatever the others answer, so that each one that is there can be made safe.
    """
    failures: list[Exception] = []
    for instrument in instruments:
        try:
            instrument.identify()
        except Exception as error:
            failures.append(error)
        else:
            known.append(instrument)
    if failures:
        for other in failures[1:]:
            failures[0].add_note(str(other))
        raise failures[0]


def proven_off(instruments: Sequence[Instrument], known: Sequence[Instrument]) -> str:
    """Return in words which outputs have been read back as off, once ``known`` of ``instruments`` are safe."""
    unknown = ", ".join(item.role for item in instruments if item not in known)
    if not unknown:
        return "every output is off, verified"
    return f"not identified, so not proven off: {unknown}: look whether they are on; the others are off, verified"


def make_safe(instruments: Sequence[Instrument]) -> None:
    """Make each of ``instruments`` safe, whatever happens to the others; raise ``UnsafeBenchError`` for those left."""
    with uninterrupted():
        failures = [(item.role, error) for item in instruments if (error := _unsafe(item)) is not None]
        # Inside, so that an interrupt that was held back cannot take this message's place.
        if failures:
            raise UnsafeBenchError(failures)


def _unsafe(instrument: Instrument) -> Exception | None:
    """Return why ``instrument`` could not be proven safe; None where it was."""
    failure: Exception | None = None
    for _ in range(SAFE_ATTEMPTS):
        try:
            instrument.make_safe()
        except Exception as error:
            failure = error
        else:
            return None
    return failure
