"""Command ``commission``: questions to the person who moves the T piece, the table of cables, the bench file."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from pathlib import Path

from hpe_rig.bench import Bench, BenchFile, read_bench
from hpe_rig.cli.console import EXIT_INSTRUMENT, announce
from hpe_rig.cli.tables import wide_console
from hpe_rig.cli.terminal import answer, has_terminal
from hpe_rig.measurement import CableResult, Operator, Tap, commission, record_commissioning, taps, twin_operator
from hpe_rig.result import rich_table
from hpe_rig.scene import Mistake, SettingsError
from hpe_rig.store import refuse_unwritable


def commission_bench(path: Path | None) -> int:
    """Commission the bench of the bench file ``path``, print and record the results, and return the exit code."""
    # Imported here: the other commands of a bench need no numbers.
    import numpy as np

    text = read_bench(path)
    if path is not None:
        refuse_unwritable(path)
    _confirm_amplifier_off(text.bench)
    results = commission(text.bench, _operator(text.bench), np.random.default_rng())
    _print(text.bench, results)
    if path is not None:
        record_commissioning(path, text, results, date.today())
    faulty = [result for result in results if result.fault]
    if faulty:
        where = f"; {path} holds no commissioning now" if path is not None else ""
        announce(f"{len(faulty)} of {len(results)} cables are not proven, so that nothing is recorded{where}")
        return EXIT_INSTRUMENT
    where = f" and recorded in {path}" if path is not None else "; no bench file is named, so that none is written"
    announce(f"all {len(results)} cables are proven{where}")
    return 0


def _confirm_amplifier_off(bench: BenchFile) -> None:
    """Ask whether the amplifier of a real bench is off; raise ``SettingsError`` without that, or without a terminal."""
    if bench.simulated:
        return
    if not has_terminal():
        what = "a person must confirm that the amplifier is off and move a T piece, and there is no terminal"
        raise SettingsError("commission", [Mistake("", what, "the same command in a terminal at the bench")])
    announce("This drives every cable of the bench, among them those to the power amplifier.")
    if answer("Is the power amplifier switched off? yes/no: ") not in ("y", "yes"):
        what = "the power amplifier must be off: an exchanged cable would bring 5 V pulses to its input"
        raise SettingsError("commission", [Mistake("", what, "switch it off, run the command again")])


def _operator(bench: BenchFile) -> Operator:
    """Return the person at the terminal; on a simulated bench each move of the T piece is simulated and announced."""
    t_pieces, move = taps(bench), twin_operator(bench)

    def ask(instruments: Bench, tap: Tap | None) -> None:
        if tap is None:
            text = "remove the T piece and plug every cable back"
        else:
            text = f"{t_pieces.index(tap) + 1} of {len(t_pieces)}: T piece at {tap}; its third end to channel B"
        if instruments.simulated:
            announce(text)
            move(instruments, tap)
        else:
            answer(f"{text}. All outputs are off. Enter when done: ")

    return ask


def _print(bench: BenchFile, results: Sequence[CableResult]) -> None:
    console = wide_console()
    console.print(f"{bench.title} ({'SIMULATED' if bench.simulated else 'real'})", style="bold")
    rows = [
        (item.source, item.target, "FAULT", "-", "-")
        if item.fault
        else (item.source, item.target, "proven", f"{item.delay_s * 1e9:.1f}", f"{item.delay_u_s * 1e9:.1f}")
        for item in results
    ]
    console.print(rich_table(("from", "to", "cable", "delay\nns", "u\nns"), rows, words=3))
    for item in results:
        if item.fault:
            console.print(f"{item.source} -> {item.target}: {item.fault}", style="bold")
