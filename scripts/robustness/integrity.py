"""What is lost, and what is said of it, when bytes flip, files are cut or lost, and disks fail: counts, as a table.

Usage: python scripts/robustness/integrity.py flips [--cases 1000]         one bit of a run file inverted
       python scripts/robustness/integrity.py truncations [--cases 400]    a run file cut at a random length
       python scripts/robustness/integrity.py faults [--every 1]           the n-th write, sync or truncation fails (cc; Linux)
       python scripts/robustness/integrity.py hangs [--every 12]           it never returns, and somebody presses Ctrl-C (the same)
       python scripts/robustness/integrity.py lost                         the file cut, removed, moved or replaced during a run
Each is done with plain and with compressed records. A change is silent where a result differs from that of the whole
file and nothing says so. The exit code is 0 where nothing was silent, crashed or hung.
"""

from __future__ import annotations

import argparse
import ctypes
import errno
import io
import itertools
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hpe_rig.measurement import Progress, Setup, Step, prepare_resumption, prepare_text, record_run, resume
from hpe_rig.plan import PlanError
from hpe_rig.runs import process
from hpe_rig.scene import SettingsError, shipped_scenes
from hpe_rig.store import StoreError, WriteOptions, read_run, verify

SMALL = (
    ("pulse_count = 101", "pulse_count = 48"),
    ("[acquisition]", "[acquisition]\nrepeats = 2\nrecord_samples = 256"),
)
MESSAGES = (StoreError, SettingsError, PlanError)
KINDS = {"plain": False, "compressed": True}
EXIT_INTERRUPTED = 130
CTRL_C_S = 1.0
"""How long a step has not returned when Ctrl-C comes."""
LONGEST_S = 60.0
"""A run of a second that takes longer hangs."""


def small_setup() -> Setup:
    """Return a measurement of two shots of 48 records, on the simulated bench."""
    text = shipped_scenes()["table-1"]
    for old, new in SMALL:
        if old not in text:
            raise SystemExit(f"the scene has no {old!r} any more")
        text = text.replace(old, new)
    return prepare_text("small", text)


def table(path: Path) -> dict[str, Any]:
    """Return everything a result says but its file's name and the time it took."""
    result = process(path).as_dict()
    return {key: value for key, value in result.items() if key not in ("run_file", "run_time_s")}


def outcome(path: Path, whole: dict[str, Any]) -> str:
    """Return what becomes of a damaged file: a message, a result that says what is missing, the same, or silence."""
    try:
        found = table(path)
    except MESSAGES:
        return "refused with a message"
    if found == whole:
        return "same result"
    said = [*found["warnings"], *(warning for shot in found["shots"] for warning in shot["warnings"])]
    if any("checksum" in text or "cut short" in text or "damaged" in text for text in said):
        return "result without what is damaged, said so"
    return "SILENT"


def damaged(kind: str, cases: int, damage: Callable[[bytearray, np.random.Generator], None]) -> Counter[str]:
    """Return how often each outcome came of ``cases`` damaged copies of one run file."""
    outcomes: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        path = record_run(small_setup(), Path(name) / "run.h5", options=WriteOptions(compress=KINDS[kind]))
        data, whole, rng = path.read_bytes(), table(path), np.random.default_rng(7)
        for _ in range(cases):
            copy = bytearray(data)
            damage(copy, rng)
            path.write_bytes(copy)
            found = outcome(path, whole)
            outcomes[found] += 1
            outcomes["found by verify"] += found_by_verify(path)
            if found == "SILENT":
                pairs = enumerate(zip(data, copy, strict=False))
                where = next((place for place, (old, new) in pairs if old != new), len(copy))
                print(f"silent: byte {where} of {len(data)}", file=sys.stderr)
    return outcomes


def found_by_verify(path: Path) -> bool:
    """Return whether ``verify`` finds the file damaged or refuses it."""
    try:
        return bool(verify(path).damage)
    except StoreError:
        return True


