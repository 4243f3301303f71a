"""Command ``bench --off``: every output switched off and verified; nothing is imported that this does not need."""

from __future__ import annotations

from pathlib import Path

from hpe_rig.bench import WITHOUT_OUTPUT, OffState, read_bench, switch_off
from hpe_rig.cli.console import EXIT_INSTRUMENT, EXIT_UNSAFE, announce
from hpe_rig.cli.streams import results_accepted
from hpe_rig.cli.tables import wide_console
from hpe_rig.result import rich_table


def switch_all_off(path: Path | None) -> int:
    """Switch every output of a bench off, print the verified state of each, and return the exit code."""
    bench = read_bench(path, lenient=True).bench
    instruments = switch_off(bench, announce)
    console = wide_console()
    console.print(f"{bench.title} ({'SIMULATED' if bench.simulated else 'real'})", style="bold")
    rows = [
        (item.role, item.address, _output_text(item), item.reason.removeprefix(f"{item.role}: "))
        for item in instruments
    ]
    console.print(rich_table(("role", "address", "output", "evidence"), rows, words=4))
    if not results_accepted():
        for role, address, output, evidence in rows:
            announce(f"{role} at {address}, output: {output}{f' ({evidence})' if evidence else ''}")
    unproven = [item.role for item in instruments if not item.proven]
    outputs = [role for role in unproven if role not in WITHOUT_OUTPUT]
    if outputs:
        text = f"NOT PROVEN OFF: {', '.join(outputs)}: switch them off by hand, now"
        console.print(text, style="bold")
        if not results_accepted():
            announce(text)
        return EXIT_UNSAFE
    return EXIT_INSTRUMENT if unproven else 0


def _output_text(item: OffState) -> str:
    if item.role in WITHOUT_OUTPUT:
        return "drives nothing"
    return "off" if item.proven else "NOT PROVEN"
