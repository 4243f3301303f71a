"""What stands on the bench: every instrument asked who it is and how it is set, nothing programmed, all left safe."""

from __future__ import annotations

import difflib
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from drivers.interfaces import Identity, Instrument, InstrumentError, Setting
from hpe_rig.bench import open_each, visa_addresses
from hpe_rig.bench_compare import file_differences, settings_differences
from hpe_rig.bench_file import BenchFile, DigitizerBoard, read_bench
from hpe_rig.mistakes import parse_toml
from hpe_rig.open_instruments import make_safe
from hpe_rig.store import read_run, read_snapshots

LATENCY_QUERIES: Final = 5
TABLE_WIDTH: Final = 120
OLD_FPGA, OLD_FPGA_RECORDS = 18, 1000

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


def survey(bench: BenchFile, clock_s: Callable[[], float] = time.perf_counter, self_test: bool = False) -> BenchReport:
    """Return what stands on ``bench``; every instrument that answers is safe, verified, when this returns.

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


@dataclass(frozen=True, slots=True)
class BenchState:
    """A bench's file and settings, from the bench itself (``report``) or from a run file."""

    name: str
    tables: Mapping[str, Any]
    settings: Mapping[str, Settings]
    report: BenchReport | None


def bench_state(path: Path | None, self_test: bool = False) -> BenchState:
    """Return the state of the bench in the bench file ``path``, or of the bench that a run file remembers.

    See ``survey`` for ``self_test``.
    """
    if path is not None and path.suffix == ".h5":
        return _state_of_run(path)
    text = read_bench(path)
    report = survey(text.bench, self_test=self_test)
    return BenchState("the bench now", parse_toml(text.text, text.name), report.settings, report)


def compare_with(path: Path, state: BenchState) -> str:
    """Return in words what differs between the run file ``path`` and ``state``."""
    run = _state_of_run(path)
    before = run.settings if state.report is None else _stated_now(run.settings, state.settings)
    found = [*file_differences(run.tables, state.tables), *settings_differences(before, state.settings)]
    if not found:
        return f"{run.name} and {state.name} do not differ"
    lines = "\n".join(f"  {difference.text(run.name, state.name)}" for difference in found)
    return f"{len(found)} differences\n{lines}"


def _stated_now(before: Mapping[str, Settings], now: Mapping[str, Settings]) -> dict[str, Settings]:
    """Return ``before`` without what a board states only once it is programmed, as nobody has done now."""
    stated = now.get("digitizer")
    if stated is None or "digitizer" not in before:
        return dict(before)
    board = {key: value for key, value in before["digitizer"].items() if key in stated}
    return {**before, "digitizer": board}


def _state_of_run(path: Path) -> BenchState:
    run, snapshots = read_run(path), read_snapshots(path)
    settings = snapshots[-1] if snapshots else {}
    return BenchState(path.name, parse_toml(run.bench_toml, run.bench_name), settings, None)


def print_report(report: BenchReport) -> None:
    """Print the table, then what is wrong with the remedy, then the addresses found."""
    console = Console(soft_wrap=True, highlight=False, markup=False, width=max(TABLE_WIDTH, Console().width))
    console.print(f"{report.title} ({'SIMULATED' if report.simulated else 'real'})", style="bold")
    table = Table(box=None, header_style="bold")
    for header in ("role", "address", "model", "serial", "firmware", "round trip\nms", "found", "self-test"):
        table.add_column(header, justify="right" if header.startswith("round") else "left")
    for found in report.found:
        table.add_row(*_row(found))
    console.print(table)
    for found in report.found:
        for problem in found.problems:
            console.print(f"{found.role}: {problem.removeprefix(f'{found.role}: ')}", style="bold")
    if not report.simulated:
        console.print(
            f"VISA addresses found: {', '.join(report.addresses) or 'none (LAN instruments may not be listed)'}"
        )
    if report.settings:
        console.print("every instrument that answered is safe: outputs off, digitizer idle, read back")


def _row(found: Found) -> tuple[str, ...]:
    state = "on" if found.settings.get("output_on") else "off" if "output_on" in found.settings else "idle"
    if found.identity is None or found.latency_s is None:
        return found.role, found.address, "-", "-", "-", "-", "problem", "-"
    who = found.identity
    tested = {None: "-", True: "passed", False: "FAILED"}[found.self_test]
    latency = f"{found.latency_s * 1e3:.2f}"
    return found.role, found.address, who.model, who.serial, who.firmware, latency, state, tested


def _found(
    role: str,
    item: Instrument | Exception,
    bench: BenchFile,
    addresses: Sequence[str],
    clock_s: Callable[[], float],
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
        ("dual_port_memory", board.dual_port_memory),
        ("memory_samples_per_channel", board.samples_per_channel),
    ):
        reported = settings.get(key)
        if reported is not None and reported != declared:
            name = key.removeprefix("memory_")
            yield f"the board reports {key} = {reported}. Try: digitizer.{name} = {str(reported).lower()}"
    version = str(settings.get("firmware", "")).removeprefix("FPGA ").partition(",")[0]
    if version.isdecimal() and int(version) <= OLD_FPGA and board.max_records > OLD_FPGA_RECORDS:
        what = f"FPGA version {version} holds {OLD_FPGA_RECORDS} single-port records"
        yield f"{what}. Try: digitizer.max_records = {OLD_FPGA_RECORDS}"
