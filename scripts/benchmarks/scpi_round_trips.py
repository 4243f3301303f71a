"""Count SCPI messages and round trips, and time the sequencer's overhead per shot, for every transport.

A round trip is a reply that the program waits for. On the twin the train takes no time, and the echoes are computed
while records are collected. The times of the other steps are those of sequencer, drivers and transport. The step
"verify" includes the snapshot and its way into the run file.

    python scripts/benchmarks/scpi_round_trips.py [SCENE]
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
COUNTS = ("messages", "round trips", "bytes")


class Ledger:
    """Traffic of the connections and elapsed time, for each step of each shot."""

    def __init__(self) -> None:
        self.counts: dict[tuple[int, Step], Counter[str]] = defaultdict(Counter)
        self.elapsed_s: Counter[tuple[int, Step]] = Counter()
        self._step: tuple[int, Step] | None = None
        self._traffic_step: tuple[int, Step] | None = None
        self._start_s = 0.0

    def observe(self, progress: Progress) -> None:
        """Book the time since the last step, and begin the next one."""
        now_s, step = time.perf_counter(), (progress.shot.index, progress.step)
        if self._step is not None:
            # Making safe begins when the last record is stored and is reported at its end, unlike the other steps.
            self.elapsed_s[step if progress.step is Step.SAFE else self._step] += now_s - self._start_s
        # Settings are read back after the outputs are off, which has no time of its own.
        self._traffic_step = step
        # Storing the shot and computing the twin's truth come after it and are no overhead of the sequencer.
        self._step, self._start_s = None if progress.step is Step.SAFE else step, now_s

    def count(self, kind: str, size: int) -> None:
        """Count a message or a reply of the present step."""
        if self._traffic_step is not None:
            self.counts[self._traffic_step].update({kind: 1, "bytes": size + 1})


def counting(ledger: Ledger, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap the method ``name`` of a connection so that ``ledger`` counts its calls."""

    def counted(connection: Any, *message: str) -> Any:
        reply = method(connection, *message)
        if name == "write":
            ledger.count("messages", len(message[0]))
        else:
            ledger.count("round trips", len(reply))
        return reply

    return counted


def measure_sweep(scene: Path, transport: str | None, folder: Path) -> Ledger:
    """Measure the sweep over ``transport`` (in this process if None) and return its ledger."""
    bench = folder / f"{transport}.toml"
    line = f'simulated = true\ntransport = "{transport}"' if transport else "simulated = true"
    bench.write_text(read_bench().text.replace("simulated = true", line), encoding="utf-8")
    ledger, connection = Ledger(), VisaConnection if transport else GeneratorConnection
    originals = {name: getattr(connection, name) for name in ("write", "read")}
    for name, method in originals.items():
        setattr(connection, name, counting(ledger, name, method))
    try:
        record_run(prepare(str(scene), bench), folder / f"{transport}.h5", ledger.observe)
    finally:
        for name, method in originals.items():
            setattr(connection, name, method)
    return ledger


def print_counts(ledger: Ledger) -> None:
    """Print the traffic of all generators together in the first shot and in a later one, for each step."""
    print(f"{'SCPI, 5 generators':22}{'first shot':>36}{'later shot of a sweep':>36}")
    print(f"{'':22}" + 2 * "".join(f"{name:>12}" for name in COUNTS) + f"{'s at 57600 Bd':>16}")
    totals: tuple[Counter[str], Counter[str]] = (Counter(), Counter())
    for step in (Step.CONFIGURE, Step.VERIFY, Step.ENABLE, Step.FIRE, Step.COLLECT, Step.SAFE):
        counts = ledger.counts[0, step], ledger.counts[1, step]
        for total, count in zip(totals, counts, strict=True):
            total.update(count)
        # Messages between the last record and the end of the shot switch outputs off.
        name = {Step.COLLECT: "make safe", Step.SAFE: "read back"}.get(step, step.value)
        print(f"{name:22}" + "".join(f"{count[key]:12}" for count in counts for key in COUNTS))
    cells = "".join(f"{total[key]:12}" for total in totals for key in COUNTS)
    print(f"{'total':22}{cells}{totals[1]['bytes'] / RS232_BYTES_PER_S:16.2f}\n")


def print_overhead(ledgers: dict[str, Ledger]) -> None:
    """Print for each transport the time per shot beyond its train, ms, by step."""
    steps = (Step.CONFIGURE, Step.VERIFY, Step.ARM, Step.ENABLE, Step.FIRE, Step.SAFE)
    print("overhead a shot, ms   " + "".join(f"{step.value:>16}" for step in steps) + f"{'sum':>10}")
    for name, ledger in ledgers.items():
        # The first shot programs everything; later shots only what changes.
        shots = sorted({shot for shot, _ in ledger.elapsed_s})[1:]
        times_ms = [1e3 * median(ledger.elapsed_s[shot, step] for shot in shots) for step in steps]
        print(f"{name:22}" + "".join(f"{time_ms:16.2f}" for time_ms in times_ms) + f"{sum(times_ms):10.2f}")


def main() -> None:
    """Measure a sweep over burst lengths in process and over every transport, and print both tables."""
    scenes = [name for name, text in shipped_scenes().items() if SWEEP[0] in text]
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scene", nargs="?", default="bovine-muscle", choices=scenes, help="a shipped scene")
    scene = parser.parse_args().scene
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "sweep.toml"
        path.write_text(shipped_scenes()[scene].replace(*SWEEP), encoding="utf-8")
        transports = [None, *(item for item in TRANSPORTS if item != "serial" or sys.platform != "win32")]
        ledgers = {item or "in process": measure_sweep(path, item, path.parent) for item in transports}
    print_counts(ledgers["in process"])
    print_overhead(ledgers)


if __name__ == "__main__":
    main()
