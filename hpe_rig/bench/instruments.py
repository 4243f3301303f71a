"""Open instruments of a bench, and how each of them is made safe whatever happens to the others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from drivers.interfaces import (
    Clock,
    Digitizer,
    Instrument,
    InstrumentError,
    MasterTrigger,
    PulseGenerator,
    Setting,
    ToneburstGenerator,
)
from hpe_rig.bench.interrupts import uninterrupted

if TYPE_CHECKING:
    from sim_backend.world import World

AnInstrument = TypeVar("AnInstrument", bound=Instrument)
Answer = TypeVar("Answer")

SAFE_ORDER = ("toneburst", "burst_train", "master", "tracking_pulser", "tracking_train", "digitizer")
"""Order of making safe: what pushes first."""


class UnsafeBenchError(Exception):
    """Some output could not be proven off; ``proven`` says of the others, by role, how they are known to be."""

    def __init__(
        self,
        failures: Sequence[tuple[str, BaseException]],
        proven: Mapping[str, str],
        tried: Sequence[Instrument] = (),
    ) -> None:
        lines = "\n".join(f"  {role}: {error}" for role, error in failures)
        others = f"\nKnown to be off: {_in_words(proven)}." if proven else ""
        super().__init__(
            f"THE BENCH MAY STILL BE DRIVING: not proven off: {', '.join(role for role, _ in failures)}\n{lines}\n"
            f"Switch these outputs off by hand, now; programmed trains are finite and end by themselves.{others}"
        )
        self.roles = tuple(role for role, _ in failures)
        self.reasons = {role: str(error) for role, error in failures}
        self.proven = dict(proven)
        self._tried = tuple(tried)

    def concerns(self, instruments: Sequence[Instrument]) -> bool:
        """Return whether every one of ``instruments`` was among those that were tried."""
        return all(any(item is tried for tried in self._tried) for item in instruments)


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

    def make_safe(self) -> dict[str, str]:
        """Switch every output off, abort the capture, and return by role how that is known; as ``make_safe``."""
        return make_safe(self.instruments)

    def verify(self) -> dict[str, Mapping[str, Setting]]:
        """Return every instrument's settings as read back, by role; raise where one is not as programmed."""
        told = _each(self.instruments, lambda line: [_told(item.role, item.verify) for item in line])
        settings = {}
        for item in self.instruments:
            found = told[item.role]
            if isinstance(found, Exception):
                raise found
            settings[item.role] = found
        return settings

    def recheck(self) -> tuple[str, ...]:
        """Return in words where outputs or settings are no longer as verified, or cannot be read back any more."""
        told = _each(self.generators, lambda line: [_told(item.role, item.recheck) for item in line])
        return tuple(str(found) for found in told.values() if found is not None)


def proven_off(roles: Sequence[str], proven: Mapping[str, str]) -> str:
    """Return in words which outputs of ``roles`` are known to be off, and how, once those in ``proven`` are safe.

    The digitizer drives nothing by itself: what it triggers is a generator of its own role.
    """
    unknown = [role for role in roles if role not in proven and role != "digitizer"]
    if not unknown:
        return f"every output is off, verified: {_in_words(proven)}"
    others = f"the others are off, verified: {_in_words(proven)}" if proven else "there are no others"
    whether = "it is" if len(unknown) == 1 else "they are"
    return f"not identified, so not proven off: {', '.join(unknown)}: look whether {whether} on; {others}"


def make_safe(instruments: Sequence[Instrument]) -> dict[str, str]:
    """Make each of ``instruments`` safe, whatever happens to the others; return by role how each is known to be.

    Every one is sent its switch before any is asked, those of different lines at the same time, so that none waits for
    one that is mute. Raises ``UnsafeBenchError`` for those that are not proven safe.
    """
    with uninterrupted():
        told = _each(instruments, _safe)
        proven = {role: how for role, how in told.items() if isinstance(how, str)}
        failures = [(role, how) for role, how in told.items() if not isinstance(how, str)]
        # Inside, so that an interrupt that was held back cannot take this message's place.
        if failures:
            raise UnsafeBenchError(failures, proven, instruments)
    return proven


def _each(
    instruments: Sequence[AnInstrument], ask: Callable[[Sequence[AnInstrument]], list[tuple[str, Answer]]]
) -> dict[str, Answer]:
    """Return by role what ``ask`` returns of each line with instruments, all lines being asked at the same time.

    What is reached within this process comes last, and never at the same time as anything else.
    """
    lines: dict[str, list[AnInstrument]] = {}
    for item in instruments:
        lines.setdefault(item.bus, []).append(item)
    within = lines.pop("", [])
    told = {role: answer for line in (*_at_once(ask, list(lines.values())), ask(within)) for role, answer in line}
    return {item.role: told[item.role] for item in instruments}


def _at_once(
    ask: Callable[[Sequence[AnInstrument]], list[tuple[str, Answer]]], lines: Sequence[Sequence[AnInstrument]]
) -> list[list[tuple[str, Answer]]]:
    if len(lines) > 1:
        # No thread can be started any more at the end of the interpreter; one after the other will do there.
        with suppress(RuntimeError), ThreadPoolExecutor(len(lines)) as pool:
            return list(pool.map(ask, lines))
    return [ask(line) for line in lines]


def _told(role: str, ask: Callable[[], Answer]) -> tuple[str, Answer | Exception]:
    try:
        return role, ask()
    except InstrumentError as error:
        return role, error


def _safe(line: Sequence[Instrument]) -> list[tuple[str, str | Exception]]:
    """Make the instruments of one line safe: every switch is sent before the first answer is awaited."""
    for item in line:
        # What goes wrong here is met again by the attempts that follow, which set it right where they can.
        with suppress(Exception):
            item.switch_off()
    return [(item.role, _proof(item)) for item in line]


def _proof(instrument: Instrument) -> str | Exception:
    """Return how ``instrument`` is known to be safe, or why it is not; one lost reply is no lost bench."""
    for attempt in (instrument.prove_off, instrument.make_safe):
        try:
            return attempt()
        except Exception as error:
            failure = error
    return failure


def _in_words(proven: Mapping[str, str]) -> str:
    ways = dict.fromkeys(proven.values())
    return "; ".join(f"{', '.join(role for role, how in proven.items() if how == way)} {way}" for way in ways)