def flip(data: bytearray, rng: np.random.Generator) -> None:
    """Invert one bit."""
    data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))


def cut(data: bytearray, rng: np.random.Generator) -> None:
    """Cut the end off."""
    del data[int(rng.integers(len(data))) :]


def faults(kind: str, every: int) -> Counter[str]:
    """Return how runs ended whose n-th step on the disk failed; this process has ``disk_faults.c`` preloaded."""
    library = ctypes.CDLL(None)
    setup, outcomes = small_setup(), Counter[str]()
    # Removed at the end alone, since the copies of this process unwind as well.
    folder = Path(tempfile.mkdtemp()).resolve()
    whole = record_run(setup, folder / "whole.h5")
    steps = steps_of(setup, folder, KINDS[kind], library)
    for code, on, number in itertools.product((errno.EIO, errno.ENOSPC), (0, 1), range(1, steps + 1, every)):
        arm = partial(library.disk_faults_arm, str(folder / "disk").encode(), number, on, code, 0)
        found = one_fault(setup, folder, KINDS[kind], whole, arm)
        outcomes[found] += 1
        if found not in GOOD:
            print(f"{kind}, step {number} of {steps}, {errno.errorcode[code]}, {on=}: {found}", file=sys.stderr)
    shutil.rmtree(folder)
    return outcomes


def hangs(kind: str, every: int) -> Counter[str]:
    """Return how runs ended whose n-th step on the disk never returned, when Ctrl-C came ``CTRL_C_S`` later."""
    library, setup, outcomes = ctypes.CDLL(None), small_setup(), Counter[str]()
    folder = Path(tempfile.mkdtemp()).resolve()
    steps = steps_of(setup, folder, KINDS[kind], library)
    # Without those before the bench is opened, and those that close the run file, for which it waits 60 s; the last
    # two are the result's.
    for number in (*range(3, steps - 8, every), steps - 1, steps):
        (folder / "disk").mkdir()
        code = in_child(partial(hang, setup, folder / "disk", KINDS[kind], library, number), folder / "said")
        said = (folder / "said").read_text()
        after_s = float(said.partition("safe after ")[2].split()[0]) if "safe after" in said else math.inf
        good = code == EXIT_INTERRUPTED and after_s < 2 and "outputs on" not in said
        outcomes["exit 130, outputs off within 2 s" if good else f"HANG, exit {code}: {said[-300:]!r}"] += 1
        shutil.rmtree(folder / "disk")
    shutil.rmtree(folder)
    return outcomes


def hang(setup: Setup, disk: Path, compress: bool, library: ctypes.CDLL, number: int) -> None:
    """Measure onto a disk whose step ``number`` never returns, interrupted ``CTRL_C_S`` later as by Ctrl-C."""
    met_s: list[float] = []

    def look(*_: object) -> None:
        # By the disk's own count: how long a run takes to come so far depends on what else the machine does.
        if library.disk_faults_count() >= number:
            met_s.append(time.monotonic())
        if met_s and not pressed_s and met_s[-1] - met_s[0] >= CTRL_C_S:
            signal.setitimer(signal.ITIMER_REAL, 0)
            pressed_s.append(met_s[-1])
            signal.raise_signal(signal.SIGINT)

    library.disk_faults_arm(str(disk).encode(), number, 0, 0, 1)
    signal.signal(signal.SIGALRM, look)
    signal.setitimer(signal.ITIMER_REAL, 0.1, 0.1)
    measure(setup, disk, compress)


pressed_s: list[float] = []
"""When this process, a copy that measures, was interrupted."""
NOT_REACHED = "no step failed"
GOOD = ("exit 2, message, file readable", "exit 2, message, no file", NOT_REACHED)


