"""Streaming: the writer beside plain h5py, and processing of a run larger than the memory it takes.

Usage: python scripts/benchmarks/streaming.py [--megabytes 1000] [--samples 2048] [--repeats 3] [--folder FOLDER]

Records of one echo and noise, in blocks of 1000 as a board hands them over. Plain h5py writes the same chunks into a
file of the same format and flushes it after each, with and without a checksum of each. The ways take turns; the rate is
the best of each, by the clock; without ``--repeats`` (0) the writer alone writes, once. Then the run is processed in a
process of its own, beside one that only reads it, by plain h5py and with its checksums: clock, processor time and peak
memory of each, beyond what it takes to load the package (nothing).
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

if TYPE_CHECKING:
    from drivers.interfaces import RecordBlock
    from hpe_rig.measurement import Setup

AT_ONCE = 1000
CODES = 997
"""Blocks are cut at different places out of one array of so many records more than a block."""


def main() -> None:
    """Print rates of writing, then what reading and processing cost."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--megabytes", type=float, default=1000.0)
    parser.add_argument("--samples", type=int, default=2048, help="of a record")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--folder", type=Path, help="on the disk to be tried")
    parser.add_argument("--alone", nargs=2, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.alone and asked.alone[0] == "write":
        _write(Path(asked.alone[1]).parent, asked.megabytes, asked.samples, asked.repeats)
        return
    if asked.alone:
        _alone(asked.alone[0], Path(asked.alone[1]))
        return
    with tempfile.TemporaryDirectory(dir=asked.folder) as name:
        # A process of its own for the writing too: on Linux the peak of a process counts as one of those it starts.
        for what in ("write", "nothing", "plain read", "read", "process"):
            command = [sys.executable, __file__, "--alone", what, str(Path(name) / "run.h5")]
            sizes = ("megabytes", "samples", "repeats")
            subprocess.run([*command, *(f"--{each}={getattr(asked, each)}" for each in sizes)], check=True)
            if what == "write":
                print("\n| of that run | clock, s | processor, s | peak, MB |\n|---|---|---|---|", flush=True)


def _write(folder: Path, megabytes: float, samples: int, repeats: int) -> None:
    import hpe_rig as hpe
    from hpe_rig.measurement import prepare

    pulses = AT_ONCE * max(1, round(megabytes * 1e6 / (2 * samples * AT_ONCE)))
    keys = {"tracking.pulse_count": pulses, "acquisition.record_samples": samples}
    setup = prepare(hpe.load_scene("table-1").with_(keys), refuse=False)
    size_mb, taken, used = pulses * samples * 2 / 1e6, dict[str, list[float]](), dict[str, list[float]]()
    for _ in range(max(1, repeats)):
        for way in ("writer", "plain", "plain with checksums")[: 3 if repeats else 1]:
            path = folder / "run.h5"
            path.unlink(missing_ok=True)
            start_s, used_s = time.perf_counter(), time.process_time()
            if way == "writer":
                _by_writer(setup, path)
                path.replace(folder / "kept.h5")
            else:
                _plainly(setup, path, way != "plain")
            taken.setdefault(way, []).append(time.perf_counter() - start_s)
            used.setdefault(way, []).append(time.process_time() - used_s)
    (folder / "kept.h5").replace(folder / "run.h5")
    least = {way: min(each) for way, each in taken.items()}
    print(f"| {size_mb:.0f} MB, best of {repeats} | MB/s | over plain h5py | processor, s |\n|---|---|---|---|")
    for way, best_s in least.items():
        over = f"{least['plain'] / best_s:.2f}" if repeats else ""
        print(f"| {way} | {size_mb / best_s:.0f} | {over} | {min(used[way]):.2f} |", flush=True)


def _blocks(setup: Setup) -> Iterator[RecordBlock]:
    import numpy as np

    from drivers.interfaces import RecordBlock

    shot = setup.plan.shots[0]
    samples = np.arange(shot.capture.record_samples)
    turn = 2 * np.pi * setup.scene.scene.tracking.carrier_hz / shot.capture.sample_rate_hz * samples
    noise = np.random.default_rng(0).normal(0, 20, (AT_ONCE + CODES, samples.size))
    codes = (1000 * np.sin(turn) + noise).astype(np.int16)
    board = setup.bench.bench.digitizer.board_model
    limits = board.code_limits
    scale_v = 2 * shot.capture.input_range_v / (2 * limits[1] + 1)
    for first in range(0, shot.capture.record_count, AT_ONCE):
        place = first // AT_ONCE % CODES
        time_s = (first + np.arange(AT_ONCE)) / shot.tracking_train.rate_hz
        yield RecordBlock(first, codes[place : place + AT_ONCE], time_s, scale_v, scale_v / 2, limits)


def _by_writer(setup: Setup, path: Path) -> None:
    from hpe_rig.store import RunWriter

    with RunWriter(path, setup.scene, setup.bench, setup.plan) as writer:
        for block in _blocks(setup):
            writer.append(setup.plan.shots[0], block)
        writer.finish(setup.plan.shots[0])


def _plainly(setup: Setup, path: Path, checksums: bool) -> None:
    from hashlib import blake2b

    import h5py
    import numpy as np

    capture = setup.plan.shots[0].capture
    shape = (1, capture.record_count, capture.record_samples)
    with h5py.File(path.with_name("kept.h5")) as file:
        chunks = file["records/echo"].chunks
    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        echo = file.create_dataset("echo", shape, "<i2", chunks=chunks)
        sums = file.create_dataset("sums", (-(-shape[1] // echo.chunks[1]),), "<u8")
        held = np.empty(echo.chunks[1:], "<i2")
        for block in _blocks(setup):
            done = 0
            while done < AT_ONCE:
                first = block.first_record + done
                row, some = first % len(held), min(len(held) - first % len(held), AT_ONCE - done)
                held[row : row + some] = block.codes[done : done + some]
                done += some
                if row + some == len(held) or first + some == shape[1]:
                    number = first // len(held)
                    echo.id.write_direct_chunk((0, number * len(held), 0), held)
                    if checksums:
                        sums[number] = int.from_bytes(blake2b(held, digest_size=8).digest(), "little")
                    file.flush()


def _alone(what: str, path: Path) -> None:
    # Guarded, as it is not there on Windows.
    import resource

    from hpe_rig.runs import process
    from hpe_rig.store import read_run

    start_s = time.perf_counter()
    if what == "process":
        process(path)
    elif what == "plain read":
        import h5py

        with h5py.File(path) as file:
            echo = file["records/echo"]
            for first in range(0, echo.shape[1], echo.chunks[1]):
                echo[0, first : first + echo.chunks[1]]
    elif what == "read":
        # with its checksums, as processing reads it
        for _ in read_run(path).records.chunks(0, AT_ONCE):
            pass
    used = resource.getrusage(resource.RUSAGE_SELF)
    peak_mb = used.ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)
    wall_s = time.perf_counter() - start_s
    print(f"| {what} | {wall_s:.2f} | {used.ru_utime + used.ru_stime:.2f} | {peak_mb:.0f} |", flush=True)


if __name__ == "__main__":
    main()
