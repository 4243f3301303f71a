"""Command ``bench``: a bench as it stands, or as a run file records it, printed and compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hpe_rig.bench import (
    BenchReport,
    Difference,
    InstrumentReport,
    Settings,
    file_differences,
    open_bench,
    read_bench,
    settings_differences,
    survey,
    switch_off,
)
from hpe_rig.cli.console import EXIT_INSTRUMENT, EXIT_UNSAFE, announce
from hpe_rig.cli.tables import Page, wide_console
from hpe_rig.measurement import prepare_text, program_shot
from hpe_rig.result import rich_table
from hpe_rig.runs import open_run
from hpe_rig.scene import parse_toml
from hpe_rig.store import read_snapshots


@dataclass(frozen=True, slots=True)
class BenchState:
    """A bench's file and settings, from the bench itself (``report``, its file at ``path``) or from a run file."""

    name: str
    tables: Mapping[str, Any]
    settings: Mapping[str, Settings]
    report: BenchReport | None
    path: Path | None = None


def bench_state(path: Path | None, self_test: bool = False) -> BenchState:
    """Return the state of the bench in the bench file ``path``, or of the bench that a run file records.

    See ``survey`` for ``self_test``.
    """
    if path is not None and path.suffix == ".h5":
        return _state_of_run(path)
    text = read_bench(path)
    report = survey(text.bench, self_test=self_test)
    return BenchState("the bench now", parse_toml(text.text, text.name), report.settings, report, path)


def all_off(path: Path | None) -> int:
    """Switch every output of a bench off, print how each is known to be, and return the exit code."""
    bench = read_bench(path, any_title=True).bench
    switched = switch_off(bench, announce)
    console = wide_console()
    console.print(f"{bench.title} ({'SIMULATED' if bench.simulated else 'real'})", style="bold")
    rows = [
        (item.role, item.address, "off" if item.proven else "NOT PROVEN", item.reason.removeprefix(f"{item.role}: "))
        for item in switched
    ]
    console.print(rich_table(("role", "address", "output", "known because"), rows, words=4))
    left = [item.role for item in switched if not item.proven]
    outputs = [role for role in left if role != "digitizer"]
    if outputs:
        console.print(f"NOT PROVEN OFF: {', '.join(outputs)}: switch them off by hand, now", style="bold")
        return EXIT_UNSAFE
    # The board drives nothing by itself: what it triggers is a generator whose output is off.
    return EXIT_INSTRUMENT if left else 0


def compare_with(path: Path, state: BenchState) -> str:
    """Return the differences between the bench of the run file ``path`` and ``state`` as text, one a line."""
    run, found = _state_of_run(path), list[Difference]()
    found += file_differences(run.tables, state.tables)
    left = ""
    if state.report is None:
        found += settings_differences(run.settings, state.settings)
    elif run.settings and state.report.complete:
        found += settings_differences(run.settings, _programmed_as(path, state))
    else:
        why = "not every instrument answers" if run.settings else "the run holds none"
        left = f"\nwhat the instruments are set to is not compared: {why}"
    if not found:
        return f"{run.name} and {state.name} do not differ{left}"
    lines = "\n".join(f"  {difference.text(run.name, state.name)}" for difference in found)
    return f"{len(found)} differences\n{lines}{left}"


def _programmed_as(path: Path, state: BenchState) -> Mapping[str, Settings]:
    """Return the settings of the bench once it is programmed as for the last shot of the run in ``path``.

    An idle bench differs from one that measures in nearly everything. No output is enabled, and all are verified off.
    """
    stored, shots = open_run(path).stored, len(read_snapshots(path))
    setup = prepare_text(stored.scene_name, stored.scene_toml, state.path, refuse=False, stored=path)
    shot = setup.plan.shots[shots - 1]
    point = setup.scene.scene.points[shot.point]
    with open_bench(point.scene, setup.bench.bench.with_(point.bench), setup.plan.roles) as bench:
        return program_shot(shot, bench)


def _state_of_run(path: Path) -> BenchState:
    stored, snapshots = open_run(path).stored, read_snapshots(path)
    settings = snapshots[-1] if snapshots else {}
    return BenchState(path.name, parse_toml(stored.bench_toml, stored.bench_name), settings, None)


def print_report(report: BenchReport, wide: bool = False) -> None:
    """Print the table of instruments, then each problem with its remedy, then the addresses found.

    A narrow terminal gets no serial numbers, firmware and self-tests, but with ``wide``.
    """
    console, page = wide_console(), Page(wide)
    console.print(f"{report.title} ({'SIMULATED' if report.simulated else 'real'})", style="bold")
    headers = ("role", "address", "model", "serial", "firmware", "found", "self-test", "round trip\nms")
    rows = [_row(item) for item in report.instruments]
    tested = any(row[6] != "-" for row in rows)
    kept = [0, 1, 2, 5, *([6] if tested else []), 7] if page.narrow else range(len(headers))
    page.show(rich_table([headers[at] for at in kept], [[row[at] for at in kept] for row in rows], words=len(kept) - 1))
    for item in report.instruments:
        for problem in item.problems:
            console.print(f"{item.role}: {problem.removeprefix(f'{item.role}: ')}", style="bold")
    if not report.simulated:
        console.print(
            f"VISA addresses found: {', '.join(report.addresses) or 'none (LAN instruments may not be listed)'}"
        )
    if report.settings:
        console.print("every instrument that answered is safe: outputs off, digitizer idle, verified")


def _row(found: InstrumentReport) -> tuple[str, ...]:
    state = "on" if found.settings.get("output_on") else "off" if "output_on" in found.settings else "idle"
    if found.identity is None or found.latency_s is None:
        return found.role, found.address, "-", "-", "-", "problem", "-", "-"
    who = found.identity
    tested = {None: "-", True: "passed", False: "FAILED"}[found.self_test]
    latency = f"{found.latency_s * 1e3:.2f}"
    return found.role, found.address, who.model, who.serial, who.firmware, state, tested, latency