def steps_of(setup: Setup, folder: Path, compress: bool, library: ctypes.CDLL) -> int:
    """Return how many steps on the disk an undisturbed run takes."""
    counted = folder / "count"

    def child() -> None:
        library.disk_faults_arm(str(folder / "disk").encode(), 0, 0, 0, 0)
        measure(setup, folder / "disk", compress)
        counted.write_text(str(library.disk_faults_count()))

    (folder / "disk").mkdir()
    code = in_child(child, folder / "said")
    shutil.rmtree(folder / "disk")
    if code:
        raise SystemExit(f"the undisturbed run ended with {code}: {(folder / 'said').read_text()}")
    return int(counted.read_text())


def one_fault(setup: Setup, folder: Path, compress: bool, whole: Path, arm: Callable[[], object]) -> str:
    """Measure with a fault in a process that ends as any program does, and return how that went."""
    disk = folder / "disk"
    disk.mkdir()

    def child() -> None:
        arm()
        measure(setup, disk, compress)
        print(NOT_REACHED)

    code = in_child(child, folder / "said")
    said = (folder / "said").read_text()
    left = disk / "run.h5"
    try:
        if code < 0:
            return "HANG" if code == -9 else f"CRASH by signal {-code}"
        if code == 0 and said.endswith(f"{NOT_REACHED}\n"):
            # It synced once less than the run whose steps were counted, which took longer.
            return GOOD[2]
        if code != 2 or "Try:" not in said or "Traceback" in said or "outputs on" in said:
            return f"exit {code}: {said[-300:]!r}"
        if not left.exists():
            return GOOD[1]
        return GOOD[0] if holds_what_it_says(left, whole) else "FILE DAMAGED"
    except StoreError as error:
        return f"UNREADABLE: {error}"
    finally:
        shutil.rmtree(disk)


def measure(setup: Setup, disk: Path, compress: bool) -> None:
    """Measure and process as the command line does, and say so where an output stays on."""
    from hpe_rig import acquire, bench

    worlds: list[Any] = []
    opened = bench.open_bench

    @contextmanager
    def noted(*arguments: Any) -> Iterator[Any]:
        try:
            with opened(*arguments) as one:
                worlds.append(one.world)
                yield one
        finally:
            # Left in order, which proves every output off.
            print(f"safe after {time.monotonic() - (pressed_s or [math.inf])[0]:.2f} s")

    vars(sys.modules[acquire.record_run.__module__])["open_bench"] = noted
    try:
        process(record_run(setup, disk / "run.h5", options=WriteOptions(compress)))
    except StoreError as error:
        print(f"hpe-rig: {error}")
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)
    finally:
        if any(on for world in worlds for on in world.outputs_on().values()):
            print("outputs on")


def in_child(child: Callable[[], None], said: Path) -> int:
    """Run ``child`` in a copy of this process, let that end with all that ends a program, and return its exit code."""
    pid = os.fork()
    if pid == 0:
        output = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1)
        os.dup2(output, 2)
        child()
        sys.exit(0)
    end_s = time.monotonic() + LONGEST_S
    while time.monotonic() < end_s:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    os.kill(pid, 9)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def holds_what_it_says(path: Path, whole: Path) -> bool:
    """Return whether every record in ``path`` is as in the whole run, and ``verify`` finds nothing wrong."""
    stored, expected = read_run(path), read_run(whole)
    if verify(path).damage or (stored.status == "complete" and not stored.shot_complete.all()):
        return False
    for here, there, complete in zip(stored.records, expected.records, stored.shot_complete, strict=True):
        if (complete and not here.valid.all()) or (here.codes[here.valid] != there.codes[here.valid]).any():
            return False
    return True


def lost(kind: str) -> Counter[str]:
    """Return how runs ended whose file was tampered with in the middle of a shot, or between two."""
    outcomes: Counter[str] = Counter()
    setup = small_setup()
    for what, harm in HARMS.items():
        for step in (Step.COLLECT, Step.CONFIGURE):
            with tempfile.TemporaryDirectory() as name:
                outcomes[f"{what}: {one_loss(setup, Path(name), KINDS[kind], harm, step)}"] += 1
    return outcomes


