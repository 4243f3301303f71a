"""Cut the power at every moment of a command and check the files on the disk. Linux, needs cc.

    python scripts/robustness/power_loss.py [--states 3000] [--scenarios plain resumed ...]

Every write, truncation, sync, rename and folder sync of a command is recorded (disk_trace.c). A state of the disk after
a power loss has everything before the last sync of each file, any later writes of it, and a file name is certain only
after a sync of its folder. Unsynced writes are torn at sectors of 512 or 4096 bytes. In each state:

* A shot that the program had announced as stored is in the file, equal bit for bit, and no record differs.
* A run can be read as soon as its first step was announced. `resume` continues after its stored shots. The log of the
  run becomes an HDF5 file with the same content.
* Every other file (results, pages, queues, tables) is absent, or is one of its versions, whole; after the end of the
  command it is the last version.

The exit code is 0 if no state breaks a rule.
"""

from __future__ import annotations

import argparse
import ctypes
import io
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from unittest.mock import patch

import numpy as np
from edited_scenes import prepare_edited

from hpe_rig.cli import main as main_command
from hpe_rig.measurement import Progress, Setup, Step, prepare_resumption, record_run, resume
from hpe_rig.plan import PlanError
from hpe_rig.report import write_report
from hpe_rig.runs import import_records, process
from hpe_rig.scene import SettingsError
from hpe_rig.store import StoreError, WriteOptions, read_run, read_snapshots, recover, verify

EVENT = struct.Struct("<8sQQQII")
"""Kind, inode, offset, size of the data, lengths of both paths; as in disk_trace.c."""
SECTORS = (512, 4096)
END = -1
"""Mark at the end of a command. The other marks are numbers of shots that are stored."""
RECOVER_EVERY, RESUME_EVERY = 3, 100
"""A log becomes an HDF5 file, and a run is resumed, in every n-th state: both take long."""
SCENE = ("table-1", ("pulse_count = 101", "pulse_count = 24"))
STUDY = """title = "one case"
scene = "table-1"
scatterers = 8
[set]
"tracking.pulse_count" = 40
[[axes]]
name = "D_0"
keys = { "simulation.motion[0].amplitude_m" = [1e-6] }
"""


def shots(count: int) -> Setup:
    """Prepare a measurement of ``count`` small shots on the simulated bench."""
    return prepare_edited(*SCENE, ("[acquisition]", f"[acquisition]\nrepeats = {count}\nrecord_samples = 256"))


# Commands, each in a folder that may hold files from before.


def measure(count: int, compress: bool = False, stop_in: int | None = None) -> Callable[[Path, Callable], None]:
    """Return a command that measures ``count`` shots and stops in shot ``stop_in``."""

    def command(folder: Path, mark: Callable[[int], None]) -> None:
        def observe(progress: Progress) -> None:
            # The first step of a shot follows the storage of the shot before.
            mark(progress.shot.index)
            if progress.shot.index == stop_in and progress.step is Step.COLLECT:
                raise KeyboardInterrupt

        try:
            record_run(shots(count), folder / "run.h5", observe, options=WriteOptions(compress))
        except KeyboardInterrupt:
            return

    return command


def resume_run(folder: Path, mark: Callable[[int], None]) -> None:
    resumption = prepare_resumption(folder / "earlier.h5")
    resume(resumption, folder / "run.h5", lambda progress: mark(progress.shot.index))


def import_run(folder: Path, mark: Callable[[int], None]) -> None:
    codes = np.random.default_rng(1).integers(-1000, 1000, (24, 9216), np.int16)
    setup = shots(1)
    (folder.parent / "scene.toml").write_text(setup.scene.text, encoding="utf-8")
    rates = {"sample_rate_hz": setup.plan.shots[0].capture.sample_rate_hz, "pulse_rate_hz": 4e3, "carrier_hz": 9e6}
    import_records(codes, str(folder.parent / "scene.toml"), folder / "run.h5", axes="pulse,sample", **rates)


def measure_queue(folder: Path, mark: Callable[[int], None]) -> None:
    scene = folder.parent / "small.toml"
    scene.write_text(shots(2).scene.text, encoding="utf-8")
    run_command("queue", str(scene), str(scene), "--output", str(folder / "queue"))


