"""Inventory of a bench: every instrument identified and its settings read; nothing is programmed, outputs end off.

Also the identification by a person: each role on the display of the instrument at its address.
"""

from __future__ import annotations

import difflib
import re
import secrets
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from drivers.interfaces import Identity, Instrument, InstrumentError, Setting
from hpe_rig.bench.bench_file import BenchFile, DigitizerBoard
from hpe_rig.bench.bench_loading import parse_bench
from hpe_rig.bench.identity import reported_serials, serial_problems, shared_serials
from hpe_rig.bench.instruments import DigitizerNotIdleError, UnsafeBenchError, make_safe
from hpe_rig.bench.interrupts import uninterrupted
from hpe_rig.bench.lock import holder_of, resources
from hpe_rig.bench.opening import open_each, visa_addresses

LATENCY_QUERIES: Final = 5
"""Number of identifications for the median round trip."""

Settings = Mapping[str, Setting]


@dataclass(frozen=True, slots=True)
class InstrumentReport:
    """One instrument in the inventory; ``identity`` and ``latency_s`` are None if it did not answer.

    ``settings`` were read before any command that changes them; ``self_test`` is None without a test; ``problems`` are
    differences from the bench file, each with a remedy.
    """

    role: str
    address: str
    identity: Identity | None = None
    latency_s: float | None = None
    settings: Settings = field(default_factory=dict)
    self_test: bool | None = None
    problems: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class BenchReport:
    """Every instrument of a bench, and the addresses of all VISA instruments."""

    title: str
    simulated: bool
    instruments: tuple[InstrumentReport, ...]
    addresses: tuple[str, ...]

    @property
    def complete(self) -> bool:
        """Whether every instrument answered as the bench file says."""
        return not any(instrument.problems for instrument in self.instruments)

    @property
    def settings(self) -> dict[str, Settings]:
        """The settings of the instruments that answered, by role."""
        return {item.role: item.settings for item in self.instruments if item.identity is not None}


@dataclass(frozen=True, slots=True)
class OffState:
    """One instrument after switching everything off: whether that is verified, and the proof or the reason."""

    role: str
    address: str
    proven: bool
    reason: str


def switch_off(bench: BenchFile, announce: Callable[[str], None]) -> tuple[OffState, ...]:
    """Switch every output of ``bench`` off and return the proof or the error of each.

    The locks of other programs do not prevent this; ``announce`` is called with their names.
    """
    for name in resources(bench, resolve=False):
        if holder := holder_of(name):
            announce(f"{name} is in use by {holder}: it is switched off anyway")
    errors: dict[str, str] = {}
    proven: dict[str, str] = {}
    try:
        with open_each(bench, lock=False) as instruments:
            errors = {role: str(item) for role, item in instruments.items() if isinstance(item, Exception)}
            identified = [item for item in instruments.values() if not isinstance(item, Exception)]
            proven = make_safe(identified)
            # An exchanged instrument is switched off too, so this comes last.
            serials = reported_serials(bench, identified)
            mistakes = serial_problems(bench, {role: item for role, item in serials.items() if isinstance(item, str)})
            for role, text in mistakes.items():
                announce(f"{role}: {text}")
    except (UnsafeBenchError, DigitizerNotIdleError) as error:
        errors, proven = errors | error.reasons, error.proven
    roles = [role for role in (*bench.generators.by_role, "digitizer") if role in proven or role in errors]
    return tuple(
        OffState(role, bench.address_text(role), role in proven, proven.get(role) or errors[role]) for role in roles
    )


def survey(bench: BenchFile, clock_s: Callable[[], float] = time.perf_counter, self_test: bool = False) -> BenchReport:
    """Return the inventory of ``bench``; every instrument that answers is safe, verified, when this returns.

    ``self_test`` runs the self-tests of all instruments that have one, after all outputs are off. Raises
    ``UnsafeBenchError`` if an output cannot be verified to be off.
    """
    snapshots: dict[str, Settings] = {}

    def read_settings(item: Instrument) -> None:
        snapshots[item.role] = item.snapshot()

    # Settings are reported as another program left them.
    with open_each(bench, before_off=read_settings) as instruments:
        reports = tuple(_report(role, item, bench, snapshots, clock_s) for role, item in instruments.items())
        # A search of the buses takes seconds, and a self-test may drive an output: all are off before.
        make_safe([item for item in instruments.values() if not isinstance(item, Exception)])
        addresses = () if bench.simulated else visa_addresses()
        reports = tuple(_with_suggestions(report, bench, addresses) for report in reports)
        if self_test:
            reports = tuple(_with_self_test(report, instruments[report.role]) for report in reports)
    serials = {report.role: report.identity.serial for report in reports if report.identity is not None}
    mistakes = shared_serials(serials) | serial_problems(bench, serials)
    reports = tuple(
        replace(report, problems=(*report.problems, *filter(None, [mistakes.get(report.role)]))) for report in reports
    )
    return BenchReport(bench.title, bench.simulated, reports, addresses)


def _report(
    role: str,
    item: Instrument | Exception,
    bench: BenchFile,
    snapshots: Mapping[str, Settings],
    clock_s: Callable[[], float],
) -> InstrumentReport:
    address = bench.address_text(role)
    if isinstance(item, Exception):
        return InstrumentReport(role, address, problems=(str(item),))
    try:
        identity, latency_s = _timed_identity(item, clock_s)
        identity = replace(identity, serial=item.serial_number())
        # If the first attempt failed, its error is that of the second one.
        settings = snapshots[role] if role in snapshots else item.snapshot()
    except InstrumentError as error:
        return InstrumentReport(role, address, problems=(str(error),))
    problems = list(_digitizer_problems(bench.digitizer, settings)) if role == "digitizer" else []
    if settings.get("output_on"):
        problems.append("its output was on; it is off now. Try: find the program that left it on")
    return InstrumentReport(role, address, identity, latency_s, settings, problems=tuple(problems))


