"""Measure the processing of a run larger than memory, compared with reading it.

Records hold one echo and noise, in blocks of 1000 as a board delivers them. Processing is compared with reading only,
by plain h5py and with checksums. Each step is a fresh process, with its elapsed time, processor time and peak memory
beyond loading the package ("nothing").

    python scripts/benchmarks/streaming.py [--megabytes 1000] [--samples 2048] [--folder FOLDER]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from process_cost import resource_usage

if TYPE_CHECKING:
    from drivers.interfaces import RecordBlock
    from hpe_rig.measurement import Setup

BLOCK_RECORDS = 1000
BLOCK_OFFSETS = 997
"""Blocks start at this many offsets in one array of records, so that successive blocks differ."""


def main() -> None:
    """Print the cost of reading and processing."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--megabytes", type=float, default=1000.0, help="size of the run")
    parser.add_argument("--samples", type=int, default=2048, help="samples per record")
    parser.add_argument("--folder", type=Path, help="a folder on the disk to test")
    parser.add_argument("--step", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.step:
        step, path = options.step[0], Path(options.step[1])
        if step == "write":
            write_run(path, options.megabytes, options.samples)
        else:
            print_cost(step, path)
        return
    sizes = [f"--{name}={getattr(options, name)}" for name in ("megabytes", "samples")]
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        # Writing has its own process too: on Linux a child's peak memory includes that of the process that started it.
        for step in ("write", "nothing", "plain read", "read", "process"):
            command = [sys.executable, __file__, "--step", step, str(Path(folder) / "run.h5"), *sizes]
            subprocess.run(command, check=True)
            if step == "write":
                print("\n| step | elapsed, s | processor, s | peak, MB |\n|---|---|---|---|", flush=True)


def record_blocks(setup: Setup) -> Iterator[RecordBlock]:
    """Yield the records of the first shot in blocks as from the digitizer."""
    import numpy as np

    from drivers.interfaces import RecordBlock

    shot = setup.plan.shots[0]
    samples = np.arange(shot.capture.record_samples)
    phase = 2 * np.pi * setup.scene.scene.tracking.carrier_hz / shot.capture.sample_rate_hz * samples
    noise = np.random.default_rng(0).normal(0, 20, (BLOCK_RECORDS + BLOCK_OFFSETS, samples.size))
    codes = (1000 * np.sin(phase) + noise).astype(np.int16)
    limits = setup.bench.bench.digitizer.board_model.code_limits
    scale_v = 2 * shot.capture.input_range_v / (2 * limits[1] + 1)
    for first in range(0, shot.capture.record_count, BLOCK_RECORDS):
        offset = first // BLOCK_RECORDS % BLOCK_OFFSETS
        time_s = (first + np.arange(BLOCK_RECORDS)) / shot.tracking_train.rate_hz
        yield RecordBlock(first, codes[offset : offset + BLOCK_RECORDS], time_s, scale_v, scale_v / 2, limits)


def write_run(path: Path, megabytes: float, samples: int) -> None:
    """Write a run file of one shot with the program's own writer."""
    import hpe_rig as hpe
    from hpe_rig.measurement import prepare
    from hpe_rig.store import RunWriter

    pulses = BLOCK_RECORDS * max(1, round(megabytes * 1e6 / (2 * samples * BLOCK_RECORDS)))
    keys = {"tracking.pulse_count": pulses, "acquisition.record_samples": samples}
    setup = prepare(hpe.load_scene("table-1").with_(keys), refuse=False)
    with RunWriter(path, setup.scene, setup.bench, setup.plan) as writer:
        for block in record_blocks(setup):
            writer.append(setup.plan.shots[0], block)
        writer.finish(setup.plan.shots[0])


def print_cost(step: str, path: Path) -> None:
    """Do one step with the run file and print the cost in this process."""
    from hpe_rig.runs import process
    from hpe_rig.store import read_run

    start_s = time.perf_counter()
    if step == "process":
        process(path)
    elif step == "plain read":
        import h5py

        with h5py.File(path) as file:
            echo = file["records/echo"]
            for first in range(0, echo.shape[1], echo.chunks[1]):
                echo[0, first : first + echo.chunks[1]]
    elif step == "read":
        # Verifies checksums, as processing does.
        for _ in read_run(path).records.chunks(0, BLOCK_RECORDS):
            pass
    elapsed_s = time.perf_counter() - start_s
    processor_s, peak_mb = resource_usage()
    print(f"| {step} | {elapsed_s:.2f} | {processor_s:.2f} | {peak_mb:.0f} |", flush=True)


if __name__ == "__main__":
    main()
