"""Test run files at full size: runs far larger than memory, and disks that become full. Linux.

    python scripts/robustness/survival.py stream FOLDER --gigabytes 20
    python scripts/robustness/survival.py throughput FOLDER
    python scripts/robustness/survival.py full --sizes 50        (as root: mounts a tmpfs of each size)

stream      measures a simulated scene into FOLDER, prints resident memory as the file grows, then does `throughput`
throughput  writes the same records with the run file's writer and with plain h5py, without checksums and with the same
            checksums, alternately
full        measures onto each disk, moves the remaining file to a larger disk, resumes there, and compares the result
            with that of an undisturbed run
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import statistics
import subprocess
import tempfile
import time
from dataclasses import replace
from functools import partial
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
    """Write the same records with each writer alternately; print median and range of the rate, MB/s.

    Then the speed of the run file's writer relative to the others, medians over the rounds, by elapsed and by processor
    time. A busy machine changes the latter less.
    """
    setup = large_setup(gigabytes)
    # Every shot has the records of the first, so that computing echoes does not count.
    first = replace(setup.plan, shots=setup.plan.shots[:1])
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        blocks = [event.block for event in acquire(first, bench) if isinstance(event, ShotBlock)]
    writers = {
        "run file": write_run,
        "h5py, checksums": partial(write_plain, checksums=True),
        "plain h5py": write_plain,
    }
    elapsed_s, processor_s = ({name: list[float]() for name in writers} for _ in range(2))
    for _ in range(rounds):
        for name, write in writers.items():
            path = folder / "throughput.h5"
            start_s, start_processor_s = time.monotonic(), time.process_time()
            write(path, setup, blocks)
            elapsed_s[name].append(time.monotonic() - start_s)
            processor_s[name].append(time.process_time() - start_processor_s)
            path.unlink()
    megabytes = len(setup.plan.shots) * SHOT_BYTES / 1e6
    for name, times_s in elapsed_s.items():
        rate, low, high = (megabytes / statistic(times_s) for statistic in (statistics.median, max, min))
        print(f"{name:15}  {rate:6.0f} MB/s ({low:.0f} to {high:.0f}), {rounds} times {megabytes:.0f} MB, synced")
    for name in list(writers)[1:]:
        elapsed_ratio, processor_ratio = (
            statistics.median(np.array(times_s[name]) / np.array(times_s["run file"]))
            for times_s in (elapsed_s, processor_s)
        )
        print(f"run file over {name}: {elapsed_ratio:.2f} by elapsed time, {processor_ratio:.2f} by processor time")


def write_run(path: Path, setup: Setup, blocks: list[RecordBlock]) -> None:
    """Write every shot in blocks as from the digitizer, and print resident memory in the middle and at the end."""
    memory_mb = []
    with RunWriter(path, setup.scene, setup.bench, setup.plan) as writer:
        for shot in setup.plan.shots:
            for block in blocks:
                writer.append(shot, block)
            writer.finish(shot)
            memory_mb.append(resident_mb())
    print(
        f"run file: {memory_mb[len(memory_mb) // 2]:.0f} MB of memory in the middle, {memory_mb[-1]:.0f} MB at the end"
    )


def write_plain(path: Path, setup: Setup, blocks: list[RecordBlock], checksums: bool = False) -> None:
    """Write the same codes into one chunked dataset, without flushes between shots, synced at the end."""
    digests = []
    shots = len(setup.plan.shots)
    with h5py.File(path, "w", libver="v110") as file:
        echo = file.create_dataset("echo", (shots, RECORDS, SAMPLES), "<i2", chunks=(1, 50, SAMPLES))
        for shot in range(shots):
            for block in blocks:
                echo[shot, block.first_record : block.first_record + block.codes.shape[0]] = block.codes
                if checksums:
                    digests.append(hashlib.blake2b(block.codes.tobytes(), digest_size=8).digest())
        if checksums:
            file["checksum"] = np.frombuffer(b"".join(digests), "<u8")
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