def _with_suggestions(report: InstrumentReport, bench: BenchFile, addresses: Sequence[str]) -> InstrumentReport:
    """Return ``report`` with suggestions for the address of an instrument that did not answer."""
    if report.identity is not None:
        return report
    suggestions = _address_suggestion(report.role, report.address, bench, addresses)
    return replace(report, problems=(*report.problems, *suggestions))


def _with_self_test(report: InstrumentReport, item: Instrument | Exception) -> InstrumentReport:
    """Return ``report`` with the result of the instrument's self-test."""
    if isinstance(item, Exception):
        return report
    try:
        passed = item.self_test()
    except InstrumentError as error:
        return replace(report, self_test=False, problems=(*report.problems, str(error)))
    failure = "its self-test failed (*TST?). Try: power it off and on, test again, then have it repaired"
    return replace(report, self_test=passed, problems=(*report.problems, *([failure] if passed is False else [])))


def _timed_identity(instrument: Instrument, clock_s: Callable[[], float]) -> tuple[Identity, float]:
    """Return the identity and the median round-trip time of asking for it."""
    # The median is insensitive to the first query, which can include the set-up of a connection.
    durations_s = []
    for _ in range(LATENCY_QUERIES):
        start_s = clock_s()
        identity = instrument.identify()
        durations_s.append(clock_s() - start_s)
    return identity, statistics.median(durations_s)


def _address_suggestion(role: str, address: str, bench: BenchFile, addresses: Sequence[str]) -> Iterator[str]:
    if role == "digitizer" or bench.simulated:
        return
    # Addresses of serial lines are similar by their prefix; only another number is likely to be meant.
    candidates = [item for item in addresses if not item.upper().startswith("ASRL") or _unnumbered(item, address)]
    close = difflib.get_close_matches(address, candidates, n=3, cutoff=0.5)
    if address in addresses:
        yield f"an instrument answers at {address}, but it is no generator that can play this role"
    elif close:
        yield f"generators.{role}.address: did you mean {' or '.join(close)}?"
    elif addresses:
        yield f"generators.{role}.address: the addresses found are {', '.join(addresses)}"


def _unnumbered(first: str, second: str) -> bool:
    """Return whether two addresses are equal up to their numbers, as those of /dev/ttyUSB0 and /dev/ttyUSB1 are."""
    return re.sub(r"\d+", "0", first).lower() == re.sub(r"\d+", "0", second).lower()


def _digitizer_problems(board: DigitizerBoard, settings: Settings) -> Iterator[str]:
    for reported_key, key, stated in (
        ("dual_port_memory", "dual_port_memory", board.has_dual_port_memory),
        ("memory_samples_per_channel", "samples_per_channel", board.samples_per_channel),
    ):
        reported = settings.get(reported_key)
        if reported is not None and reported != stated:
            yield f"the board reports {reported_key} = {reported}. Try: digitizer.{key} = {str(reported).lower()}"
    # FPGA versions limit the records that an old board holds.
    version = str(settings.get("firmware", "")).removeprefix("FPGA ").partition(",")[0]
    if version.isdecimal() and board.max_records > (limit := board.board_model.record_limit(int(version))):
        yield f"FPGA version {version} holds {limit} single-port records. Try: digitizer.max_records = {limit}"


@contextmanager
def displayed_roles(bench: BenchFile) -> Iterator[Mapping[str, Instrument | Exception]]:
    """Yield every instrument by role, or its error, with outputs off and each generator's role on its display.

    The displays are cleared at the end, also after an interrupt.
    """
    with open_each(bench) as instruments:
        make_safe([item for item in instruments.values() if not isinstance(item, Exception)])
        generators: dict[str, Any] = {
            role: item for role, item in instruments.items() if role != "digitizer" and not isinstance(item, Exception)
        }
        try:
            for role, generator in generators.items():
                generator.display(role.replace("_", " ").upper())
            yield instruments
        finally:
            with uninterrupted():
                for generator in generators.values():
                    with suppress(InstrumentError):
                        generator.display("")


def lasting_serial(instrument: Any) -> str:
    """Return the serial number of ``instrument``, or its label; a generator without either is given a new label."""
    serial = str(instrument.serial_number())
    if not serial:
        serial = f"HPE_{secrets.token_hex(3).upper()}"
        instrument.store_label(serial)
    return serial


def with_serials(path: Path, serials: Mapping[str, str]) -> str:
    """Return the text of the bench file ``path`` with ``serials`` by role; comments and layout stay.

    Raises ``SettingsError`` if that is no bench file, such as one with the same number for two roles.
    """
    # Loads the editor of TOML files, which switching off does not need.
    from hpe_rig.scene import edited_text

    # Line ends stay as they are, so the text is not read with universal newlines.
    text = path.read_bytes().decode("utf-8-sig")
    sections = {role: ("digitizer",) if role == "digitizer" else ("generators", role) for role in serials}
    edited = edited_text(text, {(*sections[role], "serial"): serial for role, serial in serials.items()})
    parse_bench(path.stem, edited)
    return edited
