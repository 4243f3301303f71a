"""Command ``bench``: the state of a bench, or its record in a run file, printed and compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from hpe_rig.bench import (
    WITHOUT_OUTPUT,
    BenchFile,
    BenchReport,
    InstrumentReport,
    Settings,
    file_differences,
    open_bench,
    read_bench,
    read_conditions,
    settings_differences,
    survey,
)
from hpe_rig.cli.console import print_json
from hpe_rig.cli.tables import Printer, wide_console
from hpe_rig.measurement import prepare_text, program_shot
from hpe_rig.plan import calibration_expiry
from hpe_rig.result import rich_table
from hpe_rig.runs import open_run
from hpe_rig.scene import parse_toml
from hpe_rig.store import read_snapshots


@dataclass(frozen=True, slots=True)
class BenchState:
    """Bench file and settings, read from the bench (``report``, ``bench`` from file ``path``) or from a run file."""

    name: str
    tables: Mapping[str, Any]
    settings: Mapping[str, Settings]
    report: BenchReport | None
    path: Path | None = None
    bench: BenchFile | None = None


def bench_state(path: Path | None, self_test: bool = False) -> BenchState:
    """Return the state of the bench of a bench file or run file ``path``; see ``survey`` for ``self_test``."""
    if path is not None and path.suffix == ".h5":
        return _state_of_run(path)
    text = read_bench(path)
    report = survey(text.bench, self_test=self_test)
    tables = parse_toml(text.text, text.name)
    return BenchState("the bench now", tables, report.settings, report, path, text.bench)


def compare_with(path: Path, state: BenchState) -> str:
    """Return the differences between the bench of the run file ``path`` and ``state`` as text, one a line."""
    run = _state_of_run(path)
    differences = list(file_differences(run.tables, state.tables))
    note = ""
    if state.report is None:
        differences += settings_differences(run.settings, state.settings)
    # An idle bench is programmed for the run first; an incomplete one cannot be.
    elif run.settings and state.report.complete:
        differences += settings_differences(run.settings, _settings_of_last_shot(path, state))
    else:
        why = "not every instrument answers" if run.settings else "the run holds none"
        note = f"\nthe settings of the instruments are not compared: {why}"
    changed = open_run(path).stored.changed_settings
    note += "".join(f"\nshot {shot + 1} of {run.name}: after it {text}" for shot, text in changed.items())
    if not differences:
        return f"{run.name} and {state.name} do not differ{note}"
    lines = "\n".join(f"  {difference.text(run.name, state.name)}" for difference in differences)
    return f"{len(differences)} differences\n{lines}{note}"


def _settings_of_last_shot(path: Path, state: BenchState) -> Mapping[str, Settings]:
    """Return the settings of the bench after it is programmed for the last shot of the run in ``path``.

    The settings of an idle bench would differ in nearly everything. No output is enabled, and all are verified off.
    """
    stored, shots = open_run(path).stored, len(read_snapshots(path))
    # The run was measured: its conflicts are no reason to refuse a comparison.
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
    """Print the table of instruments, then each problem with its remedy, then the VISA addresses.

    A narrow terminal gets no serial numbers and firmware, unless ``wide``.
    """
    console, printer = wide_console(), Printer(wide)
    console.print(f"{report.title} ({'SIMULATED' if report.simulated else 'real'})", style="bold")
    headers = ("role", "address", "model", "serial", "firmware", "found", "self-test", "round trip\nms")
    rows = [_row(item) for item in report.instruments]
    tested = any(row[6] != "-" for row in rows)
    # The self-test has a column only if it ran, else every cell would be a dash.
    columns = [0, 1, 2, 5, *([6] if tested else []), 7] if printer.narrow else range(len(headers))
    cells = [[row[column] for column in columns] for row in rows]
    printer.table(rich_table([headers[column] for column in columns], cells, words=len(columns) - 1))
    for item in report.instruments:
        for problem in item.problems:
            console.print(f"{item.role}: {problem.removeprefix(f'{item.role}: ')}", style="bold")
    if not report.simulated:
        console.print(
            f"VISA addresses found: {', '.join(report.addresses) or 'none (LAN instruments may not be listed)'}"
        )
    if report.settings:
        console.print(_safe_text(list(report.settings)))


def report_json(report: BenchReport, bench: BenchFile) -> bool:
    """Print the instruments and conditions as JSON; return whether a run could begin."""
    conditions = read_conditions(bench.conditions)
    is_ready = report.complete and all(reading.accepted for reading in conditions)
    print_json(
        {
            "title": report.title,
            "simulated": report.simulated,
            "ready": is_ready,
            "instruments": [_instrument_as_dict(item) for item in report.instruments],
            "conditions": [{"text": str(reading), "accepted": reading.accepted} for reading in conditions],
        }
    )
    return is_ready


def _instrument_as_dict(instrument: InstrumentReport) -> dict[str, Any]:
    """Return the identity of an instrument, null if it did not answer, and its problems."""
    identity = instrument.identity
    return {
        "role": instrument.role,
        "address": instrument.address,
        "model": identity and identity.model,
        "serial": identity and identity.serial,
        "firmware": identity and identity.firmware,
        "self_test": instrument.self_test,
        "round_trip_s": instrument.latency_s,
        "problems": list(instrument.problems),
    }


def _safe_text(roles: Sequence[str]) -> str:
    """Return in words the verified state of ``roles``, the instruments that answered."""
    states = {
        "outputs off": any(role not in WITHOUT_OUTPUT for role in roles),
        "digitizer idle": "digitizer" in roles,
    }
    return f"every instrument that answered is safe: {', '.join(name for name in states if states[name])}, verified"


def print_calibration(bench: BenchFile) -> None:
    """Print that the calibration of a real bench has expired or lies in the future."""
    for finding in () if bench.simulated else calibration_expiry(bench, date.today()):
        if finding.level != "passed":
            wide_console().print(f"{finding}", style="bold")


def print_conditions(bench: BenchFile) -> bool:
    """Read and print the conditions of ``bench``; return whether a run could begin without a wait for them."""
    readings = read_conditions(bench.conditions)
    for reading in readings:
        wide_console().print(f"{reading}", style="" if reading.accepted else "bold")
    waiting = [reading.condition for reading in readings if not reading.accepted]
    if waiting:
        names = " and ".join(condition.name for condition in waiting)
        longest_s = min(condition.max_wait_s for condition in waiting)
        what = f"a run would wait before its first shot for {names}, and end after {longest_s:g} s"
        remedy = "bring the values within their limits, or correct the command or the limits in the bench file"
        wide_console().print(f"{what}. Try: {remedy}.", style="bold")
    return not waiting


def _row(instrument: InstrumentReport) -> tuple[str, ...]:
    role, address, identity = instrument.role, instrument.address, instrument.identity
    if identity is None or instrument.latency_s is None:
        return role, address, "-", "-", "-", "problem", "-", "-"
    output_on = instrument.settings.get("output_on")
    state = "idle" if output_on is None else "on" if output_on else "off"
    self_test = {None: "-", True: "passed", False: "FAILED"}[instrument.self_test]
    latency = f"{instrument.latency_s * 1e3:.2f}"
    return role, address, identity.model, identity.serial, identity.firmware, state, self_test, latency
