"""What a run file survives, at full size: a run far larger than memory may grow, and disks that are full.

Usage: python scripts/robustness/survival.py stream FOLDER --gigabytes 20
       python scripts/robustness/survival.py throughput FOLDER
       python scripts/robustness/survival.py full --sizes 50        (as root: mounts a tmpfs of each size)
`stream` measures a simulated scene into FOLDER, printing resident memory as the file grows, then does what
`throughput` does: write the same records with the run file's writer and with plain h5py, without checksums and with
the same checksums of the same bytes, in turns. `full` measures onto each disk, moves what is left to a larger one, goes
on there, and compares the table with that of an undisturbed run. Linux.
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
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np

from drivers.interfaces import RecordBlock
from hpe_rig.bench import open_bench
from hpe_rig.measurement import (
    Progress,
    Setup,
    ShotBlock,
    Step,
    acquire,
    prepare_resumption,
    prepare_text,
    record_run,
    resume,
)
from hpe_rig.runs import process
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import RunWriter, StoreError, read_run

LONG = (
    ("pulse_count = 101", "pulse_count = 500"),
    ("pulse_rate_hz = 4000.0", "pulse_rate_hz = 2000.0"),
    ("snr_db = 40.0", ""),
)
SHOT_BYTES = 500 * 10_000 * 2
SWEEP = (
    ("burst_length_s = 100e-6", "burst_length_s = [50e-6, 100e-6]"),
    ("burst_count = 20", "burst_count = 6"),
    ("window_start_s = 50e-3", ""),
    ("[acquisition]", "[acquisition]\nrepeats = 2"),
)


def edited(name: str, *edits: tuple[str, str]) -> Setup:
    """Return a shipped scene with pieces of its text replaced, prepared on the simulated bench."""
    text = shipped_scenes()[name]
    for old, new in edits:
        if old not in text:
            raise SystemExit(f"the scene {name} has no {old!r} any more")
        text = text.replace(old, new)
    return prepare_text(name, text)


def long_setup(gigabytes: float) -> Setup:
    """Return a measurement of so many gigabytes of records."""
    shots = round(gigabytes * 1e9 / SHOT_BYTES)
    return edited("table-1", *LONG, ("[acquisition]", f"[acquisition]\nrecord_samples = 10000\nrepeats = {shots}"))


def resident_mb() -> float:
    """Return how much of the machine's memory this process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def stream(folder: Path, gigabytes: float) -> None:
    """Measure, and print resident memory over time and at its highest."""
    setup, path = long_setup(gigabytes), folder / "stream.h5"
    start_s, seen_mb = time.monotonic(), []
    every = max(1, len(setup.plan.shots) // 20)

    def observe(progress: Progress) -> None:
        seen_mb.append(resident_mb())
        shot = progress.shot.index
        if progress.step is Step.SAFE and shot % every == 0:
            print(
                f"{time.monotonic() - start_s:8.1f} s  {(shot + 1) * SHOT_BYTES / 1e9:7.2f} GB  {seen_mb[-1]:6.1f} MB"
            )

    record_run(setup, path, observe)
    took_s, size = time.monotonic() - start_s, path.stat().st_size
    print(f"{size / 1e9:.2f} GB in {took_s:.0f} s, resident memory at most {max(seen_mb):.0f} MB")
    path.unlink()


def throughput(folder: Path, gigabytes: float = 1.0, rounds: int = 5) -> None:
    """Write the same records with the run file's writer and with plain h5py in turns; print median and range, MB/s.

    Plain h5py once without and once with the checksums that the run file has; then the run file's speed over that of
    the others, medians of the rounds, by the clock and by processor time, which a busy machine changes less.
    """
    setup = long_setup(gigabytes)
    first = replace(setup.plan, shots=setup.plan.shots[:1])
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        blocks = [event.block for event in acquire(first, bench) if isinstance(event, ShotBlock)]
    writers = {
        "run file": write_run,
        "h5py, checksums": partial(write_plain, checksums=True),
        "plain h5py": write_plain,
    }
    took_s, worked_s = ({name: list[float]() for name in writers} for _ in range(2))
    for _ in range(rounds):
        for name, write in writers.items():
            path = folder / "throughput.h5"
            start_s, begun_s = time.monotonic(), time.process_time()
            write(path, setup, blocks)
            took_s[name].append(time.monotonic() - start_s)
            worked_s[name].append(time.process_time() - begun_s)
            path.unlink()
    megabytes = len(setup.plan.shots) * SHOT_BYTES / 1e6
    for name, each_s in took_s.items():
        rate, low, high = (megabytes / value(each_s) for value in (statistics.median, max, min))
        print(f"{name:15}  {rate:6.0f} MB/s ({low:.0f} to {high:.0f}), {rounds} times {megabytes:.0f} MB, synced")
    for name in list(writers)[1:]:
        of_clock, of_processor = (
            statistics.median(other / own for own, other in zip(each["run file"], each[name], strict=True))
            for each in (took_s, worked_s)
        )
        print(f"run file over {name}: {of_clock:.2f} by the clock, {of_processor:.2f} by processor time")


def write_run(path: Path, setup: Setup, blocks: list[RecordBlock]) -> None:
    """Write every shot as the digitizer delivers it, and print resident memory in the middle and at the end."""
    held_mb = []
    with RunWriter(path, setup.scene, setup.bench, setup.plan) as writer:
        for shot in setup.plan.shots:
            for block in blocks:
                writer.append(shot, block)
            writer.finish(shot)
            held_mb.append(resident_mb())
    print(f"run file: {held_mb[len(held_mb) // 2]:.0f} MB of memory in the middle, {held_mb[-1]:.0f} MB at the end")


def write_plain(path: Path, setup: Setup, blocks: list[RecordBlock], checksums: bool = False) -> None:
    """Write the same codes into one chunked dataset, without marks, flushes or readers, synced at the end."""
    found = []
    shots = len(setup.plan.shots)
    with h5py.File(path, "w", libver="v110") as file:
        echo = file.create_dataset("echo", (shots, 500, 10_000), "<i2", chunks=(1, 50, 10_000))
        for shot in range(shots):
            for block in blocks:
                echo[shot, block.first_record : block.first_record + block.codes.shape[0]] = block.codes
                if checksums:
                    found.append(hashlib.blake2b(block.codes.tobytes(), digest_size=8).digest())
        if checksums:
            file["checksum"] = np.frombuffer(b"".join(found), "<u8")
        file.flush()
        os.fsync(file.id.get_vfd_handle())


def full(sizes: int) -> None:
    """Measure onto tmpfs disks of random sizes up to the run file's; raise where a record or the table is not kept."""
    setup = edited("bovine-muscle-synchronous", *SWEEP)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        whole_path = record_run(setup, folder / "whole.h5")
        whole, expected = read_run(whole_path), table(whole_path)
        refused, kept, records = 0, 0, 0
        for size in np.random.default_rng(3).uniform(0.01, 0.99, sizes) * whole_path.stat().st_size:
            left = on_small_disk(setup, folder, int(size))
            if left is None:
                refused += 1
                continue
            stored = read_run(left)
            for shot in range(len(whole.records)):
                here, there = stored.records[shot], whole.records[shot]
                np.testing.assert_array_equal(here.codes[here.valid], there.codes[here.valid])
                records += int(here.valid.sum())
            done = resume(prepare_resumption(left), folder / "resumed.h5")
            assert table(done) == expected
            kept += 1
            for path in (left, done, folder / "resumed.coherent.h5"):
                path.unlink()
        print(f"{sizes} disks: {refused} refused before a file was there, {kept} files kept, {records} records equal")


def on_small_disk(setup: Setup, folder: Path, size: int) -> Path | None:
    """Measure onto a tmpfs of ``size`` bytes and return what is left, moved off it; None where no file appeared."""
    disk = folder / "disk"
    disk.mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", disk], check=True)
    complaint = ""
    try:
        # Somebody else fills the disk while the run goes on: the check for room before it sees enough.
        with unchecked_room():
            record_run(setup, disk / "run.h5")
    except StoreError as error:
        complaint = str(error)
    try:
        assert "No space left on device" in complaint, complaint or f"a disk of {size} bytes held the run"
        assert "Try:" in complaint, complaint
        left = disk / "run.h5"
        assert sorted(disk.iterdir()) == ([left] if left.exists() else []), "something was left behind"
        if not left.exists():
            return None
        assert read_run(left).status == "failed"
        return Path(shutil.copy(left, folder / "left.h5"))
    finally:
        subprocess.run(["umount", disk], check=True)


@contextmanager
def unchecked_room() -> Iterator[None]:
    """Let the check for room before a run see a large disk."""
    usage = shutil.disk_usage
    shutil.disk_usage = lambda path: usage(path)._replace(free=1 << 40)
    try:
        yield
    finally:
        shutil.disk_usage = usage


def table(path: Path) -> dict[str, object]:
    """Return everything a result says but its file's name and the time it took."""
    result = process(path).as_dict()
    return {key: value for key, value in result.items() if key not in ("run_file", "run_time_s")}


def main() -> None:
    """Run one of the three."""
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
    given = parser.parse_args()
    match given.command:
        case "full":
            full(given.sizes)
        case "stream":
            stream(given.folder, given.gigabytes)
            throughput(given.folder)
        case "throughput":
            throughput(given.folder, given.gigabytes, given.rounds)


if __name__ == "__main__":
    main()