def run_study(folder: Path, mark: Callable[[int], None]) -> None:
    study = folder.parent / "small-study.toml"
    study.write_text(STUDY, encoding="utf-8")
    run_command("study", str(study), "--output", str(folder / "study"), "--workers", "1")


def run_command(*arguments: str) -> None:
    """Run a command of ``hpe-rig`` in this process; raise ``SystemExit`` with its exit code unless that is 0."""
    with patch.object(sys, "argv", ["hpe-rig", *arguments]), redirect_stdout(io.StringIO()):
        try:
            main_command()
        except SystemExit as end:
            if end.code:
                raise


@dataclass(frozen=True)
class Scenario:
    """A ``command`` and the content of the folder before it."""

    command: Callable[[Path, Callable[[int], None]], None]
    before: Callable[[Path], object] = lambda folder: None


def with_run(folder: Path) -> None:
    record_run(shots(2), folder / "earlier.h5")


def with_stopped_run(folder: Path) -> None:
    measure(6, stop_in=3)(folder, lambda shot: None)
    (folder / "run.h5").rename(folder / "earlier.h5")


def with_result(folder: Path) -> None:
    with_run(folder)
    process(folder / "earlier.h5")
    write_report(folder / "earlier.h5", output=folder / "page.html")


SCENARIOS = {
    "plain": Scenario(measure(6)),
    "compressed": Scenario(measure(6, compress=True)),
    "sixty": Scenario(measure(60)),
    "stopped": Scenario(measure(6, stop_in=3)),
    "resumed": Scenario(resume_run, with_stopped_run),
    "imported": Scenario(import_run),
    "result": Scenario(lambda folder, mark: process(folder / "earlier.h5"), with_result),
    "report": Scenario(
        lambda folder, mark: write_report(folder / "earlier.h5", output=folder / "page.html"), with_result
    ),
    "queue": Scenario(measure_queue),
    "study": Scenario(run_study),
}


# The trace of a command, and states of the disk.


@dataclass(frozen=True)
class Event:
    """A change of a file, by ``inode``, or of a name; ``mark``: number of shots stored, or ``END``."""

    kind: str
    inode: int
    offset: int
    data: bytes
    path: str
    second: str


@dataclass
class Disk:
    """Content of files by inode, and inodes by path."""

    files: dict[int, bytearray] = field(default_factory=dict)
    names: dict[str, int] = field(default_factory=dict)

    def copy(self) -> Disk:
        return Disk({inode: bytearray(content) for inode, content in self.files.items()}, dict(self.names))

    def change(self, event: Event, data: bytes | None = None, offset: int = 0) -> None:
        """Apply a write, with part of its data if given, or a truncation."""
        content = self.files.setdefault(event.inode, bytearray())
        if event.kind == "cut":
            content[:] = content[: event.offset].ljust(event.offset, b"\0")
            return
        data, start = (event.data, event.offset) if data is None else (data, event.offset + offset)
        content.extend(bytes(max(0, start + len(data) - len(content))))
        content[start : start + len(data)] = data

    def rename(self, event: Event) -> None:
        """Apply a change of a name."""
        if event.kind == "create":
            self.names[event.path] = event.inode
        elif event.kind == "unlink":
            self.names.pop(event.path, None)
        elif event.path in self.names:
            self.names[event.second] = self.names[event.path]
            if event.kind == "rename":
                del self.names[event.path]


NAMES = ("create", "unlink", "rename", "link")
DATA = ("write", "cut")


def trace(scenario: Scenario, folder: Path, file: Path, library: ctypes.CDLL) -> tuple[Disk, list[Event]]:
    """Run the command of ``scenario`` in ``folder``; return the disk before it and its events."""
    folder.mkdir()
    scenario.before(folder)
    before = Disk()
    for path in folder.rglob("*"):
        if path.is_file():
            before.names[str(path)] = path.stat().st_ino
            before.files[path.stat().st_ino] = bytearray(path.read_bytes())
    pid = os.fork()
    if pid == 0:
        library.disk_trace_start(os.fsencode(folder), os.fsencode(file))
        try:
            scenario.command(folder, library.disk_trace_mark)
            library.disk_trace_mark(END)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    if os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]):
        raise SystemExit("the undisturbed command failed")
    return before, list(events(file.read_bytes()))


