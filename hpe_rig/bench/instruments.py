"""Open instruments of a bench; each is made safe, whatever happens to the others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
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
from hpe_rig.bench.bench_file import BenchFile
from hpe_rig.bench.comparison import BenchSettings, settings_differences
from hpe_rig.bench.interrupts import uninterrupted
from hpe_rig.bench.output_limits import require_within_limits

if TYPE_CHECKING:
    from sim_backend.world import World

AnInstrument = TypeVar("AnInstrument", bound=Instrument)
Answer = TypeVar("Answer")

SAFE_ORDER = ("toneburst", "burst_train", "master", "tracking_pulser", "tracking_train", "digitizer")
"""Order of making safe: the generators of the push first."""
WITHOUT_OUTPUT = ("digitizer",)
"""Roles without an output: the trigger output of the board starts a generator, which is off."""


class UnsafeBenchError(Exception):
    """Some outputs could not be verified to be off; ``proven`` holds the proofs of the others, by role."""

    def __init__(
        self,
        failures: Sequence[tuple[str, BaseException]],
        proven: Mapping[str, str],
        tried: Sequence[Instrument] = (),
    ) -> None:
        lines = "\n".join(f"  {role}: {_without_role(error)}" for role, error in failures)
        off_text = f"\nKnown to be off: {_proofs_text(proven)}." if proven else ""
        outputs = [role for role, _ in failures if role not in WITHOUT_OUTPUT]
        super().__init__(
            f"THE BENCH MAY STILL BE DRIVING: not proven off: {', '.join(outputs)}\n{lines}\n"
            f"Switch these outputs off by hand, now; programmed trains are finite and end by themselves.{off_text}"
        )
        self.roles = tuple(role for role, _ in failures)
        self.reasons = {role: str(error) for role, error in failures}
        self.proven = dict(proven)
        self.tried = tuple(tried)


class DigitizerNotIdleError(InstrumentError):
    """The digitizer could not be verified to be idle; it drives nothing. The outputs in ``proven`` are off."""

    def __init__(self, error: BaseException, proven: Mapping[str, str], tried: Sequence[Instrument]) -> None:
        off_text = f"; off, verified: {_proofs_text(proven)}" if proven else ""
        super().__init__(
            "digitizer",
            f"it is not verified to be idle ({_without_role(error)})",
            f"the board or its driver does not answer; it drives nothing{off_text}",
            "end other programs that use the board, restart the computer",
        )
        self.reasons = {"digitizer": str(self)}
        self.proven = dict(proven)
        self.tried = tuple(tried)


def has_tried(error: BaseException, instruments: Sequence[Instrument]) -> bool:
    """Return whether ``error`` reports an attempt to make every one of ``instruments`` safe."""
    if not isinstance(error, UnsafeBenchError | DigitizerNotIdleError):
        return False
    return all(any(item is tried for tried in error.tried) for item in instruments)


@dataclass(frozen=True, slots=True)
class Bench:
    """The open instruments of a bench; ``burst_train`` and ``toneburst`` are None without tonebursts."""

    simulated: bool
    clock: Clock
    world: World | None
    master: MasterTrigger
    tracking_train: PulseGenerator
    tracking_pulser: ToneburstGenerator
    digitizer: Digitizer
    burst_train: PulseGenerator | None = None
    toneburst: ToneburstGenerator | None = None
    file: BenchFile | None = None

    @property
    def instruments(self) -> tuple[Instrument, ...]:
        """Every open instrument, in the order of making safe."""
        return tuple(getattr(self, role) for role in SAFE_ORDER if getattr(self, role) is not None)

    @property
    def generators(self) -> tuple[MasterTrigger | PulseGenerator | ToneburstGenerator, ...]:
        """The open generators, in the order of the triggers."""
        chain = (self.master, self.burst_train, self.toneburst, self.tracking_train, self.tracking_pulser)
        return tuple(generator for generator in chain if generator is not None)

    def make_safe(self) -> dict[str, str]:
        """Switch every output off, abort the capture, and return the proofs by role; raises as ``make_safe``."""
        return make_safe(self.instruments)

    def verify(self) -> dict[str, Mapping[str, Setting]]:
        """Return every instrument's settings as read back, by role.

        Raises ``InstrumentError`` if one differs from the programmed value, or drives a transducer beyond a limit of
        the bench file.
        """
        answers = ask_each(self.instruments, lambda item: item.verify())
        settings = {}
        for role, answer in answers.items():
            if isinstance(answer, Exception):
                raise answer
            settings[role] = answer
        if self.file is not None:
            require_within_limits(self.file, settings)
        return settings

    def recheck(self) -> tuple[str, ...]:
        """Return in words the outputs or settings that changed since ``verify``, or cannot be read back any more."""
        answers = ask_each(self.generators, lambda item: item.recheck())
        return tuple(str(answer) for answer in answers.values() if answer is not None)

    def changed_since(self, settings: BenchSettings) -> tuple[str, ...]:
        """Return in words what differs from ``settings`` of the verified shot, after it and with outputs off.

        Settings that are not programmed are included, and errors that are queued. An instrument that cannot be read
        back is named too.
        """
        answers = ask_each(self.instruments, lambda item: item.snapshot_and_errors())
        read = {role: answer for role, answer in answers.items() if not isinstance(answer, Exception)}
        differences = settings_differences(
            {role: settings[role] for role in read}, {role: answer[0] for role, answer in read.items()}
        )
        return (
            *(item.text("the settings before the shot", "those after it") for item in differences),
            *(f"{role}: error queue: {', '.join(errors)}" for role, (_, errors) in read.items() if errors),
            *(f"not read back: {answer}" for answer in answers.values() if isinstance(answer, Exception)),
        )


def proven_off(roles: Sequence[str], proven: Mapping[str, str]) -> str:
    """Return in words the outputs of ``roles`` that are verified to be off, with their proofs, and the other ones.

    The digitizer does not drive the transducer, so that it is not among the others.
    """
    unknown = [role for role in roles if role not in proven and role != "digitizer"]
    if not unknown:
        return f"every output is off, verified: {_proofs_text(proven)}"
    off_text = f"the others are off, verified: {_proofs_text(proven)}" if proven else "there are no others"
    whether = "it is" if len(unknown) == 1 else "they are"
    return f"not identified, so not proven off: {', '.join(unknown)}: look whether {whether} on; {off_text}"


def make_safe(instruments: Sequence[Instrument]) -> dict[str, str]:
    """Make each of ``instruments`` safe, whatever happens to the others; return the proofs by role.

    All are sent the command before any is asked, those on different buses at the same time, so that no instrument
    waits for one that does not answer. Raises ``UnsafeBenchError`` for outputs that cannot be verified, and
    ``DigitizerNotIdleError`` if all outputs are off.
    """
    with uninterrupted():
        answers = _ask_buses(instruments, _make_bus_safe)
        proven = {role: answer for role, answer in answers.items() if isinstance(answer, str)}
        failures = [(role, answer) for role, answer in answers.items() if not isinstance(answer, str)]
        # Raised inside the block, so that a deferred interrupt cannot replace this message.
        if any(role not in WITHOUT_OUTPUT for role, _ in failures):
            raise UnsafeBenchError(failures, proven, instruments)
        for _, error in failures:
            raise DigitizerNotIdleError(error, proven, instruments)
    return proven


def ask_each(
    instruments: Sequence[AnInstrument], ask: Callable[[AnInstrument], Answer]
) -> dict[str, Answer | Exception]:
    """Return by role the answer of each instrument, or its ``InstrumentError``; all buses at the same time."""
    return _ask_buses(instruments, lambda items: [_answer(item.role, partial(ask, item)) for item in items])


def _ask_buses(
    instruments: Sequence[AnInstrument], ask: Callable[[Sequence[AnInstrument]], list[tuple[str, Answer]]]
) -> dict[str, Answer]:
    """Return by role the answers of ``ask`` for the instruments on each bus; all buses are asked at the same time.

    Instruments in this process share its memory; they are asked last, and not in a thread.
    """
    buses: dict[str, list[AnInstrument]] = {}
    for item in instruments:
        buses.setdefault(item.bus, []).append(item)
    in_process = buses.pop("", [])
    answers = dict(
        answer for answers in (*_in_threads(ask, list(buses.values())), ask(in_process)) for answer in answers
    )
    return {item.role: answers[item.role] for item in instruments}


def _in_threads(
    ask: Callable[[Sequence[AnInstrument]], list[tuple[str, Answer]]], buses: Sequence[Sequence[AnInstrument]]
) -> list[list[tuple[str, Answer]]]:
    if len(buses) > 1:
        # At the end of the interpreter no thread can be started; the buses are then asked one after the other.
        with suppress(RuntimeError), ThreadPoolExecutor(len(buses)) as pool:
            return list(pool.map(ask, buses))
    return [ask(items) for items in buses]


def _answer(role: str, ask: Callable[[], Answer]) -> tuple[str, Answer | Exception]:
    try:
        return role, ask()
    except InstrumentError as error:
        return role, error


def _make_bus_safe(items: Sequence[Instrument]) -> list[tuple[str, str | Exception]]:
    """Make the instruments on one bus safe: all are sent the command before the first answer is awaited."""
    for item in items:
        # A failure here is repeated or repaired by the attempts in _proof.
        with suppress(Exception):
            item.switch_off()
    return [(item.role, _proof(item)) for item in items]


def _proof(instrument: Instrument) -> str | Exception:
    """Return the proof that ``instrument`` is safe, or the error; after one lost reply it is made safe again."""
    for attempt in (instrument.prove_off, instrument.make_safe):
        try:
            return attempt()
        except Exception as error:
            failure = error
    return failure


def _without_role(error: BaseException) -> str:
    """Return the text of ``error`` without the role at its beginning, which the message states already."""
    return str(error).removeprefix(f"{error.role}: ") if isinstance(error, InstrumentError) else str(error)


def _proofs_text(proven: Mapping[str, str]) -> str:
    """Return the proofs in words, each once with all roles that it applies to."""
    roles: dict[str, list[str]] = {}
    for role, proof in proven.items():
        roles.setdefault(proof, []).append(role)
    return "; ".join(f"{', '.join(names)} {proof}" for proof, names in roles.items())
