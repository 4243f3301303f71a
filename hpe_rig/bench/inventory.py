"""Inventory of a bench: every instrument identified and its settings read, nothing programmed, outputs left off."""

from __future__ import annotations

import difflib
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from drivers.interfaces import Identity, Instrument, InstrumentError, Setting
from hpe_rig.bench.bench_file import BenchFile, DigitizerBoard
from hpe_rig.bench.instruments import UnsafeBenchError, make_safe
from hpe_rig.bench.lock import holder_of, resources
from hpe_rig.bench.opening import open_each, visa_addresses

LATENCY_QUERIES: Final = 5

Settings = Mapping[str, Setting]


@dataclass(frozen=True, slots=True)
class Found:
    """One instrument as it was found; ``identity`` and ``latency_s`` are None where it did not answer.

    ``settings`` are as read before anything was sent that changes them; ``self_test`` is None where none was made;
    ``problems`` say what does not fit the bench file and what to try.
    """

    role: str
    address: str
    identity: Identity | None
    latency_s: float | None
    settings: Settings
    self_test: bool | None
    problems: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class BenchReport:
    """Every instrument of a bench, and the VISA addresses that can be found."""

    title: str
    simulated: bool
    found: tuple[Found, ...]
    addresses: tuple[str, ...]

    @property
    def complete(self) -> bool:
        """Whether every instrument answered as the bench file says."""
        return not any(found.problems for found in self.found)

    @property
    def settings(self) -> dict[str, Settings]:
        """The settings of the instruments that answered, by role."""
        return {found.role: found.settings for found in self.found if found.identity is not None}


@dataclass(frozen=True, slots=True)
class Switched:
    """One instrument after everything was switched off: whether it is proven to be, and how, or why not."""

    role: str
    address: str
    proven: bool
    how: str


def switch_off(bench: BenchFile, announce: Callable[[str], None]) -> tuple[Switched, ...]:
    """Switch every output of ``bench`` off and return for each how it is known to be, or why it is not.

    Nobody's lock keeps this from being done; ``announce`` is told whose bench it is.
    """
    for name in resources(bench):
        if holder := holder_of(name):
            announce(f"{name} is in use by {holder}: it is switched off all the same")
    reasons: dict[str, str] = {}
    proven: dict[str, str] = {}
    try:
        with open_each(bench, lock=False) as opened:
            reasons = {role: str(item) for role, item in opened.items() if isinstance(item, Exception)}
            proven = make_safe([item for item in opened.values() if not isinstance(item, Exception)])
    except UnsafeBenchError as error:
        reasons, proven = reasons | error.reasons, error.proven
    roles = [role for role in (*bench.generators.by_role, "digitizer") if role in proven or role in reasons]
    return tuple(
        Switched(role, _address(role, bench), role in proven, proven.get(role) or reasons[role]) for role in roles
    )


def survey(bench: BenchFile, clock_s: Callable[[], float] = time.perf_counter, self_test: bool = False) -> BenchReport:
    """Return what is on ``bench``; every instrument that answers is safe, verified, when this returns.

    ``self_test`` has every instrument that can test itself do so, once the outputs of all are off. Raises
    ``UnsafeBenchError`` where that cannot be proven.
    """
    addresses = () if bench.simulated else visa_addresses()
    with open_each(bench) as opened:
        found = tuple(_found(role, item, bench, addresses, clock_s) for role, item in opened.items())
        if self_test:
            make_safe([item for item in opened.values() if not isinstance(item, Exception)])
            found = tuple(_tested(here, opened[here.role]) for here in found)
    return BenchReport(bench.title, bench.simulated, found, addresses)


def _found(
    role: str, item: Instrument | Exception, bench: BenchFile, addresses: Sequence[str], clock_s: Callable[[], float]
) -> Found:
    address = _address(role, bench)
    if isinstance(item, Exception):
        return Found(role, address, None, None, {}, None, (str(item), *_suggestion(role, address, bench, addresses)))
    try:
        identity, latency_s = _timed(item, clock_s)
        settings = item.snapshot()
    except InstrumentError as error:
        return Found(role, address, None, None, {}, None, (str(error),))
    problems = _digitizer_problems(bench.digitizer, settings) if role == "digitizer" else _output_problems(settings)
    return Found(role, address, identity, latency_s, settings, None, tuple(problems))


def _tested(found: Found, item: Instrument | Exception) -> Found:
    """Return ``found`` with the result of the instrument's self-test."""
    if isinstance(item, Exception):
        return found
    try:
        passed = item.self_test()
    except InstrumentError as error:
        return replace(found, self_test=False, problems=(*found.problems, str(error)))
    failure = "its self-test failed (*TST?). Try: power it off and on, test again, then have it repaired"
    return replace(found, self_test=passed, problems=(*found.problems, *([failure] if passed is False else [])))


def _timed(instrument: Instrument, clock_s: Callable[[], float]) -> tuple[Identity, float]:
    durations_s = []
    for _ in range(LATENCY_QUERIES):
        start_s = clock_s()
        identity = instrument.identify()
        durations_s.append(clock_s() - start_s)
    return identity, statistics.median(durations_s)


def _address(role: str, bench: BenchFile) -> str:
    if role == "digitizer":
        return f"system {bench.digitizer.system_id}, board {bench.digitizer.board_id}"
    if bench.simulated:
        return f"{bench.transport} loopback" if bench.transport else "in process"
    return getattr(bench.generators, role).address or "-"


def _suggestion(role: str, address: str, bench: BenchFile, addresses: Sequence[str]) -> Iterator[str]:
    if role == "digitizer" or bench.simulated:
        return
    close = difflib.get_close_matches(address, addresses, n=3, cutoff=0.5)
    if address in addresses:
        yield f"{address} is there, but what answers it is no generator that can play this role"
    elif close:
        yield f"generators.{role}.address: did you mean {' or '.join(close)}?"
    elif addresses:
        yield f"generators.{role}.address: found are {', '.join(addresses)}"


def _output_problems(settings: Settings) -> Iterator[str]:
    if settings.get("output_on"):
        yield "its output was on; it is off now. Try: find the program that left it on"


def _digitizer_problems(board: DigitizerBoard, settings: Settings) -> Iterator[str]:
    for key, declared in (
        ("dual_port_memory", board.has_dual_port_memory),
        ("memory_samples_per_channel", board.samples_per_channel),
    ):
        reported = settings.get(key)
        if reported is not None and reported != declared:
            name = key.removeprefix("memory_")
            yield f"the board reports {key} = {reported}. Try: digitizer.{name} = {str(reported).lower()}"
    version = str(settings.get("firmware", "")).removeprefix("FPGA ").partition(",")[0]
    if version.isdecimal() and board.max_records > (most := board.board_model.record_limit(int(version))):
        what = f"FPGA version {version} holds {most} single-port records"
        yield f"{what}. Try: digitizer.max_records = {most}"
