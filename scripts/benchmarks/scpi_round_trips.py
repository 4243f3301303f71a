"""Count SCPI messages and round trips, and what the sequencer costs a shot, over every transport.

Usage: python scripts/benchmarks/scpi_round_trips.py [SCENE]

A round trip is a reply that was waited for. The twin's train takes no wall time and its echoes are worked out while
records are collected, so that every other step's wall time is the sequencer's, the drivers' and the transport's own;
verifying includes the snapshot and its way into the run file.
"""

import argparse
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

from drivers.visa import VisaConnection
from hpe_rig.bench import TRANSPORTS, read_bench
from hpe_rig.measurement import Progress, Step, prepare, record_run
from hpe_rig.scene import shipped_scenes
from sim_backend.world import GeneratorConnection

SWEEP = ("burst_length_s = 100e-6", "burst_length_s = [100e-6, 120e-6, 80e-6, 100e-6, 60e-6]")
RS232_BYTES_PER_S = 5760.0
COUNTED = ("messages", "round trips", "bytes")


class Ledger:
    """What went over the connections, and the wall time, by step of each shot."""

    def __init__(self) -> None:
        self.counts: dict[tuple[int, Step], Counter[str]] = defaultdict(Counter)
        self.wall_s: Counter[tuple[int, Step]] = Counter()
        self._now: tuple[int, Step] | None = None
        self._since_s = 0.0

    def observe(self, progress: Progress) -> None:
        """Note that the sequencer goes on to another step."""
        now_s, here = time.perf_counter(), (progress.shot.index, progress.step)
        if self._now is not None:
            # Making safe begins when the last record is stored, and ends where its own step is told.
            self.wall_s[here if progress.step is Step.SAFE else self._now] += now_s - self._since_s
        # What the store and the twin's truth take after a shot is not the sequencer's.
        self._now, self._since_s = None if progress.step is Step.SAFE else here, now_s

    def count(self, what: str, size: int) -> None:
        """Note a message or a reply of the present step."""
        if self._now is not None:
            self.counts[self._now].update({what: 1, "bytes": size + 1})


def counting(ledger: Ledger, method: str, what: str) -> Callable[..., Any]:
    """Return a wrapper of a connection's ``method`` that keeps the ledger."""

    def wrap(original: Callable[..., Any]) -> Callable[..., Any]:
        def counted(connection: Any, *message: str) -> Any:
            reply = original(connection, *message)
            ledger.count(what, len(message[0] if method == "write" else reply))
            return reply

        return counted

    return wrap


def measured(scene: Path, transport: str | None, folder: Path) -> Ledger:
    """Return the ledger of one sweep over ``transport``; None is in process."""
    bench = folder / f"{transport}.toml"
    line = f'simulated = true\ntransport = "{transport}"' if transport else "simulated = true"
    bench.write_text(read_bench().text.replace("simulated = true", line), encoding="utf-8")
    ledger, connection = Ledger(), VisaConnection if transport else GeneratorConnection
    before = {method: getattr(connection, method) for method in ("write", "read")}
    for method, what in (("write", "messages"), ("read", "round trips")):
        setattr(connection, method, counting(ledger, method, what)(before[method]))
    try:
        record_run(prepare(str(scene), bench), folder / f"{transport}.h5", ledger.observe)
    finally:
        for method, original in before.items():
            setattr(connection, method, original)
    return ledger


def print_counts(ledger: Ledger) -> None:
    """Print what the first shot and a later one exchange with all generators together, step by step."""
    print(f"{'SCPI, 5 generators':22}{'first shot':>36}{'later shot of a sweep':>36}")
    print(f"{'':22}" + 2 * "".join(f"{name:>12}" for name in COUNTED) + f"{'s at 57600 Bd':>16}")
    steps = (Step.CONFIGURE, Step.VERIFY, Step.ENABLE, Step.FIRE, Step.COLLECT)
    total: Counter[str] = Counter()
    for step in steps:
        first, later = ledger.counts[0, step], ledger.counts[1, step]
        total.update({f"0 {name}": first[name] for name in COUNTED} | {f"1 {name}": later[name] for name in COUNTED})
        name = "make safe" if step is Step.COLLECT else step.value
        print(f"{name:22}" + "".join(f"{count[key]:12}" for count in (first, later) for key in COUNTED))
    cells = "".join(f"{total[f'{shot} {name}']:12}" for shot in (0, 1) for name in COUNTED)
    print(f"{'total':22}{cells}{total['1 bytes'] / RS232_BYTES_PER_S:16.2f}\n")


def print_overhead(ledgers: dict[str, Ledger]) -> None:
    """Print the wall time a shot of a sweep takes beyond its train, step by step, in ms."""
    steps = (Step.CONFIGURE, Step.VERIFY, Step.ARM, Step.ENABLE, Step.FIRE, Step.SAFE)
    print("overhead a shot, ms   " + "".join(f"{step.value:>16}" for step in steps) + f"{'sum':>10}")
    for name, ledger in ledgers.items():
        shots = sorted({shot for shot, _ in ledger.wall_s})[1:]
        ms = [1e3 * median(ledger.wall_s[shot, step] for shot in shots) for step in steps]
        print(f"{name:22}" + "".join(f"{value:16.2f}" for value in ms) + f"{sum(ms):10.2f}")


def main() -> None:
    """Measure a sweep over burst lengths in process and over every transport, and print both tables."""
    scenes = [name for name, text in shipped_scenes().items() if SWEEP[0] in text]
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scene", nargs="?", default="bovine-muscle", choices=scenes, help="a shipped scene")
    scene = parser.parse_args().scene
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / "sweep.toml"
        path.write_text(shipped_scenes()[scene].replace(*SWEEP), encoding="utf-8")
        transports = [item for item in TRANSPORTS if item != "serial" or sys.platform != "win32"]
        ledgers = {item or "in process": measured(path, item, folder) for item in (None, *transports)}
    print_counts(ledgers["in process"])
    print_overhead(ledgers)


if __name__ == "__main__":
    main()
