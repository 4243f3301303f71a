"""Test run files at full size: runs far larger than memory, and disks that become full. Linux.

    python scripts/robustness/survival.py stream FOLDER --gigabytes 20
    python scripts/robustness/survival.py throughput FOLDER
    python scripts/robustness/survival.py full --sizes 50        (as root: mounts a tmpfs of each size)

stream      measures a simulated scene into FOLDER, prints resident memory as the file grows, then does `throughput`
throughput  appends records to the log of a run, makes the run file from it, and writes the same records with plain h5py
            and its checksum Fletcher-32, alternately
full        measures onto each disk, moves the remaining file to a larger disk, resumes there, and compares the result
            with that of an undisturbed run
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import h5py
import numpy as np
from edited_scenes import prepare_edited, result_table

from drivers.interfaces import RecordBlock
from hpe_rig.bench import open_bench
from hpe_rig.measurement import Progress, Setup, ShotBlock, Step, acquire, prepare_resumption, record_run, resume
from hpe_rig.store import RunWriter, StoreError, read_run

RECORDS, SAMPLES = 500, 10_000
SHOT_BYTES = RECORDS * SAMPLES * 2
LONG_SHOTS = (
    ("pulse_count = 101", f"pulse_count = {RECORDS}"),
    ("pulse_rate_hz = 4000.0", "pulse_rate_hz = 2000.0"),
    ("snr_db = 40.0", ""),
)
FOUR_SHOTS = (
    ("burst_length_s = 100e-6", "burst_length_s = [50e-6, 100e-6]"),
    ("burst_count = 20", "burst_count = 6"),
    ("window_start_s = 50e-3", ""),
    ("[acquisition]", "[acquisition]\nrepeats = 2"),
)


def large_setup(gigabytes: float) -> Setup:
    """Prepare a measurement with this size of records."""
    shots = round(gigabytes * 1e9 / SHOT_BYTES)
    acquisition = f"[acquisition]\nrecord_samples = {SAMPLES}\nrepeats = {shots}"
    return prepare_edited("table-1", *LONG_SHOTS, ("[acquisition]", acquisition))


def resident_mb() -> float:
    """Return the resident memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def stream(folder: Path, gigabytes: float) -> None:
    """Measure, and print resident memory over time and its maximum."""
    setup, path = large_setup(gigabytes), folder / "stream.h5"
    start_s, memory_mb = time.monotonic(), []
    shots_per_line = max(1, len(setup.plan.shots) // 20)

    def observe(progress: Progress) -> None:
        memory_mb.append(resident_mb())
        shot = progress.shot.index
        if progress.step is Step.SAFE and shot % shots_per_line == 0:
            written_gb = (shot + 1) * SHOT_BYTES / 1e9
            print(f"{time.monotonic() - start_s:8.1f} s  {written_gb:7.2f} GB  {memory_mb[-1]:6.1f} MB")

    record_run(setup, path, observe)
    elapsed_s, size = time.monotonic() - start_s, path.stat().st_size
    print(f"{size / 1e9:.2f} GB in {elapsed_s:.0f} s, resident memory at most {max(memory_mb):.0f} MB")
    path.unlink()


def throughput(folder: Path, gigabytes: float = 1.0, rounds: int = 5) -> None:
    """Append records to a log, make the run file, and write them with h5py; print median and range of each rate, MB/s.

    Then the rate of making the run file relative to plain h5py, by elapsed and by processor time. A busy machine
    changes the latter less.
    """
    setup = large_setup(gigabytes)
    # Every shot has the records of the first, so that computing echoes does not count.
    first = replace(setup.plan, shots=setup.plan.shots[:1])
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        blocks = [event.block for event in acquire(first, bench) if isinstance(event, ShotBlock)]
    elapsed_s, processor_s = (defaultdict[str, list[float]](list) for _ in range(2))

    @contextmanager
    def timed(name: str) -> Iterator[None]:
        start_s, start_processor_s = time.monotonic(), time.process_time()
        yield
        elapsed_s[name].append(time.monotonic() - start_s)
        processor_s[name].append(time.process_time() - start_processor_s)

    for _ in range(rounds):
        path = folder / "throughput.h5"
        with ExitStack() as stack:
            with timed("log, synced after each shot"):
                writer = stack.enter_context(RunWriter(path, setup.scene, setup.bench, setup.plan))
                for shot in setup.plan.shots:
                    for block in blocks:
                        writer.append(shot, block)
                    writer.finish(shot)
            with timed("run file from the log"):
                stack.close()
        path.unlink()
        with timed("plain h5py, Fletcher-32"):
            write_plain(path, setup, blocks)
        path.unlink()
    megabytes = len(setup.plan.shots) * SHOT_BYTES / 1e6
    for name, times_s in elapsed_s.items():
        rate, low, high = (megabytes / statistic(times_s) for statistic in (statistics.median, max, min))
        print(f"{name:27}  {rate:6.0f} MB/s ({low:.0f} to {high:.0f}), {rounds} times {megabytes:.0f} MB, synced")
    _, ours, plain = elapsed_s
    ratios = [statistics.median(np.array(times[plain]) / np.array(times[ours])) for times in (elapsed_s, processor_s)]
    print(f"{ours} over {plain}: {ratios[0]:.2f} by elapsed time, {ratios[1]:.2f} by processor time")
    print(f"resident memory {resident_mb():.0f} MB")


def write_plain(path: Path, setup: Setup, blocks: list[RecordBlock]) -> None:
    """Write the same codes into one chunked dataset, without flushes between shots, synced at the end."""
    shots = len(setup.plan.shots)
    with h5py.File(path, "w", libver="v110") as file:
        shape, chunks = (shots, RECORDS, SAMPLES), (1, 50, SAMPLES)
        echo = file.create_dataset("echo", shape, "<i2", chunks=chunks, fletcher32=True, fillvalue=-32768)
        for shot in range(shots):
            for block in blocks:
                echo[shot, block.first_record : block.first_record + block.codes.shape[0]] = block.codes
        file.flush()
        os.fsync(file.id.get_vfd_handle())


def full(sizes: int) -> None:
    """Measure onto disks of random sizes up to the run file's; fail if a record or the result differs."""
    setup = prepare_edited("bovine-muscle-synchronous", *FOUR_SHOTS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        complete_path = record_run(setup, folder / "complete.h5")
        complete, expected = read_run(complete_path), result_table(complete_path)
        refused, partial_files, records = 0, 0, 0
        # A full disk stops the run somewhere between its first and last record.
        for size in np.random.default_rng(3).uniform(0.01, 0.99, sizes) * complete_path.stat().st_size:
            path = measure_onto_full_disk(setup, folder, int(size))
            if path is None:
                refused += 1
                continue
            stored = read_run(path)
            # The twin repeats its records, so every stored record has a reference.
            for shot in range(len(complete.records)):
                record, reference = stored.records[shot], complete.records[shot]
                np.testing.assert_array_equal(record.codes[record.valid], reference.codes[record.valid])
                records += int(record.valid.sum())
            resumed = resume(prepare_resumption(path), folder / "resumed.h5")
            assert result_table(resumed) == expected
            partial_files += 1
            for file in (path, resumed, folder / "resumed.coherent.h5"):
                file.unlink()
    print(
        f"{sizes} disks: {refused} refused before a file existed, {partial_files} files kept, {records} records equal"
    )


def measure_onto_full_disk(setup: Setup, folder: Path, size: int) -> Path | None:
    """Measure onto a tmpfs of ``size`` bytes; return a copy of the remaining file, or None if there is none."""
    disk = folder / "disk"
    disk.mkdir(exist_ok=True)
    disk_usage = shutil.disk_usage
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", disk], check=True)
    message = ""
    try:
        # The check for free space reports a large disk, as if another program filled the disk during the run.
        with patch("shutil.disk_usage", lambda path: disk_usage(path)._replace(free=1 << 40)):
            record_run(setup, disk / "run.h5")
    except StoreError as error:
        message = str(error)
    try:
        assert "No space left on device" in message, message or f"a disk of {size} bytes held the run"
        assert "Try:" in message, message
        path = disk / "run.h5"
        assert list(disk.iterdir()) in ([], [path]), "other files remain"
        if not path.exists():
            return None
        assert read_run(path).status == "failed"
        return Path(shutil.copy(path, folder / "partial.h5"))
    finally:
        subprocess.run(["umount", disk], check=True)


def main() -> None:
    """Run one of the three commands."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True, dest="command")
    streaming = commands.add_parser("stream")
    streaming.add_argument("folder", type=Path)
    streaming.add_argument("--gigabytes", type=float, default=20.0)
    writing = commands.add_parser("throughput")
    writing.add_argument("folder", type=Path)
    writing.add_argument("--gigabytes", type=float, default=1.0)
    writing.add_argument("--rounds", type=int, default=5)
    commands.add_parser("full").add_argument("--sizes", type=int, default=50)
    options = parser.parse_args()
    match options.command:
        case "full":
            full(options.sizes)
        case "stream":
            stream(options.folder, options.gigabytes)
            throughput(options.folder)
        case "throughput":
            throughput(options.folder, options.gigabytes, options.rounds)


if __name__ == "__main__":
    main()
