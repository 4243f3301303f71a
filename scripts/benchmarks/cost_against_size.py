"""Measure processor time against numbers of scatterers, echoes, realisations and pulses.

* scatterers, echoes: a rigid gate of 130 samples, with different motion in every echo (100 echoes, 1000 scatterers);
* realisations: new scatterers, 100 echoes, noise at 20 dB and an estimate, a thousand realisations in memory at a time;
* pulses: a measurement of `table-1` with a longer train, from import to the stored result.

Rows of the last two are fresh processes with their peak memory. Calls below a second: the fastest of three.

    python scripts/benchmarks/cost_against_size.py [scatterers] [echoes] [realisations] [pulses]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from process_cost import processor_times_s, resource_usage

SIZES = {
    "scatterers": (1e3, 1e4, 1e5, 1e6),
    "echoes": (1e1, 1e2, 1e3, 1e4, 1e5),
    "realisations": (1e2, 1e3, 1e4, 1e5),
    "pulses": (1e3, 1e4, 1e5, 1e6),
}
CHUNK = 1000
"""Realisations in memory at a time."""
STAGES = ("plan", "collect", "store", "truth", "process")
COLUMNS = {
    "scatterers": ("method", "processor, s"),
    "echoes": ("method", "processor, s"),
    "realisations": ("echoes and noise, s", "coherent, s", "cross_spectrum, s", "peak, MB"),
    "pulses": (*(f"{stage}, s" for stage in STAGES), "all, s", "processor, s", "peak, MB"),
}


def main() -> None:
    """Print a table for each of the selected sizes."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("sizes", nargs="*", default=list(SIZES), metavar="SIZE", help=", ".join(SIZES))
    parser.add_argument("--in-process", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if unknown := set(options.sizes) - SIZES.keys():
        parser.error(f"no such size: {', '.join(unknown)}; there are {', '.join(SIZES)}")
    rows = {
        "scatterers": lambda count: synthesis_cells(count, 100),
        "echoes": lambda count: synthesis_cells(1000, count),
        "realisations": realisation_cells,
        "pulses": pulse_cells,
    }
    if options.in_process:
        print_row(options.in_process, rows[options.sizes[0]](options.in_process))
        return
    for name in options.sizes:
        print(f"\n| {name} | {' | '.join(COLUMNS[name])} |\n" + "|---" * (1 + len(COLUMNS[name])) + "|", flush=True)
        for count in map(int, SIZES[name]):
            if name in ("realisations", "pulses"):
                subprocess.run([sys.executable, __file__, name, "--in-process", str(count)], check=True)
            else:
                print_row(count, rows[name](count))


def print_row(count: int, cells: list[str]) -> None:
    print(f"| {count} | {' | '.join(cells)} |", flush=True)


def synthesis_cells(scatterers: int, echoes: int) -> list[str]:
    """Return the method and the processor time of one synthesis."""
    from sim_backend.echoes import EchoDelays, hann_pulse, synthesise

    rng = np.random.default_rng(0)
    pulse, gate_s = hann_pulse(9.0e6, 0.065), (np.arange(130) - 64.5) / 100e6
    delay_s = np.sort(rng.uniform(gate_s[0] + pulse.start_s, gate_s[-1] + pulse.end_s, scatterers))
    weight, shape = rng.standard_normal(scatterers), rng.uniform(0.5, 1.0, (1, scatterers))
    amplitude_s = 1e-6 * np.sin(np.arange(echoes)[:, None]) * 2 / 1540
    delays = EchoDelays(delay_s, shape, amplitude_s)
    # The first call compiles.
    method = synthesise(delays, weight, pulse, gate_s, 1e-8).method
    times_s: list[float] = []
    while len(times_s) < 3 and sum(times_s) < 3:
        times_s += processor_times_s(lambda: synthesise(delays, weight, pulse, gate_s, 1e-8), 1)
    return [method, f"{min(times_s):.2g}"]


def realisation_cells(count: int) -> list[str]:
    """Simulate and estimate ``count`` realisations in this process; return times and peak memory."""
    from hpe_rig.processing import estimate
    from hpe_rig.validation import MotionCase

    case = MotionCase(snr_db=20)
    times_s = dict.fromkeys(("echoes", "coherent", "cross_spectrum"), 0.0)
    # Loading and compiling happen once and do not count.
    for name in ("coherent", "cross_spectrum"):
        estimate(case.gate(case.twin_echoes(64, np.random.default_rng(1))), [case.frequency_hz], name)
    rng = np.random.default_rng(0)
    for first in range(0, count, CHUNK):
        start_s = time.process_time()
        volts = case.twin_echoes(min(CHUNK, count - first), rng)
        volts += np.sqrt(np.mean(volts**2, axis=(-2, -1), keepdims=True)) / 10 * rng.standard_normal(volts.shape)
        times_s["echoes"] += time.process_time() - start_s
        for name in ("coherent", "cross_spectrum"):
            start_s = time.process_time()
            estimate(case.gate(volts), [case.frequency_hz], name)
            times_s[name] += time.process_time() - start_s
    return [*(f"{time_s:.2g}" for time_s in times_s.values()), f"{resource_usage()[1]:.0f}"]


def pulse_cells(pulses: int) -> list[str]:
    """Measure and process a scene of ``pulses`` pulses in this process; return times by stage and peak memory."""
    start_s = time.perf_counter()
    import hpe_rig as hpe
    from hpe_rig.measurement import prepare, record_run
    from hpe_rig.result import Stages
    from hpe_rig.runs import process

    stages = Stages()
    with tempfile.TemporaryDirectory() as folder:
        setup = prepare(hpe.load_scene("table-1").with_({"tracking.pulse_count": pulses}), stages=stages)
        process(record_run(setup, Path(folder) / "run.h5", stages=stages), stages=stages)
    all_s = time.perf_counter() - start_s
    processor_s, peak_mb = resource_usage()
    times_s = [*(stages.run_time_s.get(name, 0.0) for name in STAGES), all_s, processor_s]
    return [*(f"{time_s:.3g}" for time_s in times_s), f"{peak_mb:.0f}"]


if __name__ == "__main__":
    main()