def one_loss(setup: Setup, folder: Path, compress: bool, harm: Callable[[Path], None], step: Step) -> str:
    """Measure, do ``harm`` to the file at ``step`` of the second shot, and return how the run ended and when."""
    path, harmed_s = folder / "run.h5", list[float]()

    def observe(progress: Progress) -> None:
        if progress.step is step and progress.shot.index == 1 and not harmed_s:
            harm(path)
            harmed_s.append(time.monotonic())

    try:
        record_run(setup, path, observe, options=WriteOptions(compress))
    except StoreError as error:
        took_s = time.monotonic() - harmed_s[0]
        return (
            f"noticed, outputs off {'within' if took_s < 2 else 'AFTER MORE THAN'} 2 s" if "Try:" in str(error) else "?"
        )
    return "SILENT"


def cut_in_place(path: Path) -> None:
    """Cut the file to 80 %."""
    os.truncate(path, int(path.stat().st_size * 0.8))


def replace_by_copy(path: Path) -> None:
    """Put another file, a copy of this one, in its place."""
    copy = path.with_name("copy.h5")
    shutil.copy(path, copy)
    copy.replace(path)


def append_to(path: Path) -> None:
    """Write behind the end of the file."""
    with path.open("ab") as file:
        file.write(b"x")


def overwrite_by_run(path: Path) -> None:
    """Try to measure another run into the same file."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        try:
            record_run(small_setup(), path, options=WriteOptions(overwrite=True))
        except StoreError:
            path.rename(path.with_name("refused.h5"))


def resume_from(path: Path) -> None:
    """Try to continue the run that goes on."""
    try:
        resume(prepare_resumption(path), path.with_name("resumed.h5"))
    except StoreError:
        path.rename(path.with_name("refused.h5"))


HARMS: dict[str, Callable[[Path], None]] = {
    "cut": cut_in_place,
    "removed": Path.unlink,
    "moved": lambda path: path.rename(path.with_name("moved.h5")) and None,
    "replaced": replace_by_copy,
    "appended to": append_to,
    "overwritten by another run: refused, then": overwrite_by_run,
    "resumed meanwhile: refused, then": resume_from,
}


def preloaded(arguments: list[str]) -> int:
    """Run this script again with the faulty disk preloaded, and return its exit code."""
    source = Path(__file__).with_name("disk_faults.c")
    with tempfile.TemporaryDirectory() as name:
        library = Path(name) / "disk_faults.so"
        subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
        command = [sys.executable, __file__, *arguments]
        return subprocess.run(command, env=os.environ | {"LD_PRELOAD": str(library)}, check=False).returncode


BAD = ("SILENT", "AFTER MORE", "HANG")


def main() -> int:
    """Do one of the five and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("flips", "truncations", "faults", "hangs", "lost"))
    parser.add_argument("--cases", type=int)
    parser.add_argument("--every", type=int)
    given = parser.parse_args()
    if given.what in ("faults", "hangs") and "disk_faults" not in os.environ.get("LD_PRELOAD", ""):
        return preloaded(sys.argv[1:])
    bad = 0
    for kind in KINDS:
        found = {
            "flips": lambda kind=kind: damaged(kind, given.cases or 1000, flip),
            "truncations": lambda kind=kind: damaged(kind, given.cases or 400, cut),
            "faults": lambda kind=kind: faults(kind, given.every or 1),
            "hangs": lambda kind=kind: hangs(kind, given.every or 12),
            "lost": lambda kind=kind: lost(kind),
        }[given.what]()
        print(
            f"{given.what}, {kind}: " + "; ".join(f"{count} {what}" for what, count in found.most_common()), flush=True
        )
        bad += sum(count for what, count in found.items() if given.what == "faults" and what not in GOOD)
        bad += sum(count for what, count in found.items() if any(word in what for word in BAD))
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