def events(data: bytes) -> Iterator[Event]:
    """Yield the events of a trace."""
    position = 0
    while position < len(data):
        kind, inode, offset, size, *lengths = EVENT.unpack_from(data, position)
        position += EVENT.size
        paths = []
        for length in lengths:
            paths.append(os.fsdecode(data[position : position + length]))
            position += length
        kind = kind.rstrip(b"\0").decode()
        content = data[position : position + size] if kind == "write" else b""
        position += len(content)
        yield Event(kind, inode, offset, content, *paths)


def versions(before: Disk, trace: list[Event]) -> dict[str, list[bytes]]:
    """Return the contents that each path had after its renames, in order."""
    disk = before.copy()
    contents = {path: [bytes(disk.files[inode])] for path, inode in disk.names.items()}
    for event in trace:
        if event.kind in DATA:
            disk.change(event)
        elif event.kind in NAMES:
            disk.rename(event)
            if event.kind in ("rename", "link"):
                contents.setdefault(event.second, []).append(bytes(disk.files[disk.names[event.second]]))
    return contents


def after_power_loss(before: Disk, trace: list[Event], rng: np.random.Generator) -> Disk:
    """Return a state of the disk after a power loss at the end of ``trace``."""
    disk = before.copy()
    synced = {event.inode: number for number, event in enumerate(trace) if event.kind == "sync"}
    folders = {event.path.rstrip("/"): number for number, event in enumerate(trace) if event.kind == "sync"}
    sector = int(rng.choice(SECTORS))
    # The chance of a later write to be on the disk differs from state to state.
    chance = float(rng.choice([0.0, 0.5, 0.9, 1.0]))
    unsynced = [n for n, event in enumerate(trace) if event.kind in NAMES and n > folders.get(folder_of(event), -1)]
    last_name = int(rng.choice([*unsynced, len(trace)])) if unsynced else len(trace)
    for number, event in enumerate(trace):
        if event.kind in NAMES and (number not in unsynced or number < last_name):
            disk.rename(event)
        elif event.kind in DATA and (
            number < synced.get(event.inode, -1) or (event.kind == "cut" and rng.random() < chance)
        ):
            disk.change(event)
        elif event.kind == "write":
            _write_sectors(disk, event, sector, lambda: bool(rng.random() < chance))
    return disk


def _write_sectors(disk: Disk, event: Event, sector: int, is_written: Callable[[], bool]) -> None:
    """Apply a write to those sectors of the file, not of the write, for which ``is_written()`` is true."""
    for start in range(-(event.offset % sector), len(event.data), sector):
        if is_written():
            disk.change(event, event.data[max(0, start) : start + sector], max(0, start))


def folder_of(event: Event) -> str:
    return str(Path(event.second or event.path).parent)


# Checks of a state.


