"""Compare the writer of run files with plain h5py, and measure the processing of a run larger than memory.

Records hold one echo and noise, in blocks of 1000 as a board delivers them. Plain h5py writes the same chunks into a
file of the same format and flushes after each, without and with a checksum per chunk. The writers alternate; the table
has the best rate of each. `--repeats 0`: the run file's writer only, once.

Then processing is compared with reading only, by plain h5py and with checksums. Each step is a fresh process, with its
elapsed time, processor time and peak memory beyond loading the package ("nothing").

    python scripts/benchmarks/streaming.py [--megabytes 1000] [--samples 2048] [--repeats 3] [--folder FOLDER]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
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
WRITERS = ("writer", "plain", "plain with checksums")


def main() -> None:
    """Print the rates of writing, then the cost of reading and processing."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--megabytes", type=float, default=1000.0, help="size of the run")
    parser.add_argument("--samples", type=int, default=2048, help="samples per record")
    parser.add_argument("--repeats", type=int, default=3, help="runs of each writer")
    parser.add_argument("--folder", type=Path, help="a folder on the disk to test")
    parser.add_argument("--step", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.step:
        step, path = options.step[0], Path(options.step[1])
        if step == "write":
            compare_writers(path, options.megabytes, options.samples, options.repeats)
        else:
            print_cost(step, path)
        return
    sizes = [f"--{name}={getattr(options, name)}" for name in ("megabytes", "samples", "repeats")]
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        # Writing has its own process too: on Linux a child's peak memory includes that of the process that started it.
        for step in ("write", "nothing", "plain read", "read", "process"):
            command = [sys.executable, __file__, "--step", step, str(Path(folder) / "run.h5"), *sizes]
            subprocess.run(command, check=True)
            if step == "write":
                print("\n| step | elapsed, s | processor, s | peak, MB |\n|---|---|---|---|", flush=True)


def compare_writers(path: Path, megabytes: float, samples: int, repeats: int) -> None:
    """Write the run with every writer, print the table of rates and leave the run file at ``path``."""
    import hpe_rig as hpe
    from hpe_rig.measurement import prepare

    pulses = BLOCK_RECORDS * max(1, round(megabytes * 1e6 / (2 * samples * BLOCK_RECORDS)))
    keys = {"tracking.pulse_count": pulses, "acquisition.record_samples": samples}
    setup = prepare(hpe.load_scene("table-1").with_(keys), refuse=False)
    size_mb = pulses * samples * 2 / 1e6
    writers = WRITERS if repeats else WRITERS[:1]
    elapsed_s, processor_s = defaultdict[str, list[float]](list), defaultdict[str, list[float]](list)
    for _ in range(max(1, repeats)):
        for writer in writers:
            target = path if writer == "writer" else path.with_name("plain.h5")
            target.unlink(missing_ok=True)
            start_s, start_processor_s = time.perf_counter(), time.process_time()
            if writer == "writer":
                write_run(setup, target)
            else:
                write_plain(setup, target, chunks_of(path), checksums=writer != "plain")
            elapsed_s[writer].append(time.perf_counter() - start_s)
            processor_s[writer].append(time.process_time() - start_processor_s)
    best_s = {writer: min(times_s) for writer, times_s in elapsed_s.items()}
    print(f"| {size_mb:.0f} MB, best of {repeats} | MB/s | over plain h5py | processor, s |\n|---|---|---|---|")
    for writer, time_s in best_s.items():
        ratio = f"{best_s['plain'] / time_s:.2f}" if repeats else ""
        print(f"| {writer} | {size_mb / time_s:.0f} | {ratio} | {min(processor_s[writer]):.2f} |", flush=True)


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


def write_run(setup: Setup, path: Path) -> None:
    """Write a run file of one shot with the program's own writer."""
    from hpe_rig.store import RunWriter

    with RunWriter(path, setup.scene, setup.bench, setup.plan) as writer:
        for block in record_blocks(setup):
            writer.append(setup.plan.shots[0], block)
        writer.finish(setup.plan.shots[0])


def chunks_of(path: Path) -> tuple[int, int, int]:
    """Return the chunk shape (shot, record, sample) of the records in a run file."""
    import h5py

    with h5py.File(path) as file:
        return file["records/echo"].chunks


def write_plain(setup: Setup, path: Path, chunks: tuple[int, int, int], *, checksums: bool) -> None:
    """Write the same records with h5py, whole chunks at a time, flushed after each."""
    from hashlib import blake2b

    import h5py
    import numpy as np

    capture = setup.plan.shots[0].capture
    shape = (1, capture.record_count, capture.record_samples)
    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        echo = file.create_dataset("echo", shape, "<i2", chunks=chunks)
        sums = file.create_dataset("sums", (-(-shape[1] // chunks[1]),), "<u8")
        buffer = np.empty(chunks[1:], "<i2")
        for block in record_blocks(setup):
            done = 0
            while done < BLOCK_RECORDS:
                # Blocks and chunks have different lengths: copy up to the end of either.
                first = block.first_record + done
                row = first % len(buffer)
                count = min(len(buffer) - row, BLOCK_RECORDS - done)
                buffer[row : row + count] = block.codes[done : done + count]
                done += count
                if row + count == len(buffer) or first + count == shape[1]:
                    number = first // len(buffer)
                    echo.id.write_direct_chunk((0, number * len(buffer), 0), buffer)
                    if checksums:
                        sums[number] = int.from_bytes(blake2b(buffer, digest_size=8).digest(), "little")
                    file.flush()


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