def problems_of(folder: Path, disk: Disk, stored: int, expected: dict[str, list[bytes]], number: int) -> list[str]:
    """Return each violation of a rule in the state ``disk`` with the last mark ``stored``."""
    shutil.rmtree(folder, ignore_errors=True)
    problems = []
    for path, inode in disk.names.items():
        target = Path(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(disk.files.get(inode, b""))
    for path, contents in expected.items():
        target = Path(path)
        if target.name.startswith("."):
            continue
        if not target.exists():
            # From before the command, or announced: its end, or the first step of a run.
            must_exist = target.name == "earlier.h5" or stored == END or (target.name == "run.h5" and stored >= 0)
            problems += [f"{target.name} is absent"] if must_exist else []
        elif contents[-1][:4] == b"\x89HDF" and target.name.count(".") == 1 and target.name != "earlier.h5":
            problems += run_problems(
                target, contents[-1], stored if target.name == "run.h5" else min(stored, 0), number
            )
        elif target.read_bytes() not in (contents[-1:] if stored == END else contents):
            problems.append(f"{target.name} is none of its versions")
    return problems


def run_problems(path: Path, final: bytes, stored: int, number: int) -> list[str]:
    """Return the differences of the run ``path`` from ``final``, its file after the undisturbed command."""
    reference_path = path.with_name("reference")
    reference_path.write_bytes(final)
    try:
        problems = list(differences(path, reference_path, stored))
        if not problems and number % RESUME_EVERY == 0 and not read_run(path).shot_complete.all():
            resumed = resume(prepare_resumption(path), path.with_name("resumed.h5"))
            problems += [f"resumed: {text}" for text in differences(resumed, reference_path, END)]
        if not problems and number % RECOVER_EVERY == 0:
            problems += [f"opened: {text}" for text in recovery(path, reference_path, stored)]
    except (StoreError, SettingsError, PlanError) as error:
        # An imported run cannot be resumed.
        return [] if "was imported from" in str(error) else [f"{path.name}: {error}"]
    return problems


def recovery(path: Path, reference: Path, stored: int) -> Iterator[str]:
    """Make an HDF5 file of the log, as opening the run does, and yield its differences and damage."""
    recover(path)
    yield from differences(path, reference, stored)
    if path.read_bytes()[:4] == b"\x89HDF":
        yield from (str(damage) for damage in verify(path).damage)


def differences(path: Path, reference_path: Path, stored: int) -> Iterator[str]:
    """Yield differences of the run ``path`` from the undisturbed one, which has at least ``stored`` shots."""
    run, reference = read_run(path), read_run(reference_path)
    complete = int(run.shot_complete.sum())
    if stored == END and run.status != reference.status and "resumed" not in path.name:
        yield f"its status is {run.status}"
    announced = int(reference.shot_complete.sum()) if stored == END else stored
    if complete < announced:
        yield f"{complete} shots are stored, {announced} were announced"
    # A run that is resumed after a stop has settings of shots that the undisturbed, stopped run never began.
    settings, reference_settings = read_snapshots(path)[:complete], read_snapshots(reference_path)
    if settings[: len(reference_settings)] != reference_settings[:complete]:
        yield "settings differ"
    for shot in range(len(run.records)):
        records, expected = run.records[shot], reference.records[shot]
        valid = records.valid
        # Records of a shot that was not announced may be damaged, which readers report.
        damaged = np.zeros(0, bool) if records.damaged is None else records.damaged
        missing = expected.valid & ~valid & ~(damaged if shot >= announced else np.zeros_like(damaged))
        if shot < complete and missing.any():
            yield f"shot {shot + 1} misses records"
        if expected.valid.any() and not np.array_equal(records.codes[valid], expected.codes[valid]):
            yield f"shot {shot + 1} differs"


def check_states(name: str, count: int, folder: Path, library: ctypes.CDLL) -> tuple[Counter[str], int]:
    """Return the number of each broken rule in ``count`` states of a scenario, and the number of states."""
    before, recorded = trace(SCENARIOS[name], folder, folder.with_name("trace"), library)
    expected, rng = versions(before, recorded), np.random.default_rng(11)
    marks = list(
        accumulate((e.inode if e.kind == "mark" else None for e in recorded), lambda a, b: a if b is None else b)
    )
    broken: Counter[str] = Counter()
    moments = np.linspace(1, len(recorded), count).astype(int)
    for number, moment in enumerate(moments):
        mark = marks[moment - 1]
        stored = -2 if mark is None else END if mark == END % 2**64 else mark
        disk = after_power_loss(before, recorded[:moment], rng)
        for problem in problems_of(folder, disk, stored, expected, number):
            broken[problem] += 1
    return broken, len(moments)


def run_with_library(arguments: list[str]) -> int:
    """Run this script again with the library that records the disk, and return its exit code."""
    source = Path(__file__).with_name("disk_trace.c")
    with tempfile.TemporaryDirectory() as name:
        library = Path(name) / "disk_trace.so"
        subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl", "-lpthread"], check=True)
        command = [sys.executable, __file__, *arguments]
        return subprocess.run(command, env=os.environ | {"LD_PRELOAD": str(library)}, check=False).returncode


def main() -> int:
    """Check the states of every scenario and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--states", type=int, default=3000, help="states in all")
    parser.add_argument("--scenarios", nargs="+", choices=SCENARIOS, default=list(SCENARIOS))
    options = parser.parse_args()
    if "disk_trace" not in os.environ.get("LD_PRELOAD", ""):
        return run_with_library(sys.argv[1:])
    bad = 0
    for name in options.scenarios:
        with tempfile.TemporaryDirectory() as parent:
            folder = Path(parent).resolve() / "disk"
            broken, count = check_states(name, -(-options.states // len(options.scenarios)), folder, ctypes.CDLL(None))
        bad += broken.total()
        print(f"{name}: {count} states, {broken.total()} broken rules", flush=True)
        for problem, times in broken.most_common(10):
            print(f"    {times} times: {problem}", flush=True)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
